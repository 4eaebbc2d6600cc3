"""The motion that is traded: starts and controls, the same for every setting.

Controls are held over a period that every time step divides, so that a coarse and a fine run
get the same forces at the same times.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from stepcore import checks
from stepcore.engine.model import Model
from stepcore.engine.sim import Sim
from stepcore.experiment.coordinates import Dofs, Start

# How far the seeded starts are from the keyframe: small beside a robot, long beside a step.
SHIFT, TURN = 1e-3, 1e-2  # [m], [rad]
SPEED, SPIN = 0.05, 0.1  # [m/s], [rad/s]
# Default time steps, over the shipped one.
FACTORS = (1 / 8, 1 / 4, 1 / 2, 1.0, 2.0, 4.0)
SAMPLES = 50
SINES = 3

# As in `Sim.run`: of (time, sim), the controls.
Control = Callable[[float, Sim], ArrayLike]


@dataclass(frozen=True)
class Motion:
    """Starts, controls and the common time grid.

    period: how long a control is held [s]; every time step divides it. periods: how many.
    every: periods between two samples. ctrl: shape (starts, periods, nu), or None where
    `control` gives it. undriven: motors that nothing tells how far they may go.
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


def time_steps(
    shipped: float, dts: Sequence[float] | None, control_dt: float | None, horizon: float
) -> tuple[list[float], float]:
    """The time steps to try, coarsest first, and the period that all of them divide [s]."""
    checks.seconds("horizon", horizon)
    if control_dt is not None and checks.seconds("control_dt", control_dt) > horizon:
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
                f"horizon = {horizon}: shorter than {shipped / 8:g} s, the finest step"
            )
        period = chosen[0]
    return chosen, period


def default_horizon(period: float) -> float:
    """Close to 1 s, and a whole number of samples of whole periods."""
    about = max(1, round(1.0 / period))
    near = sorted(
        range(max(1, about - about // 20), about + about // 20 + 1), key=lambda n: abs(n - about)
    )
    return period * next((n for n in near if n % _every(n) == 0), about)


def _common(dts: Sequence[float], horizon: float) -> float:
    """The shortest time that is a whole number of every step, as decimals read it [s]."""
    from fractions import Fraction

    parts = [Fraction(repr(dt)).limit_denominator(10**9) for dt in dts]
    period = Fraction(
        math.lcm(*(p.numerator for p in parts)), math.gcd(*(p.denominator for p in parts))
    )
    if period > horizon:
        raise ValueError(
            f"dts = {list(dts)}: first meet after {float(period):g} s, beyond the horizon of "
            f"{horizon:g} s; choose steps with a common multiple"
        )
    return float(period)


def _check_divide(dts: Sequence[float], period: float) -> None:
    for dt in dts:
        count = period / dt
        if round(count) < 1 or abs(count - round(count)) > 1e-6 * count:
            near = period / max(1, round(count))
            raise ValueError(
                f"dt = {dt:g} s: must divide the control period of {period:g} s "
                f"(nearest: {near:g} s)"
            )


def motion(
    model: Model,
    dofs: Dofs,
    *,
    horizon: float | None,
    period: float,
    key: str | int | None,
    ctrl: Any,
    control: Control | None,
    count: int,
    seed: int,
) -> Motion:
    """The motion of `count` seeded starts around a keyframe; the first is the keyframe itself.

    horizon: its length [s], about 1 s if None. period: of control [s].
    """
    if horizon is None:
        horizon = default_horizon(period)
    if control is not None and ctrl is not None:
        raise ValueError("control and ctrl are both given: a motion has one of them")
    if control is not None:
        checks.function("time", "sim")("trade", "control", control)
    checks.steps(
        horizon, model.settings.dt, count, f"from {count} start{'s' * (count > 1)} in steps"
    )
    periods = int(horizon / period + 1e-9)
    if periods < 1:
        raise ValueError(f"horizon = {horizon:g} s: shorter than one period of {period:g} s")
    every = _every(periods)
    periods -= periods % every
    rng = np.random.default_rng(seed)
    home, held = _home(model, key)
    starts = [home] + [_near(model, dofs, home, rng) for _ in range(count - 1)]
    undriven: tuple[str, ...] = ()
    if control is None and ctrl is None:
        drawn = [_smooth(dofs, held, periods, period, rng) for _ in starts]
        values = np.stack(drawn)
        undriven = tuple(
            motor.label
            for k, motor in enumerate(dofs.motors)
            if motor.ctrlrange is None and held[k] == 0
        )
    elif ctrl is not None:
        values = np.broadcast_to(
            _given(ctrl, periods, len(dofs.motors)), (count, periods, len(dofs.motors))
        )
    return Motion(
        period, periods, every, tuple(starts), None if control else values, control, undriven
    )


def _home(model: Model, key: str | int | None) -> tuple[Start, np.ndarray]:
    """A key's state and controls; by default the first key's, or the scene's pose at rest."""
    if key is None and not model.keys:
        return Start(model.qpos0, np.zeros(model.nv)), np.zeros(model.nu)
    frame = model.keys[0 if key is None else model.index("key", key)]
    return Start(frame.qpos, frame.qvel), frame.ctrl


def _every(periods: int) -> int:
    """Periods between samples: about 50 samples, and if possible none of the horizon left over."""
    whole = [n for n in range(1, periods + 1) if periods % n == 0]
    best = min(whole, key=lambda n: abs(math.log(periods / n / SAMPLES)))
    near = max(1, round(periods / SAMPLES))
    return best if periods <= SAMPLES or 20 <= periods / best <= 3 * SAMPLES else near


def _given(ctrl: Any, periods: int, nu: int) -> np.ndarray:
    """The user's controls, one row a period; the last is held if there are too few."""
    try:
        values = np.asarray(ctrl, float)
    except (TypeError, ValueError):
        raise checks.refuse("trade", "ctrl", ctrl, f"numbers of shape (n, {nu})") from None
    if values.ndim == 1 and nu == 1:
        values = values[:, None]
    if values.ndim != 2 or values.shape[1] != nu or len(values) == 0:
        raise ValueError(f"ctrl has shape {values.shape}: must be (n, {nu}), one row a period")
    bad = np.argwhere(~np.isfinite(values))
    if len(bad):
        row, column = bad[0]
        raise ValueError(f"ctrl[{row}, {column}] = {values[row, column]}: must be finite")
    return values[np.minimum(np.arange(periods), len(values) - 1)]


def _smooth(
    dofs: Dofs, held: np.ndarray, periods: int, period: float, rng: np.random.Generator
) -> np.ndarray:
    """A few sines in every motor's range, around the keyframe's control; shape (periods, nu).

    A motor without a range swings by a quarter of the keyframe's control.
    """
    times = period * np.arange(periods)
    values = np.empty((periods, len(dofs.motors)))
    for k, motor in enumerate(dofs.motors):
        hertz = rng.uniform(0.3, 3.0, SINES)
        phase = rng.uniform(0.0, 2 * math.pi, SINES)
        share = rng.dirichlet(np.ones(SINES))
        wave = np.sin(2 * math.pi * np.outer(times, hertz) + phase) @ share
        if motor.ctrlrange is None:
            values[:, k] = held[k] + 0.25 * abs(held[k]) * wave
        else:
            low, high = motor.ctrlrange
            centre = held[k] if held[k] else (low + high) / 2
            values[:, k] = np.clip(centre + 0.4 * (high - low) * wave, low, high)
    return values


def _near(model: Model, dofs: Dofs, home: Start, rng: np.random.Generator) -> Start:
    """A start near `home`, within the joints' ranges and no deeper in contact than it.

    By 0.1 mm at most where contacts are springs. A law that undoes a share of an overlap in a step
    throws a body out of it at a speed that grows as 1/dt: there, no deeper at all.
    """
    sim = Sim(model)

    def depth(start: Start) -> float:
        sim.qpos[:] = start.qpos
        sim.forward()
        dist = sim.contacts["dist"]
        return -float(dist.min()) if len(dist) else 0.0

    slack = 1e-4 if model.settings.law in ("solref", "penalty") else 1e-12
    allowed = max(0.0, depth(home)) + slack
    tried = []
    for _ in range(64):
        step, rate = dofs.drawn(rng, SHIFT, TURN), dofs.drawn(rng, SPEED, SPIN)
        start = Start(dofs.inside(dofs.moved(home.qpos, step)), home.qvel + rate)
        tried.append((depth(start), start))
        if tried[-1][0] <= allowed:
            return start
    return min(tried, key=lambda pair: pair[0])[1]
