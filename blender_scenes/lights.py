# SPDX-License-Identifier: GPL-3.0-or-later
"""The light of a scene: a map, loaded, turned and scaled, with a sun lamp or a sun inside it."""

from dataclasses import dataclass
from pathlib import Path

import bpy
import numpy as np
from mathutils import Quaternion, Vector
from skimage.transform import resize_local_mean

from blender_scenes.environment import (
    LUMINANCE,
    UP,
    irradiance,
    softened,
    sun_spot,
    with_sun_share,
)
from blender_scenes.recipe import Sky
from blender_scenes.request import SceneError, SceneRequest
from blender_scenes.variation import Variation
from blender_scenes.wheel import data_folder

GREY_TARGET = 0.52
"""Linear radiance of a horizontal 0.5 grey in full light."""

FACING_LIMIT = 1.0
"""The most a 0.5 grey facing the sun may reach: a low sun must not clip all upright faces."""

SUN_SHARE = {None: 0.75, "high_illumination": 0.9}
"""Share of the sun in the irradiance of a horizontal surface, by preset: of the lamp, or of the sun
in the map from the bpy wheel, which its file clips. The sun of a given map stays as it is."""

LAMP_TINT = np.array([1.06, 1.0, 0.9])
LAMP_ELEVATION_DEGREES = (36.0, 58.0)
LOWEST_SUN = float(np.radians(3.0))


SECOND_SUN = (2.0 / 3.0, 1.0 / 3.0)
"""How two lamps share the light of one."""

SECOND_TURN = float(np.radians(120.0))
"""Azimuth of the second lamp beyond the first's, at the same height."""


@dataclass(frozen=True)
class Lamp:
    """A distant lamp.

    Attributes:
        direction: (3,) unit, world frame, towards the lamp.
        irradiance_rgb: (3,) of a surface that faces it.
        size: full angle of its disc in degrees.
    """

    direction: np.ndarray
    irradiance_rgb: np.ndarray
    size: float


@dataclass(frozen=True)
class LightRig:
    """The light of a scene, in the units of the render.

    Attributes:
        environment: (H, 2H, 3) lat-long radiance, without the lamps.
        sun_direction: (3,) unit, world frame, towards the sun.
        sun_irradiance_rgb: (3,) of a surface that faces the sun, by the lamp or the map's spot.
        lamps: the sun, and a second one where asked for; none where the sun is a part of the map.
    """

    environment: np.ndarray
    sun_direction: np.ndarray
    sun_irradiance_rgb: np.ndarray
    lamps: tuple[Lamp, ...] = ()

    @property
    def sun_share(self) -> float:
        """Share of the strongest sun in the irradiance of a surface that faces it, 0..1."""
        sun = self.sun_irradiance_rgb @ LUMINANCE
        lit = irradiance(self.environment, self.sun_direction)
        for lamp in self.lamps:
            lit = lit + lamp.irradiance_rgb * max(float(lamp.direction @ self.sun_direction), 0.0)
        return float(sun / (lit @ LUMINANCE))


def light_rig(request: SceneRequest, rng: np.random.Generator) -> LightRig:
    """The light of a request: direction by `rng`, strength by the rule of GREY_TARGET.

    Args:
        request: names light, preset and map.
        rng: turns the map about z and places the lamp.

    Returns:
        The rig, scaled.
    """
    has_lamp = request.light == "lamp"
    bundled = data_folder(f"studiolights/world/{'courtyard' if has_lamp else 'city'}.exr")
    file = request.hdri or bundled
    environment = _load_map(file, 256 if has_lamp else 512)
    if not (irradiance(environment, UP) @ LUMINANCE > 0.0):
        raise SceneError(f"{file}: the upper half of this map is black; choose another --hdri")
    if request.recipe is not None:
        return _drawn_rig(environment, request.recipe.sky)
    environment = np.roll(environment, int(rng.integers(environment.shape[1])), axis=1)
    if has_lamp:
        share = request.variation.sun_share
        share = SUN_SHARE[request.preset] if share is None else share
        direction, sun = _lamp(irradiance(environment, UP), share, rng)
        beside = sun
    else:
        direction, sun = sun_spot(environment)
        if direction[2] < np.sin(LOWEST_SUN):
            raise SceneError(
                f"{file}: its brightest spot is below or at the horizon; choose a map with a sun"
            )
        if request.hdri is None:
            environment = with_sun_share(environment, SUN_SHARE[None])
            direction, sun = sun_spot(environment)
        beside = np.zeros(3)
    scale = _scale(environment, direction, beside)
    lamps = _lamps(direction, beside * scale, request.variation)
    strongest = lamps[0].irradiance_rgb if lamps else sun * scale
    return LightRig((environment * scale).astype(np.float32), direction, strongest, lamps)


def _scale(environment: np.ndarray, direction: np.ndarray, lamp: np.ndarray) -> float:
    """Factor by which a map and a lamp of irradiance (3,) keep to GREY_TARGET and FACING_LIMIT."""
    horizontal = (irradiance(environment, UP) + lamp * max(direction[2], 0.0)) @ LUMINANCE
    facing = (irradiance(environment, direction) + lamp) @ LUMINANCE
    return 2.0 * np.pi * float(min(GREY_TARGET / horizontal, FACING_LIMIT / facing))


def turned(environment: np.ndarray, turn: float) -> np.ndarray:
    """A map (H, 2H, 3) turned about z by a share of a whole turn."""
    return np.roll(environment, round(turn * environment.shape[1]), axis=1)


def _drawn_rig(environment: np.ndarray, sky: Sky) -> LightRig:
    """The light that a recipe says: its map, turned, with its suns.

    Args:
        environment: (H, 2H, 3) as the file has it.
        sky: what to make of it.
    """
    environment = turned(environment, sky.turn)
    if sky.is_softened:
        environment = softened(environment)
    tint = LAMP_TINT / (LAMP_TINT @ LUMINANCE)
    lamps = []
    for sun in sky.suns:
        elevation, azimuth = np.radians([sun.elevation, sun.azimuth])
        flat = np.cos(elevation)
        towards = np.array([flat * np.cos(azimuth), flat * np.sin(azimuth), np.sin(elevation)])
        beside = irradiance(environment, towards) @ LUMINANCE
        lamps.append(Lamp(towards, tint * beside * sun.share / (1.0 - sun.share), sun.size))
    if lamps:
        strongest = max(lamps, key=lambda lamp: float(lamp.irradiance_rgb.sum()))
        direction, spot = strongest.direction, strongest.irradiance_rgb
        scale = _scale(environment, direction, spot)
    else:
        direction, spot = sun_spot(environment)
        scale = _scale(environment, direction, np.zeros(3))
    scaled = tuple(Lamp(lamp.direction, scale * lamp.irradiance_rgb, lamp.size) for lamp in lamps)
    return LightRig((environment * scale).astype(np.float32), direction, spot * scale, scaled)


def second_map(file: Path, turn: float) -> np.ndarray:
    """Another light, a map alone, turned and brought to the same brightness; (H, 2H, 3) float32."""
    environment = turned(_load_map(file, 256), turn)
    direction, _ = sun_spot(environment)
    return (environment * _scale(environment, direction, np.zeros(3))).astype(np.float32)


def _lamps(
    direction: np.ndarray, irradiance_rgb: np.ndarray, variation: Variation
) -> tuple[Lamp, ...]:
    """The lamps that share an irradiance (3,), the strongest first; none where it is nothing."""
    if not irradiance_rgb.any():
        return ()
    if variation.suns == 1:
        return (Lamp(direction, irradiance_rgb, variation.sun_size),)
    cosine, sine = np.cos(SECOND_TURN), np.sin(SECOND_TURN)
    beyond = np.array([[cosine, -sine, 0.0], [sine, cosine, 0.0], [0.0, 0.0, 1.0]]) @ direction
    first, second = SECOND_SUN
    return (
        Lamp(direction, first * irradiance_rgb, variation.sun_size),
        Lamp(beyond, second * irradiance_rgb, variation.sun_size),
    )


def _lamp(sky: np.ndarray, share: float, rng: np.random.Generator) -> tuple[np.ndarray, np.ndarray]:
    """Direction (3,) and normal-incidence irradiance (3,) of a lamp beside a sky.

    Args:
        sky: (3,) irradiance that the sky gives a horizontal surface.
        share: of the lamp in that surface's irradiance.
        rng: draws the direction.
    """
    elevation = np.radians(rng.uniform(*LAMP_ELEVATION_DEGREES))
    azimuth = rng.uniform(0.0, 2.0 * np.pi)
    flat = np.cos(elevation)
    direction = np.array([flat * np.cos(azimuth), flat * np.sin(azimuth), np.sin(elevation)])
    tint = LAMP_TINT / (LAMP_TINT @ LUMINANCE)
    return direction, tint * (sky @ LUMINANCE) * share / (1.0 - share) / direction[2]


def add_lights(rig: LightRig, environment_file: Path) -> None:
    """Puts the rig into the open Blender scene, in place of any light that is there.

    Args:
        rig: the light.
        environment_file: `rig.environment` as an EXR file.
    """
    for old in [o for o in bpy.context.scene.objects if o.type == "LIGHT"]:
        bpy.data.objects.remove(old)
    world = bpy.data.worlds.new("environment")
    bpy.context.scene.world = world
    if bpy.app.version < (5, 0, 0):
        world.use_nodes = True
    node = world.node_tree.nodes.new("ShaderNodeTexEnvironment")
    node.image = bpy.data.images.load(str(environment_file))
    node.image.colorspace_settings.name = "Linear Rec.709"
    background = next(n for n in world.node_tree.nodes if n.type == "BACKGROUND")
    world.node_tree.links.new(node.outputs["Color"], background.inputs["Color"])
    world.cycles.sampling_method = "MANUAL"
    world.cycles.sample_map_resolution = rig.environment.shape[1]
    for lamp in rig.lamps:
        strength = float(lamp.irradiance_rgb.max())
        light = bpy.data.lights.new("sun", "SUN")
        light.angle = float(np.radians(lamp.size))
        light.energy = strength
        light.color = (lamp.irradiance_rgb / strength).tolist()
        sun = bpy.data.objects.new("sun", light)
        sun.rotation_mode = "QUATERNION"
        sun.rotation_quaternion = _towards(lamp.direction)
        bpy.context.scene.collection.objects.link(sun)


def _towards(direction: np.ndarray) -> Quaternion:
    """Rotation that makes a lamp, which shines along its -z, shine from `direction`."""
    return Vector(direction.tolist()).to_track_quat("Z", "Y")


def _load_map(file: Path, height: int) -> np.ndarray:
    """Reads a lat-long map, averaged down to at most `height` rows; (H, 2H, 3), top row first."""
    try:
        image = bpy.data.images.load(str(file))
    except RuntimeError as error:
        raise SceneError(
            f"{file}: not readable as an image ({error}); give a .hdr or .exr file"
        ) from error
    image.colorspace_settings.name = "Linear Rec.709"
    width, rows = image.size
    if rows == 0 or width != 2 * rows:
        raise SceneError(
            f"{file}: {width} x {rows} pixels; a lat-long map is twice as wide as high"
        )
    pixels = np.empty(width * rows * 4, dtype=np.float32)
    image.pixels.foreach_get(pixels)
    bpy.data.images.remove(image)
    values = pixels.reshape(rows, width, 4)[::-1, :, :3].astype(np.float64)
    if not np.isfinite(values).all():
        raise SceneError(f"{file}: holds infinite or undefined values; clean the map first")
    if rows > height:
        values = resize_local_mean(values, (height, 2 * height), channel_axis=-1)
    return values
