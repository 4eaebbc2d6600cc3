"""Readers of height-field files: MuJoCo's binary format, and grey PNG images of 8 bits.

Each takes the bytes of a file and returns heights, shape (rows, columns), the first row at the
largest y. Anything that is not what the format says is a ValueError.
"""

from __future__ import annotations

import os
import zlib
from typing import Any

import numpy as np
from numpy.typing import NDArray

from stepcore import checks

CONTENT = {"image/png": True, "image/vnd.mujoco.hfield": False}
# No field has more points: 128 MiB of double precision.
MOST = 2**24


def read(path: str | os.PathLike[str], content_type: str = "") -> NDArray[Any]:
    """Reads a height field: an image if its name ends with .png, or its content type says so.

    Raises FileNotFoundError, IsADirectoryError, and ValueError for a device or a pipe, a file of
    more than 256 MiB, or one whose content is damaged or of a kind that is not supported.
    """
    name = os.fsdecode(path)
    if content_type and content_type not in CONTENT:
        near = checks.nearest(content_type, CONTENT)
        text = f"no height field has the content type {checks.quoted(content_type)}{near}"
        raise ValueError(f"{name}: {text}")
    data = checks.file_bytes(name, "a height field")
    image = CONTENT.get(content_type, name.lower().endswith(".png"))
    try:
        heights = png(data) if image else binary(data)
        if not np.isfinite(heights).all():
            raise ValueError("a height is not a finite number")
    except ValueError as error:
        word = "PNG file" if image else "height-field file"
        raise ValueError(f"{checks.cut(name, 300)}: not a whole {word}: {error}") from None
    return heights


def binary(data: bytes) -> NDArray[Any]:
    """Two counts, then the heights row by row, the row of the smallest y first."""
    if len(data) < 8:
        raise ValueError(f"it has {len(data)} bytes, and the head alone has 8")
    nrow, ncol = (int(n) for n in np.frombuffer(data, "<i4", 2))
    if nrow < 1 or ncol < 1:
        raise ValueError(f"its head says {nrow} rows of {ncol}")
    if nrow * ncol > MOST:
        raise ValueError(f"its head asks for {nrow} × {ncol} heights; at most {MOST} are read")
    size = 8 + 4 * nrow * ncol
    if len(data) != size:
        raise ValueError(f"its head asks for {size} bytes; it has {len(data)}")
    return np.frombuffer(data, "<f4", nrow * ncol, 8).astype(float).reshape(nrow, ncol)[::-1]


def png(data: bytes) -> NDArray[Any]:
    """A grey image of 8 bits a pixel; other kinds are refused by name.

    W3C, Portable Network Graphics (PNG) Specification.
    """
    if data[:8] != b"\x89PNG\r\n\x1a\n":
        raise ValueError("it does not begin as one")
    chunks = _chunks(data)
    head = chunks.get(b"IHDR", b"")
    if len(head) != 13:
        raise ValueError("it has no head")
    width, height = int.from_bytes(head[:4], "big"), int.from_bytes(head[4:8], "big")
    depth, colour, _, _, interlace = head[8:]
    if (depth, colour, interlace) != (8, 0, 0):
        kind = {0: "grey", 2: "RGB", 3: "palette", 4: "grey with alpha", 6: "RGB with alpha"}
        what = f"{kind.get(colour, 'unknown')} of {depth} bits" + ", interlaced" * (interlace != 0)
        raise ValueError(f"it is {what}; only grey of 8 bits, not interlaced, is supported")
    if not 0 < width * height <= MOST:
        raise ValueError(f"it is {width} × {height} pixels; 1 to {MOST} of them are read")
    size = height * (width + 1)
    unpack = zlib.decompressobj()
    try:
        raw = unpack.decompress(chunks.get(b"IDAT", b""), size + 1)
    except zlib.error:
        raise ValueError("its pixels cannot be unpacked") from None
    if len(raw) != size:
        raise ValueError(f"{width} × {height} pixels take {size} bytes; it has {len(raw)}")
    return _unfiltered(np.frombuffer(raw, np.uint8).reshape(height, width + 1)).astype(float)


def _chunks(data: bytes) -> dict[bytes, bytes]:
    """The content of the chunks by type; those of one type are joined."""
    chunks: dict[bytes, bytes] = {}
    at = 8
    while at < len(data):
        length = int.from_bytes(data[at : at + 4], "big")
        kind, body = data[at + 4 : at + 8], data[at + 8 : at + 8 + length]
        check = data[at + 8 + length : at + 12 + length]
        if len(check) != 4 or int.from_bytes(check, "big") != zlib.crc32(kind + body):
            raise ValueError("a part of it is cut off or damaged")
        chunks[kind] = chunks.get(kind, b"") + body
        at += 12 + length
        if kind == b"IEND":
            return chunks
    raise ValueError("its end is missing")


def _unfiltered(lines: NDArray[Any]) -> NDArray[Any]:
    """The pixels of lines that each begin with the number of their filter (PNG, section 9)."""
    above = np.zeros(lines.shape[1] - 1, np.int64)
    result = np.empty((len(lines), len(above)), np.int64)
    for row, line in enumerate(lines):
        kind, pixels = int(line[0]), line[1:].astype(np.int64)
        if kind == 1:
            pixels = np.cumsum(pixels) % 256
        elif kind == 2:
            pixels = (pixels + above) % 256
        elif kind in (3, 4):
            left = corner = 0
            for column in range(len(pixels)):
                up = int(above[column])
                guess = (left + up) // 2 if kind == 3 else _paeth(left, up, corner)
                left = pixels[column] = (int(pixels[column]) + guess) % 256
                corner = up
        elif kind != 0:
            raise ValueError(f"line {row} has the filter {kind}, which does not exist")
        result[row] = above = pixels
    return result


def _paeth(left: int, up: int, corner: int) -> int:
    """Which of the three neighbours is nearest to left + up − corner."""
    guess = left + up - corner
    near = (abs(guess - left), 0, left), (abs(guess - up), 1, up), (abs(guess - corner), 2, corner)
    return min(near)[2]
