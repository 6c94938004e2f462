# SPDX-License-Identifier: GPL-3.0-or-later
"""Linear radiance to display codes, through the OpenColorIO configuration of the bpy wheel.

Equals Blender's own `save_render` with dither off to within rounding (0.5 of an 8-bit code).
"""

import functools

import numpy as np
import PyOpenColorIO

from blender_scenes.wheel import data_folder

VIEW_TRANSFORMS = ("Filmic", "Standard", "AgX", "Khronos PBR Neutral")


def display_from_linear(
    radiance_linear: np.ndarray, view_transform: str, exposure: float = 0.0
) -> np.ndarray:
    """Applies exposure and a Blender view transform for an sRGB display.

    Args:
        radiance_linear: (..., 3) linear Rec.709.
        view_transform: one of VIEW_TRANSFORMS.
        exposure: stops; the input is multiplied by 2**exposure.

    Returns:
        (..., 3) float32 display values, clipped to 0..1.
    """
    display = np.array(radiance_linear, dtype=np.float32, order="C", copy=True) * np.float32(
        2.0**exposure
    )
    _processor(view_transform).applyRGB(display.reshape(-1, 3))
    return np.clip(display, 0.0, 1.0)


def codes_from_display(display: np.ndarray) -> np.ndarray:
    """Rounds display values in 0..1 to 8-bit codes."""
    return np.round(display * 255.0).astype(np.uint8)


@functools.cache
def _processor(view_transform: str) -> PyOpenColorIO.CPUProcessor:
    config = PyOpenColorIO.Config.CreateFromFile(str(data_folder("colormanagement/config.ocio")))
    transform = PyOpenColorIO.DisplayViewTransform(
        src="Linear Rec.709", display="sRGB", view=view_transform
    )
    return config.getProcessor(transform).getDefaultCPUProcessor()
