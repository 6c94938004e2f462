# SPDX-License-Identifier: Apache-2.0
"""Meshes that only Blender reads, made by Blender's exporters, come to the engine as they stood."""

from __future__ import annotations

import json
import re
import shlex
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
import trimesh

from robir.capture.mesh_file import FOREIGN, read_mesh
from robir.errors import CaptureError

pytestmark = pytest.mark.blender

MAKE = """
import json
import sys
from math import radians

import bpy
from mathutils import Euler, Matrix, Vector

bpy.ops.wm.read_factory_settings(use_empty=True)
link = bpy.context.scene.collection.objects.link


def solid(name, corners, faces, materials, slots):
    mesh = bpy.data.meshes.new(name)
    mesh.from_pydata(corners, [], faces)
    layer = mesh.uv_layers.new(name="UVMap")
    for index, corner in enumerate(layer.uv):
        corner.vector = (0.03 * index + 0.01, 0.9 - 0.05 * index)
    for material in materials:
        mesh.materials.append(material)
    mesh.polygons.foreach_set("material_index", slots)
    tilted = [corner.vector + Vector((0.1, 0.3, 0.2)) for corner in mesh.corner_normals]
    mesh.normals_split_custom_set([normal.normalized() for normal in tilted])
    item = bpy.data.objects.new(name, mesh)
    link(item)
    return item


red, blue = (bpy.data.materials.new(name) for name in ("Red", "Blue"))
for material, paint in ((red, (1, 0, 0, 1)), (blue, (0, 0, 1, 1))):
    material.use_nodes = True
    material.node_tree.nodes["Principled BSDF"].inputs["Base Color"].default_value = paint
corners = [(0, 0, 0), (2, 0, 0), (0, 3, 0), (0, 0, 5)]
faces = [(0, 2, 1), (0, 1, 3), (0, 3, 2), (1, 2, 3)]
body = solid("Body", corners, faces, [red, blue], [0, 0, 1, 1])
lid = solid("Lid", corners, faces, [blue], [0, 0, 0, 0])
lid.modifiers.new("Push", "DISPLACE").strength = 0.5
group = bpy.data.objects.new("Group", None)
group.matrix_world = Matrix.LocRotScale(Vector((1, 2, 3)), Euler((0.3, 0.2, 1)), Vector((2, 2, 2)))
link(group)
body.parent = lid.parent = group
body.location, body.rotation_euler = (0.5, -1, 0.25), (radians(30), 0, radians(-50))
lid.location, lid.scale = (-4, 0, 1), (-1.5, 1, 1)
link(bpy.data.objects.new("Eye", bpy.data.cameras.new("Eye")))
link(bpy.data.objects.new("Lamp", bpy.data.lights.new("Lamp", "SUN")))
bpy.context.view_layer.update()

truth = []
shown = bpy.context.evaluated_depsgraph_get()
for item in (body, lid):
    mesh, uvs = item.evaluated_get(shown).to_mesh(), item.data.uv_layers[0].uv
    upright = item.matrix_world.inverted().transposed().to_3x3()
    for face in mesh.polygons:
        corners = []
        for vertex, loop in zip(face.vertices, face.loop_indices):
            normal = (upright @ mesh.corner_normals[loop].vector).normalized()
            place = item.matrix_world @ mesh.vertices[vertex].co
            corners.append([*place, *uvs[loop].vector, *normal])
        if item is lid:  # it is mirrored: this way round it looks outwards
            corners.reverse()
        truth.append([item.name, item.data.materials[face.material_index].name, corners])

folder = sys.argv[1]
bpy.ops.export_scene.fbx(filepath=folder + "/scan.fbx", use_mesh_modifiers=True)
bpy.ops.wm.usd_export(filepath=folder + "/scan.usdz")
bpy.ops.wm.obj_export(filepath=folder + "/scan.obj", forward_axis="Y", up_axis="Z")
for item in (body, lid):
    bpy.data.objects.remove(item)
bpy.ops.wm.usd_export(filepath=folder + "/bare.usda")
bpy.ops.mesh.primitive_cube_add(location=(3, 0, 0))
bpy.ops.wm.alembic_export(filepath=folder + "/cube.abc", as_background_job=False)
with open(folder + "/truth.json", "w") as file:
    json.dump(truth, file)
"""

YARD = """#usda 1.0
(
    upAxis = "Y"
    metersPerUnit = 0.01
    startTimeCode = 5
    endTimeCode = 9
)
def Xform "Yard"
{
    def Mesh "Post"
    {
        point3f[] points = [(100, 0, 0), (0, 200, 0), (0, 0, 300)]
        int[] faceVertexCounts = [3]
        int[] faceVertexIndices = [0, 1, 2]
        float3 xformOp:translate.timeSamples = { 1: (0, 700, 0), 5: (0, 0, 0) }
        uniform token[] xformOpOrder = ["xformOp:translate"]
    }
    def Xform "First" (
        references = </Kind>
        instanceable = true
    ) {}
    def Xform "Second" (
        references = </Kind>
        instanceable = true
    )
    {
        float3 xformOp:translate = (0, 1000, 0)
        uniform token[] xformOpOrder = ["xformOp:translate"]
    }
    def Mesh "Hidden" ( references = </Kind/Leaf> )
    {
        token visibility = "invisible"
    }
    def Mesh "Rough" ( references = </Kind/Leaf> )
    {
        uniform token purpose = "proxy"
    }
}
class Xform "Kind"
{
    def Mesh "Leaf"
    {
        point3f[] points = [(0, 0, 0), (100, 0, 0), (0, 100, 0)]
        int[] faceVertexCounts = [3]
        int[] faceVertexIndices = [0, 1, 2]
    }
}
"""

TILED = """
import sys
import bpy

folder = sys.argv[1]
bpy.ops.wm.read_factory_settings(use_empty=True)
bpy.ops.mesh.primitive_plane_add()
plane = bpy.context.object
for corner in plane.data.uv_layers[0].uv:
    corner.vector.x += 1
for tile in (1001, 1002):
    bpy.data.images.new("Tile", 8, 8).save(filepath=f"{folder}/paint.{tile}.png")
image = bpy.data.images.load(folder + "/paint.1001.png")
image.source, image.filepath = "TILED", folder + "/paint.<UDIM>.png"
image.tiles.new(1002)
gone = bpy.data.images.new("Gone", 8, 8)
gone.source, gone.filepath = "FILE", folder + "/gone.png"
for name, picture in (("Tiles", image), ("Lost", gone)):
    material = bpy.data.materials.new(name)
    material.use_nodes = True
    nodes = material.node_tree.nodes
    texture = nodes.new("ShaderNodeTexImage")
    texture.image = picture
    target = nodes["Principled BSDF"].inputs["Base Color"]
    material.node_tree.links.new(texture.outputs["Color"], target)
    plane.data.materials.append(material)
plane.modifiers.new("Two", "ARRAY").use_relative_offset = True
bpy.ops.wm.usd_export(filepath=folder + "/tiled.usda", export_textures_mode="KEEP")
bpy.ops.export_scene.fbx(filepath=folder + "/tiled.fbx")
"""

BUMPY = """
import sys
import bpy

folder = sys.argv[1]
bpy.ops.wm.read_factory_settings(use_empty=True)
bpy.ops.mesh.primitive_plane_add()
bpy.data.images.new("Bumps", 8, 4).save(filepath=folder + "/bumps.png")
material = bpy.data.materials.new("Bumpy")
material.use_nodes = True
nodes, links = material.node_tree.nodes, material.node_tree.links
texture, bumps = nodes.new("ShaderNodeTexImage"), nodes.new("ShaderNodeNormalMap")
texture.image = bpy.data.images.load(folder + "/bumps.png")
links.new(texture.outputs["Color"], bumps.inputs["Color"])
links.new(bumps.outputs["Normal"], nodes["Principled BSDF"].inputs["Normal"])
bpy.context.object.data.materials.append(material)
bpy.ops.export_scene.fbx(filepath=folder + "/bumpy.fbx")
bpy.ops.wm.usd_export(filepath=folder + "/bumpy.usdz")
"""


def made_by(script: str, folder: Path) -> Path:
    command = [sys.executable, "-c", script, str(folder)]
    subprocess.run(command, check=True, capture_output=True)
    return folder


def headless(file, out, *more):
    """Convert in one process, or, without --within, in one of its own that may die."""
    command = [sys.executable, "-m", "robir_addon.headless", "mesh", str(file), str(out), *more]
    return subprocess.run(command, capture_output=True, text=True, check=False)


@pytest.fixture(scope="module")
def scans(tmp_path_factory) -> Path:
    """Two objects, two materials, a parent and a mirror, in every kind of file; and the truth."""
    return made_by(MAKE, tmp_path_factory.mktemp("scans"))


def converted(file: Path, folder: Path) -> Path:
    out = folder / f"{file.stem}.glb"
    run = headless(file, out, "--within", str(1 << 33))
    assert run.returncode == 0, run.stderr
    assert json.loads(run.stdout.splitlines()[-1])["files"] == [str(out)]
    assert [path.name for path in folder.iterdir() if path.name.startswith(".")] == []
    return out


def z_up(points: np.ndarray) -> np.ndarray:
    return np.stack([points[:, 0], -points[:, 2], points[:, 1]], axis=1)


def described(glb: Path) -> dict[tuple[str, str], np.ndarray]:
    """Corners (F, 3, 8) with place, texture coordinates and normal by object and material."""
    scene, found = trimesh.load_scene(glb, process=False), {}
    for node in scene.graph.nodes_geometry:
        place, key = scene.graph[node]
        assert (place == np.eye(4)).all(), "a transform is left"
        piece = scene.geometry[key]
        each = [z_up(piece.vertices), piece.visual.uv, z_up(piece.vertex_normals)]
        found[node.partition("_")[0], piece.visual.material.name] = np.hstack(each)[piece.faces]
    return found


def in_order(triangles: np.ndarray) -> np.ndarray:
    """Each triangle from its lowest texture coordinate on, and all of them by that."""
    first = triangles[:, :, 3].argmin(1)
    turned = triangles[np.arange(len(triangles))[:, None], (first[:, None] + np.arange(3)) % 3]
    return turned[turned[:, 0, 3].argsort()]


@pytest.mark.parametrize("suffix", ["fbx", "usdz"])
def test_objects_and_materials_stand_as_they_stood(scans, tmp_path, suffix):
    glb = converted(scans / f"scan.{suffix}", tmp_path)
    truth: dict[tuple[str, str], list] = {}
    for name, material, corners in json.loads((scans / "truth.json").read_text()):
        truth.setdefault((name, material), []).append(corners)
    found = described(glb)
    assert found.keys() == truth.keys()
    for key, triangles in truth.items():
        expected = in_order(np.array(triangles))
        assert in_order(found[key])[..., :5] == pytest.approx(expected[..., :5], abs=1e-5), key
        assert in_order(found[key])[..., 5:] == pytest.approx(expected[..., 5:], abs=2e-3), key
    content = glb.read_bytes()
    document = json.loads(content[20 : 20 + int.from_bytes(content[12:16], "little")])
    assert not {"cameras", "animations", "skins", "extensionsUsed"} & document.keys()


def test_axes_units_instances_and_time_are_as_blender_shows_them(tmp_path):
    (tmp_path / "yard.usda").write_text(YARD)
    given = read_mesh(converted(tmp_path / "yard.usda", tmp_path))
    leaf = np.array([[0, 0, 0], [1, 0, 0], [0, 0, 1]])
    post = [[1, 0, 0], [0, 0, 2], [0, -3, 0]]
    expected = [leaf, leaf + np.array([0, 0, 10]), post]
    found = sorted(given.vertices[given.faces].round(5).tolist())
    assert found == sorted(np.array(expected, float).tolist())


def test_tiles_and_lost_pictures_change_no_texture_coordinates(tmp_path):
    made_by(TILED, tmp_path)
    given = read_mesh(converted(tmp_path / "tiled.fbx", tmp_path))
    assert len(given.faces) == 4, "modifiers are applied"
    assert np.unique(given.uvs[:, 0].round(4)).tolist() == [1.0, 2.0]


def test_a_normal_map_goes_along(tmp_path):
    made_by(BUMPY, tmp_path)
    given = read_mesh(converted(tmp_path / "bumpy.usdz", tmp_path))
    assert given.detail is not None and given.detail.maps[0].shape == (4, 8, 3)


@pytest.mark.parametrize(("kind", "content"), [("fbx", b""), ("usdz", b"no mesh at all\n")])
def test_files_that_hold_nothing_are_refused_in_a_sentence(tmp_path, kind, content):
    (tmp_path / f"bad.{kind}").write_bytes(content)
    refused(tmp_path / f"bad.{kind}", tmp_path / "bad.glb", f"bad.{kind} cannot be read (")


def test_alembic_stands_as_it_stood(scans, tmp_path):
    given = read_mesh(converted(scans / "cube.abc", tmp_path))
    assert len(given.faces) == 12
    assert given.vertices.min(0) == pytest.approx([2, -1, -1])


def corners(count: str, *numbers: str) -> str:
    """A USD file of one triangle that is damaged."""
    return (
        '#usda 1.0\ndef Mesh "Post"\n{\n    point3f[] points = [(1, 0, 0), (0, 2, 0), (0, 0, 3)]\n'
        f"    int[] faceVertexCounts = [{count}]\n"
        f"    int[] faceVertexIndices = [{', '.join(numbers)}]\n}}\n"
    )


@pytest.mark.parametrize(
    ("content", "sentence"),
    [
        (corners("3", "0", "1", "2000000000"), ""),
        (corners("2000000000", "0", "1", "2"), "ended Blender: it is damaged"),
        (corners("3", "0", "1", "-7"), "shows no object with faces"),
    ],
)
def test_files_that_end_blender_are_refused_in_a_sentence(tmp_path, content, sentence):
    (tmp_path / "bad.usda").write_text(content)
    refused(tmp_path / "bad.usda", tmp_path / "bad.glb", f"bad.usda {sentence}")
    assert [path.name for path in tmp_path.iterdir()] == ["bad.usda"]


def test_half_an_alembic_file_is_refused_in_a_sentence(scans, tmp_path):
    whole = (scans / "cube.abc").read_bytes()
    (tmp_path / "cut.abc").write_bytes(whole[: len(whole) // 2])
    refused(tmp_path / "cut.abc", tmp_path / "cut.glb", "cut.abc ")


@pytest.mark.skipif(sys.platform != "linux", reason="other systems bound no memory")
def test_reading_has_so_much_memory_and_time(tmp_path):
    program = """
import sys
from pathlib import Path
import bpy
from robir_addon.capture.foreign_mesh import convert_apart
from robir_addon.engine.errors import RequestError
bpy.ops.wm.read_factory_settings(use_empty=True)
bpy.ops.mesh.primitive_grid_add(x_subdivisions=500, y_subdivisions=500)
bpy.ops.wm.alembic_export(filepath=sys.argv[1], as_background_job=False)
# too little memory for the reader of Alembic, and for the writer of GLB; and no time
for limits in ((300 << 20, 600.0), (480 << 20, 600.0), (1 << 33, 0.05)):
    try:
        convert_apart(Path(sys.argv[1]), Path("cube.glb"), *limits)
    except RequestError as error:
        print("refused:", error)
"""
    words = [sys.executable, "-c", program, str(tmp_path / "grid.abc")]
    run = subprocess.run(words, capture_output=True, text=True, check=True, cwd=tmp_path)
    *memory, time = [line for line in run.stdout.splitlines() if "refused:" in line]
    for gigabytes, sentence in zip(("0.3", "0.5"), memory, strict=True):
        text = f"ended Blender: it is damaged, or takes more than {gigabytes} GB of memory"
        assert text in sentence
    assert "takes longer than 0.05 s" in time


def test_files_without_faces_are_refused(scans, tmp_path):
    refused(scans / "bare.usda", tmp_path / "bare.glb", "bare.usda shows no object with faces")


def refused(file: Path, out: Path, sentence: str) -> None:
    before = out.read_bytes() if out.is_file() else None
    run = headless(file, out)
    assert run.returncode == 2, run.stderr
    (said,) = [line for line in run.stderr.splitlines() if line.startswith("error: ")]
    assert sentence in said and "Traceback" not in run.stderr
    assert before == (out.read_bytes() if out.is_file() else None)


def test_paths_that_make_no_sense_are_refused(scans, tmp_path):
    from robir_addon.capture.foreign_mesh import convert_apart
    from robir_addon.engine.errors import RequestError

    out, taken = tmp_path / "scan.glb", tmp_path / "taken.glb"
    taken.write_bytes(b"of the user")
    for file, glb, sentence in (
        (tmp_path / "gone.fbx", out, "gone.fbx does not exist or is no file"),
        (tmp_path, out, "is of no kind that is converted here; give one of .fbx, .usd"),
        (scans / "scan.obj", out, "is of no kind that is converted here"),
        (scans / "scan.fbx", tmp_path / "scan.obj", "give it a name that ends in .glb"),
        (scans / "scan.fbx", taken, "taken.glb exists already"),
    ):
        with pytest.raises(RequestError, match=re.escape(sentence)):
            convert_apart(file, glb)
    assert taken.read_bytes() == b"of the user"
    refused(tmp_path / "gone.fbx", out, "gone.fbx does not exist or is no file")


def test_the_engine_names_the_command_that_makes_a_mesh_it_reads(scans, tmp_path, monkeypatch):
    from robir_addon.capture.foreign_mesh import SUFFIXES  # it needs Blender

    assert SUFFIXES == FOREIGN
    file = tmp_path / "a scan.fbx"
    file.write_bytes((scans / "scan.fbx").read_bytes())
    with pytest.raises(CaptureError, match=r"--mesh 'a scan\.glb'") as refusal:
        read_mesh(file)
    command = str(refusal.value).split("`")[1]
    subprocess.run(shlex.split(command), check=True, capture_output=True, cwd=tmp_path)
    monkeypatch.chdir(tmp_path)
    assert len(read_mesh(Path("a scan.glb")).faces) == 8
