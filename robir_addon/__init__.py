# SPDX-License-Identifier: GPL-3.0-or-later
"""RobIR in Blender: brings a result folder in as an object, its light and its cameras.

Importing this package has no side effects and needs no Blender; `importer` and `headless` do.
"""
