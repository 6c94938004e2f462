# SPDX-License-Identifier: GPL-3.0-or-later
"""Linear radiance to display codes, as Blender shows it or as a measured camera does.

Blender's view transforms go through the OpenColorIO configuration of the bpy wheel, which equals
its own `save_render` with dither off to within rounding (0.5 of an 8-bit code).
"""

import functools

import numpy as np
import PyOpenColorIO

from blender_scenes.wheel import data_folder

MEASURED = "EMoR mean"
"""The mean of 201 measured responses of cameras and films, in each channel alone: the empirical
model of response of Grossberg and Nayar, "Modeling the Space of Camera Response Functions", IEEE
PAMI 26(10), 2004."""

VIEW_TRANSFORMS = ("Filmic", "Standard", "AgX", "Khronos PBR Neutral", MEASURED)

FILMIC_LOOKS = (
    "Very High Contrast", "High Contrast", "Medium High Contrast",
    "Medium Low Contrast", "Low Contrast", "Very Low Contrast",
)  # fmt: skip

_MEASURED_EXPONENT = (0.665, -1.123, 1.632, -0.896)
"""Our own fit to the published mean curve, within 0.002 of it: the display value is x to the power
of this polynomial in x, constant first, the form of Ng, Chang and Lin, "Using Geometry Invariants
for Camera Response Function Estimation", CVPR 2007."""


def display_from_linear(
    radiance_linear: np.ndarray,
    view_transform: str,
    exposure: float = 0.0,
    look: str | None = None,
) -> np.ndarray:
    """Applies exposure, a look and a view transform for an sRGB display.

    Args:
        radiance_linear: (..., 3) linear Rec.709.
        view_transform: one of VIEW_TRANSFORMS.
        exposure: stops; the input is multiplied by 2**exposure.
        look: None or one of FILMIC_LOOKS, with "Filmic" alone.

    Returns:
        (..., 3) float32 display values, clipped to 0..1.
    """
    display = np.array(radiance_linear, dtype=np.float32, order="C", copy=True) * np.float32(
        2.0**exposure
    )
    if view_transform == MEASURED:
        return measured_response(display)
    _processor(view_transform, look).applyRGB(display.reshape(-1, 3))
    return np.clip(display, 0.0, 1.0)


def measured_response(linear: np.ndarray) -> np.ndarray:
    """Display values of MEASURED; any shape, clips from 1 up."""
    x = np.clip(linear, 0.0, 1.0)
    return x ** np.polyval(_MEASURED_EXPONENT[::-1], x).astype(np.float32)


def codes_from_display(display: np.ndarray) -> np.ndarray:
    """Rounds display values in 0..1 to 8-bit codes."""
    return np.round(display * 255.0).astype(np.uint8)


@functools.cache
def _processor(view_transform: str, look: str | None) -> PyOpenColorIO.CPUProcessor:
    config = PyOpenColorIO.Config.CreateFromFile(str(data_folder("colormanagement/config.ocio")))
    group = PyOpenColorIO.GroupTransform()
    if look is not None:
        space = "Linear Rec.709"
        group.appendTransform(PyOpenColorIO.LookTransform(src=space, dst=space, looks=look))
    group.appendTransform(
        PyOpenColorIO.DisplayViewTransform(
            src="Linear Rec.709", display="sRGB", view=view_transform
        )
    )
    return config.getProcessor(group).getDefaultCPUProcessor()
