"""Write runs as MCAP logs (https://mcap.dev), which Foxglove opens.

Each message is JSON with its schema. FrameTransforms and SceneUpdate have the fields of Foxglove's
documented schemas (https://docs.foxglove.dev/docs/sdk/schemas), as far as they are written here.
"""

from __future__ import annotations

import functools
import json
import os
from collections.abc import Iterator, Mapping, Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from stepcore import files
from stepcore.needs import need
from stepcore.report.outputs import MARK
from stepcore.report.table import jsonable
from stepcore.scene import frames
from stepcore.viewing.camera import Mark, force_marks
from stepcore.viewing.drawing import Drawing, Shape
from stepcore.viewing.frames import Replayed

Json = dict[str, Any]
# Topic, time [ns] and content.
Message = tuple[str, int, Json]
WORLD = "world"


def _object(title: str = "", **properties: Json) -> Json:
    named = {"title": title} if title else {}
    return {**named, "type": "object", "properties": properties}


def _list(items: Json) -> Json:
    return {"type": "array", "items": items}


def _numbers(title: str, names: str | Sequence[str]) -> Json:
    return _object(title, **dict.fromkeys(names, NUMBER))


NUMBER, TEXT, WHOLE = {"type": "number"}, {"type": "string"}, {"type": "integer"}
TIME = _object("time", sec=WHOLE, nsec=WHOLE)
VECTOR = _numbers("foxglove.Vector3", "xyz")
QUATERNION = _numbers("foxglove.Quaternion", "xyzw")
COLOR = _numbers("foxglove.Color", "rgba")
PLACED = {
    "pose": _object("foxglove.Pose", position=VECTOR, orientation=QUATERNION),
    "color": COLOR,
}
SOLID = {**PLACED, "size": VECTOR}
LENGTHS = dict.fromkeys(("shaft_length", "shaft_diameter", "head_length", "head_diameter"), NUMBER)
SCALES = {"bottom_scale": NUMBER, "top_scale": NUMBER}
TRIANGLES = {
    "points": _list(_numbers("foxglove.Point3", "xyz")),
    "colors": _list(COLOR),
    "indices": _list(WHOLE),
}
# The lists of an entity; the last three stay empty.
PRIMITIVES = {
    "arrows": _list(_object("foxglove.ArrowPrimitive", **PLACED, **LENGTHS)),
    "cubes": _list(_object("foxglove.CubePrimitive", **SOLID)),
    "spheres": _list(_object("foxglove.SpherePrimitive", **SOLID)),
    "cylinders": _list(_object("foxglove.CylinderPrimitive", **SOLID, **SCALES)),
    "triangles": _list(_object("foxglove.TriangleListPrimitive", **PLACED, **TRIANGLES)),
    "lines": _list(_object("foxglove.LinePrimitive")),
    "texts": _list(_object("foxglove.TextPrimitive")),
    "models": _list(_object("foxglove.ModelPrimitive")),
}
ENTITY = _object(
    "foxglove.SceneEntity",
    timestamp=TIME,
    frame_id=TEXT,
    id=TEXT,
    lifetime=_object("duration", sec=WHOLE, nsec=WHOLE),
    frame_locked={"type": "boolean"},
    metadata=_list(_object("foxglove.KeyValuePair", key=TEXT, value=TEXT)),
    **PRIMITIVES,
)
DELETION = _object("foxglove.SceneEntityDeletion", timestamp=TIME, type=WHOLE, id=TEXT)
SCENE_UPDATE = _object("foxglove.SceneUpdate", deletions=_list(DELETION), entities=_list(ENTITY))
TRANSFORM = _object(
    "foxglove.FrameTransform",
    timestamp=TIME,
    parent_frame_id=TEXT,
    child_frame_id=TEXT,
    translation=VECTOR,
    rotation=QUATERNION,
)
FRAME_TRANSFORMS = _object("foxglove.FrameTransforms", transforms=_list(TRANSFORM))
STATE = _object(
    "stepcore.State",
    energy={**_object(kinetic=NUMBER, potential=NUMBER), "description": "[J]"},
    residual={**NUMBER, "description": "of the solve [m/s]"},
    contacts={**WHOLE, "description": "that bear a force"},
)


def write_mcap(
    run: Replayed,
    time: NDArray[Any],
    data: Mapping[str, NDArray[Any]],
    path: str | os.PathLike[str],
) -> None:
    """Write the log of a run; time, data: the recorded arrays. See `Trajectory.save_mcap`."""
    target = files.as_path("path", path)
    writer_of = need("mcap.writer", "Trajectory.save_mcap", "mcap").Writer
    recorded = {
        name: functools.reduce(lambda schema, _: _list(schema), values.shape[1:], NUMBER)
        for name, values in data.items()
    }
    schemas = {
        "/tf": FRAME_TRANSFORMS,
        "/scene": SCENE_UPDATE,
        "/contacts": SCENE_UPDATE,
        "/state": STATE,
        "/recorded": _object("stepcore.Recorded", **recorded),
    }
    messages = [*_seen(run)]
    for step, at in enumerate(time.tolist() if data else ()):
        row = {name: np.asarray(values[step]) for name, values in data.items()}
        messages.append(("/recorded", _nanoseconds(at), jsonable(row)))
    messages.sort(key=lambda message: message[1])
    with open(target, "wb") as file:
        writer = writer_of(file)
        writer.start(library=MARK)
        numbers: dict[str, int] = {}
        channels = {}
        for topic, schema in schemas.items():
            title = schema["title"]
            if title not in numbers:
                text = json.dumps(schema).encode()
                numbers[title] = writer.register_schema(title, "jsonschema", text)
            channels[topic] = writer.register_channel(topic, "json", numbers[title])
        for topic, at, message in messages:
            text = json.dumps(message, allow_nan=False).encode()
            writer.add_message(channels[topic], log_time=at, publish_time=at, data=text)
        writer.finish()


def _seen(run: Replayed) -> Iterator[Message]:
    """Write poses, shapes, contacts and the state at every drawn instant."""
    names = frame_names(run.drawing.bodies)
    first = _nanoseconds(run.instants[0].time)
    shown = [_entity(first, name, name, _shapes(run.drawing, k)) for k, name in enumerate(names)]
    bodies = [entity for entity in shown if any(entity[kind] for kind in PRIMITIVES)]
    yield "/scene", first, {"deletions": [], "entities": bodies}
    newtons = run.drawing.weight or run.strongest
    for instant in run.instants:
        at = _nanoseconds(instant.time)
        poses = zip(names[1:], instant.xpos[1:], instant.xquat[1:], strict=True)
        yield "/tf", at, {"transforms": [_transform(at, *pose) for pose in poses]}
        marks = force_marks(run.drawing, instant, newtons)
        arrows = {"arrows": [arrow(mark) for mark in marks if mark.kind == "arrow"]}
        forces = [_entity(at, WORLD, "contact forces", arrows)]
        yield "/contacts", at, {"deletions": [], "entities": forces}
        kinetic, potential = instant.energy
        state = {
            "energy": {"kinetic": kinetic, "potential": potential},
            "residual": instant.residual,
            "contacts": len(instant.places),
        }
        yield "/state", at, jsonable(state)


def frame_names(bodies: tuple[str, ...]) -> list[str]:
    """Return unique names of the bodies' frames; the first is the world's."""
    names: list[str] = [WORLD]
    for index, body in enumerate(bodies[1:], start=1):
        name = body or f"body {index}"
        names.append(name if name not in names else f"{name} ({index})")
    return names


def _entity(at: int, frame: str, name: str, primitives: Mapping[str, list[Json]]) -> Json:
    """Return primitives that move with a frame and replace primitives of the same name."""
    return {
        "timestamp": _time(at),
        "frame_id": frame,
        "id": name,
        "lifetime": _time(0),
        "frame_locked": True,
        "metadata": [],
        **{kind: [] for kind in PRIMITIVES},
        **primitives,
    }


def _transform(at: int, frame: str, pos: Any, quat: Any) -> Json:
    """Return the pose of a frame in the world."""
    return {
        "timestamp": _time(at),
        "parent_frame_id": WORLD,
        "child_frame_id": frame,
        "translation": _named("xyz", pos),
        "rotation": _named("wxyz", quat),
    }


def _shapes(drawing: Drawing, body: int) -> dict[str, list[Json]]:
    """Return the shown shapes of a body, by the kind of primitive."""
    lists: dict[str, list[Json]] = {}
    for shape in drawing.shapes:
        if shape.body == body and shape.shown:
            kind, primitive = _primitive(shape, drawing.reach)
            pose = {
                "position": _named("xyz", shape.pos),
                "orientation": _named("wxyz", shape.quat),
            }
            color = _named("rgba", shape.rgba)
            lists.setdefault(kind, []).append({"pose": pose, "color": color, **primitive})
    return lists


def _primitive(shape: Shape, reach: float) -> tuple[str, Json]:
    """Return the list for a shape, and its form there; reach: half size of a plane [m]."""
    r, h = (*shape.size, 0.0)[:2]
    match shape.kind:
        case "box" | "ellipsoid":
            kind = "cubes" if shape.kind == "box" else "spheres"
            return kind, {"size": _named("xyz", [2 * half for half in shape.size[:3]])}
        case "sphere":
            return "spheres", {"size": _named("xyz", (2 * r,) * 3)}
        case "cylinder":
            size = _named("xyz", (2 * r, 2 * r, 2 * h))
            return "cylinders", {"size": size, "bottom_scale": 1.0, "top_scale": 1.0}
    vertices, faces = shape.triangles(reach)
    points = [_named("xyz", point) for point in vertices]
    indices = np.ravel(faces).astype(int).tolist()
    return "triangles", {"points": points, "colors": [], "indices": indices}


def arrow(mark: Mark) -> Json:
    """Return the arrow of a mark."""
    along = np.subtract(mark.end, mark.start)
    length = float(np.linalg.norm(along))
    head = min(6 * mark.width, length / 2)
    # Any perpendicular direction completes the frame.
    quat = frames.from_xy_axes(along.tolist(), np.eye(3)[np.argmin(np.abs(along))].tolist())
    return {
        "pose": {"position": _named("xyz", mark.start), "orientation": _named("wxyz", quat)},
        "shaft_length": length - head,
        "shaft_diameter": 2 * mark.width,
        "head_length": head,
        "head_diameter": 4 * mark.width,
        "color": _named("rgba", (*mark.colour, 1.0)),
    }


def _nanoseconds(seconds: float) -> int:
    return max(0, round(seconds * 1e9))


def _time(nanoseconds: int) -> Json:
    return {"sec": nanoseconds // 10**9, "nsec": nanoseconds % 10**9}


def _named(letters: str, values: Any) -> Json:
    return dict(zip(letters, map(float, values), strict=True))
