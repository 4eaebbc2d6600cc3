"""Read height-field files: MuJoCo's binary format, and PNG images (with pillow).

Each reader takes the bytes of a file and returns heights, shape (rows, columns), with the first row
at the largest y. Violations of the format raise ValueError.
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
# Largest number of points: 128 MiB in double precision.
MOST = 2**24


def read(path: str | os.PathLike[str], content_type: str = "") -> NDArray[Any]:
    """Return the heights of a file, shape (rows, columns).

    path: the path of the file. A name that ends with .png means an image.
    content_type: MJCF's content type, which takes precedence over the name.

    Raises FileNotFoundError, IsADirectoryError, and ValueError for a device or a pipe, a file of
    more than 256 MiB, damaged content or an unsupported content type.
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


# Pillow's errors for damaged images.
DAMAGED = (OSError, SyntaxError, ValueError, EOFError, LookupError, struct.error, zlib.error)


def image_levels(data: bytes) -> NDArray[Any]:
    """Return the levels of a PNG image as in MuJoCo: grey, or red of a coloured image.

    Levels of 16 bits are reduced to the upper 8 bits. Opacity has no effect.
    """
    # W3C, Portable Network Graphics (PNG) Specification, 5.2 and 11.2.1: the first chunk is the
    # header, which is checked before anything is unpacked.
    if data[:8] != b"\x89PNG\r\n\x1a\n" or data[12:16] != b"IHDR":
        raise ValueError("it does not begin as one")
    width, height = int.from_bytes(data[16:20], "big"), int.from_bytes(data[20:24], "big")
    if not 0 < width * height <= MOST:
        raise ValueError(f"it is {width} × {height} pixels; 1 to {MOST} of them are read")
    needed = _needed(data)
    from PIL import Image, UnidentifiedImageError

    try:
        with Image.open(io.BytesIO(needed), formats=["PNG"]) as image:
            # Read before the pixels: pillow then pads the palette.
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
    """Return the image without ancillary chunks, whose names begin with a small letter (5.4).

    The checksums of all chunks are verified (5.3); pillow verifies only some.
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
    """Return the heights of MuJoCo's binary format.

    The format has two counts, then the heights row by row, with the row of the smallest y first.
    """
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
