# SPDX-License-Identifier: Apache-2.0
"""View transforms against closed forms and against values measured from Blender's own output."""

import numpy as np
import pytest

from blender_scenes.view_transform import (
    MEASURED,
    display_from_linear,
)

# linear grey -> display value of a Cycles picture written by Blender 4.5
BLENDER = {
    "Filmic": {0.01: 0.1011, 0.18: 0.5002, 1.0: 0.8072, 8.0: 0.9832},
    "AgX": {0.18: 0.4613, 1.0: 0.7710},
    "Khronos PBR Neutral": {0.18: 0.4113, 1.0: 0.9364},
}


def grey(value: float) -> np.ndarray:
    return np.full((1, 3), value, dtype=np.float32)


def test_standard_is_the_srgb_transfer_function() -> None:
    linear = np.repeat(np.linspace(0.0, 1.2, 200, dtype=np.float32)[:, None], 3, axis=1)
    low, high = linear * 12.92, 1.055 * np.maximum(linear, 1e-9) ** (1 / 2.4) - 0.055
    expected = np.clip(np.where(linear <= 0.0031308, low, high), 0.0, 1.0)
    np.testing.assert_allclose(display_from_linear(linear, "Standard"), expected, atol=2e-4)


@pytest.mark.parametrize("name", BLENDER)
def test_curve_equals_the_renderers(name: str) -> None:
    for value, display in BLENDER[name].items():
        np.testing.assert_allclose(display_from_linear(grey(value), name), display, atol=3e-4)


def test_a_look_changes_contrast_about_middle_grey() -> None:
    """Display values measured from Blender 4.5's own pictures of a grey ramp."""
    for look, white in (("High Contrast", 0.8629), ("Low Contrast", 0.7550)):
        assert display_from_linear(grey(1.0), "Filmic", 0.0, look)[0, 0] == pytest.approx(
            white, abs=1e-3
        )
        assert display_from_linear(grey(0.18), "Filmic", 0.0, look)[0, 0] == pytest.approx(
            0.500, abs=2e-3
        )


def test_the_measured_response_is_the_published_mean_curve() -> None:
    """Values of the mean curve f0 of EMoR at irradiances k / 1023, as published."""
    published = {4: 0.0250, 16: 0.0680, 64: 0.1891, 128: 0.3197, 256: 0.5200, 512: 0.7581}
    for k, display in published.items():
        assert display_from_linear(grey(k / 1023), MEASURED)[0, 0] == pytest.approx(
            display, abs=2e-3
        )
    ramp = np.repeat(np.linspace(0.0, 1.3, 2000)[:, None], 3, axis=1)
    shown = display_from_linear(ramp, MEASURED)[:, 0]
    assert (np.diff(shown) >= 0.0).all()
    assert shown[0] == 0.0
    assert shown[-1] == 1.0
