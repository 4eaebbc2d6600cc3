"""Write runs as MCAP logs (https://mcap.dev), which Foxglove opens."""

from __future__ import annotations

import json
import os
from collections.abc import Iterator, Mapping
from typing import Any

import numpy as np
from numpy.typing import NDArray

from stepcore import files
from stepcore.report.outputs import MARK
from stepcore.report.table import jsonable
from stepcore.viewing import foxglove
from stepcore.viewing.drawing import ARROW
from stepcore.viewing.frames import Instant, Replayed
from stepcore.viewing.needs import need

# The arrow of a force, of the extent of the scene.
THICKNESS = 0.008
STATE = {
    "title": "stepcore.State",
    "type": "object",
    "properties": {
        "energy": {
            "type": "object",
            "description": "[J]",
            "properties": {"kinetic": {"type": "number"}, "potential": {"type": "number"}},
        },
        "residual": {"type": "number", "description": "of the solve [m/s]"},
        "contacts": {"type": "integer", "description": "that bear a force"},
    },
}
Message = tuple[str, int, foxglove.Json]


def write(
    run: Replayed,
    time: NDArray[Any],
    data: Mapping[str, NDArray[Any]],
    path: str | os.PathLike[str],
) -> None:
    """Write the log of a run; time, data: the recorded arrays. See `Trajectory.save_mcap`."""
    target = files.path("path", path)
    writer_of = need("mcap.writer", "Trajectory.save_mcap", "mcap").Writer
    schemas = {
        "/tf": foxglove.FRAME_TRANSFORMS,
        "/scene": foxglove.SCENE_UPDATE,
        "/contacts": foxglove.SCENE_UPDATE,
        "/state": STATE,
        "/recorded": _recorded_schema(data),
    }
    messages = sorted([*_seen(run), *_recorded(time, data)], key=lambda message: message[1])
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
    frames = frame_names(run.drawing.bodies)
    yield "/scene", _nanoseconds(run.instants[0].time), _scene(run, frames)
    weight = run.drawing.weight or run.strongest or 1.0
    scale = ARROW * run.drawing.extent / weight
    for instant in run.instants:
        at = _nanoseconds(instant.time)
        poses = zip(frames[1:], instant.xpos[1:], instant.xquat[1:], strict=True)
        transforms = [foxglove.transform(at, frame, pos, quat) for frame, pos, quat in poses]
        yield "/tf", at, {"transforms": transforms}
        yield "/contacts", at, _contacts(at, instant, scale, THICKNESS * run.drawing.extent)
        kinetic, potential = instant.energy
        state = {
            "energy": {"kinetic": kinetic, "potential": potential},
            "residual": instant.residual,
            "contacts": len(instant.places),
        }
        yield "/state", at, jsonable(state)


def frame_names(bodies: tuple[str, ...]) -> list[str]:
    """Return unique names of the bodies' frames; the first is the world's."""
    names: list[str] = [foxglove.WORLD]
    for index, body in enumerate(bodies[1:], start=1):
        name = body or f"body {index}"
        names.append(name if name not in names else f"{name} ({index})")
    return names


def _scene(run: Replayed, frames: list[str]) -> foxglove.Json:
    """Write the appearance of every body."""
    at, drawing = _nanoseconds(run.instants[0].time), run.drawing
    entities = []
    for body, frame in enumerate(frames):
        lists: dict[str, list[foxglove.Json]] = {}
        for shape in drawing.shapes:
            if shape.body == body and shape.shown:
                kind, primitive = foxglove.of_shape(shape, drawing.extent)
                lists.setdefault(kind, []).append(primitive)
        if lists:
            entities.append(foxglove.entity(at, frame, frame, **lists))
    return {"deletions": [], "entities": entities}


def _contacts(at: int, instant: Instant, scale: float, thickness: float) -> foxglove.Json:
    both = zip(instant.places, scale * instant.forces, strict=True)
    arrows = [foxglove.arrow(place, along, thickness) for place, along in both]
    return {
        "deletions": [],
        "entities": [foxglove.entity(at, foxglove.WORLD, "contact forces", arrows=arrows)],
    }


def _recorded(time: NDArray[Any], data: Mapping[str, NDArray[Any]]) -> Iterator[Message]:
    """Write the recorded arrays at every step."""
    for step in range(len(time)) if data else ():
        row = {name: np.asarray(values[step]) for name, values in data.items()}
        yield "/recorded", _nanoseconds(float(time[step])), jsonable(row)


def _recorded_schema(data: Mapping[str, NDArray[Any]]) -> foxglove.Json:
    properties = {}
    for name, values in data.items():
        schema: foxglove.Json = {"type": "number"}
        for _ in values.shape[1:]:
            schema = {"type": "array", "items": schema}
        properties[name] = schema
    return {"title": "stepcore.Recorded", "type": "object", "properties": properties}


def _nanoseconds(seconds: float) -> int:
    return max(0, round(seconds * 1e9))
