# SPDX-License-Identifier: Apache-2.0
"""Which reader a folder or a file of poses needs, told from names and content."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import replace
from functools import partial
from pathlib import Path

from robir.capture.capture import Finding
from robir.capture.frames import FrameSet
from robir.capture.readers import (
    colmap,
    llff,
    meshroom,
    metashape,
    neus,
    reality_scan,
    transforms,
)
from robir.capture.readers.files import children
from robir.capture.readers.programs import (
    arkit,
    bundler,
    nerfactor,
    openmvg,
    opensfm,
    record3d,
    sdfstudio,
    splats,
    stray_scanner,
)
from robir.capture.refusal import note, warning

Reader = Callable[[], FrameSet]

# files and folders that poses come in, for refusals
KNOWN = (
    "transforms_train.json, transforms.json, a COLMAP model (sparse/0), "
    "cameras_sphere.npz, poses_bounds.npy, Polycam's keyframes, RealityScan's "
    "internal/external camera parameters (CSV) or XMP files, Metashape's cameras (XML), "
    "Meshroom's cameras.sfm, or what docs/formats.md lists besides"
)
# formats that are told by what a file holds, and the suffixes of such files
_FILES = (
    (meshroom, (".json", ".sfm")),
    (opensfm, (".json",)),
    (openmvg, (".json",)),
    (sdfstudio, (".json",)),
    (splats, (".json",)),
    (stray_scanner, (".csv",)),
    (reality_scan, (".csv", ".txt")),
    (metashape, (".xml",)),
    (bundler, (".out",)),
    (record3d, (".json", "")),
)
_MOST = 200  # files of one folder that are looked into for poses
# files of poses that are known but not read: name, what it is, how its poses can be read
_UNREAD = (
    ("*.psx", "a Metashape project", "export its cameras (File > Export > Export Cameras, XML)"),
    ("*.psz", "a Metashape project", "export its cameras (File > Export > Export Cameras, XML)"),
    ("*.rcproj", "a RealityScan project", 'export "Internal/External camera parameters" (CSV)'),
    ("*.rsproj", "a RealityScan project", 'export "Internal/External camera parameters" (CSV)'),
    ("*.mg", "a Meshroom project", "copy cameras.sfm from its StructureFromMotion node here"),
    ("sfm_data.bin", "OpenMVG's scene", "convert it: openMVG_main_ConvertSfM_DataFormat -i "
     "sfm_data.bin -o sfm_data.json"),
    ("*.nvm", "VisualSFM's scene", "save it as Bundler (.out) with list.txt"),
    ("*.r3d", "a Record3D recording", "unpack it with any program for ZIP files"),
    ("*.traj", "an ARKitScenes trajectory", "write its poses as nerfstudio's transforms.json"),
    ("*_calibrated_camera_parameters.txt", "Pix4D's cameras", "export them for Bundler"),
)  # fmt: skip


def reader_of(source: Path) -> Reader | None:
    """What reads a folder or a file of poses, or None.

    Of several in a folder the one that says most counts, and what is left is said: first what names
    masks and splits, then what has lens and points, last LLFF, which has neither.
    """
    if source.is_file():
        return file_reader(source)
    found = list(_readers(source))
    if not found:
        return None
    (chosen, reader), *others = found
    if not others:
        return reader
    left = ", ".join(name for name, _ in others[:3])
    left += f" and {len(others) - 3} more" if len(others) > 3 else ""
    message = f"Poses are taken from {chosen}, which says most; {left} is left aside"
    return lambda: _with(reader(), note("several-poses", message))


def _with(frames: FrameSet, finding: Finding) -> FrameSet:
    return replace(frames, findings=(*frames.findings, finding))


def _readers(source: Path) -> Iterator[tuple[str, Reader]]:
    """Everything in a folder that poses can be read from, what says most first."""
    keyframes = transforms.find_keyframes(source)
    if keyframes is not None:
        yield f"{keyframes.name}/", partial(transforms.read_keyframes, keyframes)
    is_synthetic = (source / transforms.TRAIN).is_file()
    if is_synthetic:
        yield transforms.TRAIN, partial(transforms.read_synthetic, source)
    own = source / transforms.NAME
    if own.is_file():
        yield own.name, partial(transforms.read, own)
    archive = neus.find(source)
    if archive is not None:
        yield archive.name, partial(neus.read, archive)
    for module in (nerfactor, arkit):
        if module.find(source):
            yield f"folders of {module.FORMAT}", partial(module.read, source)
    models = colmap.find_models(source)
    if models:
        yield models[0].relative_to(source).as_posix(), partial(colmap.read, source)
    for path in _files(source):
        is_split = is_synthetic and path.name.startswith("transforms_")
        reader = None if path in (own, archive) or is_split else file_reader(path)
        if reader is not None:
            yield path.relative_to(source).as_posix(), reader
    sidecars = reality_scan.find_sidecars(source)
    if sidecars is not None:
        yield f"{sidecars.name}/*.xmp", partial(reality_scan.read_sidecars, sidecars)
    if (source / llff.NAME).is_file():
        yield llff.NAME, partial(llff.read, source / llff.NAME)


def _files(source: Path) -> list[Path]:
    """Files of a folder that may hold poses, and those at the usual places below it."""
    suffixes = {suffix for _, some in _FILES for suffix in some if suffix} | {".npz"}
    own = [path for path in children(source) if path.suffix.lower() in suffixes][:_MOST]
    below = [source / "opensfm" / opensfm.NAME, record3d.find(source)]
    found = [path for path in (*own, *below) if path is not None and path.is_file()]
    return list(dict.fromkeys(found))


def file_reader(path: Path) -> Reader | None:
    """What reads a file of poses, told by what the file holds."""
    suffix = path.suffix.lower()
    for module, suffixes in _FILES:
        if suffix in suffixes and module.looks_like(path):
            return partial(module.read, path)
    is_json = suffix == ".json" and path.name != transforms.TRAIN
    if is_json and transforms.looks_like(path):
        return partial(transforms.read, path)
    return partial(neus.read, path) if suffix == ".npz" and neus.is_camera_file(path) else None


def unread_poses(source: Path) -> list[Finding]:
    """Warnings that name files of poses which no reader here knows, and how to convert them."""
    folder = source if source.is_dir() else source.parent
    return [
        warning(
            "poses-not-read",
            f"{path.name} is {what}, whose poses are not read",
            f"To have them used, {how}.",
            path.name,
        )
        for path in children(folder)
        for pattern, what, how in _UNREAD
        if path.match(pattern)
    ]
