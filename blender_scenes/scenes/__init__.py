# SPDX-License-Identifier: GPL-3.0-or-later
"""The scenes, one a file: `build(request, rng)` adds the objects to the open Blender file."""
