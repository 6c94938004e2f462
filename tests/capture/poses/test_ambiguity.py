# SPDX-License-Identifier: Apache-2.0
"""Models that were led astray by sides that look alike, on made-up matches."""

from __future__ import annotations

from contextlib import closing
from pathlib import Path

import numpy as np
import pytest

from robir.capture.poses import register
from robir.capture.poses.diagnose import Verdict, forget, hold_against_links, look_alikes
from robir.capture.poses.sfm import Prepared, Workplace

pytestmark = pytest.mark.pycolmap

COUNT = 12
SIZE = {"width": 640, "height": 480}
# matches of a side with the one that looks like it: more than true ones, but all on one label
LABEL = 250


def ring(turned: range):
    """A model of twelve cameras around the origin; some are turned to the opposite side."""
    import pycolmap

    model = pycolmap.Reconstruction()
    camera = pycolmap.Camera.create_from_model_name(1, "SIMPLE_PINHOLE", 500.0, 640, 480)
    model.add_camera_with_trivial_rig(camera)
    for i in range(COUNT):
        angle = 2 * np.pi * i / COUNT + (np.pi if i in turned else 0.0)
        c, s = np.cos(angle), np.sin(angle)
        rotation = np.array([[-s, c, 0.0], [0.0, 0.0, -1.0], [-c, -s, 0.0]])
        pose = pycolmap.Rigid3d(pycolmap.Rotation3d(rotation), np.array([0.0, 0.0, 4.0]))
        image = pycolmap.Image(name=f"{i:02d}.png", camera_id=1, image_id=i + 1)
        model.add_image_with_trivial_frame(image, pose)
    return model


@pytest.fixture
def place(tmp_path: Path) -> Workplace:
    """Neighbours match truly; 0 to 5 match a label of 6 to 11 as if they saw the same side."""
    import pycolmap

    place = Workplace(tmp_path)
    truth, astray = ring(range(0)), ring(range(6, COUNT))
    points = np.random.default_rng(0).uniform(-1.0, 1.0, (200, 3))
    label = np.random.default_rng(1).uniform(-0.05, 0.05, (LABEL, 3))
    with closing(pycolmap.Database.open(place.database)) as database:
        camera = truth.camera(1)
        camera.camera_id = database.write_camera(camera)
        keypoints = []
        for i in range(COUNT):
            database.write_image(pycolmap.Image(name=f"{i:02d}.png", camera_id=camera.camera_id))
            sees = [
                np.array([model.image(i + 1).project_point(point) for point in seen])
                for model, seen in ((truth, points), (astray, label))
            ]
            # The label is where the misplaced model sees it.
            keypoints.append(np.concatenate(sees))
            database.write_keypoints(i + 1, keypoints[-1].astype(np.float32))
        for i in range(COUNT):
            for j in range(i + 1, COUNT):
                step = min(j - i, COUNT + i - j)
                if step <= 2:
                    which = np.arange(200 - 40 * step)
                elif (i < 6) != (j < 6) and step >= 5:
                    which = 200 + np.arange(LABEL)
                else:
                    continue
                geometry = pycolmap.TwoViewGeometry()
                geometry.config = int(pycolmap.TwoViewGeometryConfiguration.CALIBRATED)
                geometry.inlier_matches = np.stack([which, which], axis=1).astype(np.uint32)
                database.write_two_view_geometry(i + 1, j + 1, geometry)
    return place


def photographs() -> list[Prepared]:
    return [
        Prepared(relative=f"IMG_{i}.jpg", copy=f"{i:02d}.png", lens=0, focal=None, **SIZE)
        for i in range(COUNT)
    ]


def apart(pair: tuple[str, str]) -> bool:
    """Whether one of the two is among those that the misplaced model turns."""
    one, two = (int(name[:2]) for name in pair)
    return (one < 6) != (two < 6)


def steps(pair: tuple[str, str]) -> int:
    """Steps along the ring between two."""
    one, two = (int(name[:2]) for name in pair)
    return min(abs(one - two), COUNT - abs(one - two))


def test_the_true_model_contradicts_no_sure_link(place: Workplace):
    verdict = hold_against_links(place, photographs(), ring(range(0)))
    assert verdict.broken == ()
    assert verdict.suspects == ()
    assert look_alikes(photographs(), verdict, 0) == []


def test_a_model_led_astray_is_found_out_and_its_ties_are_forgotten(place: Workplace):
    verdict = hold_against_links(place, photographs(), ring(range(6, COUNT)))
    assert verdict.broken
    assert all(apart(pair) and steps(pair) <= 2 for pair in verdict.broken)
    by_the_label = {pair for pair in verdict.suspects if steps(pair) >= 5}
    assert len(by_the_label) == 16
    assert all(apart(pair) for pair in by_the_label)
    forget(place, verdict.suspects)
    after = hold_against_links(place, photographs(), ring(range(6, COUNT)))
    assert after.suspects == ()
    (warning,) = look_alikes(photographs(), after, 18)
    assert warning.level == "warning"
    assert "IMG_" in warning.files[0]
    assert "newspaper" in warning.cure
    mended = hold_against_links(place, photographs(), ring(range(0)))
    (warning,) = look_alikes(photographs(), mended, 18)
    assert "18 pairs were left out" in warning.message


# broken links of one model after the other, which one is to be used, and whether it is doubted
VERDICTS = {
    "mended by the second": ([4, 3, 0], "third", False),
    "never mended": ([4, 2, 3, 3, 3, 0], "second", True),
    "right at once": ([0], "first", None),
}


@pytest.mark.parametrize(("broken", "used", "is_doubted"), VERDICTS.values(), ids=VERDICTS.keys())
def test_cameras_are_placed_anew_until_no_link_is_broken(
    monkeypatch, tmp_path: Path, broken, used, is_doubted
):
    """Each time without the suspects; at last the model that breaks the fewest links is used."""
    models = iter(["first", "second", "third", "fourth", "fifth", "sixth"])
    far, alike = (("00.png", "01.png"),), (("00.png", "05.png"),)
    verdicts = iter(Verdict(far * number, alike * number) for number in broken)
    forgotten: list[tuple[str, str]] = []
    monkeypatch.setattr(register, "hold_against_links", lambda *_: next(verdicts))
    monkeypatch.setattr(register, "forget", lambda _, pairs: forgotten.extend(pairs))
    monkeypatch.setattr(register._Registration, "_mapped", lambda *_: [next(models)])
    registration = register._Registration(tmp_path, tmp_path, 0, lambda *_: None)
    (chosen,), findings = registration._models(photographs())
    assert chosen == used
    assert len(forgotten) == sum(broken[: register.MAX_ANEW])
    assert ["may have been put" in finding.message for finding in findings] == (
        [] if is_doubted is None else [is_doubted]
    )
