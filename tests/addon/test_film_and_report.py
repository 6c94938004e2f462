# SPDX-License-Identifier: Apache-2.0
"""Films of a turning light, the choice of what is compared, and reports that name nobody."""

import subprocess
import sys

import cv2
import numpy as np
import pytest
import trimesh
from addon.blenders import run
from addon.test_result_operators import COMMON
from evaluation.sphere_run import CENTRE, RADIUS, SPHERE, cameras
from PIL import Image
from trimesh.exchange.gltf import export_glb

pytestmark = pytest.mark.blender


FILM = """
import sys


def main(archive, result):
    install(archive)
    bpy.ops.wm.read_factory_settings(use_empty=True)
    bpy.ops.preferences.addon_enable(module=MODULE)
    call("import_result", directory=result)
    settings, state = bpy.context.scene.robir, bpy.context.window_manager.robir
    settings.turntable_frames = 2
    answer = {"film": call("turntable"), "message": state.message, "task": state.task}
    answer["nobody"] = [call("turntable", view="nobody"), state.error]
    pictures = sys.modules[MODULE + ".relighting.pictures"].light_pictures
    answer["lights"] = [len(pictures(settings.result)), call("picture_lights")]
    answer["lights"] += [sorted(pictures(settings.result)), state.error]
    return answer
"""


@pytest.mark.slow
def test_a_film_is_made_by_a_process_that_knows_no_checkout(
    own_blender, extension_zip, result, tmp_path
):
    files = (str(extension_zip), str(result.root))
    answer = run(own_blender, COMMON + FILM, *files, user=tmp_path / "user")
    assert answer["film"] == ["FINISHED"]
    film = result.renders / "turntable_environment_held_out_000.mp4"
    assert answer["message"] == f"{film.name} is in renders"
    assert film.read_bytes()[4:8] == b"ftyp"
    frames = [
        np.array(Image.open(result.renders / film.stem / f"000{k}.png").convert("RGB"))
        for k in (1, 2)
    ]
    assert not np.array_equal(*frames)
    assert answer["task"] == ""
    lights = sorted(file.stem for file in find_studio_lights(own_blender))
    assert answer["lights"] == [0, ["FINISHED"], ["", *lights], ""]
    shown = {stem: np.array(Image.open(result.light_picture(stem))) for stem in ("", *lights)}
    for codes in shown.values():
        assert codes.shape == (192, 192, 4)
        rows, columns = np.nonzero(codes[..., 3] > 128)
        ends = [columns.min(), 191 - columns.max(), rows.min(), 191 - rows.max()]
        assert min(ends) >= 12 and max(ends) <= 20, "the object fills the square"
    apart = [np.abs(shown[""].astype(int) - shown[light]).mean() for light in lights]
    assert min(apart) > 1.0, "each light shows"
    said, shown = answer["nobody"]
    assert "no view is named 'nobody'" in said
    assert shown == "No view is named 'nobody'"


def find_studio_lights(blender):
    return blender.site_packages.glob("bpy/*/datafiles/studiolights/world/*.exr")


def frames_of(film):
    """All frames (T, H, W) of a film, 0 to 1, mean over channels; and how many a second has."""
    reader = cv2.VideoCapture(str(film))
    frames = []
    while (got := reader.read())[0]:
        frames.append(got[1].mean(2) / 255)
    return np.array(frames), reader.get(cv2.CAP_PROP_FPS)


@pytest.mark.slow
def test_in_a_film_the_shadow_goes_round(result, tmp_path, request):
    """The sphere on a table; where a low sun throws its shadow is known."""
    from robir.export.textures import write_exr

    def headless(*arguments):
        command = [sys.executable, "-m", "robir_addon.headless", *map(str, arguments)]
        subprocess.run(command, check=True, capture_output=True)

    contact = CENTRE - [0, 0, RADIUS * SPHERE]
    table = contact + 10 * np.array([[-1, -1, 0], [1, -1, 0], [1, 1, 0], [-1, 1, 0]])
    (ball,) = trimesh.load_scene(result.asset).geometry.values()
    first = len(ball.vertices)
    both = trimesh.Trimesh(
        # a GLB's y is up
        vertices=np.concatenate([ball.vertices, table[:, [0, 2, 1]] * [1, 1, -1]]),
        faces=np.concatenate([ball.faces, first + np.array([[0, 1, 2], [0, 2, 3]])]),
        vertex_normals=np.concatenate([ball.vertex_normals, np.tile([0, 1, 0], (4, 1))]),
        visual=trimesh.visual.TextureVisuals(
            uv=np.concatenate([ball.visual.uv, np.tile(ball.visual.uv[:1], (4, 1))]),
            material=ball.visual.material,
        ),
        process=False,
    )
    before = result.asset.read_bytes()
    request.addfinalizer(lambda: result.asset.write_bytes(before))
    result.asset.write_bytes(export_glb(trimesh.Scene({"ball": both}), include_normals=True))
    sky = np.full((32, 64, 3), 0.1, np.float32)
    sky[8, 15:17] = 60.0  # about +Y, 42 degrees high
    write_exr(tmp_path / "low.exr", sky)
    words = ["--environment", tmp_path / "low.exr", "--views", "held_out_001", "--samples", 8]
    headless("relight", result.root, *words, "--turntable", 2)
    frames, rate = frames_of(result.renders / "turntable_low_held_out_001.mp4")
    assert frames.shape == (2, 64, 64)
    assert rate == 12
    throw = RADIUS * SPHERE / np.tan(np.radians(90 - 8.5 * 180 / 32))
    places = contact + np.array([[0, -throw, 0], [0, throw, 0]])
    pixels = cameras(3, 0.5)[1].project(places)[0].astype(int)
    at = np.array(
        [[frame[y - 1 : y + 2, x - 1 : x + 2].mean() for x, y in pixels] for frame in frames]
    )
    # the sun stands at +Y, then at -Y; the shadow lies on the other side
    assert at[0, 0] < 0.6 * at[0, 1]
    assert at[1, 1] < 0.6 * at[1, 0]
    assert 0.2 < at.max() < 0.98


def test_what_cycles_rendered_comes_first(result, tmp_path):
    import bpy  # noqa: F401 - the wheel brings mathutils

    from robir_addon.errors import ResultError
    from robir_addon.result.comparison import rendered_view
    from robir_addon.result.importer import read_cameras

    table = read_cameras(result)
    assert rendered_view(result, table).rendered_by == "RobIR"
    result.renders.mkdir(exist_ok=True)
    file = result.renders / "rerender_held_out_001.png"
    Image.fromarray(np.full((2, 3, 4), [51, 102, 204, 255], np.uint8)).save(file)
    try:
        chosen = rendered_view(result, table)
        assert (chosen.entry["name"], chosen.rendered_by) == ("held_out_001", "Cycles")
        assert chosen.picture == pytest.approx(np.full((2, 3, 4), [0.2, 0.4, 0.8, 1.0]))
        assert rendered_view(result, table, "held_out_000").rendered_by == "RobIR"
        with pytest.raises(ResultError, match="train_000"):
            rendered_view(result, table, "train_000")
    finally:
        file.unlink()


@pytest.mark.parametrize(
    ("text", "expected"),
    [
        ("/home/jo/pics/cap/a.png", "<capture>/a.png"),
        ("in /home/jo/pics/cap: no", "in <capture>: no"),
        ("/home/jo/pics/cap2/a.png", "~/pics/cap2/a.png"),
        ("/home/jo/pics/cap_robir/log", "<result>/log"),
        ("by jo on jo-desk, not john", "by USER on USER-desk, not john"),
        ('{"path": "/home/jo/x"}', '{"path": "~/x"}'),
        ("1 / 2 and a/b", "1 / 2 and a/b"),
    ],
)
def test_a_report_names_nobody(monkeypatch, text, expected):
    from robir_addon.work import support

    monkeypatch.setattr(support.getpass, "getuser", lambda: "jo")
    monkeypatch.setattr(support.Path, "home", classmethod(lambda cls: cls("/home/jo")))
    folders = {"<capture>": "/home/jo/pics/cap/", "<result>": "/home/jo/pics/cap_robir"}
    folders["<masks>"] = ""
    assert support.without_private_paths(text, folders) == expected
