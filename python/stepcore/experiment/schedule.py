"""A motion made definite for one model: its starts, its controls and the common time grid.

Controls are held over a period that every time step divides, so that a coarse and a fine run get
the same forces at the same times.
"""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Sequence
from dataclasses import dataclass
from fractions import Fraction

import numpy as np

from stepcore import checks
from stepcore.engine.model import Model
from stepcore.experiment import starts as drawing
from stepcore.experiment.control import Control
from stepcore.experiment.coordinates import Coordinates, Start
from stepcore.experiment.motion import Motion

# Default time steps, over the shipped one.
FACTORS = (1 / 8, 1 / 4, 1 / 2, 1.0, 2.0, 4.0)
SAMPLES = 50
# The motion of a measurement where nobody says otherwise: about how long [s], how many starts.
HORIZON, STARTS = 1.0, 8


@dataclass(frozen=True, eq=False)
class Schedule:
    """Starts, controls and the time grid that all runs of a measurement share.

    period: how long a control is held [s]; every time step divides it. periods: how many.
    every: periods between two samples. ctrl: shape (starts, periods, nu), or None where
    `control` gives it. undriven: actuators without a control range, which are held still.
    """

    period: float
    periods: int
    every: int
    starts: tuple[Start, ...]
    ctrl: np.ndarray | None
    control: Control | None
    undriven: tuple[str, ...] = ()

    @property
    def horizon(self) -> float:
        """Simulated time [s]."""
        return self.period * self.periods

    @property
    def times(self) -> np.ndarray:
        """When samples are taken [s]; the start is not one."""
        return self.period * np.arange(self.every, self.periods + 1, self.every)

    def steps(self, dt: float) -> int:
        """Steps in one period."""
        return round(self.period / dt)

    def part(self, first: int, last: int | None = None) -> Schedule:
        """The same with some of its starts."""
        ctrl = None if self.ctrl is None else self.ctrl[first:last]
        return dataclasses.replace(self, starts=self.starts[first:last], ctrl=ctrl)


def scheduled(
    motion: Motion, model: Model, period: float, starts: int | None = None, horizon: float = HORIZON
) -> Schedule:
    """The schedule of a motion: seeded starts around a keyframe, the first at the keyframe itself.

    period: of control [s]. starts: how many, where not those of the motion. horizon: about how
    long where the motion does not say [s].
    """
    length = default_horizon(period, horizon) if motion.horizon is None else motion.horizon
    count = starts or motion.starts or STARTS
    checks.steps(
        length, model.settings.dt, count, f"from {count} start{'s' * (count > 1)} in steps"
    )
    periods = int(length / period + 1e-9)
    if periods < 1:
        raise ValueError(f"horizon = {length:g} s: shorter than one period of {period:g} s")
    every = _every(periods)
    periods -= periods % every
    rng = np.random.default_rng(motion.seed)
    coordinates = Coordinates(model)
    home, held = drawing.home(model, motion.key)
    begin = [home]
    begin += [drawing.near(model, coordinates, home, rng) for _ in range(count - 1)]
    ctrl, undriven = None, []
    if motion.ctrl is not None:
        given = drawing.given(motion.ctrl, periods, model.nu)
        ctrl = np.broadcast_to(given, (count, periods, model.nu))
    elif motion.control is None:
        values = [drawing.smooth(model, held, periods, period, rng) for _ in begin]
        ctrl, undriven = np.stack(values), drawing.undriven(model, held)
    return Schedule(period, periods, every, tuple(begin), ctrl, motion.control, tuple(undriven))


def time_steps(
    shipped: float, dts: Sequence[float] | None, control_dt: float | None, horizon: float
) -> tuple[list[float], float]:
    """The time steps to try, coarsest first, and the period that all of them divide [s]."""
    if control_dt is not None and control_dt > horizon:
        raise ValueError(f"control_dt = {control_dt:g}: must be at most the horizon, {horizon:g} s")
    if dts is not None:
        chosen = sorted({checks.seconds("dts", dt) for dt in dts} | {shipped}, reverse=True)
        period = control_dt or _common(chosen, horizon)
        _check_divide(chosen, period)
    elif control_dt is not None:
        # The shipped step as it is; its neighbours moved to the nearest that divide the period.
        _check_divide([shipped], control_dt)
        wanted = [shipped * factor for factor in FACTORS]
        parts = {max(1, round(control_dt / dt)) for dt in wanted if dt <= 1.5 * control_dt}
        chosen, period = sorted((control_dt / n for n in parts), reverse=True), control_dt
        chosen = [shipped if math.isclose(dt, shipped, rel_tol=1e-9) else dt for dt in chosen]
    else:
        chosen = [shipped * f for f in reversed(FACTORS) if shipped * f <= horizon]
        if not chosen:
            raise ValueError(
                f"horizon = {horizon:g} s: shorter than {shipped / 8:g} s, the finest step"
            )
        period = chosen[0]
    return chosen, period


def default_horizon(period: float, horizon: float = 1.0) -> float:
    """Close to `horizon` [s], and a whole number of samples of whole periods."""
    about = max(1, round(horizon / period))
    near = sorted(
        range(max(1, about - about // 20), about + about // 20 + 1), key=lambda n: abs(n - about)
    )
    return period * next((n for n in near if n % _every(n) == 0), about)


def _common(dts: Sequence[float], horizon: float) -> float:
    """The shortest time that is a whole number of every step, as decimals read it [s]."""
    parts = [Fraction(repr(dt)).limit_denominator(10**9) for dt in dts]
    period = Fraction(
        math.lcm(*(p.numerator for p in parts)), math.gcd(*(p.denominator for p in parts))
    )
    if period > horizon:
        raise ValueError(
            f"dts = {list(dts)}: their least common multiple is {float(period):g} s, longer than "
            f"the horizon of {horizon:g} s; choose steps with a smaller one"
        )
    return float(period)


def _check_divide(dts: Sequence[float], period: float) -> None:
    for dt in dts:
        count = period / dt
        if round(count) < 1 or abs(count - round(count)) > 1e-6 * count:
            near = period / max(1, round(count))
            raise ValueError(
                f"dt = {dt:g} s: must divide the control period of {period:g} s "
                f"(nearest: {near:g} s; control_dt sets the period)"
            )


def _every(periods: int) -> int:
    """Periods between samples: about 50 samples, and if possible none of the horizon left over."""
    whole = [n for n in range(1, periods + 1) if periods % n == 0]
    best = min(whole, key=lambda n: abs(math.log(periods / n / SAMPLES)))
    near = max(1, round(periods / SAMPLES))
    return best if periods <= SAMPLES or 20 <= periods / best <= 3 * SAMPLES else near
