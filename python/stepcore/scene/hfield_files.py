"""Readers of height-field files: MuJoCo's binary format, and PNG images.

Each takes the bytes of a file and returns heights, shape (rows, columns), the first row at the
largest y. Anything that is not what the format says is a ValueError.
"""

from __future__ import annotations

import os
from typing import Any

import numpy as np
from numpy.typing import NDArray

from stepcore import checks, files
from stepcore.scene.png_files import png

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
    try:
        heights = png(data, MOST) if image else binary(data)
        if not np.isfinite(heights).all():
            raise ValueError("a height is not a finite number")
    except ValueError as error:
        word = "PNG file" if image else "height-field file"
        raise ValueError(f"{checks.without_middle(name)}: not a whole {word}: {error}") from None
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
