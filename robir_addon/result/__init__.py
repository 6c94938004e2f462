# SPDX-License-Identifier: GPL-3.0-or-later
"""A result in the open file: its object, material, size and place, and what is shown of it."""
