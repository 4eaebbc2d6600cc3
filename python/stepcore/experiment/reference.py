"""The converged motion of a scene, dt → 0 with rows solved to rounding, and how well it is known.

Two integrators run at halved time steps. What is modelled, the softness of contacts above all,
stays the scene's. The integrator that its last halving moved less is the reference; it is halved
further until its error is a tenth of the smallest error in the table, or the budget is spent.

The error is known from the order that the halvings show (Richardson), or else from the distance of
the two integrators. Where the motion has a closed form (`stepcore.experiment.closed_form`), that is
the reference, and the converged runs check it.
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
from stepcore.experiment.growth import DIRECTIONS, Growth, growth
from stepcore.experiment.run import Run
from stepcore.experiment.runner import Runner
from stepcore.experiment.sizes import scene_size
from stepcore.report.progress import Progress

# A reference finer than the errors judged by this factor changes at most their last digit shown.
FINER = 10.0
# A halving that leaves more than this share of the error has met rounding, or does not converge.
STALLED = 0.9
# Of the scene's size: shorter distances are rounding, grown by what a predictable scene allows.
ROUNDING = 1e-11
# Three halvings show an order. The first step may be one of these, in steps of the finest that is
# to be judged: the shorter the dearer.
HALVINGS, BEGIN = 3, (2.0, 4.0, 8.0, 16.0)
# Where the error is more than this many times the last halving of the reference, the halvings of
# the other integrator decide it.
EAGER = 4.0
# Coarser runs are added up to this many steps of the finest, where the finer ones met rounding.
COARSEST = 64
# Laws whose stiffness is β/dt: there is no scene that stays the same as dt shrinks.
DEPENDENT = ("lesson", "relaxed")


@dataclass(frozen=True, eq=False)
class Level:
    """The runs from all starts at one time step. moved: from the level of twice the step."""

    dt: float
    integrator: str
    runs: list[Run]
    moved: Errors | None = None

    @property
    def failed(self) -> str | None:
        return next((run.failure for run in self.runs if run.failure), None)

    @property
    def distance(self) -> float:
        """To the level of twice the step, of the median start [m]; inf without one."""
        return np.inf if self.moved is None else self.moved.median

    @property
    def high(self) -> float:
        """To the level of twice the step, of the worst start [m]; inf without one."""
        return np.inf if self.moved is None else self.moved.high


@dataclass(frozen=True)
class Gap:
    """The distance between the limits of two models of a scene.

    distance [m]: as errors of positions are measured. against: the other model, in words.
    settled: whether a step further towards it, where there is one, changes little.
    """

    distance: float
    against: str
    settled: bool = True


@dataclass(frozen=True, eq=False)
class Reference:
    """The converged motion of a scene.

    level: the finest runs of one integrator; levels: its halvings.
    known: the error of `level`.
    orders: the order that the halvings of each integrator showed in the median start, coarsest
        first.
    agreement [m]: the distance to the finest run of another integrator, `other`.
    other_error [m]: the change of that run in its own last halving.
    growth: the growth of the perturbed runs.
    exact: the closed form of the motion, if there is one.
    gaps: the distances to other models; see `stepcore.experiment.other_models`.
    stiffens: whether rows act whose law stiffens as dt shrinks, so that the limit has harder
        contacts.
    stalls: the number of last halvings in a row that did not help.
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
        """The error of the motion: that of the closed form, or of `level`."""
        return self.known if self.exact is None else self.exact.known

    @property
    def error(self) -> float:
        """The error of the median start [m]."""
        return self.sure.error

    @property
    def high(self) -> float:
        """The error of the worst start [m]."""
        return self.sure.high

    @property
    def largest(self) -> float:
        """The largest error of any body, sample and start [m]."""
        return self.sure.largest

    @property
    def angle(self) -> float:
        """The error of orientations [rad]."""
        return self.sure.angle

    @property
    def basis(self) -> str:
        """How `high` is known, in words."""
        return self.sure.bases["high"]

    @property
    def order(self) -> int | None:
        """The order that Richardson used for `high` (1, 2 or 4); None where it did not."""
        return self.sure.orders["high"]

    @property
    def scored(self) -> np.ndarray:
        """The samples that count: those that can be predicted, (starts, n)."""
        return self.growth.scored

    @property
    def notes(self) -> list[str]:
        """Limits of comparisons with this motion."""
        short = int((~self.scored).any(axis=1).sum())
        if not short:
            return []
        return [f"{short} of {len(self.scored)} starts count only as long as they can be predicted"]

    @property
    def runs(self) -> list[Run]:
        """The motion: the closed form, or the finest runs."""
        return self.level.runs if self.exact is None else self.exact.runs


class ReferenceRuns:
    """Makes the runs that a reference needs; counts what they cost in steps × (dofs + 2).

    shipped: settings of the scene. finest: the shortest time step that is to be judged [s].
    budget: the most that all runs may cost. weight: of a step (`cost.heaviness`).
    chains: the halvings of each integrator, coarsest first.
    size: of the scene [m], once runs were made.
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
        """The number of starts."""
        return len(self.runner.starts)

    @property
    def least(self) -> int:
        """The number of runs that `reference` makes, at least."""
        return (2 * (HALVINGS + 1) + 1 + DIRECTIONS) * self.starts

    @property
    def second(self) -> str:
        """The integrator that rk4 is compared with."""
        return "implicitfast" if self.shipped.law == "solref" else "semi-implicit"

    def settings(self, integrator: str, dt: float) -> Settings:
        """See `reference_settings`."""
        return reference_settings(self.shipped, integrator, dt)

    def cost(self, integrator: str, dt: float) -> float:
        """The cost of all starts at one step: steps of rk4, which solves four times, × (dofs + 2),
        of the usual weight."""
        schedule = self.runner.schedule
        steps = schedule.periods * schedule.steps(dt) * self.starts
        solves = 1.0 if integrator == "rk4" else 0.25
        return steps * (self.runner.model.nv + 2) * solves * self.weight

    def level(self, integrator: str, dt: float, bar: Progress) -> Level:
        """All starts at one step, until one fails."""
        job = partial(self.runner.run, self.settings(integrator, dt))
        runs = self.workers.until(lambda run: run.failure, job, self.runner.starts, bar)
        self.spent += self.cost(integrator, dt) * len(runs) / self.starts
        return Level(dt, integrator, runs)

    def reference(self, bar: Progress) -> Reference:
        """Two integrators at three halvings each, and perturbed runs; the better known one."""
        steps = self._steps()
        failures = [self._add_levels(name, steps, bar) for name in (self.second, "rk4")]
        if not self.chains:
            raise ValueError(
                f"the reference fails at dt = {steps[-1]:g} s{self.runner.schedule.driven}, so "
                f"there is nothing to compare with: {failures[1] or failures[0]}"
            )
        self._refuse_runaway(levels[-1] for levels in self.chains.values())
        # The finer of two where there are only those; rk4's, where it runs.
        base = list(self.chains.values())[-1][-3:][0]
        growth = self._growth(base, bar)
        for name, levels in self.chains.items():
            levels[1:] = [self._measured(*pair, growth) for pair in pairwise(levels)]
            self._add_coarser(name, growth, bar)
        reference = self._better_known(growth)
        if reference.known.high > EAGER * reference.level.high:
            # The other integrator's run decides the error, and two halvings of it are cheap.
            if reference.other not in ("", "rk4") and self._halve(reference.other, growth, bar):
                self._halve(reference.other, growth, bar)
            reference = self._better_known(growth, reference.level.integrator)
        return self._checked_exact(reference)

    def _add_levels(self, integrator: str, steps: Sequence[float], bar: Progress) -> str | None:
        """Adds an integrator's levels at steps, coarsest first; says why a coarser one failed.

        The finest is run first: what is coarser than one that fails is of no use, and a run that
        explodes can cost more than all that do not.
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
        """With the closed form, unless the converged run met something on the way."""
        exact = closed(self.runner, reference.level.runs)
        if exact is not None:
            check = errors(reference.level.runs, exact.runs, reference.scored).median
            if not check > FINER * reference.error + 1e-9 * self.size:
                exact = dataclasses.replace(exact, check=check)
                return dataclasses.replace(reference, exact=exact)
        return reference

    def _steps(self) -> list[float]:
        """Three halvings from twice the finest step, or from a coarser one where that costs too
        much; what is judged finer than these can ask for refinements."""
        chosen = [self.finest / 2**k for k in range(HALVINGS + 1)]
        for begin in BEGIN:
            steps = [self.finest * begin / 2**k for k in range(HALVINGS + 1)]
            if self._fits(steps[0]):
                chosen = steps
                if sum(self.cost("rk4", dt / 2) for dt in steps) <= self.budget:
                    break
        return chosen

    def growth(self, bar: Progress) -> tuple[Level, Growth]:
        """Every start and perturbed ones at one step: how long it can be predicted."""
        for dt in (self.finest / 2, self.finest / 8):
            for integrator in ("rk4", self.second):
                base = self.level(integrator, dt, bar)
                if not base.failed:
                    self._refuse_runaway([base])
                    return base, self._growth(base, bar)
        raise ValueError(f"the scene fails at dt = {dt:g} s: {base.failed}")

    def can_refine(self, reference: Reference) -> bool:
        """Whether a further halving is affordable and would still improve the reference."""
        done = reference.exact is not None or reference.high <= ROUNDING * self.size
        if done or reference.stalls > 1:
            return False
        levels = [self.chains[name][-1] for name in self._deciding(reference)]
        cost = sum(self.cost(level.integrator, level.dt / 2) for level in levels)
        return self.spent + cost <= self.budget

    def refined(self, reference: Reference, bar: Progress) -> Reference | None:
        """The reference with the step halved that decides its error; None if that run fails.

        Richardson's error falls with the reference's own step. The distance of two integrators
        falls with the step of the one that its last halving moved more, or of both.
        """
        for name in self._deciding(reference):
            if not self._halve(name, reference.growth, bar):
                return None
        better = self._better_known(reference.growth, reference.level.integrator)
        stalls = reference.stalls + 1 if better.high > STALLED * reference.high else 0
        return dataclasses.replace(better, stalls=stalls)

    def _deciding(self, reference: Reference) -> list[str]:
        """The integrators that a refinement halves."""
        chosen = reference.level.integrator
        if reference.order is not None or not reference.other:
            return [chosen]
        moved = {name: self.chains[name][-1].high for name in (chosen, reference.other)}
        return [name for name in moved if moved[name] >= max(moved.values()) / 2]

    def _halve(self, integrator: str, growth: Growth, bar: Progress) -> bool:
        """Adds a finer level to an integrator's; False if it fails."""
        coarse = self.chains[integrator][-1]
        fine = self.level(integrator, coarse.dt / 2, bar)
        if not fine.failed:
            self.chains[integrator].append(self._measured(coarse, fine, growth))
        return not fine.failed

    def _measured(self, coarse: Level, fine: Level, growth: Growth) -> Level:
        """The finer level with its distance to the coarser, as errors are measured."""
        return dataclasses.replace(fine, moved=errors(coarse.runs, fine.runs, growth.scored))

    def _fits(self, dt: float) -> bool:
        """Whether a step divides the period."""
        count = self.runner.schedule.period / dt
        return count >= 0.5 and abs(count - round(count)) < 1e-6 * count

    def _growth(self, base: Level, bar: Progress) -> Growth:
        """The growth of runs perturbed at a level, which gives the scene's size."""
        self.size = scene_size(self.runner.model.scene, base.runs)
        settings = self.settings(base.integrator, base.dt)
        self.spent += (1 + DIRECTIONS) * self.cost(base.integrator, base.dt)
        return growth(self.runner, settings, self.size, self.workers, bar)

    def _add_coarser(self, integrator: str, growth: Growth, bar: Progress) -> None:
        """Adds coarser levels where all there are have met rounding, to see an order at all."""
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
        """The integrator that its last halving moved least, or the one `kept`."""
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
    """The smallest value that is more than rounding in a scene of this size [m], or 0."""
    return min((value for value in values if value > ROUNDING * size), default=0.0)
