# SPDX-License-Identifier: Apache-2.0
"""Every operator on a finished result, in every Blender, with the extension as users get it."""

import numpy as np
import pytest
from addon.blenders import MODULE, run
from evaluation import sphere_run
from PIL import Image

from robir.evaluation.metrics import srgb_from_linear

pytestmark = pytest.mark.blender

COMMON = f"""
import bpy

MODULE = {MODULE!r}
KINDS = "objects collections meshes cameras lights materials worlds images".split()


def install(archive):
    bpy.ops.extensions.package_install_files(
        filepath=archive, repo="user_default", enable_on_install=True)


def census():
    return {{kind: sorted(b.name for b in getattr(bpy.data, kind)) for kind in KINDS}}


def call(name, **given):
    # with an undo step, as a button makes it
    try:
        return sorted(getattr(bpy.ops.robir, name)("EXEC_DEFAULT", True, **given))
    except RuntimeError as refusal:
        return str(refusal).strip()


def light():
    world = bpy.context.scene.world
    nodes = {{n.type: n for n in world.node_tree.nodes}}
    lamps = [o for o in bpy.data.objects if o.type == "LIGHT"]
    return {{
        "world": world.name,
        "picture": nodes["TEX_ENVIRONMENT"].image.name,
        "turn": nodes["MAPPING"].inputs["Rotation"].default_value[2],
        "hidden": [[o.hide_render, o.hide_viewport] for o in lamps],
        "towards": [list(o.matrix_world.to_3x3().col[2]) for o in lamps],
    }}
"""

LOOK = """
def main(archive, result, out):
    install(archive)
    bpy.ops.wm.read_factory_settings(use_empty=True)
    bpy.ops.preferences.addon_enable(module=MODULE)
    bpy.ops.ed.undo_push(message="start")
    scene = bpy.context.scene
    settings, state = scene.robir, bpy.context.window_manager.robir
    answer = {"empty": census(), "refused": [call("import_result"), call("compare")]}
    answer["no such"] = [call("import_result", directory=out), state.error, state.error_cure]
    answer["imported"] = call("import_result", directory=result + "/")
    answer["problem"] = state.error
    answer["result"], answer["there"] = settings.result, census()
    answer["active"] = bpy.context.object.name
    answer["again"] = [call("import_result"), census()]
    for _ in range(2):
        bpy.ops.ed.undo()
    answer["undone"] = census()
    for _ in range(2):
        bpy.ops.ed.redo()
    scene = bpy.context.scene
    answer["redone"] = census()
    answer["before match"] = scene.view_settings.view_transform
    call("match_view_transform")
    answer["matched"] = scene.view_settings.view_transform
    bpy.ops.ed.undo()
    answer["unmatched"] = bpy.context.scene.view_settings.view_transform
    answer["compared"] = [call("compare"), call("compare", view="nobody"), call("compare")]
    pictures = [i.name for i in bpy.data.images if i.name.startswith("RobIR")]
    image, views = bpy.data.images["RobIR comparison"], []
    for step in (1, 1, -1):
        call("compare_next", step=step)
        views.append(image["robir_view"])
    answer["views"] = [*views, image["robir_captions"]]
    call("compare")
    answer["pictures"] = pictures
    image = bpy.data.images["RobIR comparison"]
    image.filepath_raw, image.file_format = out + "/comparison.png", "PNG"
    image.save()
    answer["report"] = [call("open_report"), call("copy_report")]
    import sys
    answer["text"] = sys.modules[MODULE + ".work.support"].support_report(bpy.context)
    answer["removed"] = [call("remove_result"), census(), bpy.context.scene.robir.result]
    return answer
"""

LIGHTS = """
def main(archive, result):
    install(archive)
    bpy.ops.wm.read_factory_settings()
    bpy.ops.preferences.addon_enable(module=MODULE)
    scene = bpy.context.scene
    bpy.data.objects.remove(bpy.data.objects["Light"])
    bpy.ops.ed.undo_push(message="start")
    answer = {"before": scene.world.name}
    call("import_result", directory=result)
    bpy.context.view_layer.update()
    answer["recovered"] = light()
    scene.robir.use_sun_lamp = False
    answer["whole"] = light()
    scene.robir.use_sun_lamp = True
    scene.robir.rotation = 0.5
    bpy.context.view_layer.update()
    answer["turned"] = light()
    scene.robir.light = "city"
    bpy.ops.ed.undo_push(message="Light")
    answer["studio"] = [scene.robir.light, light()]
    scene.robir.use_sun_lamp = False
    scene.robir.use_sun_lamp = True
    answer["still studio"] = light()["picture"]
    bpy.ops.ed.undo()
    answer["undone"] = light()["picture"]
    scene = bpy.context.scene
    answer["file"] = [call("use_environment", filepath=result + "/export/environment.exr"), light()]
    answer["bad"] = [call("use_environment", filepath=result + name)
                     for name in ("/nothing.exr", "/run.json", "/export/damaged.exr")]
    answer["after bad"] = light()
    scene.robir.light = "recovered"
    bpy.context.view_layer.update()
    answer["back"] = [light(), scene.robir.rotation, sorted(i.name for i in bpy.data.images)]
    call("remove_result")
    answer["after"] = scene.world.name
    return answer
"""

STARTUP = """
def shown():
    return {name: [bpy.data.objects[name].visible_get(), not bpy.data.objects[name].hide_render]
            for name in ("Cube", "Light")}

def main(archive, result):
    install(archive)
    answer = {}
    for name, touch in (("untouched", None), ("moved", "location"), ("scaled", "scale")):
        bpy.ops.wm.read_factory_settings()
        bpy.ops.preferences.addon_enable(module=MODULE)
        if touch:
            for thing in ("Cube", "Light"):
                getattr(bpy.data.objects[thing], touch).x += 0.5
        call("import_result", directory=result)
        there = shown()
        call("remove_result")
        answer[name] = [there, shown()]
    return answer
"""

EXPORT = """
import os


def main(archive, result, out):
    install(archive)
    bpy.ops.wm.read_factory_settings(use_empty=True)
    bpy.ops.preferences.addon_enable(module=MODULE)
    bpy.ops.ed.undo_push(message="start")
    scene = bpy.context.scene
    scene.robir.result = result
    answer = {"not imported": [call("export_usd", filepath=out + "/a.usdc"), call("mark_asset")]}
    # what is copied needs no import
    answer["glb"] = call("export_glb", filepath=out + "/deep/er/asset")
    textures = out + "/some textures"
    answer["textures"] = [call("export_textures", directory=textures) for _ in range(2)]
    answer["textures"].append(call("export_textures", directory=textures, overwrite=True))
    answer["nowhere"] = [call("export_glb"), call("export_textures")]
    call("import_result")
    other = bpy.data.objects.new("other", None)
    scene.collection.objects.link(other)
    bpy.context.object.select_set(False)
    other.select_set(True)
    bpy.context.view_layer.objects.active = other
    asset = next(o for o in scene.objects if o.type == "MESH")
    asset.location.x = 7.0
    answer["changed glb"] = call("export_glb", filepath=out + "/changed.glb")
    asset.location.x = 0.0
    scene.robir.rotation = 0.5
    bpy.context.view_layer.update()
    lit = light()
    answer["usd"] = call("export_usd", filepath=out + "/usd/a.usdc")
    answer["selected"] = [[o.name for o in bpy.context.selected_objects], bpy.context.object.name]
    asset = next(o for o in scene.objects if o.type == "MESH")
    corners = [list(asset.bound_box[i]) for i in (0, 6)]
    answer["marked"] = [call("mark_asset"), call("mark_asset")]
    data = asset.asset_data
    answer["asset"] = {"text": data.description, "tags": sorted(t.name for t in data.tags)}
    answer["facts"] = [asset[f"robir_{name}"] for name in ("version", "device", "seed")]
    nodes = asset.data.materials[0].node_tree.nodes
    answer["packed"] = [bool(n.image.packed_file) for n in nodes if n.type == "TEX_IMAGE"]
    pixels = list(asset.preview.image_pixels_float)
    answer["preview"] = [list(asset.preview.image_size), max(pixels), sum(pixels[3::4])]
    bpy.ops.ed.undo()
    bpy.ops.ed.undo()
    asset = next(o for o in bpy.context.scene.objects if o.type == "MESH")
    answer["unmarked"] = asset.asset_data is None
    bpy.ops.wm.read_factory_settings(use_empty=True)
    bpy.context.scene.world = bpy.data.worlds.new("to be filled")
    bpy.ops.wm.usd_import(filepath=out + "/usd/a.usdc")
    (mesh,) = [o for o in bpy.context.scene.objects if o.type == "MESH"]
    (sun,) = [o for o in bpy.context.scene.objects if o.type == "LIGHT"]
    spaces = {i.name.partition(".")[0]: i.colorspace_settings.name for i in bpy.data.images}
    bpy.context.view_layer.update()
    bpy.ops.import_scene.gltf(filepath=out + "/changed.glb")
    changed = bpy.context.selected_objects[0]
    answer["changed"] = [changed.location.x, len(changed.data.uv_layers),
                         len(bpy.context.selected_objects)]
    answer["read"] = {
        "corners": [corners, [list(mesh.bound_box[i]) for i in (0, 6)]],
        "sun": [sun.data.energy, list(sun.data.color), sun.data.angle],
        "towards": [lit["towards"][0], list(sun.matrix_world.to_3x3().col[2])],
        "spaces": spaces,
        "dome": light(),
    }
    return answer
"""


@pytest.fixture
def files(extension_zip, result):
    result.log.write_text(f"INFO reading {result.root}/photographs\nINFO the end\n")
    (result.export / "damaged.exr").write_bytes(b"no picture")
    return str(extension_zip), str(result.root)


def test_a_result_is_brought_in_looked_at_and_taken_out(blender, files, result, tmp_path):
    answer = run(blender, COMMON + LOOK, *files, str(tmp_path), user=tmp_path / "user")
    assert "no folder was given" in answer["refused"][0]
    assert "Import a result first" in answer["refused"][1]
    said, sentence, cure = answer["no such"]
    assert "cannot be read" in said
    assert sentence.lower() in said.lower()
    assert cure.startswith("Choose a folder")
    assert (answer["imported"], answer["problem"]) == (["FINISHED"], "")
    assert answer["result"] == str(result.root)
    assert answer["active"] == "capture"
    assert len(answer["there"]["cameras"]) == 9
    assert answer["again"] == [["FINISHED"], answer["there"]]
    assert answer["undone"] == answer["empty"]
    assert answer["redone"] == answer["there"]
    assert (answer["before match"], answer["matched"], answer["unmatched"]) == (
        ("AgX", "Standard", "AgX")
    )
    assert answer["compared"][::2] == [["FINISHED"]] * 2
    assert "held_out_000" in answer["compared"][1]
    *views, captions = answer["views"]
    assert views[0] == views[2]
    assert len(set(views)) == 2
    assert captions.splitlines()[1:] == ["Photograph", "Re-render by RobIR", "Albedo", "Roughness"]
    assert f"View {views[2]}" in captions
    assert answer["pictures"] == ["RobIR comparison"]
    assert answer["report"] == [["FINISHED"]] * 2
    assert answer["removed"] == [["FINISHED"], answer["empty"], ""]
    check_comparison(tmp_path / "comparison.png")
    text = answer["text"]
    assert "<result>/photographs\nINFO the end" in text
    assert str(result.root) not in text
    assert blender.version in text
    assert result.run.read_text().splitlines()[1] in text


ALBEDOS = ([0.6, 0.25, 0.15], [0.15, 0.3, 0.5])
ROUGHNESS = (0.7, 0.4)


def four_pictures(file):
    """The comparison's pictures, codes (H, W, 4)."""
    with Image.open(file) as image:
        codes = np.array(image.convert("RGBA")).astype(int)
    total = codes.shape[1]
    assert total == 4 * len(codes)
    return np.split(codes, 4, axis=1)


def check_comparison(file):
    """Photograph and re-render are the same here; albedo and roughness are of two materials."""
    photo, again, albedo, roughness = four_pictures(file)
    solid = (photo[..., 3] > 250) & (albedo[..., 3] > 250)
    assert solid.mean() > 0.5
    assert np.abs(photo - again)[solid].mean() <= 1
    for picture, values in (
        (albedo[..., :3], [255 * srgb_from_linear(np.array(a)) for a in ALBEDOS]),
        (roughness[..., :1], [[255 * r] for r in ROUGHNESS]),
    ):
        # but for texels between two fields, all are one or the other
        fields = [np.abs(picture[solid] - value).max(axis=1) <= 12 for value in values]
        assert np.any(fields, axis=0).mean() > 0.8
        assert min(field.mean() for field in fields) > 0.25
    # the textures are seen by the photograph's camera: outlines agree but for its pixels' size
    assert np.mean((photo[..., 3] > 127) == (albedo[..., 3] > 127)) > 0.97
    # and so do the fields: the photograph is redder where the albedo is
    red = [picture[..., 0] > picture[..., 2] for picture in (photo, albedo)]
    assert np.mean((red[0] == red[1])[solid]) > 0.9


def test_what_blender_starts_with_stands_aside_until_the_result_is_gone(oldest, files, tmp_path):
    answer = run(oldest, COMMON + STARTUP, *files, user=tmp_path / "user")
    hidden = {"Cube": [False, False], "Light": [False, False]}
    shown = {"Cube": [True, True], "Light": [True, True]}
    assert answer["untouched"] == [hidden, shown]
    assert answer["moved"] == answer["scaled"] == [shown, shown]


def test_the_light_is_changed_turned_and_given_back(blender, files, tmp_path):
    answer = run(blender, COMMON + LIGHTS, *files, user=tmp_path / "user")
    shining, hidden = [[False, False]], [[True, True]]
    recovered = answer["recovered"]
    assert (recovered["world"], recovered["hidden"]) == ("sphere run", shining)
    assert recovered["picture"] == "environment_without_sun.exr"
    assert recovered["towards"][0] == pytest.approx(sphere_run.SUN_DIRECTION, abs=1e-6)
    assert (answer["whole"]["picture"], answer["whole"]["hidden"]) == ("environment.exr", hidden)
    x, y, z = sphere_run.SUN_DIRECTION
    cos, sin = np.cos(0.5), np.sin(0.5)
    turned = [cos * x - sin * y, sin * x + cos * y, z]
    assert answer["turned"]["towards"][0] == pytest.approx(turned, abs=1e-6)
    assert answer["turned"]["turn"] == pytest.approx(-0.5)
    said, studio = answer["studio"]
    assert (said, studio["picture"], studio["hidden"]) == ("city", "city.exr", hidden)
    assert studio["turn"] == pytest.approx(-0.5)
    assert answer["still studio"] == "city.exr"
    assert answer["undone"] == "environment_without_sun.exr"
    said, chosen = answer["file"]
    assert (said, chosen["hidden"]) == (["FINISHED"], hidden)
    missing, other, damaged = answer["bad"]
    assert "nothing.exr" in missing
    assert "run.json is no environment" in other
    assert "cannot be read as an image" in damaged
    assert answer["after bad"] == chosen
    back, rotation, images = answer["back"]
    assert back == recovered
    assert rotation == 0.0
    assert "city.exr" not in images
    assert answer["after"] == answer["before"]


def test_results_are_handed_on(newest, files, result, tmp_path):
    out = tmp_path / "out"
    out.mkdir()
    answer = run(newest, COMMON + EXPORT, *files, str(out), user=tmp_path / "user")
    assert all("import it again" in refusal for refusal in answer["not imported"])
    assert answer["glb"] == ["FINISHED"]
    assert (out / "deep/er/asset.glb").read_bytes() == result.asset.read_bytes()
    assert answer["changed glb"] == ["FINISHED"]
    assert answer["changed"] == [7.0, 1, 1], "what the user changed is in the file"
    first, second, third = answer["textures"]
    assert (first, third) == (["FINISHED"], ["FINISHED"])
    assert "some textures already has" in second
    assert "Overwrite" in second
    for file in result.textures.iterdir():
        assert (out / "some textures" / file.name).read_bytes() == file.read_bytes()
    assert all("was given" in refusal for refusal in answer["nowhere"])
    assert answer["usd"] == ["FINISHED"]
    assert answer["selected"] == [["other"], "other"]
    read = answer["read"]
    assert np.array(read["corners"][1]) == pytest.approx(np.array(read["corners"][0]), abs=1e-5)
    energy, tint, angle = read["sun"]
    assert energy * np.array(tint) == pytest.approx(sphere_run.SUN, rel=2e-3)
    assert angle == pytest.approx(4 / np.sqrt(sphere_run.SHARPNESS), rel=1e-3)
    assert read["towards"][1] == pytest.approx(read["towards"][0], abs=1e-5)
    assert read["spaces"]["albedo"] == "sRGB"
    assert read["spaces"]["roughness"] == "Non-Color"
    assert "environment_without_sun" in read["dome"]["picture"]
    assert read["dome"]["turn"] == pytest.approx(-0.5, abs=1e-5)
    for file in (out / "usd").rglob("*.usd*"):
        assert str(result.root).encode() not in file.read_bytes()
    assert answer["marked"] == [["FINISHED"]] * 2
    asset = answer["asset"]
    assert "9 photographs" in asset["text"]
    assert asset["tags"] == sorted(["RobIR", "reconstruction", "sphere run"])
    assert answer["packed"] == [True, True]
    assert answer["facts"][1:] == ["cpu", 0]
    size, brightest, covered = answer["preview"]
    assert 128 < size[0] == size[1] <= 256
    assert 0.5 < brightest <= 1.0
    assert covered / size[0] ** 2 > 0.4
    assert answer["unmarked"]
