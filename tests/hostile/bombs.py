# SPDX-License-Identifier: Apache-2.0
"""Files that claim to be photographs: bombs, damage and things that are something else."""

from __future__ import annotations

import random
import struct
import zlib
from collections.abc import Callable
from io import BytesIO

import numpy as np
from hostile.damage import WHOLE, flipped
from PIL import Image, ImageDraw, PngImagePlugin

Make = Callable[[random.Random], bytes]

KINDS = ("PNG", "JPEG", "TIFF", "BMP", "WEBP")
OTHERS = ("GIF", "PPM", "TGA", "PCX", "ICO", "DDS", "PDF", "SGI", "EPS", "JPEG2000", "MSP", "XBM")
SIZES = ((13377, 13377), (178_000_000, 1), (1, 65535), (60000, 60000), (65535, 1526), (4000, 4000))
LARGE = ((4000, 4000), (9000, 9000), (65535, 200), (10000, 9999))
SMALL = ((1, 1), (47, 48), (1, 200), (333, 7))
MODES = ("1", "L", "LA", "P", "RGB", "RGBA", "CMYK", "I;16", "I", "F")
TEXTS = (
    b"%!PS-Adobe-3.0 EPSF-3.0\n%%BoundingBox: 0 0 48 48\n%%EndComments\nshowpage\n",
    b'<svg xmlns="http://www.w3.org/2000/svg"><image href="file:///etc/passwd"/></svg>',
    b"#!/bin/sh\ntouch /tmp/pwned\n", b"GIF89a", b"\x89PNG\r\n\x1a\n",
    b"RIFF\xff\xff\xff\xffWEBPVP8X",
    b"II*\0\x08\0\0\0\xff\xff" + b"\xff" * 4000, b"BM" + b"\xff" * 60, b"\xff\xd8\xff\xe1\xff\xff",
    b"#EXTM3U\n/etc/passwd\n", b"\0\0\0\x20ftypheic" + b"\xff" * 64,
    b"FUJIFILMCCD-RAW " + b"\xff" * 200,
)  # fmt: skip


def encoded(kind: str, mode: str = "RGB", size: tuple[int, int] = (48, 48), **options) -> bytes:
    """A picture with something on it; empty where Pillow cannot write that mode."""
    picture = Image.new(mode, size)
    ImageDraw.Draw(picture).rectangle((10, 10, 30, 30), fill=1 if mode in ("1", "P") else None)
    file = BytesIO()
    try:
        picture.save(file, kind, **options)
    except (OSError, ValueError, KeyError):
        return b""
    return file.getvalue()


def png_chunk(kind: bytes, content: bytes, *, is_right: bool = True) -> bytes:
    """A chunk of a PNG file, its checksum right or not."""
    check = zlib.crc32(kind + content) if is_right else 1
    return struct.pack(">I", len(content)) + kind + content + struct.pack(">I", check)


def png(width: int, height: int, rows: bytes = b"", extra: bytes = b"", depth: int = 8) -> bytes:
    """A PNG file that claims a size."""
    header = struct.pack(">IIBBBBB", width, height, depth, 2, 0, 0, 0)
    body = png_chunk(b"IHDR", header) + extra + png_chunk(b"IDAT", rows) + png_chunk(b"IEND", b"")
    return b"\x89PNG\r\n\x1a\n" + body


def blank_png(width: int, height: int) -> bytes:
    """A whole PNG of so many pixels, all black, as small as it gets."""
    packer = zlib.compressobj(1)
    row = bytes(1 + 3 * width)
    rows = b"".join(packer.compress(row) for _ in range(height)) + packer.flush()
    return png(width, height, rows)


def _scans(generator: random.Random) -> bytes:
    side = generator.choice([500, 2000, 4000])
    content = encoded("JPEG", "L", (side, side), progressive=True)
    first = content.index(b"\xff\xda")
    scan = content[first : content.index(b"\xff\xda", first + 2)]
    return content[:-2] + generator.choice([50, 400, 5000]) * scan + b"\xff\xd9"


def _chained_tiff(generator: random.Random) -> bytes:
    """Directories that follow each other, or that come back to themselves."""
    content = bytearray(encoded("TIFF"))
    first = struct.unpack_from("<I", content, 4)[0]
    count = struct.unpack_from("<H", content, first)[0]
    struct.pack_into("<I", content, first + 2 + 12 * count, generator.choice([first, 8, 2**32 - 1]))
    for index in range(count):
        if generator.random() < 0.3:
            struct.pack_into(
                "<I", content, first + 2 + 12 * index + 4, generator.choice([0, 2**31])
            )
    return bytes(content)


def _listed_tiff(generator: random.Random) -> bytes:
    """An entry with a million numbers, in the first directory or in that of EXIF."""
    count = generator.choice([10**5, 10**6])
    size = struct.pack("<HHIIHHII", 256, 4, 1, 48, 257, 4, 1, 48)
    strips = struct.pack("<HHIIHHII", 273, 4, count, 200, 279, 4, count, 200)
    exif = struct.pack("<HHI", 34665, 4, 1) + struct.pack("<I", 8)
    body = generator.choice([size + strips, size + strips + exif, exif + strips])
    head = b"II*\0" + struct.pack("<IH", 8, len(body) // 12)
    return head + body + bytes(4 * count + 400)


def _exif(generator: random.Random) -> bytes:
    exif = Image.Exif()
    exif[274] = generator.choice([0, 9, 6, 2**15])
    data = bytearray(exif.tobytes())
    for _ in range(4):
        data[generator.randrange(len(data))] = generator.randrange(256)
    kind = generator.choice(["JPEG", "PNG", "WEBP"])
    return encoded(kind, exif=bytes(data))


def _packed(generator: random.Random) -> bytes:
    """Texts and profiles that unpack to a gigabyte."""
    packer = zlib.compressobj(9)
    zeros = b"".join(packer.compress(bytes(1 << 20)) for _ in range(200)) + packer.flush()
    kind = generator.choice([b"zTXt", b"iCCP", b"iTXt"])
    tail = b"key\0\0\0\0" + zeros if kind == b"iTXt" else b"key\0\0" + zeros
    return png(48, 48, zlib.compress(bytes(48 * 145)), png_chunk(kind, tail))


def _animated(generator: random.Random) -> bytes:
    frames = [Image.new("RGB", (48, 48), (i, 0, 0)) for i in range(generator.choice([2, 300]))]
    file = BytesIO()
    kind = generator.choice(["PNG", "WEBP", "TIFF"])
    frames[0].save(file, kind, save_all=True, append_images=frames[1:])
    return file.getvalue()


def _large(generator: random.Random) -> bytes:
    kind = generator.choice(["JPEG", "WEBP", "BMP", "TIFF"])
    size = generator.choice([(3900, 4100), (9000, 9000), (16383, 300), (1, 16000)])
    options = {"compression": "tiff_deflate"} if kind == "TIFF" else {}
    return encoded(kind, "RGB", size, **options)


def _lied(generator: random.Random) -> bytes:
    """A good file whose header claims another size, depth or colour."""
    content = bytearray(encoded(generator.choice(KINDS)))
    for _ in range(generator.randint(1, 8)):
        content[generator.randrange(min(80, len(content)))] = generator.choice([0, 1, 127, 255])
    return bytes(content)


def _texts(generator: random.Random) -> bytes:
    info = PngImagePlugin.PngInfo()
    for number in range(2000):
        info.add_text(f"key{number}", "\u00b2" * generator.randint(0, 200))
    return encoded("PNG", pnginfo=info)


# each makes the bytes of one file
MAKERS: dict[str, Make] = {
    "claims": lambda g: png(*g.choice(SIZES), depth=g.choice([1, 8, 16])),
    "blank": lambda g: blank_png(*g.choice(LARGE)),
    "large": _large,
    "scans": _scans,
    "tiff": _chained_tiff,
    "listed": _listed_tiff,
    "exif": _exif,
    "packed": _packed,
    "animated": _animated,
    "lied": _lied,
    "texts": _texts,
    "other": lambda g: encoded(g.choice(OTHERS)),
    "mode": lambda g: encoded(g.choice(KINDS), g.choice(MODES)),
    "size": lambda g: encoded(g.choice(KINDS), size=g.choice(SMALL)),
    "flipped": lambda g: flipped(encoded(g.choice(KINDS)), g),
    "cut": lambda g: (c := encoded(g.choice(KINDS)))[: g.randrange(len(c))],
    "noise": lambda g: np.random.default_rng(g.randrange(9)).bytes(5000),
    "whole": lambda g: g.choice(WHOLE),
    "text": lambda g: g.choice(TEXTS),
}  # fmt: skip
