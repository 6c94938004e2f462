# SPDX-License-Identifier: GPL-3.0-or-later
"""What the panels show and ask: settings saved with the file, and the state of the work at hand.

`Scene.robir` holds what the user chose and is saved. `WindowManager.robir` holds what goes on at
this moment; Blender keeps it when it opens a file without its windows, so it is emptied then.
"""

from pathlib import Path
from typing import Any

import bpy
from bpy.props import (
    BoolProperty,
    CollectionProperty,
    EnumProperty,
    FloatProperty,
    FloatVectorProperty,
    IntProperty,
    PointerProperty,
    StringProperty,
)

from ..blocks import MARK, select_alone
from ..engine.errors import AddonError
from ..operators.compare import draw_again
from ..relighting.lights import (
    RECOVERED,
    choose_light,
    light_items,
    shown_light,
    turn_light,
    use_lamps,
    world_of,
)
from ..result.importer import asset_of, imported_objects
from ..result.known import AUTOMATIC
from ..result.summary import read_shown
from ..words import told
from ..work import batch, monitor


def _folder(name: str, description: str, **more: Any) -> Any:
    return StringProperty(name=name, description=description, subtype="DIR_PATH", **more)


class ROBIR_PG_finding(bpy.types.PropertyGroup):
    """One finding of the check of a capture."""

    level: StringProperty(name="Level", description="error, warning or note")
    text: StringProperty(name="Finding", description="What was found and where")
    cure: StringProperty(name="Cure", description="What to do about it")
    code: StringProperty(name="Code", description="Short name of this kind of finding")
    files: StringProperty(name="Files", description="Photographs concerned, one a line")


class ROBIR_PG_photograph(bpy.types.PropertyGroup):
    """One photograph of the capture; its name is Blender's own property."""

    is_used: BoolProperty(
        name="Take part", description="Whether this photograph takes part", default=True
    )
    reason: StringProperty(name="Noticed", description="What the check noticed about it")


class ROBIR_PG_settings(bpy.types.PropertyGroup):
    """What the user chose; saved with the Blender file."""

    capture: _folder("Capture", "Folder with the photographs and their cameras")
    masks: _folder(
        "Masks", "Folder with one mask a photograph; empty takes the capture's own masks"
    )
    box: PointerProperty(
        name="Object box",
        description=(
            "Empty or mesh whose bounds, along the axes of the world, hold the object; tells it "
            "from its surroundings where the capture has no masks"
        ),
        type=bpy.types.Object,
        poll=lambda _settings, candidate: candidate.type in {"EMPTY", "MESH"},
    )
    photographs: CollectionProperty(
        type=ROBIR_PG_photograph, name="Photographs", description="Which of them take part"
    )
    photograph_index: IntProperty(name="Photograph", description="The one marked in the list")
    skip_missing: BoolProperty(
        name="Do without missing ones",
        description="Leave out photographs that have a pose but are not there",
    )
    view_scale: FloatProperty(
        name="Scale of the view",
        description="How many times as large as in its own unit the capture is shown",
        default=1.0,
    )
    view_shift: FloatVectorProperty(
        name="Shift of the view", description="Where the origin of the capture's own frame is shown"
    )
    out: _folder("Result", "Folder for the result; empty makes one beside the capture")
    library: _folder(
        "Library",
        "Folder of the results of many captures, one asset each; empty makes one beside the "
        "folder of captures",
        update=lambda _settings, _context: batch.look(),
    )
    texture: EnumProperty(
        name="Texture",
        description="How fine the textures are, and the photographs that they are made of",
        items=(
            ("2K", "2K", "At most 2048 texels a side, from photographs of 800 pixels"),
            (
                "4K",
                "4K",
                "At most 4096 texels a side, from photographs of 1600 pixels: sharper prints, for "
                "more time and memory",
            ),
        ),
        default="2K",
    )
    device: EnumProperty(
        name="Device",
        description="What computes",
        items=(
            ("auto", "Automatic", "CUDA where there is one, otherwise the processor"),
            ("cpu", "Processor", "Works everywhere"),
            ("cuda", "CUDA", "A graphics card made by NVIDIA"),
        ),
        default="auto",
    )
    result: _folder(
        "Shown result",
        "Result folder that the panels Result, Relight and Export work with",
        update=lambda _settings, _context: read_shown(),
    )
    shown: EnumProperty(
        name="Result",
        description="Which of the file's results the panels show and work with; another one is "
        "shown as well when its object is clicked",
        items=lambda settings, _context: _result_items(settings),
        get=lambda settings: [item[0] for item in _result_items(settings)].index(
            bpy.path.abspath(settings.result)
        ),
        set=lambda settings, number: _show_result(settings, number),
    )
    spot_texel: FloatVectorProperty(
        name="Spot",
        description="Place of the spot of known paint on the result's texture, v upwards",
        size=2,
        min=0.0,
        max=1.0,
    )
    spot_albedo: FloatVectorProperty(
        name="True Colour",
        description="Colour of the spot without light; a photographer's grey card is 0.18",
        subtype="COLOR",
        default=(0.18, 0.18, 0.18),
        min=0.001,
        max=1.0,
    )
    spot_result: StringProperty(
        name="Result of the spot",
        description="Result folder on whose texture the spot lies; empty if none is known",
        options={"HIDDEN"},
    )
    spot_shape: StringProperty(
        name="Shape of the spot",
        description="Fingerprint of the shape that the spot was picked on",
        options={"HIDDEN"},
    )
    sun: FloatVectorProperty(
        name="Sun",
        description="Direction towards the sun in the capture's own frame; zero if it is unknown",
    )
    tone_curve: EnumProperty(
        name="Tone Curve",
        description="How light became the photographs' values",
        items=(
            (AUTOMATIC, "Automatic", "The one whose shadows agree best with their surroundings"),
            ("standard", "Standard", "Blender's Standard: sRGB, clipped"),
            ("camera", "Camera", "The mean of many cameras: more contrast than Standard"),
            ("filmic", "Filmic", "Blender's Filmic"),
            ("khronos_pbr_neutral", "Khronos PBR Neutral", "Of product viewers on the web"),
            ("agx", "AgX", "Blender's AgX"),
            ("robir_aces", "ACES", "The fit of ACES that RobIR takes"),
        ),
        default=AUTOMATIC,
    )
    light: EnumProperty(
        name="Light",
        description="Light that shines on the object: that of the photographs, one that Blender "
        "ships, or a map of your own",
        items=light_items,
        get=lambda settings: _shown_number(settings),
        set=lambda settings, number: _choose(settings, number),
    )
    light_folder: _folder(
        "Own Lights",
        "Folder with .exr or .hdr maps of your own, which the lights to choose from then include",
    )
    rotation: FloatProperty(
        name="Rotation",
        description="Turn of the light about the up axis, counter-clockwise seen from above",
        subtype="ANGLE",
        soft_min=-3.141592653589793,
        soft_max=3.141592653589793,
        update=lambda settings, _context: turn_light(settings.id_data, settings.rotation),
    )
    turntable_frames: IntProperty(
        name="Frames",
        description="Frames of a full turn of the light",
        default=48,
        min=2,
        soft_max=240,
    )
    turntable_side: IntProperty(
        name="Resolution",
        description="Shorter side of the film, pixels",
        default=1080,
        min=16,
        soft_max=2160,
    )
    turns: EnumProperty(
        name="Turns",
        description="What goes round in the film",
        items=(
            ("light", "Light", "The light goes round the object"),
            ("object", "Object", "The object turns before the camera"),
            ("both", "Both", "The object turns, and its light with it"),
        ),
        default="light",
    )
    use_sun_lamp: BoolProperty(
        name="Sun as a lamp",
        description="Give a recovered sun or lamp as one of Blender's, so that shadows stay crisp",
        default=True,
        update=lambda settings, _context: use_lamps(settings.id_data, settings.use_sun_lamp),
    )


# choices as Blender was told last, which keeps no strings of its own
_results: list[tuple[str, str, str]] = []


def _result_items(settings: ROBIR_PG_settings) -> list[tuple[str, str, str]]:
    """The results of the file, and the shown one, which may not be imported."""
    roots = {bpy.path.abspath(settings.result), *(o[MARK] for o in imported_objects())}
    _results[:] = [(root, Path(root).name, root) for root in sorted(roots)]
    return _results


def _show_result(settings: ROBIR_PG_settings, number: int) -> None:
    """Show a result, and make its object the active one."""
    settings.result = _result_items(settings)[number][0]
    asset, layer = asset_of(Path(settings.result)), bpy.context.view_layer
    if asset is not None and asset.name in layer.objects:
        select_alone(layer, asset)


def _shown_number(settings: ROBIR_PG_settings) -> int:
    """Which of the lights shines; 0, the recovered one, where it is none of them."""
    shown = shown_light(settings.id_data) or RECOVERED
    items = light_items(settings, None)
    return next((item[4] for item in items if item[0] == shown), 0)


def _choose(settings: ROBIR_PG_settings, number: int) -> None:
    """Light the scene; what prevents that is said in the panel."""
    scene, light = settings.id_data, light_items(settings, None)[number][0]
    world = world_of(bpy.path.abspath(settings.result))
    try:
        if world is not None:
            choose_light(scene, world, "" if light == RECOVERED else light)
    except AddonError as error:
        monitor.show_problem(told(error))


class ROBIR_PG_state(bpy.types.PropertyGroup):
    """What goes on at this moment; emptied when a file is opened."""

    task: StringProperty(
        description='"" idle, "look", "reconstruct", "install", "check_engine", "remove_engine", '
        '"turntable" or "lights"'
    )
    fraction: FloatProperty(description="Share of the task that is done", min=0.0, max=1.0)
    stage: StringProperty(description="Stage of the reconstruction at work")
    message: StringProperty(description="What is being done")
    seconds_left: FloatProperty(description="Estimated seconds to the end; -1 unknown", default=-1)
    job: StringProperty(description="Result folder of the reconstruction at work")
    error: StringProperty(description="What went wrong, one sentence")
    error_cure: StringProperty(description="What to do about it")
    looked_at: StringProperty(description="Capture that was looked at, as the settings name it")
    recognised: StringProperty(description="What it was recognised as")
    findings: CollectionProperty(type=ROBIR_PG_finding, description="Findings of the check")
    engine_error: StringProperty(description="The error that was the engine's, not a capture's")
    engine_text: StringProperty(description="What the last check of the engine said")
    engine_ok: BoolProperty(description="The engine was checked and works")
    wipe_with: EnumProperty(
        name="Comparison",
        description="How the pictures of the comparison are shown",
        items=(
            ("0", "Side by Side", "All four pictures beside each other"),
            ("1", "Wipe Re-render", "The photograph over its re-render"),
            ("2", "Wipe Albedo", "The photograph over the albedo"),
            ("3", "Wipe Roughness", "The photograph over the roughness"),
        ),
        update=lambda _state, context: draw_again(context, is_fitted=True),
    )
    wipe: FloatProperty(
        name="Wipe",
        description="Share of the width that shows the photograph",
        subtype="FACTOR",
        default=0.5,
        min=0.0,
        max=1.0,
        update=lambda _state, context: draw_again(context, is_fitted=False),
    )
    preview_serial: IntProperty(description="Goes up when the preview picture was read again")


def register() -> None:
    """Attach the groups to scenes and to the window manager."""
    bpy.types.Scene.robir = PointerProperty(type=ROBIR_PG_settings)
    bpy.types.WindowManager.robir = PointerProperty(
        type=ROBIR_PG_state, options={"HIDDEN", "SKIP_SAVE"}
    )


def unregister() -> None:
    """Detach the groups; what files have saved stays in them."""
    del bpy.types.WindowManager.robir
    del bpy.types.Scene.robir


def _forget_state(*_: object) -> None:
    """Empty the state: it speaks of the capture of the file that was open before."""
    for manager in bpy.data.window_managers:
        manager.property_unset("robir")


HANDLERS = (("load_post", _forget_state),)
