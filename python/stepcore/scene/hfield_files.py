"""Readers of height-field files: MuJoCo's binary format, and PNG images (with pillow).

Each takes the bytes of a file and returns heights, shape (rows, columns), the first row at the
largest y. Anything that is not what the format says is a ValueError.
"""

from __future__ import annotations

import importlib.util
import io
import os
import struct
import zlib
from typing import Any

import numpy as np
from numpy.typing import NDArray

from stepcore import checks, files

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
        raise ValueError(f"{checks.without_middle(name)}: {text}")
    data = files.read(name, "a height field")
    image = CONTENT.get(content_type, name.lower().endswith(".png"))
    if image and importlib.util.find_spec("PIL") is None:
        text = "heights of an image are read with pillow: pip install 'stepcore[view]'"
        raise ValueError(f"{checks.without_middle(name)}: {text}")
    try:
        heights = image_levels(data) if image else binary(data)
        if not np.isfinite(heights).all():
            raise ValueError("a height is not a finite number")
    except ValueError as error:
        word = "PNG file" if image else "height-field file"
        raise ValueError(f"{checks.without_middle(name)}: not a whole {word}: {error}") from None
    return heights


# What pillow raises for bytes that are no image.
DAMAGED = (OSError, SyntaxError, ValueError, EOFError, LookupError, struct.error, zlib.error)


def image_levels(data: bytes) -> NDArray[Any]:
    """The levels of a PNG image: the grey, or the red of coloured images, as MuJoCo takes them.

    Of 16 bits the first 8 count; opacity does not.
    """
    # W3C, Portable Network Graphics (PNG) Specification, 5.2 and 11.2.1: the first chunk is the
    # head, which is looked at before anything is unpacked.
    if data[:8] != b"\x89PNG\r\n\x1a\n" or data[12:16] != b"IHDR":
        raise ValueError("it does not begin as one")
    width, height = int.from_bytes(data[16:20], "big"), int.from_bytes(data[20:24], "big")
    if not 0 < width * height <= MOST:
        raise ValueError(f"it is {width} × {height} pixels; 1 to {MOST} of them are read")
    needed = _needed(data)
    from PIL import Image, UnidentifiedImageError

    try:
        with Image.open(io.BytesIO(needed), formats=["PNG"]) as image:
            # As the file has it: once the pixels are there, it is filled up.
            colours = image.palette.getdata()[1] if image.palette is not None else b""
            levels = np.asarray(image)
            if image.mode == "P":
                levels = _red(levels, np.frombuffer(colours, np.uint8)[::3])
    except UnidentifiedImageError:
        raise ValueError("its head is damaged") from None
    except DAMAGED as error:
        raise ValueError(f"its pixels are damaged: {checks.one_line(error)}") from None
    levels = levels[..., 0] if levels.ndim == 3 else levels
    return np.asarray(levels // 256 if levels.dtype.itemsize > 1 else levels, float)


def _needed(data: bytes) -> bytes:
    """The image without the chunks that are not needed for its levels, as their names say (5.4).

    The checksums of all are compared (5.3), which pillow does of some.
    """
    view, at, kind = memoryview(data), 8, b""
    parts = [view[:8]]
    while kind != b"IEND":
        if at >= len(data):
            raise ValueError("its end is missing")
        end = at + 8 + int.from_bytes(view[at : at + 4], "big")
        kind, check = bytes(view[at + 4 : at + 8]), view[end : end + 4]
        if len(check) != 4 or int.from_bytes(check, "big") != zlib.crc32(view[at + 4 : end]):
            raise ValueError("a part of it is cut off or damaged")
        if kind[:1].isupper():
            parts.append(view[at : end + 4])
        at = end + 4
    return b"".join(parts)


def _red(indices: NDArray[Any], reds: NDArray[Any]) -> NDArray[Any]:
    if indices.max() >= len(reds):
        raise ValueError(f"one has the colour {indices.max()}, of {len(reds)}")
    return reds[indices]


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
