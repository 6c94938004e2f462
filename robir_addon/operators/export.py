# SPDX-License-Identifier: GPL-3.0-or-later
"""The result in files for other programs, and as an asset of Blender's own."""

import os
import shutil
from pathlib import Path

import bpy
from bpy.props import BoolProperty, EnumProperty, FloatProperty, IntProperty, StringProperty
from bpy_extras.io_utils import ExportHelper

from ..blocks import MARK, only_selected
from ..engine.errors import RequestError, ResultError
from ..relighting.lights import lamps_of
from ..result.asset import make_asset
from ..result.game import dense_copy, level_of, reduced
from ..result.importer import asset_of, read_cameras
from ..words import told
from .shared import (
    Operator,
    folder_property,
    has_result,
    in_object_mode,
    is_imported,
    result_asset,
    result_paths,
    result_root,
    unless,
)

_GAME_FACES, _GAME_SIDE = 10_000, 2048  # triangles, and the textures' longer side
_SIDES = [(str(s), f"{s} px", f"At most {s} pixels") for s in (512, 1024, 2048, 4096)]
_FEWEST = 4  # triangles of the coarsest level of detail


class _SaveAs(ExportHelper):
    """Asks for a file, beginning with one named after the result, and how much goes into it."""

    filepath: StringProperty(
        name="File",
        description="File to write",
        subtype="FILE_PATH",
        options={"HIDDEN", "SKIP_SAVE"},  # a file once written is not silently written again
    )

    most_faces: IntProperty(
        name="Faces",
        description="Triangles at most; 0 keeps all",
        default=0,
        min=0,
        soft_max=1_000_000,
        options={"SKIP_SAVE"},
    )
    texture_side: EnumProperty(
        name="Textures",
        description="Longer side of the textures at most",
        items=(("0", "As They Are", "Keep the textures' own size"), *_SIDES),
        default="0",
        options={"SKIP_SAVE"},
    )

    def invoke(self, context: bpy.types.Context, event: bpy.types.Event) -> set[str]:
        if not self.filepath:
            self.filepath = f"{result_root(context).name}{self.filename_ext}"
        asset = asset_of(result_root(context))
        if asset is not None and not self.most_faces:
            self.most_faces = len(asset.data.polygons)  # a figure that one can start from
        return super().invoke(context, event)

    def target(self, level: int = 0) -> Path:
        """The chosen file, or the one of a coarser level of detail beside it."""
        if not self.filepath:
            raise RequestError("no file was given; name a {kind} file", kind=self.filename_ext)
        target = Path(bpy.path.abspath(self.filepath)).with_suffix(self.filename_ext)
        return target.with_stem(f"{target.stem}_LOD{level}") if level else target


class ROBIR_OT_export_glb(_SaveAs, Operator, bpy.types.Operator):
    """Save the object as glTF binary, with what you have changed: place, modifiers, material.
    Before the import, the reconstruction's own file. The format knows no environment light.
    """

    bl_label = "Export GLB"
    bl_options = {"REGISTER", "PRESET"}
    needs = (has_result,)

    filename_ext = ".glb"
    filter_glob: StringProperty(default="*.glb", options={"HIDDEN"})

    def work(self, context: bpy.types.Context) -> None:
        asset, target = asset_of(result_root(context)), self.target()
        if asset is not None:
            with reduced(asset, self.most_faces, int(self.texture_side)):
                _write_glb(context.view_layer, asset, target)
            text = "Saved {name}, the object as it stands in the scene"
            self.report({"INFO"}, told(text, name=target.name))
            return
        if self.most_faces or self.texture_side != "0":
            raise ResultError("import the result first; its own file is saved as it is")
        source = result_paths(context).asset
        if not source.is_file():
            raise ResultError("{file} is missing; export the result again", file=source.name)
        copy_whole(source, target)
        self.report({"INFO"}, told("Saved {name}", name=target.name))


def _write_glb(
    layer: bpy.types.ViewLayer, asset: bpy.types.Object, target: Path, *, has_tangents: bool = False
) -> None:
    """Save as GLB; with tangents another program reads a normal map as it was baked."""
    target.parent.mkdir(parents=True, exist_ok=True)
    with only_selected(layer, [asset]):
        bpy.ops.export_scene.gltf(
            filepath=str(target),
            export_format="GLB",
            use_selection=True,
            export_apply=True,
            export_tangents=has_tangents,
            export_animations=False,
        )


class ROBIR_OT_export_usd(_SaveAs, Operator, bpy.types.Operator):
    """Save the imported object as USD, with its textures, the World as a dome light and the Sun
    lamps that shine.
    """

    bl_label = "Export USD"
    bl_options = {"REGISTER"}
    needs = (
        unless(lambda _: bpy.app.build_options.usd, "This Blender was built without USD"),
        is_imported,
    )

    filename_ext = ".usdc"
    filter_glob: StringProperty(default="*.usdc", options={"HIDDEN"})

    def work(self, context: bpy.types.Context) -> None:
        asset = result_asset(context)
        lamps = [lamp for lamp in lamps_of(asset[MARK]) if not lamp.hide_viewport]
        target = self.target()
        with reduced(asset, self.most_faces, int(self.texture_side)):
            _write_usd(context.view_layer, [asset, *lamps], target)
        text = "Saved {name} with its textures beside it"
        self.report({"INFO"}, told(text, name=target.name))


def _write_usd(layer: bpy.types.ViewLayer, objects: list[bpy.types.Object], target: Path) -> None:
    target.parent.mkdir(parents=True, exist_ok=True)
    known = bpy.ops.wm.usd_export.get_rna_type().properties
    is_newer = "export_textures_mode" in known  # than Blender 4.2
    textures = {"export_textures_mode": "NEW"} if is_newer else {"export_textures": True}
    with only_selected(layer, objects):
        bpy.ops.wm.usd_export(
            filepath=str(target),
            selected_objects_only=True,
            overwrite_textures=True,
            relative_paths=True,
            export_custom_properties=False,  # they name folders of the user's
            convert_world_material=MARK in objects[0],
            **textures,
        )
    if not target.is_file():
        raise ResultError("{file} was not written; is the folder writable?", file=target.name)


class ROBIR_OT_export_game(_SaveAs, Operator, bpy.types.Operator):
    """Save the object as games want it: on the floor, without ground and crumbs, of few triangles
    whose normal map holds the fine shape, and in coarser levels. The scene stays as it is.
    """

    bl_label = "Export for Games"
    bl_options = {"REGISTER", "PRESET"}
    needs = (is_imported, in_object_mode)

    filename_ext = ".glb"
    filter_glob: StringProperty(default="*.glb", options={"HIDDEN"})
    size: FloatProperty(
        name="Longest Side",
        description="Real length of the longest side; 0 keeps the size as it is",
        min=0.0,
        unit="LENGTH",
        options={"SKIP_SAVE"},
    )
    levels: IntProperty(
        name="Levels of Detail",
        description="Files to write, each with half of the faces of the one before",
        default=3,
        min=1,
        max=5,
        options={"SKIP_SAVE"},
    )
    is_cleaned: BoolProperty(
        name="Drop Ground",
        description="Without the ground of the photographs, and without crumbs",
        default=True,
    )
    is_usd: BoolProperty(
        name="USD Too", description="Write each level as USD beside the GLB", default=True
    )

    def invoke(self, context: bpy.types.Context, event: bpy.types.Event) -> set[str]:
        self.most_faces = self.most_faces or _GAME_FACES
        return super().invoke(context, event)

    def work(self, context: bpy.types.Context) -> None:
        asset, layer, first = result_asset(context), context.view_layer, self.target()
        table = read_cameras(result_paths(context))
        side = int(self.texture_side) or _GAME_SIDE
        with dense_copy(asset, table, self.size, is_cleaned=self.is_cleaned) as dense:
            finest = min(self.most_faces or _GAME_FACES, len(dense.data.polygons))
            for number in range(self.levels):
                target, faces = self.target(number), max(_FEWEST, round(finest / 2**number))
                with (
                    level_of(dense, faces, side, target.stem) as level,
                    reduced(level, faces, side),
                ):
                    _write_glb(layer, level, target, has_tangents=True)
                    if self.is_usd:
                        _write_usd(layer, [level], target.with_suffix(".usdc"))
        text = "Saved {name} and {count} coarser ones, standing at the origin"
        self.report({"INFO"}, told(text, name=first.name, count=self.levels - 1))


class ROBIR_OT_export_textures(Operator, bpy.types.Operator):
    """Copy the texture images to a folder."""

    bl_label = "Export Textures"
    bl_options = {"REGISTER", "PRESET"}
    needs = (has_result,)

    directory: folder_property("Folder", "Folder to copy to")
    overwrite: BoolProperty(
        name="Overwrite",
        description="Replace files of the same name",
        default=False,
        options={"SKIP_SAVE"},
    )

    def invoke(self, context: bpy.types.Context, event: bpy.types.Event) -> set[str]:
        context.window_manager.fileselect_add(self)
        return {"RUNNING_MODAL"}

    def work(self, context: bpy.types.Context) -> None:
        if not self.directory:
            raise RequestError("no folder was given; choose one for the textures")
        folder = Path(bpy.path.abspath(self.directory))
        files = sorted(f for f in result_paths(context).textures.glob("*") if f.is_file())
        if not files:
            raise ResultError("the result has no textures; export it again")
        there = [file.name for file in files if (folder / file.name).exists()]
        if there and not self.overwrite:
            raise RequestError(
                "{folder} already has {names}; tick Overwrite or choose another",
                folder=folder.name,
                names=", ".join(there),
            )
        for file in files:
            copy_whole(file, folder / file.name)
        text = "Copied {count} textures to {folder}"
        self.report({"INFO"}, told(text, count=len(files), folder=folder.name))


class ROBIR_OT_mark_asset(Operator, bpy.types.Operator):
    """Mark the object as an asset with preview, description and tags; it is in the library once
    this file is saved there.
    """

    bl_label = "Mark as Asset"
    needs = (is_imported,)

    def work(self, context: bpy.types.Context) -> None:
        make_asset(result_asset(context), result_paths(context))


def copy_whole(source: Path, target: Path) -> None:
    """Copy a file; the target appears whole or not at all."""
    target.parent.mkdir(parents=True, exist_ok=True)
    if target.exists() and target.samefile(source):
        return
    temporary = target.with_name(f".{target.name}-{os.getpid()}")
    try:
        shutil.copyfile(source, temporary)
        temporary.replace(target)
    finally:
        temporary.unlink(missing_ok=True)
