"""`Moves`: moves of a model's joints that its actuators can make, chosen by trials."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from stepcore.engine.model import Model
from stepcore.engine.start import Start
from stepcore.experiment.attempt import Attempt, attempt
from stepcore.experiment.drives import MOTOR, RATE, SERVO, Drives
from stepcore.experiment.joint_gains import gains_of
from stepcore.experiment.point_to_point import MOVE, REST, JointGains, PointToPoint
from stepcore.experiment.poses import Poses, contact_jacobian

# The largest force, as a share of its bound, and of what holding the start leaves of it.
FORCE, LEFT = 0.6, 0.5
# The largest share of a run in which an actuator is at its bound.
SATURATED = 0.05
# The least share of its way that a joint goes.
LEAST = 1 / 16
# The group of the joints on which the machine stands.
STANCE = 0
# The most operations of all trials of moves, and their least number.
BUDGET, LEAST_TRIALS = 2.5e8, 8
# The length of the trial that holds the start [s]; that of a move is there, and the rest.
HOLD = 2 * (MOVE + REST)


@dataclass(frozen=True)
class Move:
    """A move of one start; far: the way of each joint, (joints,). An untried one has no trial."""

    control: PointToPoint
    trial: Attempt | None
    far: np.ndarray

    @property
    def moves(self) -> bool:
        """Whether anything moves."""
        control = self.control
        return bool(control.spans.any() or control.rates.any() or control.changes.any())


class Moves:
    """Chooses the move of each start of a model, by trials."""

    def __init__(
        self,
        model: Model,
        home: Start,
        ctrl: np.ndarray,
        period: float,
        *,
        keep: bool,
        whole: bool,
    ) -> None:
        """home, ctrl: the state and the controls of the keyframe. period: the control period [s].

        keep: whether to hold the start, under the keyframe's controls even where these are 0.
        whole: whether controls are constant over each period.
        """
        self.model, self.home, self.drives = model, home, Drives(model)
        self.period, self.keep, self.whole = period, keep, whole
        clamped, free = model.scene.features.clampctrl, np.array([[-np.inf, np.inf]])
        self.ranges = model.actuator_ctrlrange if clamped else np.repeat(free, model.nu, 0)
        self.poses = Poses(model, self.drives, home)
        held = self._clamped(np.array(ctrl, float)) if keep else self._held(ctrl)
        nothing = np.zeros((1, model.nu))
        motors = self.drives.of(MOTOR)
        none = np.zeros((1, len(motors)))
        self.control = PointToPoint(held, nothing, nothing, None, none)
        self.hold = self._balanced(motors) if motors else self._trial(home, self.control, HOLD)
        if not self.hold.fell and self.hold.end is not None:
            self.poses = self.poses.standing(self.hold.end, self.hold.points)
        # Joints on which the machine stands go equally far; all others have a share of their own.
        self.groups = np.where(self.poses.stance, STANCE, 1 + np.arange(len(self.poses.stance)))
        self.shares = np.ones(1 + len(self.groups))
        self.shares[STANCE] = bool(self.poses.stance.any())
        self.trials = max(LEAST_TRIALS, int(BUDGET / max(1.0, self.hold.flops)))
        self.found = False
        # What the machine touches when it holds still, it may touch in other places.
        pairs = {self.poses.trees_of(pair) for pair in self.hold.met if not isinstance(pair, int)}
        self.handled = {trees for trees in pairs if 0 not in trees and len(trees) == 2}

    @property
    def still(self) -> Move:
        return Move(self.control, self.hold, np.zeros(len(self.poses.joints)))

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
        clamped: np.ndarray = np.clip(ctrl, *self.ranges.T)
        return clamped

    def _balanced(self, motors: list[int]) -> Attempt:
        """Choose the gains and the load of the motors, and return the trial that holds the start.

        The first trial shows the contacts on which the machine comes to stand.
        """
        tried = self._holding(motors, self.home, self.poses.kept, fixed=False)
        held = tried[1]
        if held.end is not None and held.points and not _holds(held):
            contacts = contact_jacobian(self.model, self.poses.trees, held.end, held.points)
            others = (self._holding(motors, held.end, contacts, fixed) for fixed in (True, False))
            tried = min((tried, *others), key=lambda pair: _rank(pair[1]))
        self.control, seen = tried
        return seen

    def _holding(
        self, motors: list[int], stands: Start, contacts: np.ndarray, fixed: bool
    ) -> tuple[PointToPoint, Attempt]:
        gains = gains_of(
            *(self.model, self.drives, motors, self.home.qpos, stands, contacts),
            period=self.period,
            fixed=fixed,
        )
        control = replace(self.control, gains=gains)
        return control, self._trial(self.home, control, HOLD)

    def _trial(self, start: Start, control: PointToPoint, horizon: float) -> Attempt:
        return attempt(self.model, self.drives, start, control, self.period, horizon, self.whole)

    def choose(self, starts: Sequence[Start], seed: int) -> list[Move]:
        """Return a move for each start."""
        return [self._move(k, start, seed) for k, start in enumerate(starts)]

    def _move(self, index: int, start: Start, seed: int) -> Move:
        """Return the move of a start: the first attempt without trouble, or none.

        Joints that cause trouble go half as far in the next attempt, and in all later starts.
        """
        if self.keep or self.hold.failure or self.hold.fell is not None:
            return self.still
        hold = self.hold
        drawn = self.poses.drawn(np.random.default_rng([seed, index]))
        while self.shares.any():
            control, far = self._control(*drawn)
            if self.trials <= 0:
                return Move(control, None, far) if self.found else self.still
            self.trials -= 1
            seen = self._trial(start, control, MOVE + REST)
            causes = self.causes(seen, hold)
            if causes and hold is self.hold:
                # Some of it may be the start's own doing.
                hold = hold.beside(self._trial(start, self.control, MOVE + REST))
                causes = self.causes(seen, hold)
            if not causes:
                self.found = True
                return Move(control, seen, far)
            moving = [group for group in sorted(causes) if self.shares[group]]
            # A joint that is moved by the others alone blames all of them.
            self.shares[moving or slice(None)] /= 2
            self.shares[self.shares < LEAST] = 0.0
        return self.still

    def _control(self, change: np.ndarray, others: np.ndarray) -> tuple[PointToPoint, np.ndarray]:
        """Return the controls of a move, and the way of each joint; see `Poses.drawn`."""
        model, drives, poses = self.model, self.drives, self.poses
        shares, count = self.shares[self.groups], len(poses.joints)
        change = np.array(change)
        change[poses.dofs] *= shares[:count]
        others = others * shares[count:]
        ways = poses.lengths(change)
        for k, share in zip(poses.others, others, strict=True):
            ways[k] = share * poses.span(k)
        spans, rates = np.zeros(model.nu), np.zeros(model.nu)
        for k in drives.of(SERVO):
            target = self.control.held[k] + ways[k] / drives.lengths[k]
            back = self.control.held[k] - ways[k] / drives.lengths[k]
            low, high = self.ranges[k]
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

    def causes(self, seen: Attempt, hold: Attempt) -> set[int]:
        """Return the groups of joints that cause trouble in a trial; empty if there is none.

        hold: what happens without moves, which the moves do not cause.
        """
        every = set(self.groups.tolist())
        if seen.failure:
            return every
        allowed = np.maximum(FORCE, hold.force + LEFT * (1 - hold.force))
        over = (seen.force > allowed) | (seen.saturated > hold.saturated + SATURATED)
        joints, causes = set[int](), set[int]()
        for k in np.flatnonzero(over).tolist():
            if k in self.poses.others:
                at = len(self.poses.joints) + self.poses.others.index(k)
                causes.add(int(self.groups[at]))
            elif (joint := self.drives.joint(k)) is not None:
                joints.add(joint)
        for met in seen.met - hold.met:
            if isinstance(met, int):
                joints |= {met} - self.poses.at_limit
            elif self.poses.trees_of(met) not in self.handled:
                joints |= self.poses.between(met)
        places = {joint: at for at, joint in enumerate(self.poses.joints)}
        causes |= {int(self.groups[places[joint]]) for joint in joints if joint in places}
        falls = seen.fell is not None and hold.fell is None
        if self.poses.stance.any() and (falls or hold.ends_on - seen.ends_on):
            causes |= {STANCE} & every or every
        return causes


def _holds(seen: Attempt) -> bool:
    """Return whether a trial holds the start."""
    return not (seen.failure or seen.fell is not None or (seen.saturated > SATURATED).any())


def _rank(seen: Attempt) -> tuple[bool, float, float]:
    """Return how badly a trial holds the start, for comparison."""
    standing = math.inf if seen.fell is None else seen.fell
    return bool(seen.failure), -standing, float(seen.saturated.max(initial=0.0))


def holding(
    model: Model, home: Start, ctrl: np.ndarray, period: float
) -> tuple[np.ndarray, JointGains | None]:
    """Return the controls that hold a start, (nu,), and the PD control of its motors, if any.

    ctrl: the controls of the keyframe. period: the control period [s].
    """
    control = Moves(model, home, ctrl, period, keep=True, whole=False).control
    return control.held, control.gains
