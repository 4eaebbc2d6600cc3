"""`Experiment`: the runs of one model in one motion, with their errors, failures and costs."""

from __future__ import annotations

from collections.abc import Sequence
from functools import cached_property, partial
from typing import Protocol

import numpy as np

from stepcore._core import Settings
from stepcore.engine.model import Model
from stepcore.experiment.arguments import Bar, Workers
from stepcore.experiment.batched_runs import screened
from stepcore.experiment.cost import TimedRun, costs, heaviness
from stepcore.experiment.errors import Errors, errors
from stepcore.experiment.failure import failure
from stepcore.experiment.growth import Growth, growth
from stepcore.experiment.reference import Reference, ReferenceRuns
from stepcore.experiment.run import Run
from stepcore.experiment.runner import Probes, Runner, positions, recorded
from stepcore.experiment.schedule import Schedule
from stepcore.experiment.sizes import scene_size
from stepcore.report.progress import Progress


class Truth(Protocol):
    """The motion that runs are compared with: a `Reference`, or the runs of another model.

    runs: one run from every start. scored: the samples that count, (starts, n).
    """

    @property
    def runs(self) -> Sequence[Run]: ...

    @property
    def scored(self) -> np.ndarray: ...


class Experiment:
    """One model and one motion, run and judged under different settings.

    model: a `Model`.
    schedule: the motion of the model; see `stepcore.experiment.schedule.scheduled`.
    workers: threads or an executor for the runs.
    size: the size of the scene [m], if another experiment has computed it; see the property.
    runner: makes single runs, in any process.
    reference_runs: the maker of the reference, which can also refine the reference; None at first.

    >>> from stepcore import lesson
    >>> from stepcore.experiment.motion import Motion
    >>> from stepcore.experiment.schedule import scheduled
    >>> model = lesson.spring().compile()
    >>> motion = scheduled(Motion(horizon=0.2, starts=2), model, period=0.01)
    >>> experiment = Experiment(model, motion)
    >>> reference = experiment.reference(finest=0.005, effort=1e6)
    >>> runs = experiment.run(model.settings.replace(dt=0.01))
    >>> experiment.failure(runs, reference) is None
    True
    >>> experiment.errors(runs, reference).high < 0.1
    True
    """

    def __init__(
        self,
        model: Model,
        schedule: Schedule,
        workers: Workers | None = None,
        size: float | None = None,
    ) -> None:
        self.runner, self.workers = Runner(model, schedule), workers or Workers()
        self.reference_runs: ReferenceRuns | None = None
        self._size = size

    @property
    def model(self) -> Model:
        return self.runner.model

    @property
    def schedule(self) -> Schedule:
        return self.runner.schedule

    def run(
        self,
        settings: Settings,
        starts: Sequence[int] | None = None,
        probes: Probes = recorded,
        bar: Bar = None,
    ) -> list[Run]:
        """Run from several starts until one run fails, and return the runs.

        starts: the indices of the starts; by default all.
        probes: makes the probes of each run. `recorded` records everything, `positions` records
            positions alone. Runs with `positions` are batched where batches are faster; the
            results are bit-identical.
        """
        starts = self.runner.starts if starts is None else starts
        if probes is positions:
            return screened(self.runner, settings, starts, self.workers, bar, until_fails=True)
        job = partial(self.runner.observed, settings, probes)
        return self.workers.until(lambda run: run.failure, job, starts, bar)

    def reference(
        self, finest: float, effort: float, settings: Settings | None = None
    ) -> Reference:
        """Compute the converged motion.

        finest: the shortest time step that is judged against the reference [s].
        effort: the largest cost of all runs, in steps × (dofs + 2).
        settings: by default those of the model without sleep, because the effect of sleep counts
            as an error.

        Raises ValueError if the reference fails or its energy diverges.
        """
        shipped = settings or self.model.settings.replace(sleep=False)
        weight = heaviness(self.runner, self.model.settings)
        made = ReferenceRuns(self.runner, shipped, finest, effort, self.workers, weight)
        with self.workers.bar("reference", made.least) as bar:
            reference = made.reference(bar)
        self.reference_runs = made
        if self._size is None:
            self._size = scene_size(self.model.scene, reference.runs)
        return reference

    def growth(self, settings: Settings, bar: Progress) -> Growth:
        """Measure how fast perturbed runs separate under some settings."""
        return growth(self.runner, settings, self.workers, bar)

    @property
    def size(self) -> float:
        """Size of the scene and its motion [m].

        The first reference gives the size. Without a reference, runs under the model's settings do.
        """
        if self._size is None:
            self._size = scene_size(self.model.scene, self.run(self.model.settings))
        return self._size

    @cached_property
    def weight(self) -> float:
        """Weight of all bodies [N]."""
        return float(np.sum(self.model.body_mass) * np.linalg.norm(self.runner.bodies.gravity))

    def errors(self, runs: Sequence[Run], truth: Truth) -> Errors:
        """Compute the errors of runs from the first starts."""
        count = len(runs)
        return errors(runs, truth.runs[:count], truth.scored[:count], self.size)

    def failure(self, runs: Sequence[Run], truth: Truth) -> str | None:
        """Explain why runs from the first starts failed, or return None.

        The criteria are in `stepcore.experiment.failure`.
        """
        return failure(runs, truth.runs[: len(runs)], self.size, self.weight)

    def cost(self, *settings: Settings, bar: Progress | None = None) -> list[float]:
        """Measure the computing time of the first start's motion under each of the settings.

        The unit is µs per simulated second.
        """
        timed = [TimedRun(self.runner, setting) for setting in settings]
        return costs(timed, bar)
