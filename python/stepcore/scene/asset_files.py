"""Read the files of assets: meshes, and height fields.

Meshes are in STL (binary and text), OBJ or MuJoCo's MSH; height fields in PNG images (read with
pillow) or MuJoCo's binary format.

Each reader takes the bytes of a file. Violations of the format raise ValueError. Faces of more than
three corners are split as in MuJoCo's OBJ reader. The split matters for faces that are not flat or
not convex, because hull, volume and inertia depend on the split. The first row of a height field is
at the largest y.
"""

from __future__ import annotations

import importlib.util
import io
import os
import re
import struct
import zlib
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from stepcore import checks, files


class Surface(NamedTuple):
    """The triangles of a mesh file.

    vertices: shape (n, 3).
    faces: indices of vertices, shape (m, 3); None for a file without faces.
    beyond: number of further faces, in objects that MuJoCo does not read.
    """

    vertices: NDArray[Any]
    faces: NDArray[Any] | None
    beyond: int = 0


Polygon = list[int]
# Two coordinates.
Place = tuple[Any, Any]
# Limit of the work of splitting faces, in comparisons of corners. Each corner is compared with all
# others of its face, so the work is quadratic. The limit takes seconds and allows a face of 10,000
# corners.
MOST_WORK = 10**8
# Formats by MJCF's content type.
MESHES = {"model/stl": "stl", "model/obj": "obj", "model/vnd.mujoco.msh": "msh"}
HFIELDS = {"image/png": "png", "image/vnd.mujoco.hfield": "binary"}
# Largest number of points of a height field: 128 MiB in double precision.
MOST_POINTS = 2**24


def read_mesh(path: str | os.PathLike[str], content_type: str = "") -> Surface:
    """Return the surface of a mesh file.

    path: the path of the file; the ending of its name is the format.
    content_type: MJCF's content type, which takes precedence over the ending.

    Raises FileNotFoundError, IsADirectoryError, and ValueError for an unknown format, a device or a
    pipe, a file of more than 256 MiB, or damaged content.
    """
    name = os.fsdecode(path)
    kind = _known("mesh", name, content_type, MESHES) or os.path.splitext(name)[1][1:].lower()
    if kind not in MESHES.values():
        endings = ", ".join("." + each for each in MESHES.values())
        raise _refused(name, f"the name of a mesh file ends with {endings}")
    data = files.read(name, "a mesh file")
    try:
        surface = {"stl": stl, "obj": obj, "msh": msh}[kind](data)
        _check(surface.vertices, surface.faces)
    except ValueError as error:
        raise _refused(name, f"not a whole {kind.upper()} file: {error}") from None
    return surface


def read_hfield(path: str | os.PathLike[str], content_type: str = "") -> NDArray[Any]:
    """Return the heights of a file, shape (rows, columns).

    path: the path of the file. A name that ends with .png means an image.
    content_type: MJCF's content type, which takes precedence over the name.

    Raises the errors of `read_mesh`.
    """
    name = os.fsdecode(path)
    kind = _known("height field", name, content_type, HFIELDS)
    data = files.read(name, "a height field")
    image = kind == "png" if kind else name.lower().endswith(".png")
    if image and importlib.util.find_spec("PIL") is None:
        text = "heights of an image are read with pillow: pip install 'stepcore[view]'"
        raise _refused(name, text)
    try:
        heights = image_levels(data) if image else binary(data)
        if not np.isfinite(heights).all():
            raise ValueError("a height is not a finite number")
    except ValueError as error:
        word = "PNG file" if image else "height-field file"
        raise _refused(name, f"not a whole {word}: {error}") from None
    return heights


def _known(what: str, name: str, content_type: str, known: dict[str, str]) -> str:
    """Return the format of a content type, "" without one; raise ValueError for an unknown one."""
    if content_type and content_type not in known:
        near = checks.nearest(content_type, known)
        raise _refused(name, f"no {what} has the content type {checks.quoted(content_type)}{near}")
    return known.get(content_type, "")


def _refused(name: str, text: str) -> ValueError:
    return ValueError(f"{checks.without_middle(name)}: {text}")


def notes(where: str, surface: Surface) -> list[str]:
    """Return a note on the faces of a file that its mesh leaves out, if any."""
    if not surface.beyond:
        return []
    what = "of an OBJ file the first object is read for mass and shape, as in MuJoCo"
    return [f"{where}: {what}, and {surface.beyond} faces of others are not"]


def _check(vertices: NDArray[Any], faces: NDArray[Any] | None) -> None:
    if not np.isfinite(vertices).all():
        raise ValueError("a coordinate is not a finite number")
    if faces is None:
        return
    if not len(faces):
        raise ValueError("it has no faces")
    _check_corners(faces.min(), faces.max(), len(vertices))


def _check_corners(least: int, largest: int, count: int) -> None:
    if least < 0 or largest >= count:
        raise ValueError(f"a face has the vertex {least if least < 0 else largest}, of {count}")


_TRIANGLE = np.dtype([("normal", "<f4", 3), ("corners", "<f4", (3, 3)), ("rest", "<u2")])


def stl(data: bytes) -> Surface:
    """Return the surface of an STL file, binary or text; equal corners become one vertex."""
    count = int.from_bytes(data[80:84], "little")
    if len(data) >= 84 and len(data) == 84 + 50 * count:
        corners = np.frombuffer(data, _TRIANGLE, count, 84)["corners"].astype(float)
    elif data[:5].lower() == b"solid" and b"facet" in data:
        corners = _text_corners(data)
    elif len(data) < 84:
        raise ValueError(f"it has {len(data)} bytes, and the head alone has 84")
    else:
        size = 84 + 50 * count
        raise ValueError(
            f"its head says {count} faces, which take {size} bytes; it has {len(data)}"
        )
    if not np.isfinite(corners).all():
        raise ValueError("a coordinate is not a finite number")
    if not len(corners):
        raise ValueError("it has no faces")
    return _joined(corners.reshape(-1, 3))


_FACET = re.compile(
    rb"\s*facet\s+normal(?:\s+\S+){3}\s+outer\s+loop((?:\s+vertex(?:\s+[^\s]+){3}){3})"
    rb"\s+endloop\s+endfacet"
)


def _text_corners(data: bytes) -> NDArray[Any]:
    """Return the corners of the facets of a text STL, in reading order."""
    text = data.lower()
    at = text.find(b"\n") + 1
    loops = []
    while facet := _FACET.match(text, at):
        loops.append(facet.group(1))
        at = facet.end()
    end = text[at:].strip()
    if not end.startswith(b"endsolid") or b"\n" in end:
        line = text.count(b"\n", 0, at) + 1
        raise ValueError(f"after line {line} stands neither a facet nor the end of the solid")
    return _numbers(b" ".join(loops).replace(b"vertex", b" "), 3)


def _joined(corners: NDArray[Any]) -> Surface:
    """Return the surface with distinct vertices, in the order of their first appearance."""
    # Adding 0 turns −0 into 0, so that both are equal.
    places = corners + 0.0
    order = np.lexsort(places.T)
    in_order = places[order]
    differs = np.concatenate([[True], (in_order[1:] != in_order[:-1]).any(axis=1)])
    # The sort is stable: the first of equal corners comes first.
    first = order[differs]
    group = np.empty(len(order), np.int64)
    group[order] = np.cumsum(differs) - 1
    appear = np.argsort(first)
    number = np.empty(len(appear), np.int64)
    number[appear] = np.arange(len(appear))
    return Surface(places[first[appear]], number[group].reshape(-1, 3))


def obj(data: bytes) -> Surface:
    """Return the surface of an OBJ file: its ``v`` and ``f`` lines, with larger faces split.

    As in MuJoCo, the surface has all vertices, and the faces of the first object or group that has
    faces.
    """
    text = data.replace(b"\\\r\n", b" ").replace(b"\\\n", b" ")
    places: list[bytes] = []
    polygons: list[list[bytes]] = []
    # Number of vertices before each face; negative indices count back from there.
    before: list[int] = []
    whole, beyond = False, 0
    for number, line in enumerate(text.split(b"\n"), 1):
        words = line.split()
        if not words or words[0] not in (b"v", b"f", b"o", b"g"):
            continue
        if words[0] in (b"o", b"g"):
            whole |= bool(polygons) and len(words) > 1
            continue
        if len(words) < 4:
            raise ValueError(f"line {number} has fewer than 3 entries")
        if words[0] == b"v":
            places += words[1:4]
        elif whole:
            beyond += 1
        else:
            polygons.append([word.partition(b"/")[0] for word in words[1:]])
            before.append(len(places) // 3)
    vertices = _numbers(b" ".join(places), 3)
    if not polygons:
        return Surface(vertices, None)
    corners = [
        [_corner(word, count) for word in words]
        for words, count in zip(polygons, before, strict=True)
    ]
    for face in corners:
        _check_corners(min(face), max(face), len(vertices))
    return Surface(vertices, split_polygons(corners, vertices), beyond)


def _corner(word: bytes, count: int) -> int:
    if not re.fullmatch(rb"-?\d{1,9}", word) or int(word) == 0:
        raise ValueError(f"a face has the corner {checks.shown(word)}: indices start at 1")
    index = int(word)
    return index - 1 if index > 0 else count + index


def _numbers(text: bytes, columns: int) -> NDArray[Any]:
    words = text.split()
    try:
        values = np.array([float(word) for word in words], float)
    except ValueError:
        raise ValueError("a coordinate is not a number") from None
    if any(b"_" in word for word in words):
        raise ValueError("a coordinate is not a number")
    return values.reshape(-1, columns)


def msh(data: bytes) -> Surface:
    """Return the surface of a file in MuJoCo's MSH format.

    The format has four counts, then positions, normals, texture coordinates and faces.
    """
    if len(data) < 16:
        raise ValueError(f"it has {len(data)} bytes, and the head alone has 16")
    nvertex, nnormal, ntexcoord, nface = (int(n) for n in np.frombuffer(data, "<i4", 4))
    if nvertex < 4 or nface < 0 or nnormal not in (0, nvertex) or ntexcoord not in (0, nvertex):
        counts = f"{nvertex} vertices, {nnormal} normals, {ntexcoord} coordinates, {nface} faces"
        raise ValueError(f"its head says {counts}")
    size = 16 + 12 * (nvertex + nnormal + nface) + 8 * ntexcoord
    if len(data) != size:
        raise ValueError(f"its head asks for {size} bytes; it has {len(data)}")
    vertices = np.frombuffer(data, "<f4", 3 * nvertex, 16).astype(float).reshape(-1, 3)
    if not nface:
        return Surface(vertices, None)
    faces = np.frombuffer(data, "<i4", 3 * nface, size - 12 * nface)
    return Surface(vertices, faces.astype(np.int64).reshape(-1, 3))


def split_polygons(polygons: list[Polygon], vertices: NDArray[Any]) -> NDArray[Any]:
    """Return the triangles of polygons, shape (n, 3).

    polygons: indices of vertices in order.

    Quadrilaterals are split along the shorter diagonal, or along the second if both are equal.
    Larger polygons are split by ear clipping in a coordinate plane, in single precision as in
    MuJoCo's reader.
    """
    split: list[Polygon] = []
    # More for each corner of the file, so that the number of small faces is not limited.
    work = MOST_WORK + 1000 * sum(map(len, polygons))
    for polygon in polygons:
        if len(polygon) == 3:
            split.append(polygon)
        elif len(polygon) == 4:
            a, b, c, d = polygon
            first, second = vertices[c] - vertices[a], vertices[d] - vertices[b]
            shorter = first @ first < second @ second
            split += [[a, b, c], [a, c, d]] if shorter else [[a, b, d], [b, c, d]]
        else:
            with np.errstate(all="ignore"):
                ears, work = _without_ears(polygon, vertices[polygon].astype(np.float32), work)
            split += ears
    return np.array(split, np.int64).reshape(-1, 3)


def _without_ears(polygon: Polygon, corners: NDArray[Any], work: int) -> tuple[list[Polygon], int]:
    """Return the triangles of a polygon by ear clipping, and the remaining work.

    Ear clipping repeatedly cuts off a corner whose triangle contains no other corner. A remainder
    without such a corner is no simple polygon, and is left out as in MuJoCo.

    work: the remaining number of comparisons of corners for the file. Raises ValueError when it is
        used up.
    """
    x, y = (np.ascontiguousarray(axis) for axis in corners[:, _axes(corners)].T)
    left, triangles, at, tries = list(polygon), [], 0, len(polygon)
    while len(left) > 3 and tries > 0:
        at %= len(left)
        tries -= 1
        # The test of a corner costs as much as 500 comparisons, besides those that it makes.
        work -= 500 + len(left)
        if work < 0:
            raise ValueError(
                "its faces of many corners take too long to split into triangles: save it with "
                "triangles"
            )
        ear = [at, (at + 1) % len(left), (at + 2) % len(left)]
        places = [(x[corner], y[corner]) for corner in ear]
        if _points_in(*places) or _holds_other(ear, places, x, y):
            at += 1
            continue
        triangles.append([left[corner] for corner in ear])
        del left[ear[1]]
        x, y = np.delete(x, ear[1]), np.delete(y, ear[1])
        tries = len(left) + 1
    return [*triangles, left] if len(left) == 3 else triangles, work


def _axes(corners: NDArray[Any]) -> list[int]:
    """Return the two axes of the coordinate plane for a polygon, by its first proper corner."""
    edges = np.roll(corners, -1, axis=0) - corners
    turns = np.abs(np.cross(edges, np.roll(edges, -1, axis=0)))
    for x, y, z in turns.tolist():
        if max(x, y, z) > np.finfo(np.float32).eps:
            if x > y and x > z:
                return [1, 2]
            return [0, 1] if z > x and z > y else [0, 2]
    return [1, 2]


def _points_in(a: Place, b: Place, c: Place) -> bool:
    """Return whether a corner counts as reflex.

    As in MuJoCo's reader, the turn at the corner is compared with the side on which the first edge
    passes the origin, not with the orientation of the polygon.
    """
    turn = (b[0] - a[0]) * (c[1] - b[1]) - (b[1] - a[1]) * (c[0] - b[0])
    return bool(turn * (a[0] * b[1] - a[1] * b[0]) < 0)


def _holds_other(ear: list[int], places: list[Place], x: NDArray[Any], y: NDArray[Any]) -> bool:
    """Return whether a corner other than the ear's lies in its triangle, by ray casting."""
    inside = np.zeros(len(x), bool)
    for (ax, ay), (bx, by) in zip(places, places[-1:] + places[:-1], strict=True):
        inside ^= ((ay > y) != (by > y)) & (x < (bx - ax) * (y - ay) / (by - ay) + ax)
    inside[ear] = False
    return bool(inside.any())


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
    if not 0 < width * height <= MOST_POINTS:
        raise ValueError(f"it is {width} × {height} pixels; 1 to {MOST_POINTS} of them are read")
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
    if nrow * ncol > MOST_POINTS:
        raise ValueError(
            f"its head asks for {nrow} × {ncol} heights; at most {MOST_POINTS} are read"
        )
    size = 8 + 4 * nrow * ncol
    if len(data) != size:
        raise ValueError(f"its head asks for {size} bytes; it has {len(data)}")
    return np.frombuffer(data, "<f4", nrow * ncol, 8).astype(float).reshape(nrow, ncol)[::-1]
