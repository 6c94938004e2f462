# SPDX-License-Identifier: Apache-2.0
"""The truth of photographs stands in a frame of its own: it is brought to the result, and told."""

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from evaluation import sphere_run
from PIL import Image
from scipy.spatial.transform import Rotation

from robir.capture.store import load_settled
from robir.errors import CaptureError
from robir.maths.similarity import Similarity
from robir_bench.truth.aligned import align
from robir_bench.truth.evaluate import evaluate
from robir_bench.truth.files import load_truth

# from the result's frame to that of the truth
AWAY = Similarity(
    turn=Rotation.from_rotvec([0.5, -1.1, 0.7]).as_matrix(),
    scale=2.5,
    shift=np.array([3.0, -1.0, 0.4]),
)


def photographed(folder: Path) -> Path:
    """The sphere's truth as of photographs: named as the result's, in another frame."""
    sphere_run.make_truth(folder)
    scene = json.loads((folder / "truth" / "scene.json").read_text())
    scene["sun_direction"] = (AWAY.turn @ np.array(scene["sun_direction"])).tolist()
    scene["scene_radius"] *= AWAY.scale
    scene["white_balance"] = [1.0, 1.0, 1.0]
    (folder / "truth" / "scene.json").write_text(json.dumps(scene))
    mesh = sphere_run.mesh_as_trimesh(sphere_run.world_mesh())
    mesh.vertices = AWAY(np.asarray(mesh.vertices))
    mesh.export(folder / "truth" / "mesh.ply")
    (folder / "images").mkdir()
    entries = []
    for split, count, turn in (("train", 6, 0.0), ("held_out", 3, 0.5)):
        cameras = sphere_run.cameras(count, turn)
        for k, layers in enumerate(sphere_run.seen(count, turn)):
            name, pose = f"{split}_{k:03d}", cameras[k].moved(AWAY).camera_to_world
            codes = np.round(255 * sphere_run.photograph(layers)).astype(np.uint8)
            Image.fromarray(codes).save(folder / "images" / f"{name}.jpg", quality=95)
            position = AWAY(layers.position.reshape(-1, 3)).reshape(layers.position.shape)
            there = replace(layers, position=position, normal=layers.normal @ AWAY.turn.T)
            sphere_run.write_view_truth(folder / "truth" / "test" / f"{name}.exr", there)
            is_test = split == "held_out"
            entries.append(
                {"name": name, "camera_to_world": pose.tolist(), "has_truth": is_test}
            )  # fmt: skip
    side, focal = sphere_run.SIZE, cameras[0].fx
    lens = {"w": side, "h": side, "fl_x": focal, "fl_y": focal, "cx": side / 2, "cy": side / 2}
    (folder / "truth" / "cameras.json").write_text(json.dumps(lens | {"photographs": entries}))
    return folder


@pytest.fixture(scope="module")
def truth(tmp_path_factory) -> Path:
    return photographed(tmp_path_factory.mktemp("truth") / "capture")


def test_a_perfect_result_in_another_frame_scores_perfectly(truth: Path, tmp_path: Path) -> None:
    scores = evaluate(sphere_run.make_run(tmp_path / "out"), truth, tmp_path / "sheet.png")
    assert scores["alignment"]["pixels"] < 0.01
    assert scores["alignment"]["photographs"] == 9
    assert scores["alignment"]["scale"] == pytest.approx(1.0 / 2.5, rel=1e-4)
    assert min(scores["albedo"]["psnr_linear"].values()) > 50
    assert scores["normals"]["mean_degrees"] < 0.1
    assert scores["mask_iou"] > 0.999
    assert scores["chamfer"]["chamfer"] < 0.05
    assert scores["light"]["strongest_lobe_degrees"] < 0.01
    assert scores["views"] == 3


def test_wrong_poses_of_the_result_show_in_the_alignment(truth: Path, tmp_path: Path) -> None:
    views = list(load_settled(sphere_run.make_run(tmp_path / "out")).views)
    pose = views[0].camera.camera_to_world.copy()
    # one of nine cameras looks two pixels to the side
    turn = Rotation.from_rotvec([0.0, 2.0 / views[0].camera.fx, 0.0]).as_matrix()
    pose[:3, :3] = pose[:3, :3] @ turn
    views[0] = replace(views[0], camera=replace(views[0].camera, camera_to_world=pose))
    found = align(load_truth(truth), views)
    assert 0.3 < found.pixels < 2.0 / 3.0 + 0.05
    assert found.place.turn == pytest.approx(AWAY.turn.T, abs=0.01)


def test_a_result_of_another_capture_is_refused(truth: Path, tmp_path: Path) -> None:
    views = load_settled(sphere_run.make_run(tmp_path / "out")).views
    strange = [replace(view, name=f"other_{view.name}") for view in views]
    with pytest.raises(CaptureError, match="only 0 photographs"):
        align(load_truth(truth), strange)
