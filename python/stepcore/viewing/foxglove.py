"""The messages that Foxglove draws, and their JSON schemas.

Their fields are those of Foxglove's documented schemas (https://docs.foxglove.dev/docs/sdk/schemas):
FrameTransforms and SceneUpdate, of which what is written here is described.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from stepcore.viewing.drawing import Shape, quat_of
from stepcore.viewing.primitives import surface_of

Json = dict[str, Any]
WORLD = "world"
# An endless plane is drawn this many times as large as the scene.
ENDLESS = 20.0


def _object(title: str = "", **properties: Json) -> Json:
    named = {"title": title} if title else {}
    return {**named, "type": "object", "properties": properties}


def _list(items: Json) -> Json:
    return {"type": "array", "items": items}


NUMBER, TEXT, WHOLE = {"type": "number"}, {"type": "string"}, {"type": "integer"}
TIME = _object("time", sec=WHOLE, nsec=WHOLE)
VECTOR = _object("foxglove.Vector3", x=NUMBER, y=NUMBER, z=NUMBER)
POINT = _object("foxglove.Point3", x=NUMBER, y=NUMBER, z=NUMBER)
QUATERNION = _object("foxglove.Quaternion", x=NUMBER, y=NUMBER, z=NUMBER, w=NUMBER)
COLOR = _object("foxglove.Color", r=NUMBER, g=NUMBER, b=NUMBER, a=NUMBER)
POSE = _object("foxglove.Pose", position=VECTOR, orientation=QUATERNION)
SOLID = {"pose": POSE, "size": VECTOR, "color": COLOR}
ARROW = _object(
    "foxglove.ArrowPrimitive",
    pose=POSE,
    **dict.fromkeys(("shaft_length", "shaft_diameter", "head_length", "head_diameter"), NUMBER),
    color=COLOR,
)
TRIANGLES = _object(
    "foxglove.TriangleListPrimitive",
    pose=POSE,
    points=_list(POINT),
    color=COLOR,
    colors=_list(COLOR),
    indices=_list(WHOLE),
)
LINE = _object(
    "foxglove.LinePrimitive",
    type=WHOLE,
    pose=POSE,
    thickness=NUMBER,
    scale_invariant={"type": "boolean"},
    points=_list(POINT),
    color=COLOR,
    colors=_list(COLOR),
    indices=_list(WHOLE),
)
ENTITY = _object(
    "foxglove.SceneEntity",
    timestamp=TIME,
    frame_id=TEXT,
    id=TEXT,
    lifetime=_object("duration", sec=WHOLE, nsec=WHOLE),
    frame_locked={"type": "boolean"},
    metadata=_list(_object("foxglove.KeyValuePair", key=TEXT, value=TEXT)),
    arrows=_list(ARROW),
    cubes=_list(_object("foxglove.CubePrimitive", **SOLID)),
    spheres=_list(_object("foxglove.SpherePrimitive", **SOLID)),
    cylinders=_list(
        _object("foxglove.CylinderPrimitive", **SOLID, bottom_scale=NUMBER, top_scale=NUMBER)
    ),
    lines=_list(LINE),
    triangles=_list(TRIANGLES),
    texts=_list(_object("foxglove.TextPrimitive")),
    models=_list(_object("foxglove.ModelPrimitive")),
)
SCENE_UPDATE = _object(
    "foxglove.SceneUpdate",
    deletions=_list(
        _object("foxglove.SceneEntityDeletion", timestamp=TIME, type=WHOLE, id=TEXT),
    ),
    entities=_list(ENTITY),
)
FRAME_TRANSFORMS = _object(
    "foxglove.FrameTransforms",
    transforms=_list(
        _object(
            "foxglove.FrameTransform",
            timestamp=TIME,
            parent_frame_id=TEXT,
            child_frame_id=TEXT,
            translation=VECTOR,
            rotation=QUATERNION,
        )
    ),
)


def time_of(nanoseconds: int) -> Json:
    """Return a time in the form of the messages."""
    return {"sec": nanoseconds // 10**9, "nsec": nanoseconds % 10**9}


def vector(values: Any) -> Json:
    """Return three numbers as x, y, z."""
    return dict(zip("xyz", map(float, values), strict=True))


def quaternion(wxyz: Any) -> Json:
    """Return a quaternion, given in the order of the engine."""
    return dict(zip("wxyz", map(float, wxyz), strict=True))


def transform(nanoseconds: int, frame: str, pos: Any, quat: Any) -> Json:
    """Return the pose of a frame in the world."""
    return {
        "timestamp": time_of(nanoseconds),
        "parent_frame_id": WORLD,
        "child_frame_id": frame,
        "translation": vector(pos),
        "rotation": quaternion(quat),
    }


def entity(nanoseconds: int, frame: str, name: str, **primitives: list[Json]) -> Json:
    """Return primitives that move with a frame and replace those of the same name."""
    lists = ("arrows", "cubes", "spheres", "cylinders", "lines", "triangles", "texts", "models")
    return {
        "timestamp": time_of(nanoseconds),
        "frame_id": frame,
        "id": name,
        "lifetime": {"sec": 0, "nsec": 0},
        "frame_locked": True,
        "metadata": [],
        **{kind: primitives.get(kind, []) for kind in lists},
    }


def of_shape(shape: Shape, reach: float) -> tuple[str, Json]:
    """Return the list for a shape and its primitive; reach: the extent of the scene [m]."""
    pose = {"position": vector(shape.pos), "orientation": quaternion(shape.quat)}
    color = dict(zip("rgba", map(float, shape.rgba), strict=True))
    r, h = (*shape.size, 0.0, 0.0)[:2]
    match shape.kind:
        case "box":
            return "cubes", {"pose": pose, "size": vector(_double(shape.size)), "color": color}
        case "sphere":
            return "spheres", {"pose": pose, "size": vector((2 * r,) * 3), "color": color}
        case "ellipsoid":
            return "spheres", {"pose": pose, "size": vector(_double(shape.size)), "color": color}
        case "cylinder":
            size = vector((2 * r, 2 * r, 2 * h))
            scale = {"bottom_scale": 1.0, "top_scale": 1.0}
            return "cylinders", {"pose": pose, "size": size, "color": color, **scale}
    vertices, faces = surface_of(shape, ENDLESS * reach)
    return "triangles", {
        "pose": pose,
        "points": [vector(point) for point in vertices],
        "color": color,
        "colors": [],
        "indices": np.ravel(faces).astype(int).tolist(),
    }


def arrow(place: NDArray[Any], along: NDArray[Any], thickness: float) -> Json:
    """Return an arrow from a point [m]; along: its direction and length [m]."""
    length = float(np.linalg.norm(along))
    head = min(3 * thickness, length / 2)
    return {
        "pose": {"position": vector(place), "orientation": quaternion(_turn_from_x(along))},
        "shaft_length": length - head,
        "shaft_diameter": thickness,
        "head_length": head,
        "head_diameter": 2 * thickness,
        "color": {"r": 0.9, "g": 0.3, "b": 0.1, "a": 1.0},
    }


def _double(size: Sequence[float]) -> tuple[float, ...]:
    return tuple(2 * half for half in size[:3])


def _turn_from_x(along: NDArray[Any]) -> Sequence[float]:
    """Return a quaternion that rotates the x axis into a direction."""
    x = along / np.linalg.norm(along)
    # The axis that is furthest from it makes the frame whole.
    other = np.eye(3)[int(np.argmin(np.abs(x)))]
    y = np.cross(other, x)
    y /= np.linalg.norm(y)
    return quat_of(np.stack([x, y, np.cross(x, y)], axis=1))
