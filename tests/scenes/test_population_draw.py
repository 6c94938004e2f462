# SPDX-License-Identifier: Apache-2.0
"""What is drawn for a capture of the population, and how its exposure is held."""

from dataclasses import replace

import numpy as np
import pytest

from blender_scenes.format import ToneMapping, ViewTruth, picture
from blender_scenes.population import ranges
from blender_scenes.population.draw import Drawn, Sources, draw
from blender_scenes.population.exposing import held
from blender_scenes.request import fingerprint
from blender_scenes.view_transform import display_from_linear

MANY = 400


@pytest.fixture(scope="module")
def sources(tmp_path_factory: pytest.TempPathFactory) -> Sources:
    folder = tmp_path_factory.mktemp("files")
    files = [folder / name for name in ("cow.obj", "car.gltf", "noon.hdr", "dusk.exr")]
    for file in files:
        file.write_text(file.name)
    return Sources(tuple(files[:2]), tuple(files[2:]))


@pytest.fixture(scope="module")
def drawn(sources: Sources) -> list[Drawn]:
    return [draw(seed, sources) for seed in range(MANY)]


def test_a_seed_says_everything(sources: Sources, drawn: list[Drawn]) -> None:
    assert [draw(seed, sources) for seed in range(20)] == drawn[:20]
    assert len({fingerprint(one.request, "1") for one in drawn[:8]}) == 8


def test_what_a_recipe_says_enters_the_fingerprint_and_files_by_content(
    sources: Sources, drawn: list[Drawn]
) -> None:
    one = next(d for d in drawn if d.thing == "asset").request
    before = fingerprint(one, "1")
    thicker = replace(one.recipe.parts[0], size=1.01)
    changed = replace(one, recipe=replace(one.recipe, parts=(thicker,)))
    assert fingerprint(changed, "1") != before
    file = one.recipe.parts[0].file
    other = file.with_name(f"other{file.suffix}")
    other.write_bytes(file.read_bytes())
    moved = replace(
        one, recipe=replace(one.recipe, parts=(replace(one.recipe.parts[0], file=other),))
    )
    assert len({fingerprint(r, "1") for r in (one, moved)}) == 1
    text = file.read_text()
    try:
        file.write_text("another shape")
        assert fingerprint(one, "1") != before
    finally:
        file.write_text(text)


def test_everything_lies_in_its_range(drawn: list[Drawn]) -> None:
    for one in drawn:
        request, recipe = one.request, one.request.recipe
        assert 96 <= request.resolution <= 256
        assert 16 <= request.views <= 80
        assert abs(one.tone.exposure) <= 1.5
        cost = request.resolution**2 * (request.views + 2 * request.test_views) * request.samples
        assert cost <= 1.05 * ranges.PIXEL_SAMPLES
        for part in recipe.parts:
            assert all(0.02 <= c <= 0.9 for colour in part.paint.colours for c in colour)
            assert all(0.05 <= r <= 1.0 for r in part.paint.roughness)
        assert 1 <= len(recipe.parts) <= 5
        assert (one.thing == "clutter") == (len(recipe.parts) > 1)
        for sun in recipe.sky.suns:
            assert sun.elevation >= 5.0
            assert 0.5 < sun.size <= 20.0
            assert 0.0 < sun.share < 1.0


def view(radiance: np.ndarray) -> ViewTruth:
    """A view that shows nothing but a radiance (H, W)."""
    flat = np.ones(radiance.shape, dtype=np.float32)
    image = np.repeat(radiance[..., None], 3, axis=-1).astype(np.float32)
    return ViewTruth(image, image, flat, flat, image, image, flat, flat, flat)


def test_an_exposure_that_clips_too_much_is_lowered_as_little_as_it_takes() -> None:
    """Of radiance spread evenly over 0..1 a tenth lies above .9: that is where white must be."""
    views = [view(np.linspace(0.0, 1.0, 10_000).reshape(100, 100))]
    found = held(views, ToneMapping("Standard", 1.4)).exposure
    assert 0.9 * 2.0**found == pytest.approx(1.0, rel=0.1)
    assert 0.9 * 2.0**found <= 1.005
    assert held(views, ToneMapping("Standard", -0.5)).exposure == -0.5


@pytest.mark.parametrize(("backdrop", "code"), [("black", 0), ("white", 255)])
def test_on_a_backdrop_pictures_have_no_alpha_and_mix_by_coverage(backdrop: str, code: int) -> None:
    mask = np.array([[0.0, 0.5, 1.0]], dtype=np.float32)
    one = replace(view(np.full((1, 3), 0.2)), mask=mask)
    shown = picture(one, ToneMapping("Standard", 0.0, None, backdrop))
    whole = 255.0 * display_from_linear(np.full((1, 3), 0.2), "Standard")[0, 0]
    assert shown.shape == (1, 3, 3)
    assert shown[0, :, 0] == pytest.approx([code, 0.5 * (code + whole), whole], abs=0.51)
