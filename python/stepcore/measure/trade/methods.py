"""The settings that a trade tries: time steps, a grid, families of methods, and single changes.

A *method* is all of the settings except the time step. Substeps need no setting of their own: k
substeps are a time step k times shorter with, at equal row updates, 1/k of the sweeps.
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from stepcore._core import Settings
from stepcore.engine.linear_maps import STAGED, STIFFNESS_IMPLICIT
from stepcore.engine.model import Model
from stepcore.engine.sim import Sim, unwatched

SMOOTH_LAW = ("semi-implicit", "euler", "implicitfast", "rk4")
COULOMB_LAW = ("explicit", "semi-implicit", "midpoint", "rk4")
# Numbers of sweeps: of a full grid, for each law; and of a search. Then the numbers of Newton
# iterations of a search.
SWEEPS_SMOOTH, SWEEPS_COULOMB = (5, 20, 100), (1, 5, 20)
SWEEPS, ITERATIONS = (1, 2, 3, 5, 8, 12, 20, 32, 50, 100, 200), (1, 2, 3, 5, 100)
TOLERANCES = (0.0, 1e-10, 1e-6, 1e-5, 1e-4, 1e-3, 1e-2)
# Without controls, the longest step tried, relative to the longest default step; and the least
# number of samples in the horizon.
LONGER, LEFT = 4, 25
# Largest number of digits of a round time step; and the largest factors by which a rounder step may
# be longer or shorter.
ROUND, WIDER, DENSER = 3, 1.2, 1.15


@dataclass(frozen=True)
class Steps:
    """The time steps that divide a control period into a whole number of steps (`pieces`).

    period: the control period [s].
    shipped: the shipped time step, which divides the period [s].
    """

    period: float
    shipped: float

    def dt(self, pieces: int) -> float:
        """Return the time step [s] for a number of steps in a period; the shipped one is exact."""
        return self.shipped if pieces == self.shipped_pieces else self.period / pieces

    @property
    def shipped_pieces(self) -> int:
        """The number of shipped steps in a period."""
        return round(self.period / self.shipped)

    def pieces(self, settings: Settings) -> int:
        """Return the number of steps in a period under these settings."""
        return round(self.period / settings.dt)

    def rounder(self, pieces: int) -> list[int]:
        """Return nearby numbers of steps whose time step is a rounder number, the roundest first.

        The list is empty if the step itself is round. Of equally round steps the longest comes
        first.

        >>> Steps(0.04, 0.01).rounder(21)  # 2 ms in place of 1.9047619 ms
        [20]
        """
        if digits(self.dt(pieces)) <= ROUND:
            return []
        near = range(math.ceil(pieces / WIDER), int(pieces * DENSER) + 1)
        rounder = [n for n in near if digits(self.dt(n)) <= ROUND]
        return sorted(rounder, key=lambda n: (digits(self.dt(n)), n))

    def at(self, settings: Settings, pieces: int) -> Settings:
        """Return the settings with another time step."""
        return settings.replace(dt=self.dt(pieces))

    def method(self, settings: Settings) -> Settings:
        """Return the settings with the shipped time step, which identify their method."""
        return settings.replace(dt=self.shipped)


def digits(dt: float) -> int:
    """Return the number of significant digits of a number, at most nine.

    >>> digits(0.002), digits(0.00125), digits(0.04 / 21)
    (1, 3, 8)
    """
    return len(f"{dt:.8e}".split("e")[0].replace(".", "").rstrip("0"))


def longest(period: float, horizon: float) -> float:
    """Return the longest step to try on a motion without controls [s], a multiple of the period."""
    times = LONGER
    while times > 1 and horizon < LEFT * times * period * (1 - 1e-9):
        times //= 2
    return times * period


@dataclass(frozen=True)
class Kind:
    """The properties of a scene that decide which settings are worth trying.

    shipped: the shipped settings, with steps of a fixed length.
    rows: the largest number of rows at once in the reference.
    friction: whether a contact can have friction in more than one direction.
    stiff: whether the scene has a spring, a tendon or a servo with position feedback.
    """

    shipped: Settings
    rows: int
    friction: bool
    stiff: bool

    @classmethod
    def of(cls, model: Model, rows: int) -> Kind:
        """Return the properties of a model; rows: see the class."""
        geoms = (g for g in model.scene.geoms if g.contype or g.conaffinity)
        friction = any(geom.condim > 1 for geom in geoms)
        slopes = unwatched(Sim(model)).element_slopes()
        pulls = [s.stiffness for e, s in slopes.items() if e.kind in ("spring", "actuator")]
        springs = any(np.any(np.diag(stiffness) > 0) for stiffness in pulls)
        tendons = any(np.any(tendon.stiffness) for tendon in model.scene.tendons)
        return cls(model.settings.replace(accuracy=None), rows, friction, springs or tendons)

    @property
    def smooth(self) -> bool:
        return bool(self.shipped.law == "solref")

    @property
    def integrators(self) -> list[str]:
        """The integrators to try, including the shipped one."""
        names = SMOOTH_LAW if self.smooth else COULOMB_LAW
        every = dict.fromkeys(
            [*names, *(STIFFNESS_IMPLICIT if self.stiff else ()), self.shipped.integrator]
        )
        return [name for name in every if not (self.shipped.sleep and name in STAGED)]

    @property
    def newton(self) -> dict[str, Any]:
        """The fields of Newton's method, in which sweeps only limit the iterations."""
        count = self.shipped.sweeps if self.shipped.solver == "newton" else 100
        return {"solver": "newton", "sweeps": count}


def grid(
    kind: Kind,
    dts: Sequence[float],
    integrators: Sequence[str] | None,
    solvers: Sequence[str] | None,
    sweeps: Sequence[int] | None,
    precisions: Sequence[str] | None,
) -> list[Settings]:
    """Return the full grid of settings, including the shipped ones; other fields are as shipped.

    Unless precisions are given, single precision is tried with only one number of sweeps.
    """
    methods = _methods(kind, solvers, sweeps)
    if precisions is not None:
        chosen = [method | {"precision": p} for p in precisions for method in methods]
    else:
        by_solver: dict[str, list[dict[str, Any]]] = {}
        for method in methods:
            by_solver.setdefault(method["solver"], []).append(method)
        middle = [some[len(some) // 2] for some in by_solver.values()]
        chosen = [method | {"precision": "f64"} for method in methods]
        chosen += [method | {"precision": "f32"} for method in middle]
    axes = itertools.product(dts, integrators or kind.integrators, chosen)
    points = [
        kind.shipped.replace(dt=dt, integrator=integrator, **method)
        for dt, integrator, method in axes
    ]
    return sorted(dict.fromkeys([kind.shipped, *points]), key=lambda s: -s.dt)


def _methods(
    kind: Kind, solvers: Sequence[str] | None, sweeps: Sequence[int] | None
) -> list[dict[str, Any]]:
    """Return the solvers, each with its numbers of sweeps.

    Without rows the solver has no effect and stays as shipped. A single row needs one sweep.
    """
    shipped, rows = kind.shipped, kind.rows
    if solvers is None:
        several = ["newton", "pgs"] if kind.smooth else ["pgs"]
        solvers = several if rows else [shipped.solver]
    methods: list[dict[str, Any]] = []
    for solver in solvers:
        if solver == "newton":
            methods.append(kind.newton)
            continue
        counts = {shipped.sweeps} if shipped.solver == "pgs" else set()
        if sweeps is not None:
            counts = set(sweeps)
        elif rows == 1 and not counts:
            counts = {1}
        elif rows > 1:
            counts |= set(SWEEPS_SMOOTH if kind.smooth else SWEEPS_COULOMB)
        # Sort "auto" last.
        ordered = sorted(counts, key=lambda count: math.inf if count == "auto" else count)
        methods += [{"solver": solver, "sweeps": count} for count in ordered]
    return methods or [{"solver": shipped.solver, "sweeps": shipped.sweeps}]


def families(kind: Kind) -> list[Settings]:
    """Return each integrator with each kind of solver; other fields are as shipped.

    Without rows the solver stays as shipped. A single row needs one sweep.
    """
    shipped = kind.shipped
    methods: list[dict[str, Any]] = [{}]
    if kind.rows:
        sweeps = shipped.sweeps if shipped.solver == "pgs" else 20
        single = min(sweeps, 1) if sweeps != "auto" else 1
        methods = [{"solver": "pgs", "sweeps": sweeps if kind.rows > 1 else single}]
        if kind.smooth:
            methods.append(kind.newton)
    chosen = [
        shipped.replace(integrator=name, precision="f64", **method)
        for name in kind.integrators
        for method in methods
    ]
    return list(dict.fromkeys(chosen))


def moves(settings: Settings, kind: Kind) -> list[Settings]:
    """Return settings that differ in one field other than time step, integrator and solver."""
    if not kind.rows:
        return []
    return [s for s in dict.fromkeys(_moves(settings, kind)) if s != settings]


def _moves(s: Settings, kind: Kind) -> Iterator[Settings]:
    rows = kind.rows
    if s.solver == "pgs" and rows > 1:
        for sweeps in _near(SWEEPS, 20 if s.sweeps == "auto" else s.sweeps, 2):
            yield s.replace(sweeps=sweeps)
        if s.cost_tolerance > 0:
            yield s.replace(cost_tolerance=0.0)
        yield s.replace(acceleration="none" if s.acceleration == "momentum" else "momentum")
    if s.solver == "newton":
        for sweeps in _near(ITERATIONS, 100 if s.sweeps == "auto" else s.sweeps, 2):
            yield s.replace(sweeps=sweeps)
    if rows > 1 or s.solver == "newton":
        yield s.replace(warm_start=not s.warm_start)
        for tolerance in _near(TOLERANCES, s.tolerance, 2):
            if tolerance > 0 or s.sweeps != "auto":
                yield s.replace(tolerance=tolerance)
    if kind.friction:
        yield s.replace(cone="elliptic" if s.cone == "pyramidal" else "pyramidal")


def _near(ladder: Sequence[Any], value: Any, reach: int) -> list[Any]:
    """Return the entries of a ladder next to a value, `reach` of them on either side."""
    rungs = sorted({*ladder, value})
    at = rungs.index(value)
    return rungs[max(0, at - reach) : at + reach + 1]
