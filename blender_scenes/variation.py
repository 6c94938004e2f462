# SPDX-License-Identifier: GPL-3.0-or-later
"""What may be varied in every scene, one thing at a time: its sun, its paint, its thin parts."""

from collections.abc import Sequence
from dataclasses import dataclass, fields

ALBEDO = {"white": (0.3, 0.6), "black": (0.1, 0.0)}
"""Gain and offset put on every base colour of the object: what is left of its contrasts is bright
as snow, or dark as coal."""

_LIMITS = {
    "sun_share": (0.0, 0.95),
    "sun_size": (0.1, 60.0),
    "suns": (1, 2),
    "roughness": (0.05, 1.0),
    "metallic": (0.0, 1.0),
    "texture_scale": (0.1, 32.0),
    "bounces": (0, 12),
    "rods": (0.001, 0.1),
}

_KINDS: dict[str, type] = {"suns": int, "bounces": int, "albedo": str}
"""How a value is read; as a float where nothing is said."""


class VariationError(ValueError):
    """A variation that nobody knows, or a value beyond its limits; the message says which."""


@dataclass(frozen=True)
class Variation:
    """Departures from a scene as it is built; None, or the value of old, changes nothing.

    Paint is that of the object; the ground keeps its own.

    Attributes:
        sun_share: share of the lamp in the irradiance of a horizontal surface; 0: no lamp.
        sun_size: full angle of the lamp's disc in degrees; of old the sun's, seen from the earth.
        suns: number of lamps; the second gives half of the first's light, a third of a turn aside.
        roughness: of every material, 0.05..1.
        metallic: of every material, 0..1.
        albedo: None or a name in ALBEDO.
        texture_scale: how many times finer every image texture is.
        bounces: how often light may go on after the surface seen; 0: no light from the object.
        rods: radius of eight upright rods around the object, scene units; None: no rods.
    """

    sun_share: float | None = None
    sun_size: float = 0.53
    suns: int = 1
    roughness: float | None = None
    metallic: float | None = None
    albedo: str | None = None
    texture_scale: float = 1.0
    bounces: int = 12
    rods: float | None = None

    def __post_init__(self) -> None:
        """Refuses values that make no sense, in words."""
        for name, (low, high) in _LIMITS.items():
            value = getattr(self, name)
            if value is not None and not low <= value <= high:
                raise VariationError(f"--vary {name} is {value}; it must be {low} to {high}")
        if self.albedo not in (None, *ALBEDO):
            words = f"--vary albedo is {self.albedo!r}; choose one of {', '.join(ALBEDO)}"
            raise VariationError(words)

    @property
    def is_of_lamp(self) -> bool:
        """Whether anything about the lamp is varied."""
        lamp = (self.sun_share, self.sun_size, self.suns)
        return lamp != (Variation.sun_share, Variation.sun_size, Variation.suns)


AS_BUILT = Variation()
"""Nothing varied."""


def parse(items: Sequence[str]) -> Variation:
    """The variation written as items NAME=VALUE.

    Raises:
        VariationError: If a name is unknown, or a value is of the wrong kind or size.
    """
    known = [field.name for field in fields(Variation)]
    values = {}
    for item in items:
        name, _, text = item.partition("=")
        if name not in known:
            raise VariationError(
                f"--vary {item!r}: unknown; known: {', '.join(known)} (NAME=VALUE)"
            )
        try:
            values[name] = _KINDS.get(name, float)(text)
        except ValueError:
            raise VariationError(f"--vary {name}: {text!r} is no number") from None
    return Variation(**values)
