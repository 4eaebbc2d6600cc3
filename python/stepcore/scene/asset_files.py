"""Read the files of assets: meshes, and height fields.

Meshes are in STL (binary and text), OBJ, MuJoCo's MSH or COLLADA (.dae, read with pycollada);
height fields in PNG images (read with pillow) or MuJoCo's binary format.

Each reader takes the bytes of a file. Violations of the format raise ValueError. The first row of a
height field is at the largest y.
"""

from __future__ import annotations

import importlib.util
import io
import itertools
import os
import re
import struct
import warnings
import zlib
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from stepcore import checks, files
from stepcore.needs import installing


class Surface(NamedTuple):
    """The triangles of a mesh file.

    vertices: shape (n, 3).
    faces: indices of vertices, shape (m, 3); None for a file without faces.
    beyond: number of further faces, in objects that MuJoCo does not read.
    turned: whether the file calls another axis than z up, which is passed over.
    """

    vertices: NDArray[Any]
    faces: NDArray[Any] | None
    beyond: int = 0
    turned: bool = False


Polygon = list[int]
# Formats by MJCF's content type.
MESHES = {"model/stl": "stl", "model/obj": "obj", "model/vnd.mujoco.msh": "msh"}
MESHES |= {"model/vnd.collada+xml": "dae"}
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
    data = files.contents(name, "a mesh file")
    if kind == "dae" and importlib.util.find_spec("collada") is None:
        raise _refused(name, f"COLLADA files need pycollada: {installing('dae')}")
    try:
        surface = {"stl": stl, "obj": obj, "msh": msh, "dae": dae}[kind](data)
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
    data = files.contents(name, "a height field")
    image = kind == "png" if kind else name.lower().endswith(".png")
    if image and importlib.util.find_spec("PIL") is None:
        raise _refused(name, f"heights of an image need pillow: {installing('view')}")
    try:
        heights = image_levels(data) if image else binary_heights(data)
        if not np.isfinite(heights).all():
            raise ValueError("a height is not a finite number")
    except ValueError as error:
        word = "PNG file" if image else "height-field file"
        raise _refused(name, f"not a whole {word}: {error}") from None
    return heights


def _known(noun: str, name: str, content_type: str, types: dict[str, str]) -> str:
    """Return the format of a content type, "" without one; raise ValueError for an unknown one."""
    if content_type and content_type not in types:
        near = checks.nearest(content_type, types)
        raise _refused(name, f"no {noun} has the content type {checks.quoted(content_type)}{near}")
    return types.get(content_type, "")


def _refused(name: str, text: str) -> ValueError:
    return ValueError(f"{checks.without_middle(name)}: {text}")


def notes(where: str, surface: Surface) -> list[str]:
    """Return a note on what is left out of a file, if anything."""
    if surface.turned:
        return [f"{where}: calls another axis than z up, which is passed over, as in ROS"]
    if not surface.beyond:
        return []
    note = "of an OBJ file the first object is read for mass and shape, as in MuJoCo"
    return [f"{where}: {note}, and {surface.beyond} faces of others are not"]


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
    if not np.isfinite(corners).all():
        raise ValueError("a coordinate is not a finite number")
    if not len(corners):
        raise ValueError("it has no faces")
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


def dae(data: bytes) -> Surface:
    """Return the surface of a COLLADA file, in metres: all geometries of its scene, one mesh.

    The axis that the file calls up is passed over, as MoveIt and RViz do: ROS, for which such files
    are made, has z up.
    """
    import collada

    broken = [collada.common.DaeUnsupportedError, collada.common.DaeBrokenRefError]
    try:
        with warnings.catch_warnings():
            # It has matrices of numpy's old kind.
            warnings.simplefilter("ignore")
            content = collada.Collada(io.BytesIO(data), ignore=broken)
            bound = content.scene.objects("geometry") if content.scene is not None else ()
            parts = [part for geometry in bound for part in geometry.primitives()]
            parts = [part.triangleset() if hasattr(part, "triangleset") else part for part in parts]
            scale = float(content.assetInfo.unitmeter or 1.0)
            turned = content.assetInfo.upaxis != "Z_UP"
            corners = [
                scale * np.asarray(part.vertex, float)[part.vertex_index].reshape(-1, 3)
                for part in parts
                # Lines have no triangles.
                if isinstance(part, collada.triangleset.BoundTriangleSet)
                and part.vertex is not None
            ]
    except Exception as error:  # whatever the parser meets in a damaged file
        raise ValueError(f"{type(error).__name__}: {checks.one_line(error)}") from None
    return _joined(np.concatenate([np.zeros((0, 3)), *corners]))._replace(turned=turned)


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
    several, beyond = False, 0
    for number, line in enumerate(text.split(b"\n"), 1):
        words = line.split()
        if not words or words[0] not in (b"v", b"f", b"o", b"g"):
            continue
        if words[0] in (b"o", b"g"):
            several |= bool(polygons) and len(words) > 1
            continue
        if len(words) < 4:
            raise ValueError(f"line {number} has fewer than 3 entries")
        if words[0] == b"v":
            places += words[1:4]
        elif several:
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

    Quadrilaterals are split along the shorter diagonal, or along the second if both are equal, as
    in MuJoCo's reader; larger polygons from their first corner. Raises ValueError for one of these
    that is not convex.
    """
    split: list[Polygon] = []
    for polygon in polygons:
        if len(polygon) == 4:
            a, b, c, d = polygon
            first, second = vertices[c] - vertices[a], vertices[d] - vertices[b]
            shorter = first @ first < second @ second
            split += [[a, b, c], [a, c, d]] if shorter else [[a, b, d], [b, c, d]]
            continue
        if len(polygon) > 4 and not _is_convex(vertices[polygon]):
            raise ValueError(
                f"a face of {len(polygon)} corners is not convex: save it with triangles"
            )
        split += [[polygon[0], *pair] for pair in itertools.pairwise(polygon[1:])]
    return np.array(split, np.int64).reshape(-1, 3)


def _is_convex(corners: NDArray[Any]) -> bool:
    """Return whether a polygon, flat up to rounding, turns the same way at every corner, once."""
    edges = np.roll(corners, -1, axis=0) - corners
    turns = np.cross(edges, np.roll(edges, -1, axis=0))
    normal = turns.sum(axis=0)
    normal /= max(float(np.linalg.norm(normal)), np.finfo(float).tiny)
    # Single precision, in which files are written.
    rounding = 1e-6 * np.linalg.norm(edges, axis=1).max() ** 2
    angles = np.arctan2(turns @ normal, (edges * np.roll(edges, -1, axis=0)).sum(axis=1))
    return bool((turns @ normal >= -rounding).all() and angles.sum() < 3 * np.pi)


# Pillow's errors for damaged images.
DAMAGED = (OSError, SyntaxError, ValueError, EOFError, LookupError, struct.error, zlib.error)


def image_levels(data: bytes) -> NDArray[Any]:
    """Return the levels of a PNG image as in MuJoCo: grey, or red of a coloured image.

    Levels of 16 bits are reduced to the upper 8 bits. Opacity has no effect.
    """
    from PIL import Image

    try:
        with warnings.catch_warnings():
            # Pillow only warns of images that are too large.
            warnings.simplefilter("error", Image.DecompressionBombWarning)
            image = Image.open(io.BytesIO(data), formats=["PNG"])
        with image:
            width, height = image.size
            if width * height > MOST_POINTS:
                limit = f"at most {MOST_POINTS} of them are read"
                raise ValueError(f"it is {width} × {height} pixels; {limit}")
            # Read before the pixels: pillow then pads the palette.
            colours = image.palette.getdata()[1] if image.palette is not None else b""
            levels = np.asarray(image)
            if image.mode == "P":
                levels = _red(levels, np.frombuffer(colours, np.uint8)[::3])
    except (*DAMAGED, Image.DecompressionBombError, Image.DecompressionBombWarning) as error:
        raise ValueError(f"it is damaged: {checks.one_line(error)}") from None
    levels = levels[..., 0] if levels.ndim == 3 else levels
    return np.asarray(levels // 256 if levels.dtype.itemsize > 1 else levels, float)


def _red(indices: NDArray[Any], reds: NDArray[Any]) -> NDArray[Any]:
    if indices.max() >= len(reds):
        raise ValueError(f"one has the colour {indices.max()}, of {len(reds)}")
    return reds[indices]


def binary_heights(data: bytes) -> NDArray[Any]:
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
