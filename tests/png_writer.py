"""PNG files of any kind, a filter a line: what readers of images are tried on."""

from __future__ import annotations

import struct
import zlib

import numpy as np

# Numbers of a pixel, by colour type: grey, RGB, palette, grey with alpha, RGB with alpha.
CHANNELS = {0: 1, 2: 3, 3: 1, 4: 2, 6: 4}
# The passes of an interlaced image (8.2): first column and row, steps of columns and rows.
ADAM7 = (
    *((0, 0, 8, 8), (4, 0, 8, 8), (0, 4, 4, 8), (2, 0, 4, 4)),
    *((0, 2, 2, 4), (1, 0, 2, 2), (0, 1, 1, 2)),
)
SIGNATURE = b"\x89PNG\r\n\x1a\n"


def chunk(kind: bytes, body: bytes) -> bytes:
    length, check = len(body), zlib.crc32(kind + body)
    return struct.pack(">I", length) + kind + body + struct.pack(">I", check)


def data(*parts: bytes) -> bytes:
    """The compressed pixels, in so many parts."""
    return b"".join(chunk(b"IDAT", part) for part in parts)


def grey(pixels, *, depth=8, colour=0, filters=None) -> bytes:
    """A grey image whose lines have these filters."""
    height, width = pixels.shape
    lines = b""
    above = np.zeros(width, int)
    for row, line in enumerate(pixels.astype(int)):
        kind = 0 if filters is None else filters[row % len(filters)]
        left = np.concatenate([[0], line[:-1]])
        corner = np.concatenate([[0], above[:-1]])
        guess = left + above - corner
        apart = np.abs([guess - left, guess - above, guess - corner])
        paeth = np.choose(apart.argmin(axis=0), [left, above, corner])
        minus = [0 * line, left, above, (left + above) // 2, paeth][kind]
        lines += bytes([kind]) + ((line - minus) % 256).astype(np.uint8).tobytes()
        above = line
    body = zlib.compress(lines)
    head = struct.pack(">IIBBBBB", width, height, depth, colour, 0, 0, 0)
    return SIGNATURE + chunk(b"IHDR", head) + data(body[:7], body[7:]) + chunk(b"IEND", b"")


def packed(rows, depth: int) -> bytes:
    """Rows of numbers of so many bits, each beginning with a filter."""
    lines, before = b"", b""
    for row in rows:
        bits = "".join(format(int(value), f"0{depth}b") for value in row.ravel())
        bits += "0" * (-len(bits) % 8)
        line = bytes(int(bits[at : at + 8], 2) for at in range(0, len(bits), 8))
        # Every second line is told from the one above, as the filter "up" does.
        up = len(lines) // (len(line) + 1) % 2 == 1
        told = bytes((a - b) % 256 for a, b in zip(line, before, strict=True)) if up else line
        lines += bytes([2 * up]) + told
        before = line
    return lines
