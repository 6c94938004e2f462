# SPDX-License-Identifier: Apache-2.0
"""Films of a turning light, the choice of what is compared, and reports that name nobody."""

import numpy as np
import pytest
from addon.blenders import run
from addon.test_result_operators import COMMON
from PIL import Image

pytestmark = pytest.mark.blender


FILM = """
import sys


def main(archive, result):
    install(archive)
    bpy.ops.wm.read_factory_settings(use_empty=True)
    bpy.ops.preferences.addon_enable(module=MODULE)
    call("import_result", directory=result)
    settings, state = bpy.context.scene.robir, bpy.context.window_manager.robir
    settings.turntable_frames, settings.turntable_side, settings.turns = 2, 98, "object"
    answer = {"film": call("turntable"), "message": state.message, "task": state.task}
    answer["nobody"] = [call("turntable", view="nobody"), state.error]
    pictures = sys.modules[MODULE + ".relighting.lights"].light_pictures
    button = sys.modules[MODULE + ".operators.relight"].ROBIR_OT_picture_lights
    words, small = button.words, ["--max-side", "96", "--samples", "4"]  # else half a minute
    button.words = lambda self, context: [*words(self, context), *small]
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
    assert min(frames[0].shape[:2]) == 98
    assert answer["task"] == ""
    lights = sorted(file.stem for file in find_studio_lights(own_blender))
    assert answer["lights"] == [0, ["FINISHED"], ["", *lights], ""]
    shown = {stem: np.array(Image.open(result.light_picture(stem))) for stem in ("", *lights)}
    for codes in shown.values():
        assert codes.shape == (96, 96, 4)
        rows, columns = np.nonzero(codes[..., 3] > 128)
        ends = [columns.min(), 95 - columns.max(), rows.min(), 95 - rows.max()]
        assert min(ends) >= 5 and max(ends) <= 11, "the object fills the square"
    apart = [np.abs(shown[""].astype(int) - shown[light]).mean() for light in lights]
    assert min(apart) > 1.0, "each light shows"
    said, shown = answer["nobody"]
    assert "no view is named 'nobody'" in said
    assert shown == "No view is named 'nobody'"


def find_studio_lights(blender):
    return blender.site_packages.glob("bpy/*/datafiles/studiolights/world/*.exr")


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
