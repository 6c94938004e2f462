# SPDX-License-Identifier: Apache-2.0
"""RobIR: photographs in, a relightable asset out.

Posed photographs of an object under strong light, seen through an unknown tone curve, become a
UV-unwrapped mesh with shadow-free albedo, roughness, the light and the tone curve. This package is
the torch core; it never imports Blender.
"""

__version__ = "0.1.0"
