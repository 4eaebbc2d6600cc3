"""The schedule of a motion for one model: starts, controls and a common time grid.

A control period is a multiple of every time step. Coarse and fine runs therefore get the same
controls at the same times. A log has other times: see `stepcore.experiment.control_table`.
"""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from fractions import Fraction
from functools import cached_property, partial
from typing import Any

import numpy as np

from stepcore import checks
from stepcore._core import SimulationError
from stepcore.engine.control import Control, control_name, new_control
from stepcore.engine.coordinates import Coordinates
from stepcore.engine.model import Model
from stepcore.engine.sim import Sim
from stepcore.engine.start import Start
from stepcore.experiment.change import Change
from stepcore.experiment.control_table import MOST_DT, ControlLog, Controls, PositionTable
from stepcore.experiment.default_motion import MotionRequest, default_motion, following_controls
from stepcore.experiment.motion import Motion
from stepcore.report import units
from stepcore.report.units import seconds

# Default time steps, relative to the shipped step.
FACTORS = (1 / 8, 1 / 4, 1 / 2, 1.0, 2.0, MOST_DT)
# The approximate number of samples.
SAMPLES = 50
# The default horizon, approximately [s], and the default number of starts.
HORIZON, STARTS = 1.0, 8
# The largest velocity of random starts.
SPEED, SPIN = 0.05, 0.1  # [m/s], [rad/s]
# The most steps in a control period, relative to the shipped ones. A joint that damping stops
# within the shortest of them is locked, and starts at rest: the base of gymnasium_robotics' fetch
# takes 6e-7 of a step, and a speed would tear it apart, in MuJoCo too; moving joints take 7e-3.
FINEST = 256


@dataclass(frozen=True, eq=False)
class Schedule:
    """Starts, controls and the time grid that all runs of a measurement share.

    period: the control period [s], a multiple of every time step.
    periods: the number of control periods.
    every: the number of periods between two samples.
    starts: the initial states.
    controls: the input of the motion.
    most: evaluations of the forces after which a run with adaptive steps has failed.
    _models: the models that the controls drive, made once and shared by parts of a schedule.
    """

    period: float
    periods: int
    every: int
    starts: tuple[Start, ...]
    controls: Controls
    most: float = math.inf
    _models: dict[Any, Model] = field(default_factory=dict, repr=False)

    @property
    def horizon(self) -> float:
        """Simulated time of a run [s]."""
        return self.period * self.periods

    @property
    def times(self) -> np.ndarray:
        """Times of the samples [s], (n,); the start is not a sample."""
        return self.period * np.arange(self.every, self.periods + 1, self.every)

    @property
    def indices(self) -> range:
        """Indices of the starts."""
        return range(len(self.starts))

    @property
    def control(self) -> Control | None:
        """The user's control function, or None."""
        return self.controls.function

    @property
    def driven(self) -> str:
        """The user's control function and its sampling period, in words; "" without a function."""
        if self.control is None:
            return ""
        return f" under {control_name(self.control)}, sampled every {seconds(self.period)}"

    @property
    def drive(self) -> str:
        """The default controls in words; "" if the user gave controls."""
        return self.controls.words

    @property
    def notes(self) -> list[str]:
        """Sentences on limitations of the default controls."""
        return list(self.controls.remarks)

    @property
    def change(self) -> Change:
        """The change that the controls need in the model: servos that replace its motors."""
        return Change(servos=self.controls.servos)

    def driven_model(self, model: Model) -> Model:
        """Return the model that the controls drive: with the servos that they need."""
        if not self.controls.servos:
            return model
        key = model.core, self.change
        if key not in self._models:
            self._models[key] = self.change.of(model)
        return self._models[key].with_settings(model.settings)

    def __getstate__(self) -> dict[str, Any]:
        # An executor pickles in another thread, while this thread may compile.
        return {**vars(self), "_models": {}}

    def function(self) -> Control | None:
        """Return the control function of one run, or None."""
        return None if self.control is None else new_control(self.control)

    def steps(self, dt: float) -> int:
        """Return the number of time steps in one control period; dt: [s]."""
        return round(self.period / dt)

    def rows(self, starts: Sequence[int], dt: float) -> tuple[np.ndarray | None, int]:
        """Return the controls from some starts, and the number of steps for which a row is held.

        dt: time step [s]. See `Controls.rows`.
        """
        return self.controls.rows(starts, dt, self.periods * self.steps(dt))

    def part(self, first: int, last: int | None = None) -> Schedule:
        """Return the schedule with the starts from `first` up to, but not including, `last`."""
        return self.picked(range(len(self.starts))[first:last])

    def picked(self, indices: Sequence[int]) -> Schedule:
        """Return the schedule with some of its starts, which may be repeated."""
        starts = tuple(self.starts[k] for k in indices)
        return dataclasses.replace(self, starts=starts, controls=self.controls.picked(indices))

    def joined(self, other: Schedule) -> Schedule:
        """Return these starts and another schedule's, of the same motion, as one schedule."""
        starts = (*self.starts, *other.starts)
        return dataclasses.replace(
            self, starts=starts, controls=self.controls.joined(other.controls)
        )

    @property
    def log(self) -> ControlLog | None:
        """Controls that change within periods; None if they are constant in each period."""
        log = self.controls.log
        return None if log is None or log.ends_on(self.period) else log

    @cached_property
    def ctrl(self) -> np.ndarray | None:
        """The means of the controls by period, (starts, periods, nu); None for a function."""
        if self.controls.log is None:
            return None
        rows = self.controls.log.steps(0.0, self.period, self.periods)
        return np.broadcast_to(rows, (len(self.starts), *rows.shape[-2:]))


def scheduled(
    motion: Motion, model: Model, period: float, starts: int | None = None, horizon: float = HORIZON
) -> Schedule:
    """Return the schedule of a motion: the keyframe and random starts near it, and the controls.

    period: the control period [s].
    starts: the number of starts; by default the motion's.
    horizon: the horizon if the motion has none [s]; rounded to a whole number of samples.

    Raises ValueError if the horizon is shorter than a period, or the run has too many steps.
    """
    first, key_ctrl = home(model, motion.key)
    if motion.from_log and motion.table is not None:
        first = motion.table.start(model, first)

    def drive(begin: Sequence[Start], periods: int) -> Controls:
        constant = motion.control_dt is not None
        request = MotionRequest(first, key_ctrl, begin, motion.seed, period, periods, constant)
        return driving(motion, model, request)

    slack = 1e-4 if model.settings.law in ("solref", "penalty") else 1e-12
    moving = ~locked(model, first)
    nearby = partial(random_start, Coordinates(model), first, moving, overlap_of(model), slack)
    return laid_out(motion, model.settings.dt, first, nearby, drive, period, starts, horizon)


def laid_out(
    motion: Motion,
    dt: float,
    first: Start,
    nearby: Callable[[np.random.Generator], Start],
    drive: Callable[[Sequence[Start], int], Controls],
    period: float,
    starts: int | None,
    horizon: float,
) -> Schedule:
    """Return the schedule from a first start and random starts near it; see `random_start`.

    dt: the shipped time step [s]. drive: returns the controls from the starts and the number of
    periods. The rest is as in `scheduled`.
    """
    count = starts or motion.starts or STARTS
    length = default_horizon(period, horizon) if motion.horizon is None else motion.horizon
    checks.steps(length, dt, count, f"runs from {count} start{'s' * (count > 1)}")
    periods = int(length / period + 1e-9)
    if periods < 1:
        raise ValueError(f"horizon = {length:g} s: shorter than one period of {period:g} s")
    every = _every(periods)
    periods -= periods % every
    rng = np.random.default_rng(motion.seed)
    begin = (first, *(nearby(rng) for _ in range(count - 1)))
    return Schedule(period, periods, every, begin, drive(begin, periods))


def driving(motion: Motion, model: Model, request: MotionRequest) -> Controls:
    """Return the controls of a motion: those that a user gave, or the controls of its kind."""
    if isinstance(motion.ctrl, PositionTable):
        return following_controls(motion.ctrl, model, request)
    if motion.is_users:
        return user_controls(motion, model, request.key_ctrl, request.period)
    return default_motion(model, motion.kind, request)


def user_controls(motion: Motion, model: Any, key_ctrl: np.ndarray, period: float) -> Controls:
    """Return the function or the rows that a user gave; see `driving` and `ControlTable.log`."""
    if motion.table is None:
        return Controls(function=motion.control)
    # With a control period, held rows take effect at the beginning of each period.
    linear, sampled = motion.interpolation == "linear", motion.control_dt is not None
    log = motion.table.control_log(model, key_ctrl, period, linear, sampled)
    remarks = motion.table.clamping(model, log.rows) if isinstance(model, Model) else ()
    return Controls(log, remarks=remarks)


def time_steps(
    shipped: float, dts: Sequence[float | str] | None, control_dt: float | None, horizon: float
) -> tuple[list[float], float]:
    """Return the time steps to try, coarsest first, and a control period they all divide [s].

    shipped: the scene's time step, which is always included [s].
    dts: the time steps to try [s]; by default multiples of the shipped step.
    control_dt: the control period [s]; by default a common multiple of the time steps.
    horizon: the simulated time [s].

    Raises ValueError for a step that does not divide the period, and a period beyond the horizon.
    """
    if control_dt is not None and control_dt > horizon:
        raise ValueError(f"control_dt = {control_dt:g}: must be at most the horizon, {horizon:g} s")
    wanted = [shipped * factor for factor in reversed(FACTORS)]
    if dts is not None:
        chosen = sorted({units.time("dts", dt) for dt in dts} | {shipped}, reverse=True)
        period = control_dt or _common(chosen, horizon)
        check_divide(chosen, period)
    elif control_dt is not None:
        # The shipped step is kept; the others are rounded to divisors of the period.
        check_divide([shipped], control_dt)
        parts = {max(1, round(control_dt / dt)) for dt in wanted if dt <= 1.5 * control_dt}
        chosen, period = sorted((control_dt / n for n in parts), reverse=True), control_dt
        chosen = [shipped if math.isclose(dt, shipped, rel_tol=1e-9) else dt for dt in chosen]
    else:
        chosen = [dt for dt in wanted if dt <= horizon]
        if not chosen:
            raise ValueError(
                f"horizon = {horizon:g} s: shorter than {wanted[-1]:g} s, the finest step"
            )
        period = chosen[0]
    return chosen, period


def default_horizon(period: float, horizon: float = 1.0) -> float:
    """Return the time nearest to `horizon` that is a whole number of sampling intervals [s]."""
    about = max(1, round(horizon / period))
    near = range(max(1, about - about // 20), about + about // 20 + 1)
    divisible = [n for n in near if n % _every(n) == 0]
    return period * min(divisible, key=lambda n: abs(n - about), default=about)


def _common(dts: Sequence[float], horizon: float) -> float:
    """Return the least common multiple of time steps, as decimal numbers [s]."""
    parts = [Fraction(repr(dt)).limit_denominator(10**9) for dt in dts]
    period = math.lcm(*(p.numerator for p in parts)) / math.gcd(*(p.denominator for p in parts))
    if period > horizon:
        raise ValueError(
            f"dts = {list(dts)}: their least common multiple is {period:g} s, longer than "
            f"the horizon of {horizon:g} s; choose steps with a smaller one"
        )
    return period


def divides(dt: float, period: float) -> bool:
    """Return whether a period is a whole number of time steps, within rounding."""
    count = period / dt
    return round(count) >= 1 and abs(count - round(count)) <= 1e-6 * count


def often(period: float, dt: float, horizon: float) -> float:
    """Halve a period [s] until the horizon has at least four periods, or it is a time step."""
    while period > horizon / 4 * (1 + 1e-9) and period > dt:
        period /= 2
    return period


def check_divide(dts: Sequence[float], period: float) -> None:
    """Raise ValueError, with the nearest valid steps, for a step that does not divide a period."""
    for dt in dts:
        if not divides(dt, period):
            counts = dict.fromkeys(max(1, int(period / dt) + more) for more in (1, 0))
            # Enough digits that the written step divides the period.
            near = " and ".join(f"{period / n:.9g} s" for n in counts)
            raise ValueError(
                f"dt = {dt:g} s: must divide the control period of {period:g} s "
                f"(nearest: {near}; control_dt sets the period)"
            )


def _every(periods: int) -> int:
    """Return the number of periods between samples, for about 50 samples.

    If possible, the samples fill the horizon.
    """
    divisors = [n for n in range(1, periods + 1) if periods % n == 0]
    best = min(divisors, key=lambda n: abs(math.log(periods / n / SAMPLES)))
    near = max(1, round(periods / SAMPLES))
    return best if periods <= SAMPLES or 20 <= periods / best <= 3 * SAMPLES else near


def home(model: Model, key: str | int | None) -> tuple[Start, np.ndarray]:
    """Return the state and controls of a keyframe; by default the first, or the pose at rest."""
    if key is None and not model.keys:
        return Start(model.qpos0, np.zeros(model.nv)), np.zeros(model.nu)
    frame = model.keys[0 if key is None else model.index("key", key)]
    mocap = frame.mpos.reshape(-1, 3), frame.mquat.reshape(-1, 4)
    return Start(frame.qpos, frame.qvel, frame.act, mocap), frame.ctrl


def random_start(
    coordinates: Coordinates,
    home: Start,
    moving: np.ndarray,
    overlap: Callable[[Start], float],
    slack: float,
    rng: np.random.Generator,
) -> Start:
    """Return a random start near `home`, within the joint ranges.

    moving: which dofs get a speed, (nv,).
    overlap: the deepest overlap of a start's contacts [m]. It exceeds the overlap of `home` by at
    most `slack`: 0.1 mm under laws whose contacts are springs. Other laws correct a share of it
    in each step, which ejects a body at a speed that grows as 1/dt. Under these laws the overlap
    does not increase.
    """
    allowed = max(0.0, overlap(home)) + slack
    tried = []
    for _ in range(64):
        # 1 mm and 10 mrad: small relative to a robot, large relative to the motion in one step.
        step = coordinates.drawn(rng, 1e-3, 1e-2)
        rate = np.where(moving, coordinates.drawn(rng, SPEED, SPIN), 0.0)
        moved = coordinates.inside(coordinates.moved(home.qpos, step))
        start = dataclasses.replace(home, qpos=moved, qvel=home.qvel + rate)
        tried.append((overlap(start), start))
        if tried[-1][0] <= allowed:
            return start
    return min(tried, key=lambda pair: pair[0])[1]


def locked(model: Model, home: Start) -> np.ndarray:
    """Return which dofs have too much damping to have a speed, (nv,)."""
    sim, forces = Sim(model), list[np.ndarray]()
    for speed in (0.0, 1.0):
        home.put(sim)
        sim.qvel[:] = speed
        try:
            sim.forward()
        except SimulationError:
            return np.zeros(model.nv, bool)
        forces.append(np.array(sim.passive))
    stops = np.abs(forces[1] - forces[0]) * model.settings.dt
    return stops > FINEST * np.diagonal(sim.mass_matrix())


def overlap_of(model: Model) -> Callable[[Start], float]:
    """Return a function that measures the deepest overlap of a start's contacts [m]."""
    sim = Sim(model)

    def overlap(start: Start) -> float:
        start.put(sim)
        return float(sim.overlap)

    return overlap
