"""The arguments that all measurements share: the model, the motion and the workers."""

from __future__ import annotations

import os
from collections.abc import Callable, Mapping, Sequence
from concurrent.futures import Executor
from contextlib import AbstractContextManager, nullcontext
from dataclasses import dataclass
from typing import Any, NamedTuple, TypeVar

from stepcore import checks, deadline
from stepcore.deadline import Deadline, in_time
from stepcore.engine.model import Model
from stepcore.executors import each
from stepcore.experiment.change import Change
from stepcore.experiment.engines import Engine
from stepcore.experiment.motion import Motion, MotionFields, takes_motion
from stepcore.experiment.mujoco_engine import engine_of
from stepcore.report.progress import Choice, Progress
from stepcore.scene.scene import Scene
from stepcore.signatures import F, annotation, keyword

T = TypeVar("T")
R = TypeVar("R")
# An open progress bar, the label of a new one, or None for none.
Bar = Progress | str | None
# The models that a measurement accepts; files are loaded, and scenes compiled.
Source = Model | Scene | str | os.PathLike[str]
# The measurements that accept models with adaptive steps.
WITHIN_ACCURACY = ("trade", "check", "predict", "diagnose", "stability_map")


@dataclass(frozen=True)
class Workers:
    """Threads or an executor for the runs of a measurement; every measurement has these arguments.

    threads: the number of runs at the same time; by default one per core.
    executor: any `concurrent.futures` executor, used instead of threads. Costs are timed
        afterwards, on one thread.
    progress: False for no bar, or a function of (label, done, total).
    seconds: (of the measurement) the time limit [s]; by default there is none. When the time is
        over, the result has what was completed, and `unfinished` lists the rest.
    """

    threads: int = 1
    executor: Executor | None = None
    progress: Choice = False

    @property
    def deadline(self) -> Deadline:
        """The deadline of the measurement; one that never ends if the measurement has none."""
        return deadline.current() or Deadline()

    @classmethod
    def checked(
        cls, owner: str, threads: int | None, executor: Executor | None, progress: Choice
    ) -> Workers:
        """Check the arguments of a measurement, and return its workers.

        owner: the measurement's name, for errors. threads: None for one per core.
        """
        checks.progress(owner, progress)
        if executor is not None and not hasattr(executor, "submit"):
            raise checks.refuse(owner, "executor", executor, "a concurrent.futures executor")
        return cls(checks.threads(threads), executor, progress)

    def bar(self, bar: Bar, total: int) -> AbstractContextManager[Progress]:
        """Return a progress bar, to be used in a `with` statement."""
        if isinstance(bar, str):
            return Progress(bar, total, self.progress)
        return nullcontext(bar or Progress("", total, False))

    def each(
        self,
        job: Callable[[T], R],
        points: Sequence[T],
        bar: Bar,
        done: list[R | None] | None = None,
        took: Callable[[range, list[R]], object] | None = None,
    ) -> list[R]:
        """Call a job at every point, and return the results in the order of the points.

        done: a list that receives the results; took: called with results as they come. See
            `stepcore.executors.each`.

        Raises OutOfTime if the measurement's time is over before the last result.
        """
        how: dict[str, Any] = {"threads": self.threads, "executor": self.executor}
        with self.bar(bar, len(points)) as drawn:
            return each(job, points, bar=drawn, done=done, took=took, **how)


class Setup(NamedTuple):
    """The checked arguments that measurements share."""

    engine: Engine
    motion: Motion
    workers: Workers

    @property
    def model(self) -> Model:
        return self.engine.model

    @property
    def name(self) -> str:
        """The name of the scene."""
        return self.engine.title


class MeasurementFields(MotionFields, total=False):
    """The keyword arguments of every measurement: see `Workers`, and the fields of its `Motion`."""

    threads: int | None
    executor: Executor | None
    progress: Choice
    seconds: float | None


# The keyword arguments of measurements that are not fields of `Motion`.
SHARED = MeasurementFields.__annotations__.keys() - MotionFields.__annotations__.keys()


def measurement(*, without: tuple[str, ...] = ()) -> Callable[[F], F]:
    """Return a decorator of a measurement: its time is limited, and `help` lists `**fields`.

    without: the names of the fields of `Motion` that it does not use.
    """

    hints = MeasurementFields.__annotations__
    shared = [keyword(name, None, annotation(hints[name])) for name in hints if name in SHARED]
    spelled_out = takes_motion(without=without, more=shared)
    return lambda function: spelled_out(in_time(function))


def set_up(
    called: Callable[..., Any],
    model: Source,
    motion: Motion | str | None,
    fields: Mapping[str, Any],
    *,
    missing: str,
    engine: str = "stepcore",
) -> Setup:
    """Check the arguments that all measurements share, and load and compile the model.

    called: the measurement. fields: its `MeasurementFields`.
    missing: words for the error if nothing in the scene can move, such as "no motion to predict".
    engine: "stepcore" or "mujoco".
    """
    motion = Motion.of(motion, {k: v for k, v in fields.items() if k not in SHARED}, called)
    simulator = engine_of(model, engine, motion)
    tolerance = simulator.settings(Change()).accuracy
    if tolerance is not None and called.__name__ not in WITHIN_ACCURACY:
        limit = f"None: {called.__name__} regards steps of a fixed length; stepcore.trade does not"
        raise ValueError(f"accuracy = {tolerance:g}: must be {limit}")
    shared = (fields.get(name) for name in ("threads", "executor", "progress"))
    workers = Workers.checked(called.__name__, *shared)
    if not simulator.nv:
        raise ValueError(
            "the scene has no joint, so nothing in it can move: add a body with a joint"
        )
    if not simulator.matter.moving:
        raise ValueError(f"nothing in the scene can move: there is {missing}")
    return Setup(simulator, motion, workers)
