"""The default horizon of a motion: the time until it has come to rest.

One second does not show a box that topples at 1.4 s, an arm that sags, or balls that leave a cup. A
pilot run under the shipped settings, from the first start, therefore goes on until

- the motion has come to rest: at its speed, and at the speed to which this would grow by the bound,
  no body would move 1 % of the scene's size in 10 s;
- or it repeats: over a whole period every body is where it was a period before, to 2 % of its path,
  or at rest; a body that a control drives through the scene may be a constant distance further on;
- or the bound is reached, in simulated time or in computing.

Motions that repeat or never end by construction (`Motion.kind` "move", "sines" and "random"), and
rows without times, have no pilot run. A log with times is run to its end, within the bound.
"""

from __future__ import annotations

import contextlib
import math
from dataclasses import dataclass, field, replace

import numpy as np

from stepcore._core import SimulationError
from stepcore.engine.control import ControlError
from stepcore.engine.follow import Followed
from stepcore.engine.model import Model
from stepcore.engine.norm import Matter
from stepcore.engine.sim import Sim, unwatched
from stepcore.experiment.default_motion import kind_of
from stepcore.experiment.engines import Engine, run, spread
from stepcore.experiment.motion import Motion
from stepcore.experiment.predictable import SAMPLE_TIME
from stepcore.experiment.schedule import HORIZON, scheduled
from stepcore.experiment.sizes import scene_size
from stepcore.report.units import seconds

# The bound: the longest run [s], its most steps, and its largest cost, in floating-point operations
# (one or two seconds of computing).
LONGEST_RUN, PILOT_STEPS, MOST_COST = 10.0, 20_000, 1e9
# The share of the cost of a converged motion that one run from each start may have.
COST_SHARE = 1 / 30
# The operations that take as long as a call of a control function: 20 µs.
CALL_COST = 9e4
# The time between two checks, and the shortest period of a motion that repeats [s].
CHECK_TIME = 0.1
# The time over which a speed is averaged [s]. Growth is measured from one such time to the next.
SPEED_TIME = 0.25
# The largest path of a motion at rest in `LONGEST_RUN`, over the scene's size; and the largest
# distance of a repeating motion from its place a period before, over its path.
REST_PATH, REPEATED = 0.01, 0.02
# The largest exponent of growth until the bound that counts: rounding grows to any size.
GROWTH = -math.log(np.finfo(float).eps)


@dataclass(frozen=True)
class Horizon:
    """The horizon of a motion.

    length: the simulated time [s]. words: why it is not the default, as a sentence without a full
    stop; "" for the default. ran: the pilot run, which is as long or longer; None without one.
    """

    length: float
    words: str = ""
    ran: Followed | None = field(default=None, repr=False, compare=False)

    def after(self, motion: str) -> str:
        """Return a motion in words, with the reason for its horizon."""
        return f"{motion} ({self.words})" if self.words else motion


def horizon_of(
    model: Model, motion: Motion, default: float = HORIZON, cost: float = MOST_COST
) -> Horizon:
    """Return the horizon of a motion: the given one, or the time until it has come to rest.

    default: the horizon of a motion that is at rest by then, or has no pilot run [s].
    cost: the largest cost of a run [floating-point operations].
    """
    if motion.horizon is not None:
        return Horizon(motion.horizon)
    dt = model.settings.dt
    longest = min(LONGEST_RUN, PILOT_STEPS * dt)
    table = motion.table
    if table is not None and table.duration > default:
        sim = Sim(model)
        sim.reset(key=0 if model.keys else None)
        length = max(default, min(table.duration, longest, _paid(sim, sim.count_flops(), cost)))
        lasts = f"{table.source} lasts {seconds(table.duration)}"
        if length < table.duration:
            lasts += f", of which {seconds(length)} are run; --horizon sets more"
        return Horizon(length, lasts)
    if table is not None:
        tried = not table.varies
    else:
        tried = motion.control is not None or (motion.kind or kind_of(model)) in ("fall", "hold")
    if not tried or dt > CHECK_TIME or longest <= default:
        return Horizon(default)
    pilot = _Pilot(model, motion, default, cost)
    return replace(pilot.horizon(), ran=pilot.ran)


def settled_motion(
    engine: Engine, motion: Motion, starts: int, effort: float
) -> tuple[Motion, Horizon]:
    """Return a motion whose horizon leaves its converged motion affordable, and that horizon.

    starts: the number of starts of the study. effort: its largest number of operations.
    """
    far = Horizon(motion.horizon or HORIZON)
    if engine.known:
        far = horizon_of(engine.model, motion, cost=COST_SHARE * effort / starts)
    return replace(motion, horizon=far.length if far.words else motion.horizon), far


def _paid(sim: Sim, flops: float, cost: float) -> float:
    """Return the simulated time that a cost pays for [s]; flops: the operations of a step."""
    return float(cost * sim.settings.dt / max(flops, 1.0))


class _Pilot:
    """The pilot run: first over the default horizon, and if it is not at rest, up to the bound.

    It is checked from the default horizon on, as if it had ended there.
    """

    def __init__(self, model: Model, motion: Motion, default: float, cost: float) -> None:
        dt = model.settings.dt
        self.model, self.default, self.cost = model, default, cost
        self.longest = min(LONGEST_RUN, PILOT_STEPS * dt)
        period = motion.period(dt) or dt * max(1, round(SAMPLE_TIME / dt))
        extended = replace(motion, horizon=max(self.longest, period), starts=1)
        self.count = max(1, round(SAMPLE_TIME / period))
        self.every = self.count * period
        self.schedule = replace(scheduled(extended, model, period), every=self.count)
        self.matter, self.size = Matter.of(model), scene_size(model.scene)
        self.driven, gravity = motion.control is not None, np.asarray(model.scene.gravity)
        self.up = gravity / max(np.linalg.norm(gravity), 1e-300)
        self.calls = CALL_COST * dt / period if self.driven else 0.0
        self.ran: Followed | None = None

    def horizon(self) -> Horizon:
        """Run until the motion is at rest, and return the horizon."""
        first = max(1, math.ceil(self.default / self.every - 0.5))
        places, paid, failed = self._places(first)
        if not failed and self._ends(places):
            return Horizon(self.default)
        total, look = self.schedule.periods // self.count, max(1, round(CHECK_TIME / self.every))
        most = min(total, look * math.ceil(paid / self.every / look))
        if not failed and first < most:
            places, paid, failed = self._places(most)
            # Later steps may cost more than the first ones.
            most = max(first + 1, min(most, look * math.ceil(paid / self.every / look)))
            places = places[: most + 1]
        for end in range(look * math.ceil((first + 1) / look), len(places), look):
            if why := self._ends(places[: end + 1]):
                time = round(end * self.every, 9)
                late = f"not at rest after {seconds(self.default)}: went on to {seconds(time)}"
                return Horizon(time, late + why.removeprefix("at rest"))
        length = round((len(places) - 1) * self.every, 9)
        if failed:
            # A run over this horizon shows the failure.
            length = min(self.longest, math.ceil((length + CHECK_TIME) / CHECK_TIME) * CHECK_TIME)
            return Horizon(max(self.default, length))
        if length <= self.default + self.every / 2:
            return Horizon(self.default)
        further = "; --horizon goes on further" if most < total else ", the longest run"
        return Horizon(length, f"still moving at {seconds(length)}{further}")

    def _places(self, samples: int) -> tuple[np.ndarray, float, bool]:
        """Run over some samples; return the places of the bodies, up to a failure.

        Places are centres and rotations [m], (n, bodies, 7). The function also returns the time
        that the cost pays for [s], and whether the run failed.
        """
        part = replace(self.schedule, periods=samples * self.count)
        states = ["qpos", "qvel", "act", "ctrl"]
        record = [*states, "xpos", "xquat"]
        if self.model.settings.accuracy is None:
            record.append("actuator_force")
        try:
            ran = self.ran = run(self.model, part, [0], record=record)
        except ControlError:
            raise
        except (SimulationError, ValueError):
            return np.zeros((1, len(self.matter.moving), 7)), 0.0, True
        good = int(np.isfinite(ran["xpos"][0]).all(axis=(1, 2)).sum())
        xpos, quat = (ran[name][0, :good, self.matter.moving] for name in ("xpos", "xquat"))
        # A rotation has two quaternions: take the one near the previous sample's.
        quat, xpos = quat.swapaxes(0, 1).copy(), xpos.swapaxes(0, 1)
        flips = np.sum(quat[1:] * quat[:-1], axis=2) < 0
        quat[1:][np.logical_xor.accumulate(flips, axis=0)] *= -1
        turned = 2 * self.matter.gyration[:, None] * quat
        sim, flops = unwatched(Sim(self.schedule.driven_model(self.model))), []
        for k in spread(ran["qpos"][0, :good]):
            for name in states:
                getattr(sim, name)[:] = ran[name][0, k]
            # A run that is about to fail has states from which no step can be made.
            with contextlib.suppress(SimulationError):
                flops.append(sim.count_flops() + self.calls)
        paid = _paid(sim, float(np.mean(flops)), self.cost) if flops else 0.0
        return np.concatenate([xpos, turned], axis=2), paid, bool(ran.failures)

    def _ends(self, places: np.ndarray) -> str:
        return "at rest" if self._rests(places) else ", where it repeats" * self._repeats(places)

    def _rests(self, places: np.ndarray) -> bool:
        """Return whether the bodies move slowly at the end, and will continue to."""
        return len(places) >= 2 * round(SPEED_TIME / self.every) and self._still(
            np.linalg.norm(np.diff(places, axis=0), axis=2).max(axis=1), len(places)
        )

    def _still(self, way: np.ndarray, samples: int) -> bool:
        """Return whether the paths between samples [m] are short at the end, and will stay so."""
        count, time = round(SPEED_TIME / self.every), (samples - 1) * self.every
        parts = way[-2 * count : -count], way[-count:]
        before, now = (float(part.mean()) / self.every for part in parts)
        growth = math.log(now / before) / SPEED_TIME if now > before > 0 else 0.0
        exponent = min(growth * (self.longest - time), GROWTH)
        return now * LONGEST_RUN * math.exp(exponent) <= REST_PATH * self.size

    def _repeats(self, places: np.ndarray) -> bool:
        """Return whether every moving body is, for a whole period, where it was before."""
        way = np.linalg.norm(np.diff(places, axis=0), axis=2)
        moves = [k for k, moved in enumerate(way.T) if not self._still(moved, len(places))]
        back = places[::-1, moves]
        lags = np.arange(max(1, round(CHECK_TIME / self.every)), (len(places) - 1) // 2 + 1)
        if not (len(lags) and moves):
            return False
        spans = np.maximum.accumulate(back) - np.minimum.accumulate(back)
        ways = REPEATED * np.linalg.norm(spans, axis=2)[2 * lags - 1]
        # The last sample first: it rules most periods out.
        last = back[0] - back[lags]
        if self.driven:
            last = (last - back[lags // 2] + back[lags + lags // 2]) / 2
        some = np.flatnonzero((np.linalg.norm(last, axis=2) <= ways).all(axis=1))
        return any(
            self._alike(back[:lag] - back[lag : 2 * lag], lag, limit)
            for lag, limit in zip(lags[some].tolist(), ways[some], strict=True)
        )

    def _alike(self, moved: np.ndarray, lag: int, ways: np.ndarray) -> bool:
        """Return whether bodies moved little in a period [m], or equally at all of its times."""
        mean = moved.mean(axis=0) * [1, 1, 1, 0, 0, 0, 0]
        # Falling and climbing bodies do not drive, and slow bodies creep.
        mean[:, :3] -= np.outer(mean[:, :3] @ self.up, self.up)
        fast = np.linalg.norm(mean, axis=1) * LONGEST_RUN >= self.size * lag * self.every
        moved = moved - mean * (self.driven & fast)[:, None]
        return bool((np.linalg.norm(moved, axis=2) <= ways).all())
