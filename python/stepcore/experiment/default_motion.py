"""The motion of a measurement that is given no controls: one that the machine could make.

`kind_of` chooses it from the model alone:

- Nothing is actuated: "fall". The scene falls, rolls and comes to rest.
- Servos, or motors on a fixed base or with controls in N or N·m: "move". All joints move together,
  from the start to a random pose near it in 0.8 s (minimum jerk), rest for 0.2 s, and return. A
  joint goes up to a tenth of its range and at most 0.5 rad; each start has a pose of its own.
  Contacts on which the robot stands keep their places. Position servos get these poses as their
  controls, velocity servos get the velocities. Motors get a PD controller that carries the static
  load of the start.
- Motors with controls within ±1 on a body that moves about (the walkers of gymnasium and
  dm_control), muscles and all else: "sines", which are what policies look like.

A motion is tried by running it under the shipped settings. It is made smaller, from the same random
numbers, until forces stay below 60 % of their bounds (or half of what holding the start leaves), no
actuator is at its bound for more than 5 % of the time, and no limit or contact is met that holding
the start does not meet. What cannot be reached is said.

The other kinds are for comparison: "hold" holds the start, "random" draws new controls in every
control period, and "fall" sets all controls to 0.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace

import numpy as np

from stepcore.engine.model import Model
from stepcore.experiment.coordinates import Start
from stepcore.experiment.drives import MOTOR, OTHER, RATE, SERVO, Drives, actuators_in_words
from stepcore.experiment.joint_gains import gains_of
from stepcore.experiment.point_to_point import MOVE, REST, PointToPoint
from stepcore.experiment.poses import Poses, contact_jacobian
from stepcore.experiment.sines import sines, sines_in_words, undriven, uniform
from stepcore.experiment.trial import Trial, trial
from stepcore.report.units import metres, percent, radians, seconds

KINDS = ("hold", "move", "sines", "fall", "random")
# The largest force, as a share of its bound, and of what holding the start leaves of it.
FORCE, LEFT = 0.6, 0.5
# The largest share of a run in which an actuator is at its bound.
SATURATED = 0.05
# The poses that are tried for a start: the number of the draw, and the share of the way.
ATTEMPTS = ((0, 1.0), (1, 1.0), (0, 0.5), (1, 0.5), (0, 0.25), (1, 0.25), (0, 0.125), (1, 0.125))
# The most names in a list.
NAMED = 4
# The length of a trial [s]: there and back.
TRIAL = 2 * (MOVE + REST)


def kind_of(model: Model) -> str:
    """Return the kind of motion that is chosen for a model."""
    drives = Drives(model)
    if not model.nu or not model.scene.features.actuation:
        return "fall"
    if drives.of(SERVO, RATE):
        return "move"
    if drives.of(MOTOR) and not (drives.takes_actions and drives.moves_about):
        return "move"
    return "sines"


@dataclass(frozen=True)
class DefaultMotion:
    """Controls that were made for a model.

    ctrl: the controls, (starts, periods, nu), or None with `control`.
    control: a control function with a method `of(start)`, or None.
    words: the motion in words.
    remarks: what could not be reached.
    """

    ctrl: np.ndarray | None
    control: PointToPoint | None
    words: str
    remarks: tuple[str, ...] = ()


def default_motion(
    model: Model,
    kind: str | None,
    home: Start,
    ctrl: np.ndarray,
    starts: Sequence[Start],
    seed: int,
    period: float,
    periods: int,
) -> DefaultMotion:
    """Return the controls of a motion without controls of its own.

    kind: one of `KINDS`; None chooses it. home, ctrl: the state and the controls of the keyframe.
    starts: the starts of the runs. period: the control period [s]. periods: their number.
    seed: of the controls; those of a start depend on its index alone, not on how many there are.
    """
    kind = kind or kind_of(model)
    what, count = actuators_in_words(model), len(starts)
    if not model.nu:
        return DefaultMotion(np.zeros((count, periods, 0)), None, "no motors")
    if kind == "fall":
        rows = np.zeros((count, periods, model.nu))
        return DefaultMotion(rows, None, f"{what} are held at zero")
    if kind in ("move", "hold"):
        return _moves(model, home, ctrl, starts, seed, period, periods, still=kind == "hold")
    draws = [np.random.default_rng([seed, k]) for k in range(count)]
    if kind == "random":
        rows = np.stack([uniform(model, ctrl, periods, rng) for rng in draws])
        words = f"{what} get new random controls within their range every {seconds(period)}"
        return DefaultMotion(rows, None, words)
    rows = np.stack([sines(model, ctrl, periods, period, rng) for rng in draws])
    still = undriven(model, ctrl)
    remarks = (
        [f"actuators without a control range are not driven: {', '.join(still)}"] if still else []
    )
    return DefaultMotion(rows, None, sines_in_words(model, what, still), tuple(remarks))


def _moves(
    model: Model,
    home: Start,
    ctrl: np.ndarray,
    starts: Sequence[Start],
    seed: int,
    period: float,
    periods: int,
    *,
    still: bool,
) -> DefaultMotion:
    """Return the motion "move"; with `still`, controls that hold the start."""
    made = _Moves(model, home, ctrl, period, keep=still)
    chosen = [made.still if still else made.start(k, start, seed) for k, start in enumerate(starts)]
    whole = PointToPoint.together([move.control for move in chosen])
    rows = whole.rows(periods, period) if whole.gains is None else None
    words = _Words(made, chosen)
    control = None if rows is not None else whole
    return DefaultMotion(rows, control, words.motion, tuple(words.remarks()))


@dataclass(frozen=True)
class _Move:
    """A move of one start. far: the way of each joint, (joints,)."""

    control: PointToPoint
    trial: Trial
    far: np.ndarray


class _Moves:
    """Chooses the move of each start of a model, by trials."""

    def __init__(
        self, model: Model, home: Start, ctrl: np.ndarray, period: float, keep: bool
    ) -> None:
        """keep: whether position servos keep the keyframe's controls, even where these are 0."""
        self.model, self.home, self.drives = model, home, Drives(model)
        self.period = period
        self.poses = Poses(model, self.drives, home)
        held = self._clamped(np.array(ctrl, float)) if keep else self._held(ctrl)
        nothing = np.zeros((1, model.nu))
        motors = self.drives.of(MOTOR)
        none = np.zeros((1, len(motors)))
        self.control = PointToPoint(held, nothing, nothing, None, none)
        self.hold = self._trial(home, self.control) if not motors else self._balanced(motors)
        if not self.hold.fell and self.hold.end is not None:
            self.poses = self.poses.standing(self.hold.end, self.hold.points)

    @property
    def still(self) -> _Move:
        return _Move(self.control, self.hold, np.zeros(len(self.poses.joints)))

    def _held(self, ctrl: np.ndarray) -> np.ndarray:
        """Return the controls that hold the start: the keyframe's, or those of its pose."""
        held = np.array(ctrl, float)
        servos = self.drives.of(SERVO)
        if servos and not ctrl[servos].any():
            lengths = self.poses.lengths_at(self.home.qpos)[servos]
            offset = self.model.actuator_bias[servos, 0] / self.model.actuator_gain[servos]
            held[servos] = lengths / self.drives.lengths[servos] - offset
        held[self.drives.of(RATE)] = 0.0
        return self._clamped(held)

    def _clamped(self, ctrl: np.ndarray) -> np.ndarray:
        if not self.model.scene.features.clampctrl:
            return ctrl
        clamped: np.ndarray = np.clip(ctrl, *self.model.actuator_ctrlrange.T)
        return clamped

    def _balanced(self, motors: list[int]) -> Trial:
        """Choose the gains and the load of the motors, and return the trial that holds the start.

        The first trial shows the contacts on which the machine comes to stand.
        """
        tried = self._holding(motors, self.home, self.poses.kept, fixed=False)
        held = tried[1]
        if held.end is not None and held.points:
            contacts = contact_jacobian(self.model, self.poses.trees, held.end, held.points)
            others = (self._holding(motors, held.end, contacts, fixed) for fixed in (True, False))
            tried = min((tried, *others), key=lambda pair: _rank(pair[1]))
        self.control, seen = tried
        return seen

    def _holding(
        self, motors: list[int], stands: Start, contacts: np.ndarray, fixed: bool
    ) -> tuple[PointToPoint, Trial]:
        gains = gains_of(
            *(self.model, self.drives, motors, self.home.qpos, stands, contacts),
            period=self.period,
            fixed=fixed,
        )
        control = replace(self.control, gains=gains)
        return control, self._trial(self.home, control)

    def _trial(self, start: Start, control: PointToPoint) -> Trial:
        rows = control.gains is None
        steps = max(1, round(self.period / self.model.settings.dt))
        period = steps * self.model.settings.dt
        made = control.rows(math.ceil(TRIAL / period) + 1, period)[0] if rows else None
        runs = made.__getitem__ if made is not None else control
        return trial(self.model, self.drives, start, runs, self.period, TRIAL, rows)

    def start(self, index: int, start: Start, seed: int) -> _Move:
        """Return the move of a start: the first attempt without trouble, or none."""
        if self.hold.failure or self.hold.fell is not None:
            return self.still
        rng = np.random.default_rng([seed, index])
        draws = [self.poses.drawn(rng) for _ in range(2)]
        for number, share in ATTEMPTS:
            control, far = self._control(*draws[number])
            control, far = control.scaled(share), share * far
            seen = self._trial(start, control)
            if not self.trouble(seen):
                return _Move(control, seen, far)
        return self.still

    def _control(self, change: np.ndarray, others: np.ndarray) -> tuple[PointToPoint, np.ndarray]:
        model, drives, poses = self.model, self.drives, self.poses
        ways = poses.lengths(change)
        for k, share in zip(poses.others, others, strict=True):
            ways[k] = share * poses.span(k)
        spans, rates = np.zeros(model.nu), np.zeros(model.nu)
        for k in drives.of(SERVO):
            target = self.control.held[k] + ways[k] / drives.lengths[k]
            back = self.control.held[k] - ways[k] / drives.lengths[k]
            low, high = model.actuator_ctrlrange[k]
            if not low <= target <= high and low <= back <= high:
                target = back
            spans[k] = np.clip(target, low, high) - self.control.held[k]
        for k in drives.of(RATE):
            per = drives.lengths[k] if drives.integrates(k) else drives.speeds[k]
            rates[k] = ways[k] / per
        gains = self.control.gains
        changes = np.zeros((1, 0)) if gains is None else change[None, gains.dofs]
        control = replace(self.control, spans=spans[None], rates=rates[None], changes=changes)
        return control, np.abs(change[poses.dofs])

    def trouble(self, seen: Trial) -> float:
        """Return how much is wrong with a move; 0 for nothing."""
        hold = self.hold
        if seen.failure:
            return math.inf
        allowed = np.maximum(FORCE, hold.force + LEFT * (1 - hold.force))
        full = np.maximum(SATURATED, hold.saturated + SATURATED)
        trouble = float(np.maximum(seen.force - allowed, 0).max(initial=0.0))
        trouble += float(np.maximum(seen.saturated - full, 0).max(initial=0.0))
        trouble += len(seen.met - hold.met)
        if self.drives.moves_about:
            trouble += len(hold.ends_on - seen.ends_on)
            trouble += 100.0 * (seen.fell is not None)
        return trouble


def _rank(seen: Trial) -> tuple[bool, float, float]:
    """Return how badly a trial holds the start, for comparison."""
    standing = math.inf if seen.fell is None else seen.fell
    return bool(seen.failure), -standing, float(seen.saturated.max(initial=0.0))


class _Words:
    """The motion of all starts in words."""

    def __init__(self, made: _Moves, moves: Sequence[_Move]) -> None:
        self.made, self.moves, self.model = made, moves, made.model
        self.names = self.model.called("actuator")

    @property
    def motion(self) -> str:
        """The motion, with its speed and its loads."""
        gains, far = self.made.control.gains, self._far()
        what = "servos"
        if gains is not None:
            what = "a PD controller drives the joints" if far else "a PD controller holds the start"
        if not far:
            said = what if gains is not None else f"{what} hold the start"
        elif gains is not None:
            said = f"{what} point to point over {seconds(MOVE)} to poses {far} away and back"
        else:
            said = f"{what} move point to point over {seconds(MOVE)} to poses {far} away and back"
        jerk = " (minimum jerk)" if far else ""
        return f"test motion: {said}{jerk}; {', '.join(self._loads())}"

    def _far(self) -> str:
        """Return how far joints go: "up to 0.35 rad and 5 mm", or "" if none moves."""
        poses, far = self.made.poses, np.max([move.far for move in self.moves], axis=0)
        slides = np.array([self.model.jnt_type[joint] == "slide" for joint in poses.joints], bool)
        parts = [radians(float(far[~slides].max(initial=0.0)))] * bool(far[~slides].any())
        parts += [metres(float(far[slides].max(initial=0.0)))] * bool(far[slides].any())
        spans = np.max([np.abs(move.control.spans[0]) for move in self.moves], axis=0)
        if not parts and spans.any():
            return f"up to {float(spans.max()):.2g} of control"
        return f"up to {' and '.join(parts)}" if parts else ""

    def _loads(self) -> Iterator[str]:
        dofs = self.made.poses.dofs
        speed = np.max([move.trial.speed[dofs] for move in self.moves], axis=0)
        turns = [self.model.jnt_type[joint] == "hinge" for joint in self.made.poses.joints]
        if len(dofs):
            fast = int(np.where(turns, speed, 0).argmax()) if any(turns) else int(speed.argmax())
            unit = "rad/s" if turns[fast] else "m/s"
            joint = self.model.called("joint")[self.made.poses.joints[fast]]
            yield f"top speed {speed[fast]:.2g} {unit} (`{joint}`)"
        force = np.max([move.trial.force for move in self.moves], axis=0)
        full = np.max([move.trial.saturated for move in self.moves], axis=0)
        if force.any() and not full.any():
            most = int(force.argmax())
            yield f"largest force {percent(float(force[most]))} of its bound (`{self.names[most]}`)"
        if not full.any():
            yield "never saturated"
        else:
            most = int(full.argmax())
            yield f"`{self.names[most]}` saturated {percent(float(full[most]))} of the time"

    def remarks(self) -> Iterator[str]:
        """Yield what could not be reached."""
        hold = self.made.hold
        if hold.failure:
            yield f"the motion holds the start, because holding it fails: {hold.failure}"
        elif hold.fell is not None:
            yield (
                f"nothing holds the pose of the start: the robot falls over within "
                f"{seconds(hold.fell)}, although its joints hold theirs"
            )
        others = self.made.drives.of(OTHER)
        if others:
            names = ", ".join(self.names[k] for k in others[:NAMED])
            more = f" and {len(others) - NAMED} more" if len(others) > NAMED else ""
            yield (
                "actuators that are no servos, and no motors of a joint, keep their controls: "
                f"{names}{more}"
            )
        worst = max(self.moves, key=lambda move: self.made.trouble(move.trial)).trial
        if hold.failure or hold.fell is not None or not self.made.trouble(worst):
            return
        met = sorted(worst.met - hold.met, key=str)
        if met:
            yield f"the test motion meets {len(met)} contacts or limits that the start does not"
        if worst.fell is not None:
            yield f"the robot falls over after {seconds(worst.fell)}"
