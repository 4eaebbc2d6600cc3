"""The schedule of a motion for one model: starts, controls and a common time grid.

Controls are constant over a control period, which is a multiple of every time step. Coarse and fine
runs therefore get the same controls at the same times. A log has times of its own: see
`ControlLog`.
"""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from fractions import Fraction

import numpy as np

from stepcore import checks
from stepcore.engine.control import Control, control_name, fresh
from stepcore.engine.model import Model
from stepcore.engine.sim import Sim
from stepcore.engine.start import Start
from stepcore.experiment.control_log import ControlLog, changes
from stepcore.experiment.control_table import Actuated, control_table
from stepcore.experiment.coordinates import Coordinates
from stepcore.experiment.default_motion import default_motion
from stepcore.experiment.followed import Following, PositionTable
from stepcore.experiment.motion import Motion
from stepcore.experiment.point_to_point import PointToPoint
from stepcore.report import units
from stepcore.report.units import seconds

# Default time steps, relative to the shipped step.
FACTORS = (1 / 8, 1 / 4, 1 / 2, 1.0, 2.0, 4.0)
# The approximate number of samples.
SAMPLES = 50
# The default horizon, approximately [s], and the default number of starts.
HORIZON, STARTS = 1.0, 8
# The largest distance of random starts from the keyframe: small relative to a robot, large relative
# to the motion in one step.
SHIFT, TURN = 1e-3, 1e-2  # [m], [rad]
SPEED, SPIN = 0.05, 0.1  # [m/s], [rad/s]


@dataclass(frozen=True, eq=False)
class Schedule:
    """Starts, controls and the time grid that all runs of a measurement share.

    period: the control period [s], a multiple of every time step.
    periods: the number of control periods.
    every: the number of periods between two samples.
    starts: the initial states.
    ctrl: the controls, (starts, periods, nu); None if `control` returns the controls. With a log,
        the means over the periods.
    control: the control function, or None.
    remarks: sentences on what the default controls could not do.
    drive: the default controls in words; "" if the user gave controls.
    log: controls that change within periods, at times of their own; None for controls that are
        constant in each period. Its rows have the controls of one start, nu numbers, for all
        starts; or those of every start, one start after the other.
    """

    period: float
    periods: int
    every: int
    starts: tuple[Start, ...]
    ctrl: np.ndarray | None
    control: Control | None
    remarks: tuple[str, ...] = ()
    drive: str = ""
    log: ControlLog | None = None

    @property
    def horizon(self) -> float:
        """Simulated time of a run [s]."""
        return self.period * self.periods

    @property
    def times(self) -> np.ndarray:
        """Times of the samples [s], (n,); the start is not a sample."""
        return self.period * np.arange(self.every, self.periods + 1, self.every)

    @property
    def is_users(self) -> bool:
        """Whether the controls are the user's own."""
        return not self.drive

    @property
    def calls_user(self) -> bool:
        """Whether a control function of the user is called."""
        own = isinstance(self.control, Following)
        return self.control is not None and self.is_users and not own

    @property
    def driven(self) -> str:
        """The user's control function and its sampling period, in words; "" without a function."""
        if self.control is None or not self.calls_user:
            return ""
        return f" under {control_name(self.control)}, sampled every {seconds(self.period)}"

    @property
    def notes(self) -> list[str]:
        """Sentences on what the default controls could not do."""
        return list(self.remarks)

    def function(self, start: int) -> Control | None:
        """Return the control function of one run from a start, or None."""
        if isinstance(self.control, PointToPoint):
            return self.control.of(start)
        return None if self.control is None else fresh(self.control)

    def steps(self, dt: float) -> int:
        """Return the number of time steps in one control period; dt: [s]."""
        return round(self.period / dt)

    def blocks(self, dt: float, count: int | None = None) -> Iterator[tuple[int, int]]:
        """Yield the index of each control period and the number of time steps that begin in it.

        dt: time step [s].
        count: the total number of time steps, if dt does not divide the period; the last controls
            then stay constant to the end.
        """
        if count is None:
            yield from ((period, self.steps(dt)) for period in range(self.periods))
            return
        if self.control is None and (self.ctrl is None or not self.ctrl.size):
            yield 0, count
            return
        steps, period, done = self.period / dt, 0, 0
        while done < count:
            end = min(math.ceil((period + 1) * steps - 1e-9), count)
            if end > done:
                yield min(period, self.periods - 1), end - done
            done, period = end, period + 1

    def stretches(
        self, starts: int | Sequence[int], made: int, dt: float, count: int
    ) -> Iterator[tuple[int, np.ndarray | None]]:
        """Yield the end of each stretch of equal controls in some time steps, and these controls.

        The controls are None if nothing changes them within a period.

        starts: the index of a start, or of several, whose controls have the shape (starts, nu).
        made: the number of time steps before these. dt: time step [s]. count: the number of steps.
        """
        if self.log is None:
            yield count, None
            return
        rows = self.log.steps(made * dt, dt, count)
        if self._logs_each:
            rows = rows.reshape(count, -1, self.nu)[:, starts]
        first = changes(rows)
        yield from ((end, rows[end - 1]) for end in (*first[1:], count))

    @property
    def nu(self) -> int:
        """The number of controls in a row."""
        return 0 if self.ctrl is None else self.ctrl.shape[2]

    @property
    def _logs_each(self) -> bool:
        """Whether the log has the controls of every start."""
        return self.log is not None and self.log.rows.shape[1] != self.nu

    @property
    def indices(self) -> range:
        """Indices of the starts."""
        return range(len(self.starts))

    def rows(self, starts: Sequence[int], dt: float) -> tuple[np.ndarray | None, int]:
        """Return the controls over time from some starts, and for how many steps a row is held.

        The shape is (starts, rows, nu), or (1, rows, nu) for controls that all starts share; None
        without controls.

        dt: time step [s].
        """
        count = self.steps(dt)
        if self.log is None:
            rows = None if self.ctrl is None or not self.nu else self.ctrl[list(starts)]
            return rows, count
        # Rows that are held for whole steps are played as they are.
        gaps = np.diff(self.log.times)
        held = round(float(gaps[0]) / dt) if len(gaps) and not self.log.linear else 0
        hold = held if held and np.allclose(gaps, held * dt, rtol=1e-9) else 1
        rows = self.log.rows if hold > 1 else self.log.steps(0.0, dt, self.periods * count)
        if self._logs_each:
            own = rows.reshape(len(rows), -1, self.nu)[:, list(starts)]
            return own.transpose(1, 0, 2), hold
        return rows[None], hold

    def part(self, first: int, last: int | None = None) -> Schedule:
        """Return the schedule with the starts from `first` up to, but not including, `last`."""
        return self.picked(range(len(self.starts))[first:last])

    def picked(self, indices: Sequence[int]) -> Schedule:
        """Return the schedule with some of its starts, which may be repeated."""
        starts, control = tuple(self.starts[k] for k in indices), self.control
        if isinstance(control, PointToPoint):
            control = control.picked(indices)
        ctrl = None if self.ctrl is None else self.ctrl[list(indices)]
        log = self.log
        if log is not None and self._logs_each:
            each = log.rows.reshape(len(log.rows), -1, self.nu)[:, list(indices)]
            log = dataclasses.replace(log, rows=each.reshape(len(each), -1))
        return dataclasses.replace(self, starts=starts, ctrl=ctrl, control=control, log=log)

    def joined(self, other: Schedule) -> Schedule:
        """Return the schedule with the starts of another one of the same motion after these."""
        control, ctrl, log = self.control, self.ctrl, self.log
        if isinstance(control, PointToPoint) and isinstance(other.control, PointToPoint):
            control = PointToPoint.together([control, other.control])
        if ctrl is not None and other.ctrl is not None:
            ctrl = np.concatenate([ctrl, other.ctrl])
        if log is not None and other.log is not None and not self.is_users:
            log = dataclasses.replace(log, rows=np.hstack([log.rows, other.log.rows]))
        starts = (*self.starts, *other.starts)
        return dataclasses.replace(self, starts=starts, ctrl=ctrl, control=control, log=log)


def scheduled(
    motion: Motion, model: Model, period: float, starts: int | None = None, horizon: float = HORIZON
) -> Schedule:
    """Return the schedule of a motion: the keyframe and random starts near it, and the controls.

    period: the control period [s].
    starts: the number of starts; by default that of the motion.
    horizon: the horizon if the motion has none [s]; rounded to a whole number of samples.

    Raises ValueError if the horizon is shorter than a period, or the run has too many steps.
    """
    count = starts or motion.starts or STARTS
    periods, every = grid(motion, model.settings.dt, period, count, horizon)
    rng = np.random.default_rng(motion.seed)
    coordinates = Coordinates(model)
    first, held = home(model, motion.key)
    first = begun(motion, model, first)
    slack = 1e-4 if model.settings.law in ("solref", "penalty") else 1e-12
    overlap = overlaps(model)
    begin = [first, *(near(coordinates, first, rng, overlap, slack) for _ in range(count - 1))]
    ctrl, control, remarks, drive = None, motion.control, tuple[str, ...](), ""
    log = None
    if isinstance(motion.ctrl, PositionTable):
        control = motion.ctrl.control(model, first, held, period)
    if motion.ctrl is not None and control is None:
        rows, log = played(motion, model, held, periods, period)
        ctrl = np.broadcast_to(rows, (count, periods, model.nu))
    elif control is None:
        made = default_motion(
            *(model, motion.kind, first, held, begin, motion.seed, period, periods),
            whole=motion.control_dt is not None,
        )
        ctrl, control, log = made.ctrl, made.control, made.log
        remarks, drive = made.remarks, made.words
    return Schedule(period, periods, every, tuple(begin), ctrl, control, remarks, drive, log)


def grid(
    motion: Motion, dt: float, period: float, starts: int, horizon: float = HORIZON
) -> tuple[int, int]:
    """Return the number of control periods of a motion, and that between two samples.

    dt: the shipped time step [s]. The other arguments and the errors are those of `scheduled`.
    """
    length = default_horizon(period, horizon) if motion.horizon is None else motion.horizon
    checks.steps(length, dt, starts, f"from {starts} start{'s' * (starts > 1)} in steps")
    periods = int(length / period + 1e-9)
    if periods < 1:
        raise ValueError(f"horizon = {length:g} s: shorter than one period of {period:g} s")
    every = _every(periods)
    return periods - periods % every, every


def begun(motion: Motion, model: Model, home: Start) -> Start:
    """Return the first start of a motion: recorded positions begin at the first of them."""
    if not isinstance(motion.ctrl, PositionTable):
        return home
    return dataclasses.replace(home, qpos=motion.ctrl.begin(model, home.qpos))


def played(
    motion: Motion, model: Actuated, held: np.ndarray, periods: int, period: float
) -> tuple[np.ndarray, ControlLog | None]:
    """Return the rows of a motion's `ctrl`, (periods, nu), and a log that changes within periods.

    held: the controls of actuators without a column, (nu,). period: the control period [s].
    """
    table = control_table(motion.ctrl)
    linear = table.interpolated or motion.interpolation == "linear"
    log = table.log(model, held, linear)
    if log is None or (motion.control_dt is not None and not linear):
        return table.over(model, held, periods, period), None
    within = motion.control_dt is None and not log.ends_on(period)
    return log.steps(0.0, period, periods), log if within else None


def time_steps(
    shipped: float, dts: Sequence[float | str] | None, control_dt: float | None, horizon: float
) -> tuple[list[float], float]:
    """Return the time steps to try, coarsest first, and a control period they all divide [s].

    shipped: the scene's own time step, which is always included [s].
    dts: the time steps to try [s]; by default multiples of the shipped step.
    control_dt: the control period [s]; by default a common multiple of the time steps.
    horizon: the simulated time [s].

    Raises ValueError for a step that does not divide the period, and a period beyond the horizon.
    """
    if control_dt is not None and control_dt > horizon:
        raise ValueError(f"control_dt = {control_dt:g}: must be at most the horizon, {horizon:g} s")
    if dts is not None:
        chosen = sorted({units.time("dts", dt) for dt in dts} | {shipped}, reverse=True)
        period = control_dt or _common(chosen, horizon)
        _check_divide(chosen, period)
    elif control_dt is not None:
        # The shipped step is kept; the others are rounded to divisors of the period.
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
    """Return the time nearest to `horizon` that is a whole number of sampling intervals [s]."""
    about = max(1, round(horizon / period))
    near = sorted(
        range(max(1, about - about // 20), about + about // 20 + 1), key=lambda n: abs(n - about)
    )
    return period * next((n for n in near if n % _every(n) == 0), about)


def _common(dts: Sequence[float], horizon: float) -> float:
    """Return the least common multiple of time steps, as decimal numbers [s]."""
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


def divides(dt: float, period: float) -> bool:
    """Return whether a period is a whole number of time steps, within rounding."""
    count = period / dt
    return round(count) >= 1 and abs(count - round(count)) <= 1e-6 * count


def _check_divide(dts: Sequence[float], period: float) -> None:
    for dt in dts:
        if not divides(dt, period):
            near = period / max(1, round(period / dt))
            raise ValueError(
                f"dt = {dt:g} s: must divide the control period of {period:g} s "
                f"(nearest: {near:g} s; control_dt sets the period)"
            )


def _every(periods: int) -> int:
    """Return the number of periods between samples, for about 50 samples.

    If possible, the samples fill the horizon.
    """
    whole = [n for n in range(1, periods + 1) if periods % n == 0]
    best = min(whole, key=lambda n: abs(math.log(periods / n / SAMPLES)))
    near = max(1, round(periods / SAMPLES))
    return best if periods <= SAMPLES or 20 <= periods / best <= 3 * SAMPLES else near


def home(model: Model, key: str | int | None) -> tuple[Start, np.ndarray]:
    """Return the state and controls of a keyframe; by default the first, or the pose at rest."""
    if key is None and not model.keys:
        return Start(model.qpos0, np.zeros(model.nv)), np.zeros(model.nu)
    frame = model.keys[0 if key is None else model.index("key", key)]
    mocap = frame.mpos.reshape(-1, 3), frame.mquat.reshape(-1, 4)
    return Start(frame.qpos, frame.qvel, frame.act, mocap), frame.ctrl


def near(
    coordinates: Coordinates,
    home: Start,
    rng: np.random.Generator,
    overlap: Callable[[Start], float],
    slack: float,
) -> Start:
    """Return a random start near `home`, within the joint ranges.

    overlap: the deepest overlap of a start's contacts [m]. It exceeds that of `home` by at most
    `slack`: 0.1 mm under laws whose contacts are springs. Other laws correct a share of an overlap
    in each step, which ejects a body at a speed that grows as 1/dt. Under these laws the overlap
    does not increase.
    """
    allowed = max(0.0, overlap(home)) + slack
    tried = []
    for _ in range(64):
        step, rate = coordinates.drawn(rng, SHIFT, TURN), coordinates.drawn(rng, SPEED, SPIN)
        moved = coordinates.inside(coordinates.moved(home.qpos, step))
        start = dataclasses.replace(home, qpos=moved, qvel=home.qvel + rate)
        tried.append((overlap(start), start))
        if tried[-1][0] <= allowed:
            return start
    return min(tried, key=lambda pair: pair[0])[1]


def overlaps(model: Model) -> Callable[[Start], float]:
    """Return a function that measures the deepest overlap of a start's contacts [m]."""
    sim = Sim(model)

    def overlap(start: Start) -> float:
        start.put(sim)
        sim.forward()
        dist = sim.contacts["dist"]
        return -float(dist.min()) if len(dist) else 0.0

    return overlap
