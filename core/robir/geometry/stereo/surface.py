# SPDX-License-Identifier: Apache-2.0
"""A surface by stereo: photographs in, signed distances out, without any fit of colours."""

from __future__ import annotations

import numpy as np
import torch

from robir.geometry.lattice import Lattice, Sampled, resample
from robir.geometry.mesh.isosurface import extract
from robir.geometry.rays import Photo
from robir.geometry.stereo.config import StereoConfig
from robir.geometry.stereo.fusion import confirmed, depth_maps, fuse
from robir.geometry.stereo.smoothest import smoothest


def stereo_surface(photos: list[Photo], hull: Sampled, config: StereoConfig) -> Sampled:
    """The surface that depth maps agree on, and the visual hull where they say nothing.

    What mirrors a light shows it behind the surface, and a few maps agree on that: less trust than
    chance and highlights get counts as none. A plain part then lies where its outlines put it, bent
    no more than it must be to meet what is known around it.

    Args:
        photos: Training photographs at the size they are compared at.
        hull: Lattice and (N,) signed distance of the visual hull, unit frame.
        config: Settings.

    Returns:
        Lattice and (N,) signed distances, negative inside.
    """
    lattice, outer = hull
    fine = Lattice.around(
        np.asarray(lattice.lower) + 3 * lattice.cell, lattice.upper - 3 * lattice.cell, config.cells
    )
    maps = depth_maps(photos, extract(lattice, outer), config)
    kept = confirmed(maps, config.tolerance[0] * fine.cell, config)
    wide = resample(outer, lattice, fine)
    fused = fuse(kept, fine, wide, config)
    rule = config.surface
    reach = rule.deep * fused.band
    limit = wide.clamp(-reach, reach)
    is_free = fused.distance > rule.free * fused.band
    told = torch.where(is_free, torch.maximum(fused.distance, limit), fused.distance)
    weight = (fused.weight - config.least_trust).clamp(min=0)
    prior = config.anchor + rule.outside * (wide > 0)
    total = weight + prior
    measured = (weight * told + prior * limit) / total
    shape = fine.shape
    found = smoothest(measured.view(shape), total.view(shape), config.smoothness, config.smoothest)
    return Sampled(fine, found.reshape(-1))
