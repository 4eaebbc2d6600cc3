"""The converged motion of a scene (dt → 0, rows solved to rounding), with an error estimate.

Two integrators run at repeatedly halved time steps. The physical model of the scene, in particular
the softness of contacts, does not change. The integrator whose last halving changed the motion less
gives the reference. Its step is halved further until the error of the reference is a tenth of the
smallest error in the table, or until the budget is spent.

The error is estimated by Richardson extrapolation if the halvings show an order of convergence, and
otherwise from the distance between the two integrators. If the motion has a closed form
(`stepcore.experiment.closed_form`), the closed form is the reference, and the converged runs are a
check.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Iterable, Sequence
from dataclasses import dataclass, field
from functools import partial
from itertools import pairwise

import numpy as np

from stepcore._core import Settings
from stepcore.experiment.arguments import Workers
from stepcore.experiment.closed_form import Exact, closed
from stepcore.experiment.converged import (
    Known,
    known,
    observed,
    reference_settings,
    shown,
)
from stepcore.experiment.errors import Errors, errors
from stepcore.experiment.failure import runaway
from stepcore.experiment.growth import DIRECTIONS, SHORTER, Growth, growth
from stepcore.experiment.run import Run
from stepcore.experiment.runner import Runner
from stepcore.experiment.sizes import scene_size
from stepcore.report.progress import Progress

# With a reference finer by this factor, only the last printed digit of an error can change.
FINER = 10.0
# A halving that leaves more than this share of the error is limited by rounding, or the motion
# does not converge.
STALLED = 0.9
# Distances below this share of the scene's size are rounding errors, amplified by at most the
# growth of a predictable scene.
ROUNDING = 1e-11
# Three halvings show an order of convergence. BEGIN has the possible first steps, as multiples of
# the finest step that is judged; shorter ones cost more.
HALVINGS, BEGIN = 3, (2.0, 4.0, 8.0, 16.0)
# If the error exceeds this multiple of the reference's last change, the other integrator's step is
# what limits the error, and is halved.
EAGER = 4.0
# If the finer runs are limited by rounding, coarser runs are added up to this multiple of the
# finest step.
COARSEST = 64
# Laws whose stiffness is β/dt, so that the physical model changes with dt.
DEPENDENT = ("lesson", "relaxed")


@dataclass(frozen=True, eq=False)
class Level:
    """The runs from all starts at one time step.

    dt: the time step [s]. integrator: the integrator of the runs.
    moved: the errors of the level with twice the step, measured from this one; None without it.
    """

    dt: float
    integrator: str
    runs: list[Run]
    moved: Errors | None = None

    @property
    def failed(self) -> str | None:
        return next((run.failure for run in self.runs if run.failure), None)

    @property
    def distance(self) -> float:
        """Distance to the level with twice the step, median start [m]; inf without such a level."""
        return np.inf if self.moved is None else self.moved.median

    @property
    def high(self) -> float:
        """Distance to the level with twice the step, worst start [m]; inf without such a level."""
        return np.inf if self.moved is None else self.moved.high


@dataclass(frozen=True)
class Gap:
    """The distance between the limits (dt → 0) of two models of a scene.

    distance: measured like position errors [m].
    against: the other model, in words.
    settled: whether the last step towards the other model changed the distance only little; True if
        the other model is reached in one step.
    """

    distance: float
    against: str
    settled: bool = True


@dataclass(frozen=True, eq=False)
class Reference:
    """The converged motion of a scene.

    settings: the settings of the finest runs.
    level: the finest runs of one integrator; levels: all halvings of this integrator.
    growth: the growth of the perturbed runs.
    known: the error of `level`.
    orders: for each integrator, the observed orders of convergence in the median start, coarsest
        first.
    agreement: the distance to the finest run of the other integrator, `other` [m].
    other_error: the change of that run in its last halving [m].
    exact: the closed form of the motion; None without one.
    stiffens: whether rows act whose law stiffens as dt decreases, so that the limit has harder
        contacts than the scene.
    stalls: the number of consecutive last halvings that did not reduce the error.
    gaps: the distances to other models; see `stepcore.experiment.other_models`.
    """

    settings: Settings
    level: Level
    levels: tuple[Level, ...]
    growth: Growth
    known: Known
    orders: dict[str, list[float]]
    agreement: float = np.nan
    other: str = ""
    other_error: float = np.nan
    exact: Exact | None = None
    stiffens: bool = False
    stalls: int = 0
    gaps: dict[str, Gap] = field(default_factory=dict)

    @property
    def sure(self) -> Known:
        """Error of the motion: of the closed form, or else of `level`."""
        return self.known if self.exact is None else self.exact.known

    @property
    def error(self) -> float:
        """Error of the median start [m]."""
        return self.sure.error

    @property
    def high(self) -> float:
        """Error of the worst start [m]."""
        return self.sure.high

    @property
    def each(self) -> tuple[float, ...]:
        """Error of every start [m]."""
        return self.sure.each

    @property
    def largest(self) -> float:
        """Largest error of any body, sample and start [m]."""
        return self.sure.largest

    @property
    def angle(self) -> float:
        """Error of orientations [rad]."""
        return self.sure.angle

    @property
    def basis(self) -> str:
        """Method by which `high` was estimated, in words."""
        return self.sure.bases["high"]

    @property
    def order(self) -> int | None:
        """Order of the Richardson extrapolation for `high` (1, 2 or 4); None without one."""
        return self.sure.orders["high"]

    @property
    def scored(self) -> np.ndarray:
        """Mask of the samples that count because they can be predicted, (starts, n)."""
        return self.growth.scored

    @property
    def notes(self) -> list[str]:
        """Sentences on the limits of comparisons with this motion."""
        short = int((~self.scored).any(axis=1).sum())
        if not short:
            return []
        return [f"{short} of {len(self.scored)} starts count only as long as they can be predicted"]

    @property
    def runs(self) -> list[Run]:
        """The motion: the closed form, or the finest runs."""
        return self.level.runs if self.exact is None else self.exact.runs


class ReferenceRuns:
    """The runs for a reference, and their cost in steps × (dofs + 2).

    shipped: the settings of the scene.
    finest: the shortest time step that is judged against the reference [s].
    budget: the largest cost of all runs; spent: the cost of the runs so far.
    weight: the relative work of a step (`cost.heaviness`).
    chains: the halvings of each integrator, coarsest first.
    size: the size of the scene [m], once runs have been made.
    """

    def __init__(
        self,
        runner: Runner,
        shipped: Settings,
        finest: float,
        budget: float,
        workers: Workers,
        weight: float = 1.0,
    ):
        self.runner, self.shipped, self.budget, self.workers = runner, shipped, budget, workers
        self.weight = weight
        self.finest, self.spent = finest, 0.0
        self.chains: dict[str, list[Level]] = {}
        self.size = 1.0

    @property
    def starts(self) -> int:
        """Number of starts."""
        return len(self.runner.starts)

    @property
    def least(self) -> int:
        """Smallest number of runs that `reference` makes."""
        return (2 * (HALVINGS + 1) + 1 + DIRECTIONS) * self.starts

    @property
    def second(self) -> str:
        """Integrator that is compared with rk4."""
        return "implicitfast" if self.shipped.law == "solref" else "semi-implicit"

    def settings(self, integrator: str, dt: float) -> Settings:
        """Return the settings of a reference run; see `reference_settings`."""
        return reference_settings(self.shipped, integrator, dt)

    def cost(self, integrator: str, dt: float) -> float:
        """Return the cost of the runs from all starts at one time step.

        The unit is one rk4 step of usual weight, times (dofs + 2). rk4 solves four times per step;
        steps of other integrators count a quarter.
        """
        schedule = self.runner.schedule
        steps = schedule.periods * schedule.steps(dt) * self.starts
        solves = 1.0 if integrator == "rk4" else 0.25
        return steps * (self.runner.model.nv + 2) * solves * self.weight

    def level(self, integrator: str, dt: float, bar: Progress, starts: int | None = None) -> Level:
        """Run from the first `starts` (all by default) at one time step, until one run fails."""
        job, some = partial(self.runner.run, self.settings(integrator, dt)), self.runner.starts
        runs = self.workers.until(lambda run: run.failure, job, some[:starts], bar)
        self.spent += self.cost(integrator, dt) * len(runs) / self.starts
        return Level(dt, integrator, runs)

    def reference(self, bar: Progress) -> Reference:
        """Run two integrators at three halvings each, and return the reference with less error.

        Raises ValueError if both integrators fail, or the energy of the motion diverges.
        """
        steps = self._steps()
        failures = [self._add_levels(name, steps, bar) for name in (self.second, "rk4")]
        if not self.chains:
            raise ValueError(
                f"the reference fails at dt = {steps[-1]:g} s{self.runner.schedule.driven}, so "
                f"there is nothing to compare with: {failures[1] or failures[0]}"
            )
        self._refuse_runaway(levels[-1] for levels in self.chains.values())
        # rk4 if that runs, as in `growth`.
        integrator = list(self.chains)[-1]
        self.size = scene_size(self.runner.model.scene, self.chains[integrator][-1].runs)
        growth = self._growth(integrator, self.shipped.dt / SHORTER[0], bar)
        for name, levels in self.chains.items():
            levels[1:] = [self._measured(*pair, growth) for pair in pairwise(levels)]
            self._add_coarser(name, growth, bar)
        reference = self._better_known(growth)
        if reference.known.high > EAGER * reference.level.high:
            # The other integrator limits the error, and two halvings of its step are cheap.
            if reference.other not in ("", "rk4") and self._halve(reference.other, growth, bar):
                self._halve(reference.other, growth, bar)
            reference = self._better_known(growth, reference.level.integrator)
        return self._checked_exact(reference)

    def _add_levels(self, integrator: str, steps: Sequence[float], bar: Progress) -> str | None:
        """Add the levels of an integrator at several steps; return the reason if one fails.

        The finest level is run first, because levels coarser than a failed one are useless, and
        because a diverging run can cost more than all other runs together.

        steps: coarsest first [s].
        """
        levels: list[Level] = []
        for dt in reversed(steps):
            level = self.level(integrator, dt, bar)
            if level.failed:
                break
            levels.insert(0, level)
        if len(levels) > 1:
            self.chains[integrator] = levels
        return level.failed

    def _refuse_runaway(self, levels: Iterable[Level]) -> None:
        for level in levels:
            explodes = runaway(self.runner.model, self.runner.schedule, level.runs)
            if explodes:
                raise ValueError(explodes)

    def _checked_exact(self, reference: Reference) -> Reference:
        """Add the closed form to a reference, if it exists and the converged run agrees."""
        exact = closed(self.runner, reference.level.runs)
        if exact is not None:
            check = errors(reference.level.runs, exact.runs, reference.scored).median
            if not check > FINER * reference.error + 1e-9 * self.size:
                exact = dataclasses.replace(exact, check=check)
                return dataclasses.replace(reference, exact=exact)
        return reference

    def _steps(self) -> list[float]:
        """Return the steps of three halvings, from twice the finest step that is judged [s].

        If these steps cost too much, the halvings begin at a coarser step, and `refined` can add
        finer levels later.
        """
        chosen = [self.finest / 2**k for k in range(HALVINGS + 1)]
        for begin in BEGIN:
            steps = [self.finest * begin / 2**k for k in range(HALVINGS + 1)]
            if self._fits(steps[0]):
                chosen = steps
                if sum(self.cost("rk4", dt / 2) for dt in steps) <= self.budget:
                    break
        return chosen

    def growth(self, bar: Progress) -> tuple[Level, Growth]:
        """Measure the growth of perturbations; return the run from the first start and the growth.

        If the time is over, the growth is that of the first starts.

        Raises ValueError if every level fails.
        """
        for dt in (self.shipped.dt / shorter for shorter in SHORTER):
            for integrator in ("rk4", self.second):
                base = self.level(integrator, dt, bar, starts=1)
                failure = base.failed
                if not failure:
                    self._refuse_runaway([base])
                    grown = self._growth(integrator, dt, bar, partly=True)
                    failure = grown.failure
                if not failure:
                    return base, grown
        raise ValueError(f"the scene fails at dt = {dt:g} s: {failure}")

    def can_refine(self, reference: Reference) -> bool:
        """Return whether a further halving is affordable and can still improve the reference."""
        done = reference.exact is not None or reference.high <= ROUNDING * self.size
        if done or reference.stalls > 1:
            return False
        levels = [self.chains[name][-1] for name in self._deciding(reference)]
        cost = sum(self.cost(level.integrator, level.dt / 2) for level in levels)
        return self.spent + cost <= self.budget

    def refined(self, reference: Reference, bar: Progress) -> Reference | None:
        """Halve the time step that limits the error; return the new reference, or None on failure.

        A Richardson error falls with the step of the reference. The distance between two
        integrators falls with the step of the integrator whose last halving changed the motion
        more, or with both steps.
        """
        for name in self._deciding(reference):
            if not self._halve(name, reference.growth, bar):
                return None
        better = self._better_known(reference.growth, reference.level.integrator)
        stalls = reference.stalls + 1 if better.high > STALLED * reference.high else 0
        return dataclasses.replace(better, stalls=stalls)

    def _deciding(self, reference: Reference) -> list[str]:
        """Return the integrators whose steps a refinement halves."""
        chosen = reference.level.integrator
        if reference.order is not None or not reference.other:
            return [chosen]
        moved = {name: self.chains[name][-1].high for name in (chosen, reference.other)}
        return [name for name in moved if moved[name] >= max(moved.values()) / 2]

    def _halve(self, integrator: str, growth: Growth, bar: Progress) -> bool:
        """Add a finer level to the levels of an integrator; return False if the run fails."""
        coarse = self.chains[integrator][-1]
        fine = self.level(integrator, coarse.dt / 2, bar)
        if not fine.failed:
            self.chains[integrator].append(self._measured(coarse, fine, growth))
        return not fine.failed

    def _measured(self, coarse: Level, fine: Level, growth: Growth) -> Level:
        """Return the finer level, with the errors of the coarser one measured from it."""
        return dataclasses.replace(fine, moved=errors(coarse.runs, fine.runs, growth.scored))

    def _fits(self, dt: float) -> bool:
        """Return whether a time step divides the control period."""
        count = self.runner.schedule.period / dt
        return count >= 0.5 and abs(count - round(count)) < 1e-6 * count

    def _growth(self, integrator: str, dt: float, bar: Progress, partly: bool = False) -> Growth:
        self.spent += (1 + DIRECTIONS) * self.cost(integrator, dt)
        return growth(self.runner, self.settings(integrator, dt), self.workers, bar, partly)

    def _add_coarser(self, integrator: str, growth: Growth, bar: Progress) -> None:
        """Add coarser levels, to show an order where rounding limits all existing levels."""
        floor, levels = ROUNDING * self.size, self.chains[integrator]
        while (
            shown([level.distance for level in levels[1:]], floor) is None
            and levels[1].distance < 1e3 * floor
            and levels[0].dt < COARSEST * self.finest
            and self._fits(2 * levels[0].dt)
        ):
            coarse = self.level(integrator, 2 * levels[0].dt, bar)
            if coarse.failed:
                return
            levels[:1] = [coarse, self._measured(coarse, levels[0], growth)]

    def _better_known(self, growth: Growth, kept: str | None = None) -> Reference:
        """Return the reference by the integrator that its last halving changed least.

        kept: the integrator to use in any case; by default none.
        """
        name = kept or min(self.chains, key=lambda name: self.chains[name][-1].high)
        levels = self.chains[name]
        last = levels[-1]
        other = next((key for key in self.chains if key != name), "")
        rival = None
        if other:
            rival = errors(self.chains[other][-1].runs, last.runs, growth.scored)
        moved = [level.moved for level in levels if level.moved is not None]
        count = last.runs[0].com[..., 0].size
        return Reference(
            settings=self.settings(name, last.dt),
            level=last,
            levels=tuple(levels),
            growth=growth,
            known=known(moved, ROUNDING * self.size, rival, other, count),
            orders={key: observed([x.distance for x in c[1:]]) for key, c in self.chains.items()},
            agreement=np.nan if rival is None else rival.median,
            other=other,
            other_error=self.chains[other][-1].distance if other else np.nan,
            stiffens=self.shipped.law in DEPENDENT
            and any(run.rows or run.overlap for run in last.runs),
        )


def smallest(values: Sequence[float], size: float = 0.0) -> float:
    """Return the smallest value above rounding in a scene of some size [m], or 0 without one."""
    return min((value for value in values if value > ROUNDING * size), default=0.0)
