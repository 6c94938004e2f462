# SPDX-License-Identifier: Apache-2.0
"""Which reader a folder or a file of poses needs, recognised by names and content."""

from __future__ import annotations

import re
from collections.abc import Callable, Iterator
from dataclasses import replace
from functools import partial
from pathlib import Path

from robir.capture.capture import Finding
from robir.capture.frames import FrameSet
from robir.capture.readers import (
    colmap,
    meshroom,
    metashape,
    neus,
    phones,
    programs,
    reality_scan,
    transforms,
)
from robir.capture.readers.files import children, head
from robir.capture.refusal import note, warning

Reader = Callable[[], FrameSet]

# files and folders that poses come in, for refusals
KNOWN = (
    "transforms_train.json, transforms.json, a COLMAP model (sparse/0), "
    "cameras_sphere.npz, poses_bounds.npy, Polycam's keyframes, RealityScan's "
    "internal/external camera parameters (CSV) or XMP files, Metashape's cameras (XML), "
    "Meshroom's cameras.sfm, or what docs/formats.md lists besides"
)
# suffixes of files, how files of one format begin, and what reads them
_FILES = (
    ((".json", ".sfm"), r'(?=.*"views")(?=.*"viewId")', meshroom.read),
    ((".json",), r'\s*\[(?=.*"projection_type")', programs.read_opensfm),
    ((".json",), r'(?=.*"sfm_data_version")', programs.read_openmvg),
    ((".json",), r'(?=.*"camtoworld")(?=.*"rgb_path")', transforms.read_sdfstudio),
    ((".json",), r'\s*\[(?=.*"img_name")(?=.*"rotation")', transforms.read_splats),
    ((".csv",), r"(?=[^\n]*\bframe\b)(?=[^\n]*\bqx\b)(?=[^\n]*\bqw\b)", phones.read_stray_scanner),
    ((".xml",), r"(?=.*<chunk)(?=.*<sensor)", metashape.read),
    ((".out",), r"\s*# bundle file", programs.read_bundler),
)
_MOST = 200  # files of one folder that are looked into for poses
# files of poses that are known but not read: name, what it is, how its poses can be read
_UNREAD = (
    ("*.ps[xz]", "a Metashape project", "export its cameras (File > Export > Export Cameras, XML)"),
    ("*.r[cs]proj", "a RealityScan project", 'export "Internal/External camera parameters" (CSV)'),
    ("*.mg", "a Meshroom project", "copy cameras.sfm from its StructureFromMotion node here"),
    ("sfm_data.bin", "OpenMVG's scene", "convert it: openMVG_main_ConvertSfM_DataFormat -i "
     "sfm_data.bin -o sfm_data.json"),
    ("*.nvm", "VisualSFM's scene", "save it as Bundler (.out) with list.txt"),
    ("*.r3d", "a Record3D recording", "unpack it with any program for ZIP files"),
    ("*.traj", "an ARKitScenes trajectory", "write its poses as nerfstudio's transforms.json"),
    ("*_calibrated_camera_parameters.txt", "Pix4D's cameras", "export them for Bundler"),
)  # fmt: skip


def reader_of(source: Path) -> Reader | None:
    """What reads a folder or a file of poses, of several the one that says most, or None."""
    if source.is_file():
        return file_reader(source)
    (chosen, reader), *others = list(_readers(source)) or [("", None)]
    if reader is None or not others:
        return reader
    left = ", ".join(name for name, _ in others[:3])
    left += f" and {len(others) - 3} more" if len(others) > 3 else ""
    message = f"Poses are taken from {chosen}, which says most; {left} is left aside"
    return partial(_noted, reader, note("several-poses", message))


def _noted(reader: Reader, finding: Finding) -> FrameSet:
    frames = reader()
    return replace(frames, findings=(*frames.findings, finding))


def _readers(source: Path) -> Iterator[tuple[str, Reader]]:
    """Everything in a folder that poses can be read from, what says most first."""
    keyframes = phones.find_keyframes(source)
    if keyframes is not None:
        yield f"{keyframes.name}/", partial(phones.read_keyframes, keyframes)
    is_synthetic = (source / transforms.TRAIN).is_file()
    if is_synthetic:
        yield transforms.TRAIN, partial(transforms.read_synthetic, source)
    own = source / transforms.NAME
    if own.is_file():
        yield own.name, partial(transforms.read, own)
    archive = neus.find(source)
    if archive is not None:
        yield archive.name, partial(neus.read, archive)
    if transforms.is_nerfactor(source):
        yield "folders of nerfactor", partial(transforms.read_nerfactor, source)
    if phones.is_arkit(source):
        yield "folders of arkit", partial(phones.read_arkit, source)
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
    if (source / neus.LLFF).is_file():
        yield neus.LLFF, partial(neus.read_llff, source / neus.LLFF)


def _files(source: Path) -> list[Path]:
    """Files of a folder that may hold poses, and those at the usual places below it."""
    suffixes = {suffix for some, *_ in _FILES for suffix in some} | {".npz", ".txt"}
    own = [path for path in children(source) if path.suffix.lower() in suffixes][:_MOST]
    below = [source / "opensfm" / "reconstruction.json", phones.find_record3d(source)]
    found = [path for path in (*own, *below) if path is not None and path.is_file()]
    return list(dict.fromkeys(found))


def file_reader(path: Path) -> Reader | None:
    """What reads a file of poses, recognised by what the file holds."""
    suffix, start = path.suffix.lower(), head(path)
    for suffixes, begin, read in _FILES:
        if suffix in suffixes and re.match(begin, start, re.DOTALL | re.IGNORECASE):
            return partial(read, path)
    if suffix in (".csv", ".txt") and reality_scan.looks_like(path):
        return partial(reality_scan.read, path)
    if phones.is_record3d(path):
        return partial(phones.read_record3d, path)
    if suffix == ".json" and path.name != transforms.TRAIN and transforms.looks_like(path):
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
