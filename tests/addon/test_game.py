# SPDX-License-Identifier: Apache-2.0
"""Export for Games: levels that stand on the floor, and a normal map that holds the fine shape;
in a browser they look as in Blender.
"""

from __future__ import annotations

import base64
import io
import json
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest
import trimesh
from addon.blenders import VERSIONS, run
from addon.conftest import found_or_skipped
from addon.test_result_operators import COMMON
from evaluation import sphere_run
from export.browser import SAY, needs_chromium, visit
from PIL import Image

from robir.export.report.pictures import VIEWER_SCRIPT

pytestmark = pytest.mark.blender

LEVELS = ("ball", "ball_LOD1", "ball_LOD2")
SIDE = 96  # of the pictures of a level, pixels
AROUND, DOWN, FAR, HIGH, ANGLE = 30, 75, 1.2, 0.2, 30  # where a level is seen from: degrees, metres

SESSION = """
import math

import numpy as np
from mathutils import Vector


def baked(kind):
    # what each texel of the imported object shows, (N, 3), and where something is shown
    image = bpy.data.images.new(kind, 64, 64, alpha=True, float_buffer=True)
    image.colorspace_settings.name = "Non-Color"
    image.generated_color = (0, 0, 0, 0)
    nodes = bpy.context.object.active_material.node_tree.nodes
    texture = nodes.new("ShaderNodeTexImage")
    texture.image, nodes.active = image, texture
    bpy.ops.object.bake(type=kind, normal_space="OBJECT", margin=0)
    nodes.remove(texture)
    pixels = np.empty(4 * 64 * 64, np.float32)
    image.pixels.foreach_get(pixels)
    return pixels.reshape(-1, 4)


def slant(file, radius):
    # degrees between what is shown of a sphere and what it is, with the map and without
    bpy.ops.wm.read_factory_settings(use_empty=True)
    bpy.ops.import_scene.gltf(filepath=file)
    bpy.context.scene.render.engine = "CYCLES"
    bpy.context.scene.cycles.samples = 1
    shown = next(o for o in bpy.data.objects if o.type == "MESH")
    bpy.context.view_layer.objects.active = shown
    shown.select_set(True)
    place = baked("POSITION")
    seen = (place[:, :3] != 0).any(1)  # what was not baked is 0
    truth = place[seen, :3] - [0, 0, radius]
    truth /= np.linalg.norm(truth, axis=1, keepdims=True)
    answer = []
    for _ in range(2):
        normal = 2 * baked("NORMAL")[seen, :3] - 1
        cosine = (normal * truth).sum(1) / np.linalg.norm(normal, axis=1)
        answer.append(float(np.median(np.degrees(np.arccos(np.clip(cosine, -1, 1))))))
        for link in list(shown.active_material.node_tree.links):
            if link.to_socket.name == "Normal":
                shown.active_material.node_tree.links.remove(link)
    return answer


def picture(file, sky, side, around, down, far, high, angle):
    # a level as Cycles shows it under a map of the light, at its own name as PNG
    bpy.ops.wm.read_factory_settings(use_empty=True)
    bpy.ops.import_scene.gltf(filepath=file)
    scene, camera = bpy.context.scene, bpy.data.objects.new("C", bpy.data.cameras.new("C"))
    scene.collection.objects.link(camera)
    scene.camera, camera.data.angle = camera, math.radians(angle)
    around, down = math.radians(around), math.radians(down)
    level = math.sin(down)
    towards = Vector((level * math.sin(around), -level * math.cos(around), math.cos(down)))
    camera.location = Vector((0, 0, high)) + far * towards
    camera.rotation_euler = towards.to_track_quat("Z", "Y").to_euler()
    scene.world = bpy.data.worlds.new("W")
    scene.world.use_nodes = True
    nodes = scene.world.node_tree.nodes
    light = nodes.new("ShaderNodeTexEnvironment")
    light.image = bpy.data.images.load(sky)
    scene.world.node_tree.links.new(light.outputs["Color"], nodes["Background"].inputs["Color"])
    render = scene.render
    render.engine, scene.cycles.samples, scene.cycles.use_denoising = "CYCLES", 16, False
    render.resolution_x = render.resolution_y = side
    render.film_transparent, scene.view_settings.view_transform = True, "Standard"
    render.image_settings.file_format, render.image_settings.color_mode = "PNG", "RGBA"
    render.filepath = file.replace(".glb", ".png")
    bpy.ops.render.render(write_still=True)


def main(archive, result, out, levels, seen):
    install(archive)
    bpy.ops.wm.read_factory_settings(use_empty=True)
    bpy.ops.preferences.addon_enable(module=MODULE)
    scene = bpy.context.scene
    call("import_result", directory=result)
    before = [census(), [list(o.location) for o in bpy.data.objects], scene.render.engine]
    wishes = {"most_faces": 200, "texture_side": "512", "size": 0.5}
    answer = {"said": call("export_game", filepath=out + "/ball.glb", **wishes)}
    after = [census(), [list(o.location) for o in bpy.data.objects], scene.render.engine]
    answer["is_same"] = before == after
    whole = {"most_faces": 60, "levels": 1, "is_cleaned": False, "is_usd": False}
    call("export_game", filepath=out + "/whole.glb", size=2.0, **whole)
    bpy.ops.wm.read_factory_settings(use_empty=True)
    bpy.ops.wm.usd_import(filepath=out + "/ball_LOD1.usdc")
    answer["usd"] = [[o.name, len(o.data.polygons), sorted({p.loop_total for p in o.data.polygons})]
                     for o in bpy.data.objects if o.type == "MESH"]
    answer["slant"] = slant(out + "/whole.glb", 1.0)
    for level in levels:
        picture(f"{out}/{level}.glb", f"{out}/sky.hdr", *seen)
    return answer
"""


@pytest.fixture(scope="module", params=(VERSIONS[0], VERSIONS[-1]))
def game(
    request: pytest.FixtureRequest, extension_zip, result, tmp_path_factory
) -> tuple[dict[str, Any], Path]:
    """What a session answered, and the folder it exported to."""
    out = tmp_path_factory.mktemp("game")
    # light that grows with the height, the same all around
    rows = np.linspace(1.0, 0.2, 32, dtype=np.float32)[:, None, None]
    cv2.imwrite(str(out / "sky.hdr"), np.broadcast_to(rows, (32, 64, 3)))
    table = json.loads(result.cameras.read_text())
    floor = sphere_run.CENTRE[2] - 0.8 * sphere_run.SPHERE  # what is below counts as ground
    table["ground"] = {"normal": [0.0, 0.0, 1.0], "offset": float(floor)}
    result.cameras.write_text(json.dumps(table))
    words = str(extension_zip), str(result.root), str(out)
    seen = (SIDE, AROUND, DOWN, FAR, HIGH, ANGLE)
    blender = found_or_skipped(request.param)
    answer = run(blender, COMMON + SESSION, *words, LEVELS, seen, user=out / "user")
    return answer, out


def test_levels_stand_on_the_floor_with_the_fine_shape_in_a_normal_map(game):
    answer, out = game
    assert answer["said"] == ["FINISHED"] and answer["is_same"]
    glbs = {f.name for f in out.glob("*.glb")}
    assert glbs == {"ball.glb", "ball_LOD1.glb", "ball_LOD2.glb", "whole.glb"}
    for name, faces in (("ball.glb", 200), ("ball_LOD1.glb", 100), ("ball_LOD2.glb", 50)):
        scene = trimesh.load(out / name)
        (mesh,) = scene.dump()
        assert 0.9 * faces - 2 <= len(mesh.faces) <= faces
        low, high = mesh.bounds
        assert low[1] == pytest.approx(0.0, abs=1e-5), "y is up, and the feet are at the origin"
        assert low[[0, 2]] + high[[0, 2]] == pytest.approx(0.0, abs=0.02)
        assert max(high - low) == pytest.approx(0.5, rel=0.05)
        assert high[1] < 0.47, "the ground below is gone"
        material = mesh.visual.material
        assert material.normalTexture.size == (512, 512)
        assert material.baseColorTexture.size == (sphere_run.TEXELS, sphere_run.TEXELS)
    assert answer["usd"] == [["ball_LOD1", pytest.approx(100, abs=12), [3]]]
    shown, plain = answer["slant"]
    assert shown < 2.0 and shown < 0.8 * plain, "the map says where the fine surface looks"


VIEWERS = """<style>model-viewer { width: %(side)dpx; height: %(side)dpx; }</style>%(viewers)s
<script type="module">%(script)s</script>
<script type="module">
const viewers = [...document.querySelectorAll("model-viewer")], frame = () =>
  new Promise(requestAnimationFrame);
await customElements.whenDefined("model-viewer");
customElements.get("model-viewer").minimumRenderScale = 1;
for (const viewer of viewers) {
  if (!viewer.loaded) await new Promise(done => viewer.addEventListener("load", done));
}
for (let i = 0; i < 3; i++) await frame();
say(viewers.map(viewer => viewer.toDataURL()));
</script>"""


def address(file: Path, kind: str, name: str = "") -> str:
    return f"data:{kind};base64,{base64.b64encode(file.read_bytes()).decode()}{name}"


def coloured(picture: Image.Image) -> tuple[np.ndarray, np.ndarray]:
    """Where a picture shows the object, and the mean colour of its upper and lower half, 0 to 1."""
    rgba = np.asarray(picture.convert("RGBA").resize((SIDE, SIDE)), np.float32) / 255
    shows = rgba[..., 3] > 0.5
    middle = int(np.nonzero(shows)[0].mean())
    halves = [slice(None, middle), slice(middle, None)]
    return shows, np.array([rgba[half][shows[half]][:, :3].mean(axis=0) for half in halves])


@pytest.mark.slow
@needs_chromium
def test_a_browser_shows_the_levels_as_cycles_does(game, tmp_path):
    _, out = game
    sky = address(out / "sky.hdr", "image/vnd.radiance", "#.hdr")
    seen = (
        f'camera-orbit="{AROUND}deg {DOWN}deg {FAR}m" camera-target="0m {HIGH}m 0m" '
        f'field-of-view="{ANGLE}deg" max-camera-orbit="auto auto 9m" tone-mapping="linear" '
        f'environment-image="{sky}" loading="eager"'
    )
    sources = [address(out / f"{level}.glb", "model/gltf-binary") for level in LEVELS]
    viewers = "".join(f'<model-viewer src="{source}" {seen}></model-viewer>' for source in sources)
    script = VIEWER_SCRIPT.read_text(encoding="utf-8")
    page = VIEWERS % {"side": SIDE, "viewers": viewers, "script": script}
    visited = visit(
        {"/page": f"<!doctype html><title>Levels</title>{SAY}{page}"}, tmp_path / "user"
    )
    assert not visited.faults
    assert len(visited.said) == len(LEVELS)
    for level, said in zip(LEVELS, visited.said, strict=True):
        content = base64.b64decode(said.partition(",")[2])
        (shown, browser), (there, cycles) = (
            coloured(Image.open(source)) for source in (io.BytesIO(content), out / f"{level}.png")
        )
        assert (shown & there).sum() > 0.97 * (shown | there).sum(), level
        assert np.abs(browser - cycles).max() < 0.03, (level, browser, cycles)
