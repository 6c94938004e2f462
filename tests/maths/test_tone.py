# SPDX-License-Identifier: Apache-2.0
"""Tone curves against OpenColorIO with Blender's own configuration, and against closed forms."""

import csv
import importlib.util
from pathlib import Path

import numpy as np
import pytest
import torch

from blender_scenes.view_transform import measured_response
from robir.errors import ConfigError
from robir.maths import tone

VECTORS = Path(__file__).parents[2].parent / "shared" / "data" / "tone_vectors.csv"
BLENDER = [curve for curve in tone.families() if curve.blender_view_transform]
# Largest difference from Blender up to linear 8, in display code (0..1).
BARS = {"standard": 1e-4, "filmic": 2e-3, "agx": 4e-3, "khronos_pbr_neutral": 1e-3}


def identifier(curve: tone.AbstractToneCurve) -> str:
    return curve.name


def random_colours(count: int, low: float, high: float) -> torch.Tensor:
    generator = torch.Generator().manual_seed(0)
    return torch.exp2(low + (high - low) * torch.rand(count, 3, generator=generator))


@pytest.fixture(scope="session")
def blender():
    """Function from a view transform's name and colours to what Blender displays."""
    ocio = pytest.importorskip("PyOpenColorIO")
    found = importlib.util.find_spec("bpy")
    if found is None or found.origin is None:
        pytest.skip("TONE CURVES NOT CHECKED: the bpy wheel and its config.ocio are not installed")
    folder = Path(found.origin).parent
    config = ocio.Config.CreateFromFile(
        str(next(folder.glob("*/datafiles/colormanagement/config.ocio")))
    )

    def display(view: str, linear: torch.Tensor) -> torch.Tensor:
        group = ocio.GroupTransform()
        group.appendTransform(
            ocio.DisplayViewTransform(src="Linear Rec.709", display="sRGB", view=view)
        )
        pixels = np.ascontiguousarray(linear.numpy(), dtype=np.float32).copy()
        config.getProcessor(group).getDefaultCPUProcessor().applyRGB(pixels)
        return torch.from_numpy(pixels).clamp(0.0, 1.0)

    return display


@pytest.mark.parametrize("curve", BLENDER, ids=identifier)
def test_display_is_blenders(curve, blender):
    linear = random_colours(50_000, -8.0, 3.0)
    shown = blender(curve.blender_view_transform, linear)
    error = (curve.display_from_linear(linear) - shown).abs()
    assert error.max() < BARS[curve.name]
    assert error.mean() < 4e-4


def test_agx_is_blenders_up_to_white_and_for_pure_colours(blender):
    agx = tone.curve_from_name("agx")
    pure = (
        torch.eye(3).repeat(9, 1)
        * torch.exp2(torch.arange(-4.0, 5.0)).repeat_interleave(3)[:, None]
    )
    linear = torch.cat([random_colours(50_000, -8.0, 4.0), pure])
    assert (agx.display_from_linear(linear) - blender("AgX", linear)).abs().max() < 1e-3


@pytest.mark.skipif(not VECTORS.exists(), reason=f"TONE VECTORS NOT CHECKED: no {VECTORS}")
@pytest.mark.parametrize("curve", BLENDER, ids=identifier)
def test_display_matches_stored_vectors(curve):
    with VECTORS.open() as file:
        rows = [
            [float(value) for value in row[1:]]
            for row in csv.reader(file)
            if row[0] == f"Blender4.5:{curve.blender_view_transform}"
        ]
    assert len(rows) > 15
    table = torch.tensor(rows, dtype=torch.float64)
    table = table[table[:, :3].max(dim=1).values <= 8.0]
    error = (curve.display_from_linear(table[:, :3]) - table[:, 3:].clamp(0.0, 1.0)).abs()
    assert error.max() < BARS[curve.name]


@pytest.mark.parametrize("curve", tone.families(), ids=identifier)
def test_round_trip_of_reachable_colours(curve):
    for high in (1.0, 4.0):
        display = curve.display_from_linear(random_colours(50_000, -8.0, high))
        again = curve.display_from_linear(curve.linear_from_display(display))
        error = (again - display).abs().amax(dim=-1)
        assert torch.quantile(error, 0.999) < 4e-3
        # The last few of a thousand AgX colours above linear 4 lie on its plateaus.
        assert error.max() < (0.012 if (curve.name, high) == ("agx", 4.0) else 4e-3)


@pytest.mark.parametrize("curve", tone.families(), ids=identifier)
def test_round_trip_of_all_grey_codes(curve):
    code = (torch.arange(256) / 255.0)[:, None].expand(-1, 3)
    linear = curve.linear_from_display(code)
    assert (curve.display_from_linear(linear) - code).abs().max() < 4e-3
    assert (linear.diff(dim=0) >= -1e-4 * linear[1:]).all()


@pytest.mark.parametrize("curve", tone.families(), ids=identifier)
def test_every_code_has_a_sane_inverse(curve):
    axis = torch.linspace(0.0, 1.0, 18)
    codes = torch.stack(torch.meshgrid(axis, axis, axis, indexing="ij"), dim=-1)
    linear = curve.linear_from_display(codes)
    assert linear.shape == codes.shape
    assert linear.isfinite().all()
    assert linear.min() >= 0.0
    assert linear.max() <= tone.MAX_LINEAR


@pytest.mark.parametrize("curve", tone.families(), ids=identifier)
def test_grey_is_monotone_and_ends_at_black_and_white(curve):
    samples = tone.as_samples(curve, 200)
    display = np.array(samples["display"])
    assert (np.diff(display) >= 0.0).all()
    assert display[0] < 0.05
    assert display[-1] > curve.saturation_level - 1e-3
    assert samples["linear"][0] == pytest.approx(2.0**-10)


@pytest.mark.parametrize("curve", tone.families(), ids=identifier)
def test_gradients_of_both_ways_are_inverse(curve):
    linear = torch.tensor([[0.18, 0.3, 0.1]], dtype=torch.float64)
    forward = torch.autograd.functional.jacobian(curve.display_from_linear, linear)[0, :, 0]
    display = curve.display_from_linear(linear)
    backward = torch.autograd.functional.jacobian(curve.linear_from_display, display)[0, :, 0]
    assert torch.allclose(forward @ backward, torch.eye(3, dtype=torch.float64), atol=0.05)
    grey = torch.full((1, 3), 0.2, dtype=torch.float64)
    step = 1e-4
    rise = curve.display_from_linear(grey + step) - curve.display_from_linear(grey - step)
    assert torch.allclose(curve.slope(grey), rise / (2 * step), rtol=0.05)
    black = torch.zeros(2, 3, requires_grad=True)
    curve.display_from_linear(black).sum().backward()
    assert black.grad.isfinite().all()


def test_aces_values_worked_by_hand():
    """F(1) = 2.54 / 3.16; a white pixel at g = 1 is 7.24, at g = 0.42 it is 1.21."""
    one = tone.AcesToneCurve(1.0)
    shown = one.display_from_linear(torch.ones(3, dtype=torch.float64))
    assert shown[0].item() == pytest.approx((2.54 / 3.16) ** (1 / 2.2), rel=1e-12)
    white = torch.ones(3, dtype=torch.float64)
    assert one.linear_from_display(white)[0].item() == pytest.approx(7.24, abs=5e-3)
    stretched = tone.AcesToneCurve(0.42).linear_from_display(white)
    assert stretched[0].item() == pytest.approx(1.21, abs=5e-3)


@pytest.mark.parametrize("tone_gamma", [1e-4, 0.1, 0.5, 1.0])
def test_aces_closed_form_inverse(tone_gamma):
    curve = tone.AcesToneCurve(tone_gamma)
    display = torch.linspace(0.01, 1.0, 100, dtype=torch.float64)[:, None].expand(-1, 3)
    again = curve.display_from_linear(curve.linear_from_display(display))
    assert (again - display).abs().max() < 1e-9


def test_curve_from_name_round_trips_and_refuses():
    curve = tone.curve_from_name("robir_aces", {"tone_gamma": 0.25})
    assert curve.parameters == {"tone_gamma": 0.25}
    assert tone.curve_from_name("filmic", {}).name == "filmic"
    with pytest.raises(ConfigError, match="known are standard"):
        tone.curve_from_name("sepia")
    with pytest.raises(ConfigError, match="parameters"):
        tone.curve_from_name("filmic", {"tone_gamma": 0.3})


@pytest.mark.parametrize("power", [0.5, 2.0])
@pytest.mark.parametrize("curve", tone.families(), ids=identifier)
def test_a_power_is_taken_after_the_curve_and_undone_before_it(curve, power):
    retoned = tone.powered(curve, power)
    linear = random_colours(500, -6.0, -1.0)
    shown = retoned.display_from_linear(linear)
    expected = curve.display_from_linear(linear).double() ** power
    torch.testing.assert_close(shown.double(), expected, rtol=1e-5, atol=1e-6)
    back = retoned.display_from_linear(retoned.linear_from_display(shown))
    torch.testing.assert_close(back, shown, rtol=0, atol=2e-3)
    again = tone.curve_from_name(retoned.name, retoned.parameters)
    assert again.parameters == retoned.parameters == curve.parameters | {"display_power": power}
    torch.testing.assert_close(again.display_from_linear(linear), shown)
    assert again.blender_view_transform == curve.blender_view_transform
    assert again.blender_gamma == pytest.approx(1 / power)
    assert curve.blender_gamma == 1.0


@pytest.mark.parametrize("curve", tone.families(), ids=identifier)
def test_cube_file_is_read_by_opencolorio(curve, tmp_path):
    ocio = pytest.importorskip("PyOpenColorIO")
    path = tmp_path / "curve.cube"
    path.write_text(tone.cube_text(curve, 33 if curve.mixes_channels else 2))
    config = ocio.Config.CreateRaw()
    transform = ocio.FileTransform(str(path), interpolation=ocio.INTERP_BEST)
    grey = torch.exp2(torch.linspace(-10.0, 4.0, 400))[:, None].expand(-1, 3)
    for linear, bar in ((grey, 0.01), (random_colours(5000, -10.0, 4.0), 0.03)):
        pixels = np.ascontiguousarray(linear.numpy(), dtype=np.float32).copy()
        config.getProcessor(transform).getDefaultCPUProcessor().applyRGB(pixels)
        error = (torch.from_numpy(pixels) - curve.display_from_linear(linear)).abs()
        assert error.max() < bar
        assert error.mean() < 0.003


def test_a_cameras_response_is_the_one_that_scenes_are_photographed_by():
    """Two programs from one publication; that of the scenes is held against its printed values."""
    light = np.linspace(0.0, 1.2, 500)
    wanted = measured_response(light)
    shown = tone.CameraToneCurve().display_from_linear(torch.from_numpy(light)[:, None])
    np.testing.assert_allclose(shown[:, 0].numpy(), wanted, atol=1e-5)


@pytest.mark.parametrize("curve", tone.families(), ids=identifier)
def test_a_code_means_what_its_display_value_does(curve):
    codes = torch.randint(0, 256, (5, 400, 3), generator=torch.Generator().manual_seed(1))
    known = codes.sum(2) % 5 > 0
    expected = curve.linear_from_display(codes / 255.0).float()
    found = curve.linear_from_codes(codes.to(torch.uint8), known)
    assert found.dtype == torch.float32
    torch.testing.assert_close(found[known], expected[known], rtol=1e-5, atol=1e-7)
