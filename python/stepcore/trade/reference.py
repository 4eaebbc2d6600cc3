"""The scene's own converged motion, and how well it is known.

The step is halved until two runs of the best integrator agree to a tenth of the smallest error
that the table shows, or the budget is spent. Rows are solved to rounding. What is modelled, the
softness of contacts above all, stays the scene's.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import partial

import numpy as np

from stepcore._core import Settings
from stepcore.jobs import each
from stepcore.progress import Progress
from stepcore.trade.dofs import Start
from stepcore.trade.errors import errors, predictable
from stepcore.trade.run import Course, Path

# A tenth: the reference's error may then change the last digit of an error shown, no more.
FINER = 10.0
NEARBY, GROWTH = 1e-10, 1e4
# Halvings that no longer halve the distance have met rounding.
STALLED = 0.9


@dataclass
class Level:
    """All starts at one time step.

    distance: to the level of twice the step [m], measured as errors are.
    largest: the same of any body, sample and start [m]; high: root mean square of the worst
    start [m]; angle: in orientation [rad].
    """

    dt: float
    integrator: str
    paths: list[Path]
    distance: float = np.inf
    largest: float = np.inf
    high: float = np.inf
    angle: float = np.inf

    @property
    def failed(self) -> str | None:
        return next((path.failure for path in self.paths if path.failure), None)


@dataclass
class Reference:
    """The converged motion of a scene.

    error [m], angle [rad]: distance between it and the run at twice its step, as errors in the
    table are measured. agreement [m]: distance to a second integrator, whose own halving moved
    it by `other_error`. scored: samples that count, (starts, n).
    """

    settings: Settings
    level: Level
    levels: list[Level]
    agreement: float
    other: str
    other_error: float
    scored: np.ndarray

    @property
    def error(self) -> float:
        return self.level.distance

    @property
    def largest(self) -> float:
        return self.level.largest

    @property
    def high(self) -> float:
        return self.level.high

    @property
    def angle(self) -> float:
        return self.level.angle

    @property
    def paths(self) -> list[Path]:
        return self.level.paths


class Search:
    """Looks for the reference of a course; counts what it spends in steps × (dofs + 2)."""

    def __init__(
        self, course: Course, shipped: Settings, finest: float, budget: float, threads: int
    ):
        self.course, self.shipped, self.budget, self.threads = course, shipped, budget, threads
        self.finest, self.spent = finest, 0.0

    def settings(self, integrator: str, dt: float) -> Settings:
        """Reference settings: rows solved to rounding, as the law allows."""
        solver = "newton" if self.shipped.law == "solref" else "pgs"
        sweeps = 200 if solver == "newton" else 20_000
        return self.shipped.replace(
            dt=dt,
            integrator=integrator,
            solver=solver,
            sweeps=sweeps,
            tolerance=1e-13,
            warm_start=True,
            precision="f64",
        )

    def cost(self, dt: float) -> float:
        motion = self.course.motion
        steps = motion.periods * motion.steps(dt) * len(motion.starts)
        return steps * (self.course.dofs.nv + 2)

    def level(self, integrator: str, dt: float, bar: Progress) -> Level:
        """All starts at one step."""
        settings = self.settings(integrator, dt)
        self.spent += self.cost(dt)
        starts = range(len(self.course.motion.starts))
        paths = each(partial(self.course.run, settings), starts, bar=bar, threads=self.threads)
        return Level(dt, integrator, paths)

    def first(self, bar: Progress) -> Reference:
        """Two integrators at two steps; the one that its own halving moves less is refined."""
        second = "implicitfast" if self.shipped.law == "solref" else "semi-implicit"
        dt = self.finest / 2
        found = []
        scored: np.ndarray | None = None
        for integrator in ("rk4", second):
            coarse = self.level(integrator, dt, bar)
            if coarse.failed is None and scored is None:
                scored = self.scored(coarse, bar)
            fine = self.level(integrator, dt / 2, bar)
            if not coarse.failed and not fine.failed:
                assert scored is not None
                self.compare(fine, coarse, scored)
                found.append((coarse, fine))
        if not found:
            raise ValueError(
                f"the reference fails at dt = {dt / 2:g} s, so there is nothing to compare with: "
                f"{fine.failed or coarse.failed}"
            )
        assert scored is not None
        found.sort(key=lambda pair: pair[1].distance)
        best, rest = found[0], found[-1]
        apart = errors(best[1].paths, rest[1].paths, scored).position if len(found) > 1 else np.nan
        return Reference(
            settings=self.settings(best[1].integrator, dt / 2),
            level=best[1],
            levels=[*best],
            agreement=apart,
            other=rest[1].integrator if len(found) > 1 else "",
            other_error=rest[1].distance,
            scored=scored,
        )

    def scored(self, level: Level, bar: Progress) -> np.ndarray:
        """The samples before runs that start 1e-10 apart separate by more than 1e4 times."""
        course = self.course
        motion, dofs = course.motion, course.dofs
        rng = np.random.default_rng(0)
        near, apart = [], []
        for start in motion.starts:
            change = NEARBY * rng.choice([-1.0, 1.0], dofs.nv)
            near.append(Start(dofs.moved(start.qpos, change), start.qvel))
            both = np.array([start.qpos, near[-1].qpos])
            com = course.poses(both, np.zeros((2, dofs.nv))).com
            moved = np.linalg.norm(com[1] - com[0], axis=-1).max(initial=0.0)
            apart.append(max(float(moved), NEARBY))
        shifted = type(motion)(**{**motion.__dict__, "starts": tuple(near)})
        other = Search(
            Course(course.model, dofs, shifted), self.shipped, self.finest, 0, self.threads
        )
        runs = other.level(level.integrator, level.dt, bar)
        self.spent += other.spent
        if runs.failed:
            return np.ones((len(near), len(motion.times)), bool)
        return predictable(level.paths, runs.paths, apart, GROWTH)

    def compare(self, fine: Level, coarse: Level, scored: np.ndarray) -> None:
        """Sets the distance of a level to the one at twice its step."""
        moved = errors(coarse.paths, fine.paths, scored)
        fine.distance, fine.largest = moved.position, moved.position_max
        fine.high, fine.angle = moved.high, moved.angle

    def can_refine(self, reference: Reference) -> bool:
        """Whether a further halving is affordable and would still tell something."""
        level = reference.level
        if self.spent + self.cost(level.dt / 2) > self.budget:
            return False
        before = [known.distance for known in reference.levels if np.isfinite(known.distance)]
        return len(before) < 2 or before[-1] < STALLED * before[-2]

    def refine(self, reference: Reference, bar: Progress) -> bool:
        """Halves the reference's step; False if that run fails."""
        coarse = reference.level
        fine = self.level(coarse.integrator, coarse.dt / 2, bar)
        if fine.failed:
            return False
        self.compare(fine, coarse, reference.scored)
        reference.levels.append(fine)
        # Past rounding a finer run is not a better one.
        if fine.distance <= coarse.distance:
            reference.level = fine
            reference.settings = self.settings(fine.integrator, fine.dt)
        return True


def smallest(values: Sequence[float]) -> float:
    """The smallest that is not zero, or 0."""
    return min((value for value in values if value > 0), default=0.0)
