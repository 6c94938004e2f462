# SPDX-License-Identifier: Apache-2.0
"""The transport of one scene as a value that can be stored."""

from __future__ import annotations

from collections.abc import Collection
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from scipy.sparse import csr_matrix

from robir.capture.arrays import stored_arrays
from robir.capture.capture import View
from robir.capture.images.loading import resize_views
from robir.errors import StorageError
from robir.geometry.mesh.tracer import EmbreeTracer
from robir.geometry.mesh.triangles import Mesh
from robir.jobs.paths import replacing
from robir.maths.vectors import fibonacci_sphere
from robir.transport.config import TransportConfig
from robir.transport.observe import Observations, observe, spread_views
from robir.transport.surfels import Surfels, sample_surfels
from robir.transport.visibility import Visibility, trace_visibility

# what each file has to hold, see `stored_arrays`
_FORMS = {
    "surfels.npz": {
        "position": "f4 S 3", "normal": "f4 S 3", "spacing": "f", "display": "u1 S V 3",
        "weight": "f4 S V", "clipped": "u1 *", "off_axis": "u1 S V", "camera_positions": "f4 V 3",
        "views": "U V",
    },
    "visibility.npz": {
        "directions": "f4 * 3", "bits": "u1 * *", "is_traced": "b", "offset": "f",
    },
    "bounce.npz": {"data": "f4 *", "indices": "i *", "indptr": "i *"},
}  # fmt: skip


# distance that rays start above the surface, unit frame; larger forgives errors of the mesh,
# smaller keeps contact shadows
RAY_OFFSET = 0.006


@dataclass(frozen=True, slots=True, kw_only=True)
class Transport:
    """Surface samples, what they see and how the photographs show them."""

    surfels: Surfels  # samples of the surface, unit frame
    visibility: Visibility  # bits and one-bounce matrix of the samples
    observations: Observations  # colours of the samples in the training views

    def without_views(self, names: Collection[str]) -> Transport:
        """The transport without what some views show."""
        seen = self.observations
        keep = np.array([view not in names for view in seen.views])
        return replace(self, observations=seen.of_views(keep)) if not keep.all() else self

    def save(self, folder: Path) -> None:
        """Write surfels.npz, visibility.npz and bounce.npz, each atomically."""
        surfels, visibility, seen = self.surfels, self.visibility, self.observations
        tables = {
            "surfels.npz": {
                "position": surfels.position,
                "normal": surfels.normal,
                "spacing": np.float64(surfels.spacing),
                "display": seen.display,
                "weight": seen.weight,
                "clipped": np.packbits(seen.clipped, axis=None),
                "off_axis": seen.off_axis,
                "camera_positions": seen.positions,
                "views": np.array(seen.views),
            },
            "visibility.npz": {
                "directions": visibility.directions,
                "bits": visibility.bits,
                "is_traced": np.bool_(visibility.is_traced),
                "offset": np.float64(visibility.offset),
            },
            "bounce.npz": {
                "data": visibility.bounce.data,
                "indices": visibility.bounce.indices,
                "indptr": visibility.bounce.indptr,
            },
        }
        for name, arrays in tables.items():
            with replacing(folder / name) as temporary, temporary.open("wb") as file:
                np.savez(file, **arrays)

    @classmethod
    def load(cls, folder: Path) -> Transport:
        """Read what `save` wrote."""
        samples, sight, light = (stored_arrays(folder / name, _FORMS[name]) for name in _FORMS)
        display, weight = samples["display"], samples["weight"]
        surfels = Surfels(
            position=samples["position"],
            normal=samples["normal"],
            spacing=float(samples["spacing"]),
        )
        count = len(surfels)
        try:
            clipped = np.unpackbits(samples["clipped"], count=display.size).astype(bool)
            clipped = clipped.reshape(display.shape)
            bits = sight["bits"].reshape(count, -(-len(sight["directions"]) // 8))
            bounce = csr_matrix(
                (light["data"], light["indices"], light["indptr"]), shape=(count, count)
            )
            bounce.check_format(full_check=True)  # C would follow an index to anywhere
            if weight.min() < 0.0 or not weight.any():
                raise ValueError("no view shows a sample")  # noqa: TRY301
        except ValueError as fault:
            raise StorageError(
                f"{folder} is damaged ({fault}); run `robir reconstruct` with --resume"
            ) from fault
        observations = Observations(
            display=display,
            weight=weight,
            clipped=clipped,
            off_axis=samples["off_axis"],
            positions=samples["camera_positions"],
            views=tuple(samples["views"].tolist()),
        )
        visibility = Visibility(
            directions=sight["directions"],
            bits=bits,
            bounce=bounce,
            is_traced=bool(sight["is_traced"]),
            offset=float(sight["offset"]),
        )
        return cls(surfels=surfels, visibility=visibility, observations=observations)


def bake(mesh: Mesh, views: tuple[View, ...], config: TransportConfig, seed: int) -> Transport:
    """Sample a mesh, unit frame, trace what its samples see and read them from photographs."""
    tracer = EmbreeTracer(mesh.vertices, mesh.faces)
    chosen = resize_views(spread_views(views, config.max_views), config.observation_side)
    surfels, observations = _seen_surfels(tracer, mesh, chosen, config, seed)
    directions = fibonacci_sphere(config.num_directions).numpy().astype(np.float32)
    visibility = trace_visibility(mesh, tracer, surfels, directions, RAY_OFFSET)
    nothing = csr_matrix(visibility.bounce.shape, dtype=np.float32)
    if not config.use_visibility:
        free = np.packbits(surfels.normal @ directions.T > 0, axis=1)
        visibility = replace(visibility, bits=free, bounce=nothing, is_traced=False)
    elif not config.use_indirect:
        visibility = replace(visibility, bounce=nothing)
    return Transport(surfels=surfels, visibility=visibility, observations=observations)


def _seen_surfels(
    tracer: EmbreeTracer, mesh: Mesh, views: tuple[View, ...], config: TransportConfig, seed: int
) -> tuple[Surfels, Observations]:
    """Samples of which about `num_surfels` are seen; of the hidden ones every fourth is kept."""
    # hidden samples only carry bounced light, and little of it, so they may be coarse

    def observed(samples: Surfels) -> Observations:
        return observe(tracer, samples.position, samples.normal, views, RAY_OFFSET)

    rng = np.random.default_rng(seed)
    few = sample_surfels(mesh, config.num_surfels // 8, rng)
    share = max(0.15, (observed(few).weight > 0).any(1).mean())
    surfels = sample_surfels(mesh, int(config.num_surfels / share), rng)
    observations = observed(surfels)
    seen = (observations.weight > 0).any(1)
    keep = seen | (rng.random(len(seen)) < 0.25)
    return surfels.subset(keep), observations.subset(keep)
