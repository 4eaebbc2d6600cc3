"""How long a motion without a horizon of its own is simulated: until it has come to rest.

One second does not show a box that topples at 1.4 s, an arm that sags, or balls that leave a cup. A
pilot run under the shipped settings, from the first start, therefore goes on until

- the motion has come to rest: at its speed, and at the speed to which this would grow by the bound,
  no body would move 1 % of the scene's size in 10 s;
- or it repeats: over a whole period every body is where it was a period before, to 2 % of its way;
- or the bound is reached, in simulated time or in computing.

Motions that repeat or have no end by their making (`Motion.kind` "move", "sines" and "random"), and
rows without times, are not tried. A log with times is run to its end, within the bound.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

import numpy as np

from stepcore._core import SimulationError
from stepcore.engine.control import ControlError
from stepcore.engine.model import Model
from stepcore.engine.sim import Sim
from stepcore.experiment.control_table import control_table
from stepcore.experiment.default_motion import kind_of
from stepcore.experiment.motion import Motion
from stepcore.experiment.run import Probe
from stepcore.experiment.runner import Runner
from stepcore.experiment.schedule import HORIZON, scheduled
from stepcore.experiment.sizes import scene_size
from stepcore.report.units import seconds

# The bound: the longest run [s], its most steps, and its largest cost, in floating-point operations
# (one or two seconds of computing).
LONGEST, STEPS, COST = 10.0, 20_000, 1e9
# The share of the cost of a converged motion that one run from each start may have.
SHARE = 1 / 30
# The time between samples, and between two judgements of them [s].
SAMPLE, LOOK = 0.02, 0.1
# The time over which a speed is averaged [s]. Growth is that from one such time to the next.
WINDOW = 0.25
# The way that a motion at rest may go in `LONGEST`, over the scene's size.
STILL = 0.01
# The shortest period of a motion that repeats [s], and the largest deviation, over its way.
PERIOD, ALIKE = 0.1, 0.02
# The most that growth until the bound may count, as an exponent: rounding grows to any size.
GROWTH = 40.0


@dataclass(frozen=True)
class Horizon:
    """The horizon of a motion.

    length: the simulated time [s]. words: why it is not the default, as a sentence without a full
    stop; "" for the default.
    """

    length: float
    words: str = ""

    def after(self, motion: str) -> str:
        """Return a motion in words, with the reason for its horizon."""
        return f"{motion} ({self.words})" if self.words else motion


def horizon_of(
    model: Model, motion: Motion, default: float = HORIZON, cost: float = COST
) -> Horizon:
    """Return how long a motion is simulated: its own horizon, or until it has come to rest.

    default: the horizon of a motion that is at rest by then, or is not tried [s].
    cost: the largest cost of a run [floating-point operations]; see `affordable`.
    """
    if motion.horizon is not None:
        return Horizon(motion.horizon)
    dt = model.settings.dt
    if motion.duration > default:
        return _whole(model, motion, default, cost)
    if not _is_tried(model, motion) or dt > LOOK or min(LONGEST, STEPS * dt) <= default:
        return Horizon(default)
    return _Pilot(model, motion, default, cost).horizon()


def _whole(model: Model, motion: Motion, default: float, cost: float) -> Horizon:
    """Return the horizon of a log: all of it, as far as the bounds allow."""
    dt, sim = model.settings.dt, Sim(model)
    sim.reset(key=0 if model.keys else None)
    paid = dt * cost / max(1.0, sim.count_flops())
    length = max(default, min(motion.duration, LONGEST, STEPS * dt, paid))
    lasts = f"{control_table(motion.ctrl).source} lasts {seconds(motion.duration)}"
    if length < motion.duration:
        lasts += f", of which {seconds(length)} are run; --horizon sets more"
    return Horizon(length, lasts)


def affordable(effort: float, starts: int) -> float:
    """Return the largest cost of a run for which a converged motion can be computed.

    effort: the most operations of a study.
    """
    return SHARE * effort / starts


def _is_tried(model: Model, motion: Motion) -> bool:
    if motion.ctrl is not None:
        return not control_table(motion.ctrl).changes
    return motion.control is not None or (motion.kind or kind_of(model)) in ("fall", "hold")


class _AtRest(Exception):
    """Raised to end the pilot run."""


class _Pilot(Probe):
    """The pilot run, and a probe of the bodies' places in it."""

    def __init__(self, model: Model, motion: Motion, default: float, cost: float) -> None:
        dt = model.settings.dt
        self.default, self.longest = default, min(LONGEST, STEPS * dt)
        self.cost, self.spent = cost, 0.0
        period = motion.period(dt) or dt * max(1, round(SAMPLE / dt))
        whole = replace(motion, horizon=max(self.longest, period), starts=1)
        schedule = scheduled(whole, model, period)
        self.every = max(1, round(SAMPLE / period)) * period
        schedule = replace(schedule, every=max(1, round(SAMPLE / period)))
        self.runner, self.settings = Runner(model, schedule), model.settings
        bodies = self.runner.bodies
        self.moving, self.gyration = bodies.moving, bodies.gyration
        self.size = scene_size(model.scene)
        self.places: list[np.ndarray] = []
        self.quats: np.ndarray | None = None
        self.words, self.time = "", 0.0

    def horizon(self) -> Horizon:
        """Run until the motion is at rest, and return the horizon."""
        failed = False
        try:
            self.runner.follow(self.runner.sim(self.settings), 0, [self])
        except _AtRest:
            pass
        except ControlError:
            raise
        except (SimulationError, ValueError):
            failed = True
        if failed:
            # A run over this horizon shows the failure.
            length = min(self.longest, math.ceil((self.time + LOOK) / LOOK) * LOOK)
            return Horizon(max(self.default, length), "")
        length = round(self.time, 9)
        if length <= self.default + self.every / 2:
            return Horizon(self.default)
        words = self.words or f"still moving at {seconds(length)}, the longest run"
        return Horizon(length, words)

    def begin(self, sim: Sim) -> None:
        self.begun = float(sim.time)
        self.sample(sim)

    def sample(self, sim: Sim) -> None:
        """Record the places of the bodies, and end the run if they are at rest."""
        quat = sim.xquat[self.moving].copy()
        if self.quats is not None:
            # Of the two quaternions of a rotation, the one near the last.
            quat[np.sum(quat * self.quats, axis=1) < 0] *= -1
        self.quats = quat
        turned = 2 * np.reshape(self.gyration, (-1, 1)) * quat
        self.places.append(np.hstack([sim.xpos[self.moving], turned]))
        self.time = float(sim.time) - self.begun
        looks = (len(self.places) - 1) % max(1, round(LOOK / self.every)) == 0
        if looks:
            self.spent += sim.count_flops() * LOOK / self.settings.dt
        if self.time < self.default - self.every / 2 or not (looks or self._first):
            return
        end, late = seconds(round(self.time, 9)), f"not at rest after {seconds(self.default)}"
        if self._rests():
            self.words = f"{late}: went on to {end}"
            raise _AtRest
        if self._repeats():
            self.words = f"{late}: went on to {end}, where it repeats"
            raise _AtRest
        if self.spent > self.cost:
            self.words = f"still moving at {end}; --horizon goes on further"
            raise _AtRest

    @property
    def _first(self) -> bool:
        return self.time < self.default + self.every / 2

    def _rests(self) -> bool:
        """Return whether the bodies move slowly, and will."""
        count = round(WINDOW / self.every)
        if len(self.places) < 2 * count:
            return False
        steps = np.diff(np.array(self.places[-2 * count :]), axis=0)
        way = np.linalg.norm(steps, axis=2).max(axis=1)
        before, now = (float(part.mean()) / self.every for part in (way[:count], way[count:]))
        growth = math.log(now / before) / WINDOW if now > before > 0 else 0.0
        exponent = min(growth * (self.longest - self.time), GROWTH)
        return now * LONGEST * math.exp(exponent) <= STILL * self.size

    def _repeats(self) -> bool:
        """Return whether the bodies are where they were a period before, for a whole period."""
        places = np.array(self.places)
        flat = places.reshape(len(places), -1)
        least, most = round(PERIOD / self.every), (len(flat) - 1) // 2
        for lag in range(max(1, least), most + 1):
            # The last sample first: it rules most periods out.
            if not self._alike(places, lag, 1):
                continue
            if self._alike(places, lag, lag):
                return True
        return False

    def _alike(self, places: np.ndarray, lag: int, count: int) -> bool:
        recent = places[-count:]
        apart = np.linalg.norm(recent - places[-count - lag : len(places) - lag], axis=2)
        way = np.linalg.norm(np.ptp(places[-2 * lag :], axis=0), axis=1).max()
        return bool(apart.max() <= ALIKE * way)
