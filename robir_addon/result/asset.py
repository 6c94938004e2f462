# SPDX-License-Identifier: GPL-3.0-or-later
"""The imported object as an asset of Blender's library, complete without its result folder."""

import bpy
import numpy as np

from ..gateway import JobPaths, __version__
from .comparison import rendered_view
from .importer import read_cameras, read_run

PREVIEW_SIDE = 256


def make_asset(asset: bpy.types.Object, paths: JobPaths, *, is_packed: bool = True) -> None:
    """Mark an object as an asset, with what is known of it and a picture; saves nothing.

    Args:
        asset: The imported object.
        paths: Of its result folder.
        is_packed: Whether its textures are packed, so that it is whole wherever its file goes.

    Raises:
        ResultError: If the result folder says nothing about the run.
    """
    run = read_run(paths)
    facts = {"preset": run["preset"], "device": run["device"], "seed": run["seed"]}
    table = read_cameras(paths)
    picture = preview_codes(rendered_view(paths, table).picture)
    asset.asset_mark()
    data = asset.asset_data
    data.description = (
        f"Reconstructed from {len(table['views'])} photographs by RobIR {__version__}, "
        f"preset {facts['preset']}"
    )
    known = {tag.name for tag in data.tags}
    for tag in ("RobIR", "reconstruction", paths.root.name):
        if tag not in known:
            data.tags.new(tag)
    asset["robir_version"] = __version__
    for name, value in facts.items():
        asset[f"robir_{name}"] = value
    for slot in asset.material_slots:
        for node in slot.material.node_tree.nodes if slot.material else ():
            if node.type == "TEX_IMAGE" and node.image and not node.image.packed_file and is_packed:
                node.image.pack()
    preview = asset.preview_ensure()
    preview.image_size = picture.shape[1::-1]
    preview.image_pixels_float.foreach_set(picture.astype(np.float32).ravel())


def preview_codes(picture: np.ndarray) -> np.ndarray:
    """A square picture (256, 256, 4) of the object in another picture, transparent about it."""
    rows, columns = (np.nonzero((picture[..., 3] > 0).any(axis=axis))[0] for axis in (1, 0))
    if len(rows) == 0:
        rows, columns = (np.arange(side) for side in picture.shape[:2])
    middle = 0.5 * np.array([rows[0] + rows[-1], columns[0] + columns[-1]])
    side = 1.05 * max(np.ptp(rows) + 1, np.ptp(columns) + 1)
    steps = ((np.arange(PREVIEW_SIDE) + 0.5) / PREVIEW_SIDE - 0.5) * side
    row, column = (np.round(centre + steps).astype(int) for centre in middle)
    inside = np.outer(
        (row >= 0) & (row < picture.shape[0]), (column >= 0) & (column < picture.shape[1])
    )
    last = np.array(picture.shape[:2]) - 1
    shown = picture[np.clip(row, 0, last[0])][:, np.clip(column, 0, last[1])].copy()
    shown[~inside] = 0.0
    return shown
