"""The settings that the search tries: families to begin with, then one setting changed at a time.

Substeps are no setting of their own: k substeps are a time step k times shorter and, at equal row
updates, a k-th of the sweeps. Trying dt and sweeps covers them.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import Any

from stepcore._core import Settings
from stepcore.measure.trade.settings import integrators_for
from stepcore.scene.scene import Scene

SWEEPS = (1, 2, 3, 5, 8, 12, 20, 32, 50, 100, 200)
TOLERANCES = (0.0, 1e-10, 1e-6, 1e-5, 1e-4, 1e-3, 1e-2)
# Without controls, steps up to so many times the largest default one are tried, as long as so many
# samples are left in the horizon.
LONGER, LEFT = 4, 25
# A time step is round if it has so many digits. A rounder one is looked for among steps at most
# WIDER times longer and DENSER times shorter.
ROUND, WIDER, DENSER = 3, 1.2, 1.15
# Numbers of Newton iterations.
ITERATIONS = (1, 2, 3, 5, 100)


@dataclass(frozen=True)
class Steps:
    """Time steps that divide the control period, by how many are in it (`pieces`).

    period: of control [s]. shipped: one of the time steps [s].
    """

    period: float
    shipped: float

    def dt(self, pieces: int) -> float:
        """The time step [s] of which so many are in a period; the shipped one to the bit."""
        return self.shipped if pieces == self.own else self.period / pieces

    @property
    def own(self) -> int:
        """Shipped steps in a period."""
        return round(self.period / self.shipped)

    def pieces(self, settings: Settings) -> int:
        """Steps in a period under these settings."""
        return round(self.period / settings.dt)

    def rounder(self, pieces: int) -> list[int]:
        """Numbers of steps near this one whose time step is a rounder number, the roundest first.

        None where the step itself is round. Of equally round ones the longest first.

        >>> Steps(0.04, 0.01).rounder(21)  # 2 ms in place of 1.9047619 ms
        [20]
        """
        if digits(self.dt(pieces)) <= ROUND:
            return []
        near = range(math.ceil(pieces / WIDER), int(pieces * DENSER) + 1)
        rounder = [n for n in near if digits(self.dt(n)) <= ROUND]
        return sorted(rounder, key=lambda n: (digits(self.dt(n)), n))

    def at(self, settings: Settings, pieces: int) -> Settings:
        """The settings with another time step."""
        return settings.replace(dt=self.dt(pieces))


def digits(dt: float) -> int:
    """How many significant digits a number has, of nine at most.

    >>> digits(0.002), digits(0.00125), digits(0.04 / 21)
    (1, 3, 8)
    """
    return len(f"{dt:.8e}".split("e")[0].replace(".", "").rstrip("0"))


def longest(period: float, horizon: float) -> float:
    """The longest step to try on a motion without controls [s], a multiple of the period."""
    times = LONGER
    while times > 1 and horizon < LEFT * times * period * (1 - 1e-9):
        times //= 2
    return times * period


def families(shipped: Settings, rows: int, stiff: bool = False) -> list[Settings]:
    """Each integrator with each kind of solver, all else as shipped.

    rows: the most alive at once in the reference; without any the solver stays as shipped, and
    for one alone one sweep is all. stiff: as in `settings.grid`.
    """
    smooth = shipped.law == "solref"
    methods: list[dict[str, Any]] = [{}]
    if rows:
        own = shipped.sweeps if shipped.solver == "pgs" else 20
        single = min(own, 1) if own != "auto" else 1
        methods = [{"solver": "pgs", "sweeps": own if rows > 1 else single}]
        if smooth:
            count = shipped.sweeps if shipped.solver == "newton" else 100
            methods.append({"solver": "newton", "sweeps": count})
    chosen = [
        shipped.replace(integrator=name, precision="f64", **method)
        for name in integrators_for(shipped, stiff)
        for method in methods
    ]
    return list(dict.fromkeys(chosen))


def moves(settings: Settings, rows: int, friction: bool) -> list[Settings]:
    """Settings that differ in one field other than time step, integrator and solver."""
    if not rows:
        return []
    return [s for s in dict.fromkeys(_moves(settings, rows, friction)) if s != settings]


def _moves(s: Settings, rows: int, friction: bool) -> Iterator[Settings]:
    if s.solver == "pgs" and rows > 1:
        for sweeps in _near(SWEEPS, 20 if s.sweeps == "auto" else s.sweeps, 2):
            yield s.replace(sweeps=sweeps)
        yield s.replace(acceleration="none" if s.acceleration == "momentum" else "momentum")
    if s.solver == "newton":
        for sweeps in _near(ITERATIONS, 100 if s.sweeps == "auto" else s.sweeps, 2):
            yield s.replace(sweeps=sweeps)
    if rows > 1 or s.solver == "newton":
        yield s.replace(warm_start=not s.warm_start)
        for tolerance in _near(TOLERANCES, s.tolerance, 2):
            if tolerance > 0 or s.sweeps != "auto":
                yield s.replace(tolerance=tolerance)
    if friction:
        yield s.replace(cone="elliptic" if s.cone == "pyramidal" else "pyramidal")


def _near(ladder: Sequence[Any], value: Any, reach: int) -> list[Any]:
    """The entries of a ladder next to a value, so many on either side."""
    rungs = sorted({*ladder, value})
    at = rungs.index(value)
    return rungs[max(0, at - reach) : at + reach + 1]


def slides(scene: Scene) -> bool:
    """Whether some contact of the scene could have friction in more than one direction."""
    return any(g.condim > 1 for g in scene.geoms if g.contype or g.conaffinity)
