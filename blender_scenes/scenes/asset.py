# SPDX-License-Identifier: GPL-3.0-or-later
"""Any OBJ or glTF file, one unit in size, standing on the ground plate."""

import numpy as np

from blender_scenes.imported import import_asset, stand
from blender_scenes.request import SceneError, SceneRequest

SIZE = 1.0
"""Longest side of the asset's bounding box, scene units."""


def build(request: SceneRequest, rng: np.random.Generator) -> None:
    """Imports `request.asset`, keeps base colour, roughness and metallic, and turns it by `rng`."""
    if request.asset is None:
        raise SceneError("scene 'asset' needs --asset FILE (an .obj, .gltf or .glb file)")
    stand(import_asset(request.asset), SIZE, (0.0, 0.0, float(rng.uniform(0.0, 360.0))))
