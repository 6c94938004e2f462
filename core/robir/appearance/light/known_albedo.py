# SPDX-License-Identifier: Apache-2.0
"""A spot whose albedo the user knows: a grey card, a label, a measured colour."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from robir.errors import ConfigError
from robir.geometry.mesh.triangles import Mesh
from robir.geometry.mesh.unwrap import plane_cross
from robir.transport.surfels import interpolate

Floats = NDArray[np.float32]

READ_ERROR = 0.02  # error of a spot's reading, of each channel's logarithm
_SPECULAR = 0.01  # what a white specular reflection adds to all channels of it (albedo)
_LEVEL_SPREAD = 2.0  # usual log by which albedo is off at all
# usual log by which each channel is off against the others: what white balance leaves
_HUE_SPREAD = 0.1


@dataclass(frozen=True, slots=True, kw_only=True)
class KnownAlbedo:
    """A spot whose albedo the user knows."""

    texel: tuple[float, float]  # u and v on the atlas, 0..1, v upwards
    position: Floats  # (3,) of the spot, unit frame
    normal: Floats  # (3,) unit
    albedo: Floats  # (3,) linear Rec.709, above 0

    @classmethod
    def of(cls, mesh: Mesh, white_point: tuple[float, ...]) -> KnownAlbedo | None:
        """The spot of the setting `appearance.white_point` on an unwrapped mesh, if there is one.

        `ConfigError` if no face lies at its u and v, over the tiles if the mesh has such.
        """
        if not white_point:
            return None
        texel = np.asarray(white_point[:2], np.float64)
        a, b, c = np.moveaxis(mesh.own_uvs()[mesh.uv_faces].astype(np.float64), 1, 0)
        whole = plane_cross(b - a, c - a)
        shares = np.stack(
            [plane_cross(b - texel, c - texel), plane_cross(c - texel, a - texel)], axis=1
        )
        with np.errstate(divide="ignore", invalid="ignore"):
            shares = shares / whole[:, None]
        shares = np.concatenate([shares, 1 - shares.sum(1, keepdims=True)], axis=1)
        found = np.flatnonzero((shares >= -1e-6).all(1) & (np.abs(whole) > 0))
        if not len(found):
            raise ConfigError(
                f"appearance.white_point: no face has the texture coordinates {texel[0]:g}, "
                f"{texel[1]:g}; pick a texel that shows the object"
            )
        face = found[:1].astype(np.int32)
        position, normal = interpolate(mesh, face, shares[face].astype(np.float32))
        u, v = shares[found[0]] @ mesh.uvs[mesh.uv_faces[found[0]]]
        return cls(
            texel=(float(u), float(v)),
            position=position[0],
            normal=normal[0],
            albedo=np.asarray(white_point[2:], np.float32),
        )

    def off(self, seen: Floats) -> Floats:
        """Log (3,) by which all albedo is too bright, if it is read as `seen` (N, 3) at the spot.

        The posterior mean where each channel errs by `READ_ERROR` and all together by a white
        `_SPECULAR`, which is much of a dark channel: grey or bright paint fixes level and hue, red
        hardly any hue.
        """
        read = np.log(np.maximum(seen, 1e-4).mean(0) / self.albedo.astype(np.float64))
        specular = _SPECULAR / self.albedo.astype(np.float64)
        noise = READ_ERROR**2 * np.eye(3) + np.outer(specular, specular)
        prior = _LEVEL_SPREAD**2 + _HUE_SPREAD**2 * np.eye(3)
        return (prior @ np.linalg.solve(prior + noise, read)).astype(np.float32)

    def texels(self, inside: NDArray[np.bool_]) -> NDArray[np.int64]:
        """Numbers (N,) of the texels about the spot, among those (T, T) inside charts."""
        side = len(inside)
        column, row = self.texel[0] * side, (1 - self.texel[1]) * side
        rows, columns = np.nonzero(inside)
        distance = np.hypot(rows + 0.5 - row, columns + 0.5 - column)
        return np.flatnonzero(distance <= max(1.5, float(distance.min())))
