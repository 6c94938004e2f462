# SPDX-License-Identifier: GPL-3.0-or-later
"""Rendered captures with ground truth: `python -m blender_scenes SCENE OUT`.

The on-disk format is documented in `blender_scenes.format`. This package imports bpy (only while it
renders) and third-party libraries, and knows nothing of the reconstruction that reads its files.
"""
