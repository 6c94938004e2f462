# SPDX-License-Identifier: GPL-3.0-or-later
"""Renders and packs the add-on's sample, an avocado on a plate; `make sample` does it all.

`python -m blender_scenes.sample render AVOCADO.gltf MAP.hdr CAPTURE`, whose model and map have to
be CC0, and `pack RESULT CAPTURE robir_addon/sample`.
"""

import json
import shutil
import sys
from pathlib import Path

import bpy
from PIL import Image

from blender_scenes import cache
from blender_scenes.command_line import carried_out, say
from blender_scenes.format import ToneMapping, write_capture
from blender_scenes.recipe import Cameras, Ground, Paint, Part, Recipe, SecondLight, Sky, Sun
from blender_scenes.request import SceneRequest

NAME = "avocado"
LIGHT_SIDE = 1024
"""Width of the packed maps of the light, pixels."""

README = """Avocado: a capture of 32 rendered pictures, and what RobIR has reconstructed of it.

Model: "Avocado" of the Khronos glTF sample assets, by Microsoft, CC0 1.0.
Light: "Kloppenheim 05" of Poly Haven, CC0 1.0.
The pictures and all that was made of them: CC0 1.0 as well,
https://creativecommons.org/publicdomain/zero/1.0/

Made by: make sample ASSET=Avocado.gltf HDRI=kloppenheim_05_1k.hdr
"""

_OWN = Paint("own", ((0.5, 0.5, 0.5), (0.5, 0.5, 0.5)), (0.5, 0.5), 0.0, 1)
_PLATE = Paint("speckled", ((0.62, 0.58, 0.52), (0.4, 0.36, 0.32)), (0.5, 0.5), 0.0, 40)


def render(model: Path, sky: Path, out: Path) -> None:
    """Render the capture, unless it is there.

    Args:
        model: glTF file of the avocado.
        sky: Lat-long map.
        out: Folder of the capture.
    """
    if (out / "transforms_test.json").is_file():
        return
    recipe = Recipe(
        parts=(Part("asset", _OWN, 0, (0.0, 0.0, 0.0), 1.0, (0.0, 0.0), model),),
        ground=Ground("disc", _PLATE, 0.56, 3),
        sky=Sky(0.0, (Sun(40.0, -45.0, 2.0, 0.6),), is_softened=True),
        cameras=Cameras("dome", (8.0, 62.0), (0.0, 360.0), 0.98),
        second_light=SecondLight(sky, 0.5),
    )
    request = SceneRequest(
        "drawn", "none", "hdri-sun", hdri=sky, resolution=640, views=28, test_views=4,
        samples=12, seed=1, recipe=recipe,
    )  # fmt: skip
    folder, _ = cache.linear_renders(request, out.parent / "renders", _report)
    write_capture(out, folder, ToneMapping("Filmic", 0.3))


def _report(done: int, total: int) -> None:
    say(f"rendered {done}/{total}", ending="\r")


def pack(result: Path, capture: Path, shipped: Path) -> None:
    """Make the add-on's sample anew of a finished result with its light pictures.

    Pictures become WebP, and maps of the light half as fine and precise: their suns are lamps.
    """
    out = shipped / NAME
    shutil.rmtree(shipped, ignore_errors=True)
    kept = [result / "run.json", *result.glob("export/textures/*.png")]
    # Blender has the tone curve, so that its table is not read
    kept += [result / "export" / name for name in ("asset.glb", "light.json", "tone_curve.json")]
    for kind in ("light_*.png", "rerender_*.png", "compare_*.webp"):
        kept += result.glob(f"renders/{kind}")
    for file in kept:
        target = out / file.relative_to(result)
        target.parent.mkdir(parents=True, exist_ok=True)
        shutil.copyfile(file, target)
    report = json.loads((result / "report" / "report.json").read_text(encoding="utf-8"))
    report["capture"]["source"] = NAME  # no path of this machine
    (out / "report").mkdir()
    (out / "report" / "report.json").write_text(json.dumps(report), encoding="utf-8")
    for file in result.glob("export/environment*.exr"):
        _smaller_map(file, out / "export" / file.name)
    table = json.loads((result / "export" / "cameras.json").read_text(encoding="utf-8"))
    for view in table["views"]:
        name = f"{Path(view['image']).stem}.webp"
        _webp(result / "export" / view["image"], out / "views" / name)
        view["image"] = f"../views/{name}"
    (out / "export" / "cameras.json").write_text(json.dumps(table), encoding="utf-8")
    for part in ("train", "test"):
        transforms = f"transforms_{part}.json"
        for file in sorted((capture / part).glob("r_[0-9]*.png")):
            _webp(file, out / NAME / part / f"{file.stem}.webp")
        shutil.copyfile(capture / transforms, out / NAME / transforms)
    (out / "README.txt").write_text(README, encoding="utf-8")


def _webp(source: Path, target: Path) -> None:
    target.parent.mkdir(parents=True, exist_ok=True)
    with Image.open(source, formats=("PNG",)) as picture:
        picture.save(target, quality=85, method=6, exact=True)


def _smaller_map(source: Path, target: Path) -> None:
    image = bpy.data.images.load(str(source))
    image.scale(LIGHT_SIDE, LIGHT_SIDE // 2)
    settings = bpy.context.scene.render.image_settings
    settings.file_format, settings.color_mode = "OPEN_EXR", "RGB"
    settings.color_depth, settings.exr_codec = "16", "DWAA"
    image.save_render(str(target))


if __name__ == "__main__":
    command, *given = sys.argv[1:]
    files = [Path(word).absolute() for word in given]
    work = {"render": render, "pack": pack}[command]
    sys.exit(carried_out(lambda: work(*files), files[-1]))
