# SPDX-License-Identifier: GPL-3.0-or-later
"""Mesh files that the engine does not read, by Blender's readers: a GLB for `--mesh`.

Blender turns what a file says is up to its own z and takes a file's unit into account; the GLB is
y-up as its standard wants it. The engine turns that back, so it has what Blender showed.

A damaged file may end Blender or take all memory, so a Blender of its own reads it, within limits.
"""

import ctypes
import json
import signal
import subprocess
import sys
import tempfile
from contextlib import suppress
from pathlib import Path

import bpy
import numpy as np
from mathutils import Matrix

from ..blocks import numbers_of
from ..child import blender_command
from ..engine.errors import RequestError, ResultError
from ..gateway import replacing

# kinds of files that are read here; GLB, glTF, OBJ, PLY, STL and OFF the engine reads itself
SUFFIXES = (".fbx", ".usd", ".usda", ".usdc", ".usdz", ".abc")
MOST_BYTES = 1 << 33  # memory that reading may take; five million faces take a quarter of it
MOST_SECONDS = 600.0  # time on the clock, and of the processor, that reading may take
_PR_SET_PDEATHSIG = 1  # of <linux/prctl.h>: a signal is sent when the parent ends
_KINDS = {kind.exit_code: kind for kind in (RequestError, ResultError)}
_SOLID = ("MESH", "CURVE", "SURFACE", "FONT", "META")  # types of objects that may have faces


def convert_apart(
    file: Path, out: Path, most_bytes: int = MOST_BYTES, most_seconds: float = MOST_SECONDS
) -> tuple[str, ...]:
    """Do as `convert` in a Blender of its own, which may die; RequestError if it takes too much."""
    _check(file, out)
    out.parent.mkdir(parents=True, exist_ok=True)
    with tempfile.TemporaryDirectory(prefix=".robir-mesh-", dir=out.parent) as folder:
        made = Path(folder, out.name)
        words = ["mesh", str(file), str(made), "--within", str(most_bytes)]
        command, environment = blender_command(words)
        environment.pop("ROBIR_FOLLOWED", None)
        environment["OPENBLAS_NUM_THREADS"] = "1"  # a buffer a thread, see `bound`
        try:
            done = subprocess.run(
                command,
                stdin=subprocess.DEVNULL,
                capture_output=True,
                check=False,
                timeout=most_seconds,
                env=environment,
            )
        except subprocess.TimeoutExpired:
            raise RequestError(
                "{file} takes longer than {seconds:g} s to read; export it smaller",
                file=file,
                seconds=most_seconds,
            ) from None
        notes, sentence = _heard(done)
        if notes is None and sentence and done.returncode in _KINDS:
            sentence = sentence.replace(str(made), str(out))
            raise _KINDS[done.returncode]("{sentence}", sentence=sentence)
        if notes is None:
            text = (
                "{file} ended Blender: it is damaged, or takes more than {most:.1f} GB of memory; "
                "export it again with the program it comes from"
            )
            raise RequestError(text, file=file, most=most_bytes / 1e9)
        with replacing(out) as temporary:
            made.replace(temporary)
    return notes


def _heard(done: subprocess.CompletedProcess[bytes]) -> tuple[tuple[str, ...] | None, str]:
    """Notes that a reader of a mesh ends with, None where it did not come so far; its error."""
    for line in reversed(done.stdout.decode("utf-8", "replace").splitlines()):
        with suppress(ValueError, LookupError, TypeError):
            return tuple(json.loads(line)["notes"]), ""
    lines = done.stderr.decode("utf-8", "replace").splitlines()
    ours = [line.removeprefix("error: ") for line in lines if line.startswith("error: ")]
    return None, (ours or [""])[-1]


def bound(most_bytes: int) -> None:
    """Have this process end with its parent (Linux), or if it takes too much (not on Windows)."""
    if sys.platform == "linux":
        with suppress(OSError, AttributeError):  # the system kills it once its parent is gone
            ctypes.CDLL(None).prctl(_PR_SET_PDEATHSIG, signal.SIGKILL)
    # OpenBLAS waits for memory for ever, so it takes its buffer before the limit holds
    np.matmul(np.ones((64, 64)), np.ones((64, 64)))
    with suppress(ImportError, ValueError, OSError):
        import resource

        seconds = int(MOST_SECONDS)
        resource.setrlimit(resource.RLIMIT_CPU, (seconds, seconds))
        resource.setrlimit(resource.RLIMIT_DATA, (most_bytes, most_bytes))
        resource.setrlimit(resource.RLIMIT_CORE, (0, 0))


def convert(file: Path, out: Path) -> tuple[str, ...]:
    """Write all faces that a file shows as a GLB; what Blender has open is lost.

    Each object keeps its name, texture coordinates and materials, and stands at its place without
    a transform; modifiers are applied, at the first frame of what moves. Cameras, lights and
    skeletons are left out.
    """
    _check(file, out)
    bpy.ops.wm.read_factory_settings(use_empty=True)
    _load(file)
    scene = bpy.context.scene
    scene.frame_set(scene.frame_start)
    parts = _parts()
    if not parts:
        text = "{file} shows no object with faces; export the mesh, not hidden, and try again"
        raise RequestError(text, file=file)
    _replace_all(parts)
    with replacing(out) as temporary:
        try:
            bpy.ops.export_scene.gltf(
                filepath=str(temporary),
                export_format="GLB",
                export_animations=False,
                export_skins=False,
                export_morph=False,
            )
        except RuntimeError as fault:
            if "MemoryError" in str(fault):  # the exporter's, which Blender hands on as a text
                raise MemoryError from fault
            raise ResultError(
                "{file} cannot be written ({fault})", file=out, fault=_cause(fault)
            ) from fault
    meshes = [mesh for _, mesh in parts]
    materials = {material for mesh in meshes for material in mesh.materials if material}
    faces = sum(len(mesh.polygons) for mesh in meshes)
    return (f"Objects: {len(parts)}, materials: {len(materials)}, faces: {faces}.",)


def _check(file: Path, out: Path) -> None:
    """Refuse paths that make no sense before anything is opened."""
    if file.suffix.lower() not in SUFFIXES:
        text = "{file} is of no kind that is converted here; give one of {known}"
        raise RequestError(text, file=file, known=", ".join(SUFFIXES))
    if not file.is_file():
        raise RequestError("{file} does not exist or is no file; check the path", file=file)
    if out.suffix.lower() != ".glb":
        raise RequestError("{file} is to be a GLB; give it a name that ends in .glb", file=out)
    if out.exists():
        raise RequestError("{file} exists already; remove it or give another name", file=out)


def _load(file: Path) -> None:
    """Bring all of a file into the open scene."""
    path, suffix = str(file.resolve()), file.suffix.lower()
    try:
        if suffix == ".abc":
            done = bpy.ops.wm.alembic_import(filepath=path, set_frame_range=False)
        elif suffix != ".fbx":
            # proxies stand where what is rendered stands
            done = bpy.ops.wm.usd_import(filepath=path, import_proxy=False, import_guide=False)
        elif "fbx_import" in dir(bpy.ops.wm):
            done = bpy.ops.wm.fbx_import(filepath=path, use_anim=False)
        else:  # Blender before 4.5
            done = bpy.ops.import_scene.fbx(filepath=path, use_anim=False)
        fault = "" if done == {"FINISHED"} else f"Blender takes it for no {suffix} file"
    except RuntimeError as error:
        fault = str(error).partition("\n")[0].removeprefix("Error: ")
    if fault:
        text = "{file} cannot be read ({fault}); export it again with the program it comes from"
        raise RequestError(text, file=file, fault=fault)


def _parts() -> list[tuple[str, bpy.types.Mesh]]:
    """Name and mesh, in the world, of everything with faces that is shown, instances included."""
    found = []
    shown = bpy.context.evaluated_depsgraph_get()
    for instance in shown.object_instances:
        item = instance.object
        if item.type not in _SOLID:
            continue
        mesh = bpy.data.meshes.new_from_object(item, preserve_all_data_layers=True, depsgraph=shown)
        mesh.validate()  # corners that are not there end Blender later
        if len(mesh.polygons):
            _place(mesh, instance.matrix_world.copy())
            found.append((item.name, mesh))
    return found


def _place(mesh: bpy.types.Mesh, place: Matrix) -> None:
    """Move a mesh, its own normals included; under a mirror its faces keep their outside."""
    normals = numbers_of(mesh.corner_normals, "vector", 3)
    before, has_own = _order(mesh), mesh.has_custom_normals
    mesh.transform(place)
    if place.is_negative:
        mesh.flip_normals()
    if not has_own:
        return
    moved = np.empty(normals.shape)
    moved[_order(mesh)] = normals[before] @ np.array(place.inverted_safe())[:3, :3]
    length = np.linalg.norm(moved, axis=1, keepdims=True)
    mesh.normals_split_custom_set(moved / np.maximum(length, 1e-30))


def _order(mesh: bpy.types.Mesh) -> np.ndarray:
    """Corners (Nc,) by face and vertex, whichever way round the faces go."""
    vertices = numbers_of(mesh.loops, "vertex_index", kind=np.int32).ravel()
    sizes = numbers_of(mesh.polygons, "loop_total", kind=np.int32).ravel()
    return np.lexsort([vertices, np.repeat(np.arange(len(sizes)), sizes)])


def _replace_all(parts: list[tuple[str, bpy.types.Mesh]]) -> None:
    """Have nothing but these parts in the scene."""
    for item in list(bpy.data.objects):
        bpy.data.objects.remove(item)
    for name, mesh in parts:
        bpy.context.scene.collection.objects.link(bpy.data.objects.new(name, mesh))
    for image in list(bpy.data.images):
        if image.source == "TILED":  # for its sake the exporter would move texture coordinates
            bpy.data.images.remove(image)


def _cause(fault: Exception) -> str:
    """The exception that ended an operator, of the traceback that Blender hands on as a text."""
    lines = [line for line in str(fault).splitlines() if line and not line.startswith("Location:")]
    return (lines or [""])[-1].removeprefix("Error: ")
