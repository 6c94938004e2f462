# SPDX-License-Identifier: Apache-2.0
"""Models that were led astray by sides that look alike, on made-up matches."""

from __future__ import annotations

from contextlib import closing
from pathlib import Path

import numpy as np
import pytest

from robir.poses.consistency import forget, hold_against_links
from robir.poses.diagnose import look_alikes
from robir.poses.prepare import Prepared
from robir.poses.solve import Workplace

pytestmark = pytest.mark.pycolmap

COUNT = 12
SIZE = {"width": 640, "height": 480}
FALSE = 40
"""Matches of a side with the one that looks like it, against hundreds of true ones."""


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
    """Neighbours match truly; 0 to 5 match 6 to 11 a little, as if they saw the same side."""
    import pycolmap

    place = Workplace(tmp_path)
    truth, astray = ring(range(0)), ring(range(6, COUNT))
    points = np.random.default_rng(0).uniform(-0.5, 0.5, (300, 3))
    with closing(pycolmap.Database.open(place.database)) as database:
        camera = truth.camera(1)
        camera.camera_id = database.write_camera(camera)
        keypoints = []
        for i in range(COUNT):
            database.write_image(pycolmap.Image(name=f"{i:02d}.png", camera_id=camera.camera_id))
            sees = [
                np.array([model.image(i + 1).project_point(point) for point in points])
                for model in (truth, astray)
            ]
            # The second half of the points is where the misplaced model sees them.
            keypoints.append(np.concatenate(sees))
            database.write_keypoints(i + 1, keypoints[-1].astype(np.float32))
        for i in range(COUNT):
            for j in range(i + 1, COUNT):
                step = min(j - i, COUNT + i - j)
                if step <= 2:
                    which = np.arange(200 - 40 * step)
                elif (i < 6) != (j < 6) and step >= 5:
                    which = 300 + np.arange(FALSE)
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


def test_the_true_model_contradicts_no_sure_link(place: Workplace):
    verdict = hold_against_links(place, photographs(), ring(range(0)))
    assert verdict.broken == ()
    assert verdict.suspects == ()
    assert look_alikes(photographs(), verdict, None) == []


def test_a_model_led_astray_is_found_out_and_its_ties_are_forgotten(place: Workplace):
    verdict = hold_against_links(place, photographs(), ring(range(6, COUNT)))
    assert set(verdict.broken) == {("05.png", "06.png"), ("00.png", "11.png")}
    assert verdict.suspects
    assert all((int(a[:2]) < 6) != (int(b[:2]) < 6) for a, b in verdict.suspects)
    forget(place, verdict.suspects)
    after = hold_against_links(place, photographs(), ring(range(6, COUNT)))
    assert after.suspects == ()
    (warning,) = look_alikes(photographs(), after, None)
    assert warning.level == "warning"
    assert "IMG_" in warning.files[0]
    assert "newspaper" in warning.cure
    mended = hold_against_links(place, photographs(), ring(range(0)))
    (warning,) = look_alikes(photographs(), verdict, mended)
    assert "may not be enough" in warning.message
