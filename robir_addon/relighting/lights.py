# SPDX-License-Identifier: GPL-3.0-or-later
"""The light of a result: its World, its lamps, other environments, and how they are turned.

A recovered sun is shown in one of two ways: as a lamp beside an environment without it, or as part
of the whole environment. A lamp that stands near is a Point lamp in its place. Any other
environment hides the lamps. The World that a scene had before is remembered in the scene, so that
it can be given back. Each light to choose from has a picture of the object under it.
"""

import math
import os
from collections.abc import Iterable
from pathlib import Path
from typing import Any

import bpy
import bpy.utils.previews
from mathutils import Quaternion, Vector

from ..blocks import MARK, enable_nodes, load_image, reload_image, with_mark
from ..engine.errors import RequestError, ResultError, Sentence
from ..gateway import JobPaths
from ..words import words

# the recovered light and the maps that Blender ships: file stem, name, tool-tip
SHOWN_LIGHTS = (
    ("", Sentence("Recovered"), Sentence("Light of the photographs")),
    ("city", Sentence("City"), Sentence("Street between buildings under an open sky")),
    ("courtyard", Sentence("Courtyard"), Sentence("Shaded courtyard, soft light from above")),
    ("forest", Sentence("Forest"), Sentence("Sky through trees, green from below")),
    ("interior", Sentence("Interior"), Sentence("Room lit by its windows")),
    ("night", Sentence("Night"), Sentence("Few small lamps in the dark")),
    ("studio", Sentence("Studio"), Sentence("Two large soft boxes")),
    ("sunrise", Sentence("Sunrise"), Sentence("Low sun and a clear sky; long shadows")),
    ("sunset", Sentence("Sunset"), Sentence("Warm light from the horizon")),
)
_BEFORE = "robir_world_before"
_WHOLE = "robir_whole_light"
_WITHOUT_SUN = "robir_light_without_sun"
_TOWARDS = "robir_towards_light"
# custom property of a lamp that stands near: its distance from the middle of the result
_AWAY = "robir_distance_of_light"


def add_lamps(lamps: list[dict[str, Any]], name: str, mark: str) -> list[bpy.types.Object]:
    """Lamps of light.json, neither linked nor in their place.

    A Sun lamp's strength is irradiance, whatever the angle; a Point lamp's is watts.
    """
    made = []
    for lamp in lamps:
        strongest, away = max(lamp["irradiance"]), lamp.get("distance")
        if away is None:
            data = bpy.data.lights.new(f"{name} sun", "SUN")
            data.energy, data.angle = strongest, lamp["angular_diameter"]
        else:
            data = bpy.data.lights.new(f"{name} lamp", "POINT")
            # watts in all directions, of which a surface that faces it gets 1 / (4 pi d^2)
            data.energy = strongest * 4.0 * math.pi * away**2
            data.shadow_soft_size = away * math.tan(0.5 * lamp["angular_diameter"])
        data.color = [channel / max(strongest, 1e-12) for channel in lamp["irradiance"]]
        sun = bpy.data.objects.new(data.name, data)
        for block in (data, sun):
            block[MARK] = mark
        sun[_TOWARDS] = lamp["direction"]
        sun.rotation_mode = "QUATERNION"
        _aim(sun, 0.0)
        if away is not None:
            sun[_AWAY] = away
        made.append(sun)
    return made


def make_world(name: str, paths: JobPaths, mark: str) -> bpy.types.World:
    """The World of a result, without its light, but with both images, so that a file has them."""
    known = with_mark(bpy.data.worlds, mark)
    world = known[0] if known else bpy.data.worlds.new(name)
    world[MARK] = mark
    enable_nodes(world)
    nodes, links = world.node_tree.nodes, world.node_tree.links
    nodes.clear()
    place = nodes.new("ShaderNodeTexCoord")
    turn = nodes.new("ShaderNodeMapping")
    picture = nodes.new("ShaderNodeTexEnvironment")
    background = nodes.new("ShaderNodeBackground")
    output = nodes.new("ShaderNodeOutputWorld")
    for column, node in enumerate((place, turn, picture, background, output)):
        node.location = (220 * column - 800, 0)
    links.new(place.outputs["Generated"], turn.inputs["Vector"])
    links.new(turn.outputs["Vector"], picture.inputs["Vector"])
    links.new(picture.outputs["Color"], background.inputs["Color"])
    links.new(background.outputs["Background"], output.inputs["Surface"])
    world[_WHOLE] = load_image(paths.environment, "Linear Rec.709", mark)
    if paths.environment_without_sun.is_file():
        world[_WITHOUT_SUN] = load_image(paths.environment_without_sun, "Linear Rec.709", mark)
    elif _WITHOUT_SUN in world:
        del world[_WITHOUT_SUN]
    return world


def refresh_world(world: bpy.types.World, paths: JobPaths) -> None:
    """Read the recovered light anew; nodes, strength and another chosen light stay."""
    reload_image(world[_WHOLE])
    if not paths.environment_without_sun.is_file():
        _forget_sun(world)
    elif _WITHOUT_SUN in world:
        reload_image(world[_WITHOUT_SUN])
    else:
        world[_WITHOUT_SUN] = load_image(
            paths.environment_without_sun, "Linear Rec.709", world[MARK]
        )


def _forget_sun(world: bpy.types.World) -> None:
    """The light has no sun that could be a lamp: where that was shown, the whole light is."""
    without = world.get(_WITHOUT_SUN)
    if without is None:
        return
    for node in world.node_tree.nodes:
        if node.type == "TEX_ENVIRONMENT" and node.image == without:
            node.image = world[_WHOLE]
    del world[_WITHOUT_SUN]


def light_lamps(scene: bpy.types.Scene, mark: str, lit: bool) -> None:
    """Light or hide a result's lamps; those of other results in the scene are hidden."""
    for lamp in [o for o in scene.objects if _TOWARDS in o and MARK in o]:
        lamp.hide_render = lamp.hide_viewport = not (lit and lamp[MARK] == mark)


def world_of(mark: str) -> bpy.types.World | None:
    """The World of an imported result."""
    return next(iter(with_mark(bpy.data.worlds, mark)), None)


def lamps_of(mark: str) -> list[bpy.types.Object]:
    """The lamps of an imported result."""
    return [o for o in with_mark(bpy.data.objects, mark) if _TOWARDS in o]


def show_recovered_light(
    scene: bpy.types.Scene, world: bpy.types.World, use_sun_lamp: bool
) -> None:
    """Light the scene as the photographs were."""
    without = world.get(_WITHOUT_SUN)
    as_lamp = use_sun_lamp and without is not None and bool(lamps_of(world[MARK]))
    _show(scene, world, without if as_lamp else world[_WHOLE])
    light_lamps(scene, world[MARK], as_lamp)


def show_environment(scene: bpy.types.Scene, world: bpy.types.World, file: Path) -> None:
    """Light the scene with another lat-long image, and with no lamp of ours."""
    picture = _node(world, "TEX_ENVIRONMENT").image
    if picture is None or environment_file(world) != file:
        picture = load_image(file, "Linear Rec.709", world[MARK])
    _show(scene, world, picture)
    light_lamps(scene, world[MARK], False)


def found_environment(given: Path) -> Path:
    """The file, or one of the maps that Blender ships where only a name such as `city` is given."""
    if given.is_file():
        if given.suffix.lower() not in (".exr", ".hdr"):
            text = "{file} is of an unknown kind, {kind}; use .exr or .hdr"
            raise RequestError(text, file=given, kind=repr(given.suffix))
        return given.resolve()
    folder = Path(bpy.utils.system_resource("DATAFILES", path="studiolights/world"))
    shipped = folder / f"{given}.exr"
    if shipped.is_file():
        return shipped
    names = ", ".join(sorted(file.stem for file in folder.glob("*.exr")))
    raise RequestError(
        "{file}: no such file, and Blender ships only {names}", file=given, names=names
    )


def shows_recovered_light(world: bpy.types.World) -> bool:
    """Whether the World holds the recovered light, rather than another environment."""
    known = [image for image in (world.get(_WHOLE), world.get(_WITHOUT_SUN)) if image]
    return any(n.type == "TEX_ENVIRONMENT" and n.image in known for n in world.node_tree.nodes)


def environment_file(world: bpy.types.World) -> Path:
    """File of the environment that the World shows."""
    return Path(os.path.normpath(bpy.path.abspath(_node(world, "TEX_ENVIRONMENT").image.filepath)))


def shown_light(scene: bpy.types.Scene) -> str:
    """Stem of the shipped light that shines, or path of another file; empty for the recovered."""
    world = scene.world
    if world is None or MARK not in world or shows_recovered_light(world):
        return ""
    pictures = (n.image for n in world.node_tree.nodes if n.type == "TEX_ENVIRONMENT")
    file = Path(next((bpy.path.abspath(i.filepath) for i in pictures if i is not None), ""))
    return file.stem if "studiolights" in file.parts else str(file) * bool(file.name)


def choose_light(scene: bpy.types.Scene, world: bpy.types.World, light: str) -> None:
    """Light a scene by the stem of a shipped map, a path, or "" (recovered), turned as set."""
    if light:
        show_environment(scene, world, found_environment(Path(light)))
    else:
        show_recovered_light(scene, world, scene.robir.use_sun_lamp)
        scene.robir.rotation = 0.0
    turn_light(scene, scene.robir.rotation)


def strength_of(scene: bpy.types.Scene) -> bpy.types.NodeSocket | None:
    """What says how strong the light of the scene's World is, if the World is one of ours."""
    world = scene.world
    if world is None or MARK not in world:
        return None
    found = (n for n in world.node_tree.nodes if n.type == "BACKGROUND")
    return next((node.inputs["Strength"] for node in found), None)


def use_lamps(scene: bpy.types.Scene, use_sun_lamp: bool) -> None:
    """Change how the recovered light is given; nothing happens while another light shines."""
    world = scene.world
    if world is not None and MARK in world and shows_recovered_light(world):
        show_recovered_light(scene, world, use_sun_lamp)


def turn_light(scene: bpy.types.Scene, rotation: float) -> None:
    """Turn the light of a scene's World, if it is ours, and its lamps by `rotation`, radians."""
    world = scene.world
    if world is None or MARK not in world:
        return
    for node in world.node_tree.nodes:  # none, if the user rebuilt the World
        if node.type == "MAPPING":
            # it turns the direction that is looked up, so the picture turns the other way
            node.inputs["Rotation"].default_value = (0.0, 0.0, -rotation)
    for lamp in lamps_of(world[MARK]):
        _aim(lamp, rotation)


def give_back_world(scene: bpy.types.Scene) -> None:
    """Light the scene by the World it had before the first import."""
    scene.world = scene.get(_BEFORE)
    if _BEFORE in scene:
        del scene[_BEFORE]


def _show(scene: bpy.types.Scene, world: bpy.types.World, picture: bpy.types.Image) -> None:
    before = scene.world
    if before is not None and MARK not in before:
        scene[_BEFORE] = before  # a user of the data-block, so that saving keeps it
    scene.world = world
    node = _node(world, "TEX_ENVIRONMENT")
    replaced, node.image = node.image, picture
    if replaced is not None and replaced.users == 0 and replaced.get(MARK) == world[MARK]:
        bpy.data.images.remove(replaced)


def scale_lamp(lamp: bpy.types.Object, factor: float) -> None:
    """Let a lamp that stands near light a thing so many times as large as it did before."""
    if _AWAY in lamp:
        lamp[_AWAY] *= factor
        lamp.data.energy *= factor**2
        lamp.data.shadow_soft_size *= factor


def _aim(lamp: bpy.types.Object, rotation: float) -> None:
    """A lamp shines along its -z axis; one that stands near goes round the middle of the result."""
    away, along = lamp.get(_AWAY, 0.0), Vector((0.0, 0.0, 1.0))
    middle = lamp.location - away * (lamp.rotation_quaternion @ along)
    towards = Vector(lamp[_TOWARDS]).to_track_quat("Z", "Y")
    lamp.rotation_quaternion = Quaternion((0.0, 0.0, 1.0), rotation) @ towards
    if away:
        lamp.location = middle + away * (lamp.rotation_quaternion @ along)


def _node(world: bpy.types.World, kind: str) -> bpy.types.Node:
    found = next((node for node in world.node_tree.nodes if node.type == kind), None)
    if found is None:
        raise ResultError("the World {name} was rebuilt; import the result again", name=world.name)
    return found


RECOVERED = "recovered"  # identifier of the light of the photographs
_MAPS = (".exr", ".hdr")

# Blender's collections of icons by the result's absolute path, and by folders of own maps
_known: dict[str, Any] = {}
# choices as Blender was told last, which keeps no strings of its own
_items: dict[str, list[tuple[str, str, str, int, int]]] = {}


def light_pictures(result: str) -> dict[str, int]:
    """Icons by the light's stem, "" the recovered light's; touches no file."""
    icons = _known.get(bpy.path.abspath(result), {})
    return {stem: icons[stem].icon_id for stem, _, _ in SHOWN_LIGHTS if stem in icons}


def light_items(settings: Any, _context: object) -> list[tuple[str, str, str, int, int]]:
    """The choices as an enumeration has them: a path stands for a map of the user's own."""
    pictures, own = light_pictures(settings.result), _own_maps(settings.light_folder)
    shipped = [
        (stem or RECOVERED, words(name), words(about), pictures.get(stem, 0), number)
        for number, (stem, name, about) in enumerate(SHOWN_LIGHTS)
    ]
    maps = [
        (file, Path(file).stem, file, icon.icon_id, len(shipped) + number)
        for number, (file, icon) in enumerate(own.items())
    ]
    key = bpy.path.abspath(settings.result)
    _items[key] = [*shipped, *maps]
    return _items[key]


def _own_maps(folder: str) -> dict[str, Any]:
    """Icons of the maps in a folder by their paths; the folder is read once."""
    if folder and folder not in _known:
        icons = _known[folder] = bpy.utils.previews.new()
        place = Path(bpy.path.abspath(folder))
        for file in sorted(f for f in place.glob("*") if f.suffix.lower() in _MAPS):
            icons.load(str(file), str(file), "IMAGE")
    return _known.get(folder, {})


def read_pictures(results: Iterable[str]) -> None:
    """Take up the pictures of some results, absolute paths; forget all others."""
    unregister()
    for result in results:
        paths = JobPaths(Path(result))
        files = {stem: paths.light_picture(stem) for stem, _, _ in SHOWN_LIGHTS}
        if not any(file.is_file() for file in files.values()):
            continue
        icons = _known[result] = bpy.utils.previews.new()
        for stem, file in files.items():
            if file.is_file():
                icons.load(stem, str(file), "IMAGE")


def unregister() -> None:
    """Give the icons back."""
    while _known:
        bpy.utils.previews.remove(_known.popitem()[1])
