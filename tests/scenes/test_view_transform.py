# SPDX-License-Identifier: Apache-2.0
"""View transforms against closed forms and against values measured from Blender's own output."""

import numpy as np
import pytest

from blender_scenes.view_transform import VIEW_TRANSFORMS, codes_from_display, display_from_linear

MEASURED = {
    "Filmic": {0.01: 0.1011, 0.18: 0.5002, 1.0: 0.8072, 8.0: 0.9832},
    "AgX": {0.18: 0.4613, 1.0: 0.7710},
    "Khronos PBR Neutral": {0.18: 0.4113, 1.0: 0.9364},
}
"""Linear grey -> display value of a Cycles picture written by Blender 4.5."""


def grey(value: float) -> np.ndarray:
    return np.full((1, 3), value, dtype=np.float32)


def test_standard_is_the_srgb_transfer_function() -> None:
    linear = np.repeat(np.linspace(0.0, 1.2, 200, dtype=np.float32)[:, None], 3, axis=1)
    low, high = linear * 12.92, 1.055 * np.maximum(linear, 1e-9) ** (1 / 2.4) - 0.055
    expected = np.clip(np.where(linear <= 0.0031308, low, high), 0.0, 1.0)
    np.testing.assert_allclose(display_from_linear(linear, "Standard"), expected, atol=2e-4)


@pytest.mark.parametrize("name", MEASURED)
def test_curve_equals_the_renderers(name: str) -> None:
    for value, display in MEASURED[name].items():
        np.testing.assert_allclose(display_from_linear(grey(value), name), display, atol=3e-4)


@pytest.mark.parametrize("name", VIEW_TRANSFORMS)
def test_exposure_scales_the_input(name: str) -> None:
    np.testing.assert_allclose(
        display_from_linear(grey(0.1), name, 1.5),
        display_from_linear(grey(0.1 * 2**1.5), name),
        atol=1e-6,
    )


def test_input_is_left_alone_and_codes_are_rounded() -> None:
    values = grey(0.25)
    display_from_linear(values, "Filmic", 1.0)
    assert (values == 0.25).all()
    assert codes_from_display(np.array([0.0, 0.499 / 255, 0.501 / 255, 1.0])).tolist() == [
        0,
        0,
        1,
        255,
    ]
