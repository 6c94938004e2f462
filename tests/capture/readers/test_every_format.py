# SPDX-License-Identifier: Apache-2.0
"""The same cameras written in every format that is read, and read back to a 1e-5th."""

from __future__ import annotations

from dataclasses import replace
from functools import partial
from pathlib import Path

import numpy as np
import pytest
from capture import app_writers, program_writers, writers
from capture.readers.test_readers import assert_same, read
from capture.scene import Shot

from robir.capture.checks.findings import check_frames
from robir.capture.images.decode import stored_size
from robir.capture.images.loading import size_within
from robir.capture.recognise import read_frames, rigid

DATA = Path(__file__).parents[4] / "shared" / "data"
REAL = (
    "figure_nerfstudio", "fruit_nerfstudio", "gum_nerfstudio", "house_neus", "milk_carton_llff",
    "mouse_colmap", "scissors_neus",
)  # fmt: skip

# formats with one focal length, or without a principal point
CENTRED = {
    "nerf-synthetic": writers.nerf_synthetic,
    "llff": partial(writers.llff, numeric=False),
    "realityscan": app_writers.reality_scan,
    "openmvg": program_writers.openmvg,
    "bundler": program_writers.bundler,
    "realityscan-xmp": program_writers.reality_xmp,
    "nerfactor": program_writers.nerfactor,
    "gaussian-splatting": program_writers.splats,
}

OFF_CENTRE = {
    "nerfstudio": writers.nerfstudio,
    "colmap": partial(writers.colmap, binary=True),
    "colmap-text": partial(writers.colmap, binary=False),
    "neus": writers.neus,
    "polycam": app_writers.polycam,
    "metashape": app_writers.metashape,
    "meshroom": partial(app_writers.meshroom, version=(1, 2, 14)),
    "opensfm": program_writers.opensfm,
    "sdfstudio": program_writers.sdfstudio,
    "record3d": program_writers.record3d,
    "stray-scanner": program_writers.stray_scanner,
    "arkit": program_writers.arkit,
}
WITH_POINTS = ("colmap", "meshroom", "opensfm", "openmvg", "bundler")


def read_back(write, root, shots) -> None:
    """Write cameras, read them, and compare each with the one nearest to it."""
    write(root, shots)
    found = read_frames(root)
    assert len(found.frames) == len(shots)
    assert {finding.level for finding in check_frames(found)} <= {"warning", "note"}
    assert "unposed-images" not in {finding.code for finding in check_frames(found)}
    left = list(found.frames)
    for shot in shots:
        truth = shot.camera
        poses = np.array([frame.camera_to_world for frame in left])
        frame = left.pop(int(np.abs(poses - truth.camera_to_world).max(axis=(1, 2)).argmin()))
        camera = frame.lens.camera(frame.camera_to_world, truth.width, truth.height)
        size = max(1.0, np.abs(truth.position).max())  # some captures are in millimetres
        np.testing.assert_allclose(camera.camera_to_world, truth.camera_to_world, atol=1e-5 * size)
        lens, right = ((c.fx, c.fy, c.cx, c.cy) for c in (camera, truth))
        np.testing.assert_allclose(lens, right, atol=1e-5)
        assert frame.lens.distortion.is_null
        assert frame.image.is_file()
    assert (len(found.points) > 0) == (found.format in WITH_POINTS)


@pytest.mark.parametrize("form", CENTRED)
def test_a_centred_lens(form, shots, tmp_path):
    read_back(CENTRED[form], tmp_path, shots)
    assert read_frames(tmp_path).format == form


@pytest.mark.parametrize("form", OFF_CENTRE)
def test_an_off_centre_lens(form, odd_shots, tmp_path):
    read_back(OFF_CENTRE[form], tmp_path, odd_shots)
    assert read_frames(tmp_path).format == form.removesuffix("-text")


@pytest.mark.pycolmap
def test_a_rig_of_colmap(odd_shots, tmp_path):
    """COLMAP writes each image's own pose beside rigs and frames."""
    program_writers.colmap_rig(tmp_path, odd_shots)
    frames = {frame.name: frame for frame in read_frames(tmp_path).frames}
    for i, shot in enumerate(odd_shots):
        found = frames[f"c{i:02d}"].camera_to_world
        np.testing.assert_allclose(found, shot.camera.camera_to_world, atol=1e-9)


@pytest.mark.parametrize("form", ["sdfstudio", "nerfactor"])
def test_masks_that_the_format_brings(form, shots, tmp_path):
    (CENTRED | OFF_CENTRE)[form](tmp_path, shots)
    assert_same(read(tmp_path), shots)


def real_shots(name: str, is_centred: bool) -> list[Shot]:
    """Cameras of a real capture over small pictures of noise, which no reader looks at."""
    frames = read_frames(DATA / name).frames
    shots = []
    for number, frame in enumerate(frames[:: len(frames) // 5][:5]):
        full = stored_size(frame.image)
        assert full is not None
        camera = frame.lens.camera(rigid(frame.camera_to_world), *full)
        camera = camera.resized(*size_within(full, 48))
        if shots:  # most formats have one lens for all
            first = shots[0].camera
            lens = {key: getattr(first, key) for key in ("width", "height", "fx", "fy", "cx", "cy")}
            camera = replace(camera, **lens)
        elif is_centred:
            middle = {"cx": camera.width / 2, "cy": camera.height / 2, "fy": camera.fx}
            camera = replace(camera, **middle)
        shape = (camera.height, camera.width, 4)
        noise = np.random.default_rng(number).integers(0, 256, shape, np.uint8)
        shots.append(Shot(camera, noise))
    return shots


@pytest.mark.skipif(not DATA.is_dir(), reason=f"REAL CAMERAS NOT TESTED: {DATA} is absent")
@pytest.mark.parametrize("name", REAL)
def test_cameras_of_a_real_capture_in_every_format(name, tmp_path):
    for is_centred, forms in ((True, CENTRED), (False, OFF_CENTRE)):
        shots = real_shots(name, is_centred)
        for form, write in forms.items():
            (tmp_path / form).mkdir()
            try:
                read_back(write, tmp_path / form, shots)
            except Exception as fault:
                fault.add_note(form)
                raise
