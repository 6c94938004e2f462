# SPDX-License-Identifier: GPL-3.0-or-later
"""The asset as a mesh object with UVs and a Principled material."""

import hashlib
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import bpy
import numpy as np

from ..blocks import MARK, are_there, enable_nodes, load_image, numbers_of, reload_image, with_mark
from ..gateway import UDIM, JobPaths, of_tile, tiles_there
from .glb import GlbMesh
from .placing import fit_again

_DIGEST = "robir_digest"  # custom property of a mesh: its digest as it was imported
_SPECULAR = "robir_specular"  # custom property of a material: the specular level as it was imported
# custom property of a material: one string with the names of all sockets given a texture
_FED = "robir_fed"
_LEVEL = "Specular IOR Level"


def texture_sockets(paths: JobPaths) -> list[tuple[Path, str, str]]:
    """Texture files (of UDIM tiles: one path for all), sockets they feed, colour spaces."""
    albedo = paths.textures / "albedo.png"
    tile = UDIM if tiles_there(albedo) and not albedo.is_file() else None
    files = {
        "Base Color": (of_tile(albedo, tile), "sRGB"),
        "Roughness": (of_tile(paths.textures / "roughness.png", tile), "Non-Color"),
        "Metallic": (of_tile(paths.textures / "metallic.png", tile), "Non-Color"),
        "Normal": (of_tile(paths.textures / "normal.png", tile), "Non-Color"),
    }
    # written only where something is metal, and where the user's own mesh brought one
    absent = [s for s in ("Metallic", "Normal") if not are_there(files[s][0])]
    return [(f, socket, space) for socket, (f, space) in files.items() if socket not in absent]


def coverage_file(paths: JobPaths) -> Path:
    """Texture of the share of the photographs that see each texel, or of all its tiles."""
    (albedo, *_), *_ = texture_sockets(paths)
    return albedo.with_name(albedo.name.replace("albedo", "coverage"))


def add_asset(mesh: GlbMesh, name: str, paths: JobPaths, mark: str) -> bpy.types.Object:
    """The object in the capture's frame, not yet linked to a collection."""
    data = _mesh(mesh, mark)
    data.materials.append(new_material(name, mesh.specular, paths, mark))
    asset = bpy.data.objects.new(mesh.name, data)
    asset[MARK] = mark
    return asset


def refresh_asset(asset: bpy.types.Object, mesh: GlbMesh, paths: JobPaths) -> None:
    """Give the object a newer mesh and newer pictures; all else is the user's and stays."""
    mark, before = asset[MARK], asset.data
    refresh_pictures(paths, mark)
    data = _mesh(mesh, mark)
    for material in before.materials:
        data.materials.append(material)
        if material is not None:
            refresh_material(material, mesh.specular, paths)
    fit_again(asset, data)
    data[_DIGEST] = _digest(data)
    name = before.name
    asset.data = data
    if before.users == 0:
        bpy.data.meshes.remove(before)
    data.name = name


def is_edited(asset: bpy.types.Object | None) -> bool:
    """Whether the user has changed the mesh itself since it was imported."""
    if asset is None:
        return False
    data = asset.data
    if data.shape_keys is not None or len(asset.vertex_groups) or len(data.uv_layers) != 1:
        return True
    return data.get(_DIGEST, "") not in ("", _digest(data))


def mark_as_imported(asset: bpy.types.Object) -> None:
    """Count the mesh as it is now as the worker's: nothing of the user's would be lost with it."""
    asset.data[_DIGEST] = _digest(asset.data)


@contextmanager
def no_edit(asset: bpy.types.Object) -> Iterator[None]:
    """What changes the mesh here is done to a newer one again, and so is no edit of the user's."""
    was_edited = is_edited(asset)
    yield
    if not was_edited:
        mark_as_imported(asset)


def _mesh(mesh: GlbMesh, mark: str) -> bpy.types.Mesh:
    data = bpy.data.meshes.new(mesh.name)
    data[MARK] = mark
    data.from_pydata(mesh.vertices.tolist(), [], mesh.faces.tolist())
    layer = data.uv_layers.new(name="UVMap")
    layer.uv.foreach_set("vector", mesh.corner_uvs.reshape(-1).astype(np.float32))
    data.polygons.foreach_set("use_smooth", np.ones(len(mesh.faces), dtype=bool))
    data.normals_split_custom_set(mesh.corner_normals.reshape(-1, 3).tolist())
    data.update()
    data[_DIGEST] = _digest(data)
    return data


def _digest(data: bpy.types.Mesh) -> str:
    """Of corners, faces, their materials and texture coordinates."""
    digest = hashlib.sha256()
    for values, name, width, kind in (
        (data.vertices, "co", 3, np.float32),
        (data.loops, "vertex_index", 1, np.int32),
        (data.polygons, "loop_start", 1, np.int32),
        (data.polygons, "material_index", 1, np.int32),
        (data.uv_layers[0].uv, "vector", 2, np.float32),
    ):
        digest.update(numbers_of(values, name, width, kind).tobytes())
    return digest.hexdigest()


def new_material(name: str, specular: float, paths: JobPaths, mark: str) -> bpy.types.Material:
    """Principled material from the texture files of a result."""
    material = bpy.data.materials.new(name)
    material[MARK] = mark
    enable_nodes(material)
    shader = _principled(material)
    shader.inputs[_LEVEL].default_value *= specular  # 0.5: as the IOR says
    material[_SPECULAR] = shader.inputs[_LEVEL].default_value
    for row, (file, socket, space) in enumerate(texture_sockets(paths)):
        _feed(material, load_image(file, space, mark), socket, row)
    material[_FED] = " ".join(socket for _, socket, _ in texture_sockets(paths))
    return material


def refresh_pictures(paths: JobPaths, mark: str) -> None:
    """Read the texture files of a newer result, those too that the former one did without."""
    known = {_file(image): image for image in with_mark(bpy.data.images, mark)}
    for file, _, space in texture_sockets(paths):
        if file in known:
            reload_image(known[file])
        else:
            load_image(file, space, mark)


def refresh_material(material: bpy.types.Material, specular: float, paths: JobPaths) -> None:
    """Give the material what the newer result has more, take what it lacks, and keep edits."""
    shader = _principled(material) if _FED in material else None
    if shader is None:  # a material of the user's own
        return
    level = 0.5 * specular
    if abs(shader.inputs[_LEVEL].default_value - material[_SPECULAR]) < 1e-6:
        shader.inputs[_LEVEL].default_value = material[_SPECULAR] = level
    nodes = material.node_tree.nodes
    sockets = texture_sockets(paths)
    images = {_file(i): i for i in with_mark(bpy.data.images, material[MARK])}
    gone = [i for f, i in images.items() if f.parent == paths.textures and not are_there(f)]
    lost = [n for n in nodes if n.type == "TEX_IMAGE" and n.image in gone]
    fed = {s for _, s, _ in sockets if s in material[_FED]} - {n.label for n in lost}
    for node in lost:
        nodes.remove(node)
    for row, (file, socket, _) in enumerate(sockets):
        if socket not in fed:  # where it was, another or none is the user's choice
            _feed(material, images[file], socket, row)
    material[_FED] = " ".join(socket for _, socket, _ in sockets)


def _file(image: bpy.types.Image) -> Path:
    return Path(bpy.path.abspath(image.filepath))


def _principled(material: bpy.types.Material) -> Any:
    return next((n for n in material.node_tree.nodes if n.type == "BSDF_PRINCIPLED"), None)


def _feed(material: bpy.types.Material, image: bpy.types.Image, socket: str, row: int) -> None:
    nodes, links = material.node_tree.nodes, material.node_tree.links
    texture = nodes.new("ShaderNodeTexImage")
    texture.location = (-420, 300 - 300 * row)
    texture.label = socket
    texture.image = image
    colour = texture.outputs["Color"]
    if socket == "Normal":
        tangent = nodes.new("ShaderNodeNormalMap")
        tangent.location = (-160, 300 - 300 * row)
        links.new(colour, tangent.inputs["Color"])
        colour = tangent.outputs["Normal"]
    links.new(colour, _principled(material).inputs[socket])
