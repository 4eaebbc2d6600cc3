"""PNG images as heights: the grey levels, or the red of coloured images, as MuJoCo takes them.

W3C, Portable Network Graphics (PNG) Specification; its sections are named below. Of 16 bits the
first 8 count. Opacity says nothing.
"""

from __future__ import annotations

import zlib
from typing import Any

import numpy as np
from numpy.typing import NDArray

# Numbers of a pixel, by colour type: grey, RGB, palette, grey with alpha, RGB with alpha.
CHANNELS = {0: 1, 2: 3, 3: 1, 4: 2, 6: 4}
DEPTHS = {0: (1, 2, 4, 8, 16), 2: (8, 16), 3: (1, 2, 4, 8), 4: (8, 16), 6: (8, 16)}
# The passes of an interlaced image (8.2): first column and row, steps of columns and rows.
ADAM7 = (
    *((0, 0, 8, 8), (4, 0, 8, 8), (0, 4, 4, 8), (2, 0, 4, 4)),
    *((0, 2, 2, 4), (1, 0, 2, 2), (0, 1, 1, 2)),
)


def png(data: bytes, most: int) -> NDArray[Any]:
    """The levels of an image of at most so many pixels, shape (rows, columns).

    Raises ValueError for anything that is not what the format says.
    """
    if data[:8] != b"\x89PNG\r\n\x1a\n":
        raise ValueError("it does not begin as one")
    chunks = _chunks(data)
    head = chunks.get(b"IHDR", b"")
    if len(head) != 13:
        raise ValueError("it has no head")
    width, height = int.from_bytes(head[:4], "big"), int.from_bytes(head[4:8], "big")
    depth, colour, _, _, interlace = head[8:]
    if depth not in DEPTHS.get(colour, ()) or interlace > 1:
        raise ValueError(f"its head says colour type {colour}, {depth} bits, {interlace}")
    if not 0 < width * height <= most:
        raise ValueError(f"it is {width} × {height} pixels; 1 to {most} of them are read")
    passes = ADAM7 if interlace else ((0, 0, 1, 1),)
    bits = depth * CHANNELS[colour]
    parts = [(-(-(width - x) // dx), -(-(height - y) // dy)) for x, y, dx, dy in passes]
    parts = [(columns, rows) if columns > 0 else (0, 0) for columns, rows in parts]
    sizes = [max(rows, 0) * ((columns * bits + 7) // 8 + 1) for columns, rows in parts]
    raw = _unpacked(chunks.get(b"IDAT", b""), sum(sizes), width, height)
    levels = np.zeros((height, width), np.uint8)
    start = 0
    for (x, y, dx, dy), (columns, rows), size in zip(passes, parts, sizes, strict=True):
        if columns > 0 and rows > 0:
            lines = np.frombuffer(raw, np.uint8, size, start).reshape(rows, -1)
            pixels = _unfiltered(lines, max(bits // 8, 1))
            levels[y::dy, x::dx] = _first_channel(pixels, columns, depth, CHANNELS[colour])
        start += size
    return _red(levels, chunks) if colour == 3 else levels.astype(float)


def _unpacked(packed: bytes, size: int, width: int, height: int) -> bytes:
    unpack = zlib.decompressobj()
    try:
        raw = unpack.decompress(packed, size + 1)
    except zlib.error:
        raise ValueError("its pixels cannot be unpacked") from None
    if len(raw) != size:
        raise ValueError(f"{width} × {height} pixels take {size} bytes; it has {len(raw)}")
    return raw


def _first_channel(pixels: NDArray[Any], columns: int, depth: int, channels: int) -> NDArray[Any]:
    """The grey or the red, the first 8 bits of it, of rows of bytes."""
    if depth >= 8:
        return pixels[:, :: channels * (depth // 8)][:, :columns]
    bits = np.unpackbits(pixels, axis=1).reshape(len(pixels), -1, depth)[:, :columns]
    weights = (1 << np.arange(depth)[::-1]).astype(np.uint8)
    return np.asarray(bits @ weights, np.uint8)


def _red(levels: NDArray[Any], chunks: dict[bytes, bytes]) -> NDArray[Any]:
    palette = np.frombuffer(chunks.get(b"PLTE", b""), np.uint8)[::3]
    if levels.max() >= len(palette):
        raise ValueError(f"a pixel has the colour {levels.max()}, of {len(palette)}")
    return palette[levels].astype(float)


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


def _unfiltered(lines: NDArray[Any], step: int) -> NDArray[Any]:
    """The bytes of lines that each begin with the number of their filter (section 9).

    step: how many bytes a pixel takes, by which a byte finds its neighbour on the left.
    """
    above = np.zeros(lines.shape[1] - 1, np.int64)
    result = np.empty((len(lines), len(above)), np.uint8)
    for row, line in enumerate(lines):
        kind, pixels = int(line[0]), line[1:].astype(np.int64)
        if kind == 1:
            for channel in range(step):
                pixels[channel::step] = np.cumsum(pixels[channel::step]) % 256
        elif kind == 2:
            pixels = (pixels + above) % 256
        elif kind in (3, 4):
            pixels = _by_neighbours(kind, pixels.tolist(), above.tolist(), step)
        elif kind != 0:
            raise ValueError(f"line {row} has the filter {kind}, which does not exist")
        result[row] = above = pixels
    return result


def _by_neighbours(kind: int, line: list[int], above: list[int], step: int) -> NDArray[Any]:
    for at, up in enumerate(above):
        left, corner = (line[at - step], above[at - step]) if at >= step else (0, 0)
        guess = (left + up) // 2 if kind == 3 else _paeth(left, up, corner)
        line[at] = (line[at] + guess) % 256
    return np.array(line, np.int64)


def _paeth(left: int, up: int, corner: int) -> int:
    """Which of the three neighbours is nearest to left + up − corner."""
    guess = left + up - corner
    near = (abs(guess - left), 0, left), (abs(guess - up), 1, up), (abs(guess - corner), 2, corner)
    return min(near)[2]
