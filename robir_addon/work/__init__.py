# SPDX-License-Identifier: GPL-3.0-or-later
"""What works outside of Blender for the panels: processes, what they say, and how far they are."""
