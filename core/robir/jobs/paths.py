# SPDX-License-Identifier: Apache-2.0
"""Every file name of a result folder, and the one way to write a file there."""

from __future__ import annotations

import json
import os
import tempfile
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from robir.errors import QualityError
from robir.jobs.records import read_record

STAGES = ("capture", "geometry", "transport", "appearance", "export")


class Named:
    """A file or folder of fixed name below the `root` of what has it as an attribute."""

    def __init__(self, name: str) -> None:
        self._name = name

    def __get__(self, owner: Any, kind: Any = None) -> Path:
        return owner.root / self._name


@dataclass(frozen=True, slots=True)
class JobPaths:
    """Names of a result folder's files; nothing else may spell them."""

    root: Path  # the result folder, OUT on the command line

    run = Named("run.json")  # who made the result: versions, device, seed, capture, times
    config = Named("config.toml")  # the resolved configuration, every value
    status = Named("status.json")  # where the run stands; replaced as a whole
    events = Named("events.jsonl")  # what happened, one JSON line each; only ever appended to
    log = Named("log.txt")  # the log for people
    preview = Named("preview.png")  # a photograph and its present re-render, while the run goes on
    growing = Named("growing.npz")  # the surface so far, coarse, capture frame, while it is fitted
    masks = Named("masks")  # guessed ones of a capture without; the user may look and mend
    mesh_fit = Named("mesh_fit.png")  # photographs with the user's mesh over them, if moved
    cancel = Named("cancel")  # touch this file to ask the run to stop
    lock = Named("lock")  # held by the one process that works in the folder
    worker = Named("worker.json")  # when and as which process a client started the worker
    worker_log = Named("worker.log")  # all that a worker started by a client printed
    stale = Named("stages/.stale")  # results of other settings, never deleted
    registration = Named("stages/.registration")  # poses of photographs without, if stopped

    def stage(self, name: str) -> Path:
        """Folder of a stage."""
        return self.root / "stages" / name

    def manifest(self, name: str) -> Path:
        """A stage's manifest, written last: it makes the stage count as done."""
        return self.stage(name) / "stage.json"

    def steps(self, name: str) -> Path:
        """Which of a stage's steps changed nothing on this capture, and what each cost."""
        return self.stage(name) / "steps.json"

    ground = Named("stages/geometry/ground.json")  # plane of the flat ground, unit frame, if any
    frame = Named("stages/geometry/frame.json")  # the capture's, by the user's mesh, if moved
    # normal map of a handed-in mesh that keeps its texture coordinates; else absent. A mesh of UDIM
    # tiles has one for each, see `of_tile`.
    normal_map = Named("stages/geometry/normal_map.png")
    cut_masks = Named("stages/geometry/masks")  # guessed masks that geometry cut again
    export = Named("export")  # what the user takes away
    textures = Named("export/textures")  # texture images of the asset
    asset = Named("export/asset.glb")  # the asset as glTF binary
    library_asset = Named("export/asset.blend")  # for Blender's library, if asked for
    usd = Named("export/asset.usda")  # beside its textures, if asked for
    library_facts = Named("export/asset.json")  # of `library_asset` and `usd`, written after them
    environment = Named("export/environment.exr")  # lat-long, linear Rec.709, Blender's world
    # recovered light without the lobes that light.json gives as Sun lamps; absent without
    environment_without_sun = Named("export/environment_without_sun.exr")
    light = Named("export/light.json")  # recovered light as lobes
    tone_curve = Named("export/tone_curve.json")  # family, parameters, samples
    tone_lut = Named("export/tone_curve.cube")  # the curve as OpenColorIO reads it
    tone_plot = Named("export/tone_curve.png")  # against the other candidates
    cameras = Named("export/cameras.json")  # in the capture's frame, for Blender
    transforms = Named("export/transforms.json")  # the same as nerfstudio and instant-ngp read them
    colmap = Named("export/colmap")  # the same as a folder with a COLMAP model, sparse/0
    scene = Named("export/scene.blend")  # asset, light and cameras in Blender
    renders = Named("renders")  # of Cycles: held-out and relit views, turntables

    def rerender(self, view: str) -> Path:
        """Cycles picture of a view under the recovered light; absent where none was rendered."""
        return self.renders / f"rerender_{view}.png"

    def comparison(self, view: str) -> Path:
        """A view's photograph, re-render, albedo and roughness beside each other, as wide each."""
        return self.renders / f"compare_{view}.webp"

    def light_picture(self, light: str) -> Path:
        """Small Cycles picture under a light, by its file's stem or "" for the recovered one."""
        return self.renders / f"light_{light or 'recovered'}.png"

    report = Named("report/index.html")  # the report as one page
    contact = Named("report/contact.jpg")  # photograph, re-render, albedo, relit or trust, in small
    report_json = Named("report/report.json")  # the report's numbers
    scores = Named("report/scores.json")  # scores against the truth, where it is known
    levels = Named("report/levels.json")  # scores of the chain's levels on held-out photographs
    levels_strip = Named("report/levels.png")  # held-out photographs as each level shows them
    truth_sheet = Named("report/truth.png")  # pictures of the result beside the truth


UDIM = "<UDIM>"  # what stands in a path for the number of any tile, to Blender and to USD


def of_tile(path: Path, tile: int | str | None) -> Path:
    """The file of one UDIM tile or `UDIM`: albedo.png of tile 1002 is albedo.1002.png."""
    return path if tile is None else path.with_name(f"{path.stem}.{tile}{path.suffix}")


def tiles_there(path: Path) -> list[int]:
    """Rising numbers of the tiles that have a file; see `of_tile`."""
    found = (file.name.split(".") for file in path.parent.glob(of_tile(path, "[1-9]*").name))
    return sorted(int(parts[-2]) for parts in found if parts[-2].isdecimal())


def files_of(path: Path) -> list[Path]:
    """The files that a path of `of_tile` stands for: itself, or those of its tiles."""
    mark = f".{UDIM}{path.suffix}"
    if not path.name.endswith(mark):
        return [path]
    alone = path.with_name(path.name.removesuffix(mark) + path.suffix)
    return [of_tile(alone, tile) for tile in tiles_there(alone)]


@contextmanager
def replacing(path: Path) -> Iterator[Path]:
    """A temporary path beside `path`, of the same suffix, that replaces it if the block ends well.

    The file is flushed to disk before the exchange, so a killed process leaves either the old file
    or the new one, never half of one.
    """
    path.parent.mkdir(parents=True, exist_ok=True)
    handle, name = tempfile.mkstemp(prefix=f".{path.stem}-", suffix=path.suffix, dir=path.parent)
    os.close(handle)
    temporary = Path(name)
    try:
        yield temporary
        with temporary.open("rb") as written:
            os.fsync(written.fileno())
        temporary.chmod(0o644)
        temporary.replace(path)
    finally:
        temporary.unlink(missing_ok=True)


def write_json(path: Path, value: Any) -> None:
    """Write plain values as a whole JSON file; a `QualityError` if a number is not finite."""
    try:
        text = json.dumps(value, indent=2, allow_nan=False, ensure_ascii=False)
    except ValueError as error:
        raise QualityError(
            f"{path.name} would hold numbers that are not finite; run `robir check` on the "
            "capture, or try another --seed"
        ) from error
    with replacing(path) as temporary:
        temporary.write_text(text + "\n", encoding="utf-8")


def read_json(path: Path) -> Any:
    """Read a JSON file of `write_json`; an `OSError` or `ValueError` as of `read_record`."""
    return read_record(path, Any)
