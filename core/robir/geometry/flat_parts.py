# SPDX-License-Identifier: Apache-2.0
"""Flat parts of a surface, made flat and sharp unless photographs speak against it.

What lies near a plane may be a plane with noise, or something slightly curved. Each part is tried:
photographs that predict each other over it as well as before keep it flat.
"""

from __future__ import annotations

import numpy as np

from robir.geometry.mesh.facets import find_facets, flattened
from robir.geometry.mesh.triangles import Mesh
from robir.geometry.prediction import Predictions

# lead, in standard errors of the photographs that show a part, from which it stays flat: planes
# that are none come to -1.2 to -5
_LEAST_LEAD = -0.5


def with_flat_parts(
    mesh: Mesh, width: float, predictions: Predictions, *, follows: bool = True
) -> Mesh:
    """A mesh, unit frame, whose parts within a width of a plane are flat; the same faces.

    `follows` says whether what adjoins them is drawn along: beside a smooth surface they would end
    in teeth, a fit is too rough for that to show.
    """
    facets = find_facets(mesh, width)
    if not facets:
        return mesh
    flat = flattened(mesh, width, facets, follows=follows)
    leads = predictions.leads((mesh, flat.mesh), flat.part[mesh.faces].max(axis=1))
    leads += [-np.inf] * (len(facets) - len(leads))  # what no face has any more
    kept = [facet for facet, ahead in zip(facets, leads, strict=True) if ahead > _LEAST_LEAD]
    if len(kept) < len(facets):
        flat = flattened(mesh, width, kept, follows=follows)
    return flat.mesh
