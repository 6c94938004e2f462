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


@dataclass(frozen=True, slots=True)
class JobPaths:
    """Names of a result folder's files; nothing else may spell them."""

    root: Path  # the result folder, OUT on the command line

    @property
    def run(self) -> Path:
        """Who made the result: versions, device, seed, capture, times."""
        return self.root / "run.json"

    @property
    def config(self) -> Path:
        """The resolved configuration, every value."""
        return self.root / "config.toml"

    @property
    def status(self) -> Path:
        """Where the run stands; replaced as a whole."""
        return self.root / "status.json"

    @property
    def events(self) -> Path:
        """What happened, one JSON line each; only ever appended to."""
        return self.root / "events.jsonl"

    @property
    def log(self) -> Path:
        """The log for people."""
        return self.root / "log.txt"

    @property
    def preview(self) -> Path:
        """A photograph and its present re-render side by side; replaced while the run goes on."""
        return self.root / "preview.png"

    @property
    def growing(self) -> Path:
        """The surface so far, coarse, capture frame; replaced while it is fitted, else absent."""
        return self.root / "growing.npz"

    @property
    def masks(self) -> Path:
        """Masks that were guessed for a capture without masks; the user may look and mend."""
        return self.root / "masks"

    @property
    def mesh_fit(self) -> Path:
        """Photographs with a handed-in mesh over them where it, or their cameras, had to move."""
        return self.root / "mesh_fit.png"

    @property
    def cancel(self) -> Path:
        """Touch this file to ask the run to stop."""
        return self.root / "cancel"

    @property
    def lock(self) -> Path:
        """Held by the one process that works in the folder."""
        return self.root / "lock"

    @property
    def worker(self) -> Path:
        """When and as which process a client started the worker; the client writes it."""
        return self.root / "worker.json"

    @property
    def worker_log(self) -> Path:
        """All that a worker started by a client printed."""
        return self.root / "worker.log"

    @property
    def stale(self) -> Path:
        """Where results of another configuration are moved, never deleted."""
        return self.root / "stages" / ".stale"

    @property
    def registration(self) -> Path:
        """Work of the capture stage on photographs without poses; it survives a stopped stage."""
        return self.root / "stages" / ".registration"

    def stage(self, name: str) -> Path:
        """Folder of a stage."""
        return self.root / "stages" / name

    def manifest(self, name: str) -> Path:
        """A stage's manifest, written last: it makes the stage count as done."""
        return self.stage(name) / "stage.json"

    def steps(self, name: str) -> Path:
        """Which of a stage's steps changed nothing on this capture, and what each cost."""
        return self.stage(name) / "steps.json"

    @property
    def ground(self) -> Path:
        """Plane of the flat ground that the mesh shows, unit frame; else absent."""
        return self.stage("geometry") / "ground.json"

    @property
    def frame(self) -> Path:
        """Where the capture was brought to stand as a handed-in mesh does; else absent."""
        return self.stage("geometry") / "frame.json"

    @property
    def normal_map(self) -> Path:
        """Normal map of a handed-in mesh that keeps its texture coordinates; else absent.

        A mesh of UDIM tiles has one for each, see `of_tile`.
        """
        return self.stage("geometry") / "normal_map.png"

    @property
    def cut_masks(self) -> Path:
        """Masks of the views where the geometry stage cut guessed ones again; else absent."""
        return self.stage("geometry") / "masks"

    @property
    def export(self) -> Path:
        """What the user takes away."""
        return self.root / "export"

    @property
    def textures(self) -> Path:
        """Texture images of the asset."""
        return self.export / "textures"

    @property
    def asset(self) -> Path:
        """The asset as glTF binary."""
        return self.export / "asset.glb"

    @property
    def library_asset(self) -> Path:
        """The object as an asset of Blender's library; absent where none was asked for."""
        return self.export / "asset.blend"

    @property
    def usd(self) -> Path:
        """The asset as USD, beside its textures; absent where none was asked for."""
        return self.export / "asset.usda"

    @property
    def library_facts(self) -> Path:
        """What `library_asset` and `usd` were made with; written after them."""
        return self.export / "asset.json"

    @property
    def environment(self) -> Path:
        """Recovered light, lat-long, linear Rec.709, Blender's world frame."""
        return self.export / "environment.exr"

    @property
    def environment_without_sun(self) -> Path:
        """Recovered light without the lobes that light.json gives as Sun lamps; absent without."""
        return self.export / "environment_without_sun.exr"

    @property
    def light(self) -> Path:
        """Recovered light as lobes."""
        return self.export / "light.json"

    @property
    def tone_curve(self) -> Path:
        """Recovered tone curve: family, parameters, samples."""
        return self.export / "tone_curve.json"

    @property
    def tone_lut(self) -> Path:
        """Recovered tone curve as a look-up table that OpenColorIO reads."""
        return self.export / "tone_curve.cube"

    @property
    def tone_plot(self) -> Path:
        """Plot of the recovered tone curve against the other candidates."""
        return self.export / "tone_curve.png"

    @property
    def cameras(self) -> Path:
        """Capture cameras in the capture's own frame, for Blender."""
        return self.export / "cameras.json"

    @property
    def transforms(self) -> Path:
        """The same as nerfstudio and instant-ngp read them."""
        return self.export / "transforms.json"

    @property
    def colmap(self) -> Path:
        """The same as a folder with a COLMAP model, sparse/0."""
        return self.export / "colmap"

    @property
    def scene(self) -> Path:
        """Blender scene with the asset, its light and the capture cameras."""
        return self.export / "scene.blend"

    @property
    def renders(self) -> Path:
        """Cycles renders: re-renders of held-out views, relit views, turntables."""
        return self.root / "renders"

    def rerender(self, view: str) -> Path:
        """Cycles picture of a view under the recovered light; absent where none was rendered."""
        return self.renders / f"rerender_{view}.png"

    def light_picture(self, light: str) -> Path:
        """Small Cycles picture under a light, by its file's stem or "" for the recovered one."""
        return self.renders / f"light_{light or 'recovered'}.png"

    @property
    def report(self) -> Path:
        """The report as one page."""
        return self.root / "report" / "index.html"

    @property
    def contact(self) -> Path:
        """A view in small: photograph, re-render, albedo, and relit or trust beside each other."""
        return self.root / "report" / "contact.jpg"

    @property
    def report_json(self) -> Path:
        """The report's numbers."""
        return self.root / "report" / "report.json"

    @property
    def scores(self) -> Path:
        """Scores against the truth, where it is known."""
        return self.root / "report" / "scores.json"

    @property
    def levels(self) -> Path:
        """Scores of each level of the chain against held-out photographs."""
        return self.root / "report" / "levels.json"

    @property
    def levels_strip(self) -> Path:
        """Pictures of a few held-out photographs as each level shows them."""
        return self.root / "report" / "levels.png"

    @property
    def truth_sheet(self) -> Path:
        """Pictures of the result beside the truth."""
        return self.root / "report" / "truth.png"


UDIM = "<UDIM>"  # what stands in a path for the number of any tile, to Blender and to USD


def of_tile(path: Path, tile: int | str | None) -> Path:
    """The file of one UDIM tile: albedo.png of tile 1002 is albedo.1002.png.

    `UDIM` stands for all tiles; without any the path stays.
    """
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
