# SPDX-License-Identifier: Apache-2.0
"""What the user takes away: asset, textures, light, tone curve, Blender scene and report."""
