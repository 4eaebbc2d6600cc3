"""The common beginning of every measurement: model, motion and workers, all checked."""

from __future__ import annotations

import os
from collections.abc import Callable, Mapping
from concurrent.futures import Executor
from typing import Any, NamedTuple

from stepcore.engine.model import Model
from stepcore.experiment.coordinates import Coordinates
from stepcore.experiment.motion import Motion
from stepcore.experiment.workers import Workers
from stepcore.loading import find_model
from stepcore.report.progress import Choice
from stepcore.scene.scene import Scene

# What a measurement can be made of: a file is read, a scene compiled.
Source = Model | Scene | str | os.PathLike[str]


class Setup(NamedTuple):
    """A measurement's common arguments. name: of the scene."""

    model: Model
    motion: Motion
    workers: Workers

    @property
    def name(self) -> str:
        return self.model.scene.name or "scene"


def set_up(
    measurement: Callable[..., Any],
    model: Source,
    motion: Motion | None,
    fields: Mapping[str, Any],
    *,
    missing: str,
    threads: int | None = None,
    executor: Executor | None = None,
    progress: Choice = None,
) -> Setup:
    """Checks the arguments that all measurements share, and loads and compiles the model.

    measurement: the function that was called. fields: its keyword arguments that are none of its
    own. missing: what there is none of where nothing in the scene can move, in words.
    """
    motion = Motion.of(motion, fields, measurement)
    compiled = find_model(model)
    workers = Workers.checked(measurement.__name__, threads, executor, progress)
    if not compiled.nv:
        raise ValueError(
            "the scene has no joint, so nothing in it can move: add a body with a joint"
        )
    if not Coordinates(compiled).moving:
        raise ValueError(f"nothing in the scene can move: there is {missing}")
    return Setup(compiled, motion, workers)
