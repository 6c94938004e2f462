# SPDX-License-Identifier: Apache-2.0
"""A surface by stereo: photographs in, signed distances out, without any fit of colours."""

from __future__ import annotations

import numpy as np
import torch

from robir.geometry.lattice import Lattice, Sampled, resample
from robir.geometry.mesh.isosurface import extract
from robir.geometry.rays import Photo
from robir.geometry.stereo.fusion import TOLERANCE, confirmed, depth_maps, fuse
from robir.geometry.stereo.smoothest import smoothest

# share of the band's half width from which a distance says that a node is free, not how far
_FREE = 0.98
_DEEP = 2.0  # distance to the hull beyond which it says no more than inside or outside (bands)
_OUTSIDE = 1.0  # weight of the visual hull where it says that there is nothing
_CELLS = 128  # cells of the fused lattice along the object's longest side
_LEAST_TRUST = 2.0  # sum of the maps' trust below which a distance counts as unknown
_ANCHOR = 1e-5  # weight of the visual hull's distance inside it, where that is unknown
_SMOOTHNESS = 1.0  # weight of the squared Laplacian of the distances, against a trust of 1


def stereo_surface(photos: list[Photo], hull: Sampled, coarseness: float = 1.0) -> Sampled:
    """The surface that depth maps agree on, and the visual hull where they say nothing.

    What mirrors a light shows it behind the surface, and a few maps agree on that: less trust than
    chance and highlights get counts as none. A plain part then lies where its outlines put it, bent
    no more than it must be to meet what is known around it.

    Args:
        photos: Training photographs at the size they are compared at.
        hull: Lattice and (N,) signed distance of the visual hull, unit frame.
        coarseness: Cells along a side, as a share of those of a final surface.

    Returns:
        Lattice and (N,) signed distances, negative inside.
    """
    lattice, outer = hull
    lower, upper = np.asarray(lattice.lower) + 3 * lattice.cell, lattice.upper - 3 * lattice.cell
    fine = Lattice.around(lower, upper, round(coarseness * _CELLS))
    maps = depth_maps(photos, extract(lattice, outer))
    kept = confirmed(maps, TOLERANCE[0] * fine.cell)
    wide = resample(outer, lattice, fine)
    fused = fuse(kept, fine, wide)
    reach = _DEEP * fused.band
    limit = wide.clamp(-reach, reach)
    is_free = fused.distance > _FREE * fused.band
    told = torch.where(is_free, torch.maximum(fused.distance, limit), fused.distance)
    weight = (fused.weight - _LEAST_TRUST).clamp(min=0)
    prior = _ANCHOR + _OUTSIDE * (wide > 0)
    total = weight + prior
    measured = (weight * told + prior * limit) / total
    shape = fine.shape
    found = smoothest(measured.view(shape), total.view(shape), _SMOOTHNESS)
    return Sampled(fine, found.reshape(-1))
