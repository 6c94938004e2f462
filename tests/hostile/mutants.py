# SPDX-License-Identifier: Apache-2.0
"""Mutated captures in all formats: seeded, and the same on every machine."""

from __future__ import annotations

import json
import os
import random
import re
import shutil
import struct
import zipfile
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from functools import partial
from io import BytesIO
from pathlib import Path
from typing import Any

import numpy as np
from capture import app_writers, writers
from hostile.bombs import MAKERS
from hostile.damage import NASTY, WHOLE, flipped, places, replaced

Mutate = Callable[[Path, random.Random], None]

_META = (1, 2, 6)
# what writes a capture, and where its poses lie
FORMATS: dict[str, tuple[Callable[..., Path], str]] = {
    "nerf_synthetic": (writers.nerf_synthetic, "transforms_train.json"),
    "nerfstudio": (writers.nerfstudio, "transforms.json"),
    "nerfstudio_frames": (partial(writers.nerfstudio, per_frame=True), "transforms.json"),
    "colmap_binary": (partial(writers.colmap, binary=True), "sparse/0/*.bin"),
    "colmap_text": (partial(writers.colmap, binary=False), "sparse/0/*.txt"),
    "neus": (writers.neus, "cameras_sphere.npz"),
    "llff": (partial(writers.llff, numeric=True), "poses_bounds.npy"),
    "polycam": (app_writers.polycam, "keyframes/corrected_cameras/*.json"),
    "reality_scan": (app_writers.reality_scan, "cameras.csv"),
    "metashape": (app_writers.metashape, "cameras.xml"),
    "meshroom": (partial(app_writers.meshroom, version=_META), "cameras.sfm"),
}

# words in place of words of a text file
TOKENS = (
    "", "nan", "inf", "-inf", "1e999", "-1e308", "1" * 400, "²", "٣", "1_000", "0x10", "x", "-",
    "\0", "\ud800", "/", "../../../../etc/passwd", "/dev/zero", "a" * 300, '"', "'", "<", "&x;",
    "]]>", ",,,", "\ufeff", "\u202e", "\r", "1,5", "18446744073709551616", "-9223372036854775809",
    "True", "None",
)  # fmt: skip

NAMES = (
    b"\xff\xfe.png", b"a\nb.png", b"-rf.png", b"$(touch x).png", b"a;b.png", b"\xe2\x80\xae.png",
    b"a" * 251 + b".png", b" .png", b"..png", b"con.png", b"%00.png", b"<b>.png", b"'\".png",
    b"~.png", "é.png".encode(), "é.png".encode(), "😀.png".encode(), b"a\\b.png", b"\x7f.png",
    b"*.png",
)  # fmt: skip

SPECIAL: dict[str, Callable[[Path], object]] = {
    "folder": Path.mkdir,
    "pipe": os.mkfifo,
    "endless": lambda path: path.symlink_to("/dev/zero"),
    "noise": lambda path: path.symlink_to("/dev/random"),
    "terminal": lambda path: path.symlink_to("/dev/tty"),
    "loop": lambda path: path.symlink_to(path.name),
    "nowhere": lambda path: path.symlink_to("nowhere"),
    "root": lambda path: path.symlink_to("/"),
    "secret": lambda path: path.symlink_to("/etc/passwd"),
    "process": lambda path: path.symlink_to("/proc/self/mem"),
    "hole": lambda path: os.truncate(path, 1 << 40) if path.touch() is None else None,
    "empty": Path.touch,
    "missing": lambda path: None,
}


@dataclass(frozen=True, slots=True)
class Mutant:
    """One case."""

    name: str  # format, kind and number
    form: str  # key of `FORMATS`
    mutate: Mutate  # changes a fresh capture
    seed: str  # of its generator

    def make(self, whole: Path, folder: Path) -> Path:
        """Write it from a whole capture; its root."""
        root = shutil.copytree(whole, folder / "capture")
        self.mutate(root, random.Random(self.seed))
        return root


def corpus(seed: int, rounds: int) -> Iterator[Mutant]:
    """All kinds of mutants in all formats that they make sense for, so many times each."""
    for form in FORMATS:
        for kind, mutate in _kinds(form).items():
            for number in range(rounds):
                name = f"{form}-{kind}-{number}"
                yield Mutant(name, form, mutate, f"{seed} {name}")


def write_wholes(folder: Path, shots: Sequence[Any]) -> dict[str, Path]:
    """A whole capture of each format."""
    return {form: write(folder / form, shots) for form, (write, _) in FORMATS.items()}


def _kinds(form: str) -> dict[str, Mutate]:
    """What may be done to a capture of a format, by name."""
    pattern = FORMATS[form][1]
    suffix = Path(pattern).suffix

    def on_poses(change: Callable[[bytes, random.Random], bytes]) -> Mutate:
        def mutate(root: Path, generator: random.Random) -> None:
            path = generator.choice(sorted(root.glob(pattern)))
            path.write_bytes(change(path.read_bytes(), generator))

        return mutate

    common: dict[str, Mutate] = {
        "flipped": on_poses(flipped),
        "whole": on_poses(lambda content, generator: generator.choice(WHOLE)),
        "twice": on_poses(lambda content, generator: content * generator.choice([2, 50])),
        "special": partial(_special, pattern=pattern),
        "picture": _picture,
        "picture2": _picture,
        "name": _name,
        "beside": _beside,
        "gone": _gone,
    }
    if suffix in (".json", ".sfm"):
        own = {"value": _value, "value2": _value, "shape": _shape, "token": _token}
    elif suffix in (".txt", ".csv", ".xml"):
        own = {"token": _token, "token2": _token, "lines": _lines}
        own |= {"markup": _markup} if suffix == ".xml" else {}
    elif suffix in (".npz", ".npy"):
        own = {"arrays": partial(_arrays, suffix=suffix), "header": _header}
        own |= {"arrays2": own["arrays"]}
    else:
        own = {"numbers": _numbers, "numbers2": _numbers}
    return common | {kind: on_poses(change) for kind, change in own.items()}


def _value(content: bytes, generator: random.Random) -> bytes:
    document = json.loads(content)
    place = generator.choice(places(document))
    text = replaced(document, place, generator.choice([*NASTY, ...]))
    return text.encode("utf-8", errors="surrogatepass")


def _shape(content: bytes, generator: random.Random) -> bytes:
    """The structure as a whole: much too often, too deep, doubled keys, other encodings."""
    text = content.decode()
    match generator.randrange(6):
        case 0:
            return re.sub(r'"frames": \[', '"frames": [' + "{}," * 50_000, text).encode()
        case 1:
            return ("[" * 50_000 + text + "]" * 50_000).encode()
        case 2:
            return (text[:-1] + "," + text[1:]).encode()
        case 3:
            return text.encode(generator.choice(["utf-16", "utf-32", "utf-8-sig"]))
        case 4:
            frame = re.search(r"\{[^{}]*\}", text)
            part = frame[0] if frame else "0"
            return text.replace(part, ",".join([part] * 20_000), 1).encode()
        case _:
            return text.replace('"', generator.choice(["'", "\\u0000", '""'])).encode()


def _token(content: bytes, generator: random.Random) -> bytes:
    words = re.split(r"([\s,\"<>=]+)", content.decode())
    for _ in range(generator.randint(1, 3)):
        words[2 * generator.randrange((len(words) + 1) // 2)] = generator.choice(TOKENS)
    return "".join(words).encode("utf-8", errors="surrogatepass")


def _lines(content: bytes, generator: random.Random) -> bytes:
    lines = content.decode().split("\n")
    match generator.randrange(5):
        case 0:
            generator.shuffle(lines)
        case 1:
            del lines[generator.randrange(len(lines))]
        case 2:
            lines += [generator.choice(lines)] * 30_000
        case 3:
            lines = ["x" * 5_000_000, *lines]
        case _:
            lines = [line[: generator.randrange(len(line) + 1)] for line in lines]
    return "\n".join(lines).encode()


def _markup(content: bytes, generator: random.Random) -> bytes:
    text = content.decode()
    at = text.index("<document")
    entities = "".join(f'<!ENTITY e{i + 1} "{f"&e{i};" * 10}">' for i in range(9))
    bomb = f'<!DOCTYPE d [<!ENTITY e0 "x">{entities}]>'
    outside = '<!DOCTYPE d [<!ENTITY e9 SYSTEM "file:///etc/passwd">]>'
    match generator.randrange(5):
        case 0:
            text = bomb + text[at:].replace("Chunk 1", "&e9;")
        case 1:
            text = outside + text[at:].replace("Chunk 1", "&e9;")
        case 2:
            text = text.replace("<chunk", "<g>" * 30_000 + "<chunk", 1)
        case 3:
            tag = generator.choice(["sensor", "camera", "transform", "resolution", "f", "chunk"])
            text = re.sub(rf"<{tag}\b", "<other", text)
        case _:
            part = text[text.index("<camera ") : text.index("</camera>") + 9]
            text = text.replace(part, part * 20_000, 1)
    return text.encode()


def _numbers(content: bytes, generator: random.Random) -> bytes:
    """Whole numbers and reals of a binary file replaced, the counts at its head above all."""
    data = bytearray(content)
    for _ in range(generator.randint(1, 3)):
        near = min(len(data) - 8, 64 if generator.random() < 0.6 else len(data) - 8)
        at = generator.randint(0, near // 4) * 4
        number = generator.choice([0, 1, 2**31 - 1, 2**31, 2**32 - 1, 2**63, 2**64 - 1, 10**9])
        real = generator.choice([float("nan"), float("inf"), 1e308, -1.0, 0.0])
        is_real = generator.random() < 0.3
        struct.pack_into("<d" if is_real else "<Q", data, at, real if is_real else number)
    return bytes(data)


def _array(generator: random.Random) -> np.ndarray:
    shape = generator.choice(
        [(), (0,), (4, 4), (3, 4), (8, 17), (8, 16), (1, 1, 1, 1), (17,), (4, 0)]
    )
    kind = generator.choice(
        ["f8", "f4", "f2", "i8", "u1", "?", "c16", "U3", "S3", "M8[s]", "V7", ">f8"]
    )
    with np.errstate(all="ignore"):
        array = np.full(shape, generator.choice([0, 1, -1]), "f8").astype(kind)
        if kind in ("f8", "f4", "f2", ">f8"):
            array = array * generator.choice([1.0, np.nan, np.inf, 1e308])
    return array


def _arrays(content: bytes, generator: random.Random, suffix: str) -> bytes:
    file = BytesIO()
    if suffix == ".npy":
        np.save(file, _array(generator))
        return file.getvalue()
    with np.load(BytesIO(content), allow_pickle=False) as arrays:
        kept = dict(arrays)
    name = generator.choice(sorted(kept))
    match generator.randrange(4):
        case 0:
            del kept[name]
        case 1:
            kept[f"world_mat_{generator.choice([99, 10**6, -1])}"] = kept[name]
        case _:
            kept[name] = _array(generator)
    np.savez(file, **kept)
    return file.getvalue()


def _header(content: bytes, generator: random.Random) -> bytes:
    """An array whose header claims another size, kind or language."""
    shape = generator.choice([(1 << 27, 4), (-1, 4), (2**62, 4), (10**30,), ("x",), (4,) * 40])
    descr = generator.choice(
        ["'<f8'", "'|O'", "'<f8' if 1 else 0", "__import__('os')", "'<U100000000'"]
    )
    text = (
        f"{{'descr': {descr}, 'fortran_order': False, 'shape': {shape!r}}}".encode().ljust(117)
        + b"\n"
    )
    array = b"\x93NUMPY\x01\x00" + struct.pack("<H", len(text)) + text + bytes(64)
    if not zipfile.is_zipfile(BytesIO(content)):
        return array
    file = BytesIO()
    with zipfile.ZipFile(file, "w", zipfile.ZIP_DEFLATED) as archive:
        for name in generator.choice([["world_mat_0.npy"], ["../../x.npy", "world_mat_0.npy"]]):
            archive.writestr(name, array)
    return file.getvalue()


def _pictures(root: Path) -> list[Path]:
    return sorted(p for p in root.rglob("*.png") if p.is_file())


def _special(root: Path, generator: random.Random, pattern: str) -> None:
    chosen = [*sorted(root.glob(pattern)), *_pictures(root)[:2], *_pictures(root)[-2:]]
    path = generator.choice(chosen)
    path.unlink()
    SPECIAL[generator.choice(sorted(SPECIAL))](path)


def _picture(root: Path, generator: random.Random) -> None:
    maker = MAKERS[generator.choice(sorted(MAKERS))]
    generator.choice(_pictures(root)).write_bytes(maker(generator))


def _name(root: Path, generator: random.Random) -> None:
    path = generator.choice(_pictures(root))
    odd = os.fsencode(path.parent) + b"/" + generator.choice(NAMES)
    if generator.random() < 0.5:
        os.rename(path, odd)  # noqa: PTH104
    else:
        with open(odd, "wb") as file:  # noqa: PTH123
            file.write(path.read_bytes())


def _beside(root: Path, generator: random.Random) -> None:
    """Things that lie in the capture's folder and do not belong there."""
    match generator.randrange(5):
        case 0:
            name = generator.choice(
                ["a.json", "a.png", "cameras.npz", "masks", "images", "b.xml", "c.sfm"]
            )
            if not (root / name).exists():
                SPECIAL[generator.choice(sorted(SPECIAL))](root / name)
        case 1:
            for number in range(3000):
                (root / f"{number}.json").write_bytes(b"{}")
        case 2:
            deep = root
            for _ in range(300):
                deep = deep / "d"
            deep.mkdir(parents=True)
        case 3:
            for name in ("self", "masks", "images2"):
                if not (root / name).exists():
                    (root / name).symlink_to(".")
        case _:
            (root / generator.choice(["x.json", "x.csv", "x.xml", "x.npy"])).write_bytes(
                generator.choice(WHOLE) * 20
            )


def _gone(root: Path, generator: random.Random) -> None:
    """Some pictures are missing, or all of a folder lies elsewhere."""
    pictures = _pictures(root)
    for path in generator.sample(pictures, generator.choice([1, 2, len(pictures) - 1])):
        path.unlink()
    if generator.random() < 0.3 and pictures[0].parent != root:
        shutil.rmtree(pictures[0].parent)
