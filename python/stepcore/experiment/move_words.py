"""`MoveWords`: the moves of a measurement in words, with their speeds and loads."""

from __future__ import annotations

from collections.abc import Iterator, Sequence

import numpy as np

from stepcore.engine.model import Model
from stepcore.experiment.drives import OTHER
from stepcore.experiment.moves import Move, Moves
from stepcore.experiment.point_to_point import MOVE
from stepcore.report.units import counted, metres, percent, radians, seconds

# A smaller speed is that of settling, and is not told [rad/s, m/s].
SLOW = 1e-3
# The most names in a list.
NAMED = 4


class MoveWords:
    """The motion of all starts in words."""

    def __init__(self, made: Moves, moves: Sequence[Move]) -> None:
        self.made, self.moves, self.model = made, moves, made.model
        self.trials = [move.trial for move in moves if move.trial is not None]
        self.names = [_name(self.model, "actuator", k) for k in range(self.model.nu)]

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
        return "; ".join([f"test motion: {said}{jerk}", ", ".join(self._loads()), *self._failed()])

    def _failed(self) -> Iterator[str]:
        """Yield why the machine, or some starts, do not move."""
        hold = self.made.hold
        if hold.failure:
            yield f"it only holds the start, and that fails: {hold.failure}"
        elif hold.fell is not None:
            yield f"nothing holds this pose: the robot falls over within {seconds(hold.fell)}"
        elif not self.made.keep and (still := sum(not move.moves for move in self.moves)):
            yield (
                f"{still} of {counted(len(self.moves), 'start')} only hold their pose, because "
                "even small moves meet contacts, limits or the bounds of forces"
            )

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
        speed = np.max([trial.speed[dofs] for trial in self.trials], axis=0)
        turns = [self.model.jnt_type[joint] == "hinge" for joint in self.made.poses.joints]
        if len(dofs) and speed.max() > SLOW:
            fast = int(np.where(turns, speed, 0).argmax()) if any(turns) else int(speed.argmax())
            unit = "rad/s" if turns[fast] else "m/s"
            joint = _name(self.model, "joint", self.made.poses.joints[fast])
            yield f"top speed {speed[fast]:.2g} {unit} ({joint})"
        force = np.max([trial.force for trial in self.trials], axis=0)
        full = np.max([trial.saturated for trial in self.trials], axis=0)
        if force.any() and not full.any():
            most = int(force.argmax())
            yield f"largest force {percent(float(force[most]))} of its bound ({self.names[most]})"
        if not full.any():
            yield "never saturated"
        else:
            most = int(full.argmax())
            yield f"{self.names[most]} saturated {percent(float(full[most]))} of the time"

    def remarks(self) -> Iterator[str]:
        """Yield what does not move, and what was not tried."""
        others = self.made.drives.of(OTHER)
        if others:
            names = ", ".join(self.names[k] for k in others[:NAMED])
            more = f" and {len(others) - NAMED} more" if len(others) > NAMED else ""
            yield (
                "actuators that are no servos, and no motors of a joint, keep their controls: "
                f"{names}{more}"
            )
        tried = len(self.trials)
        if tried < len(self.moves):
            yield f"the test motion was tried from {tried} of {counted(len(self.moves), 'start')}"


def _name(model: Model, kind: str, index: int) -> str:
    """Return the name of an element in backticks, or what describes it."""
    name = model.names[kind][index]
    return f"`{name}`" if name else model.called(kind)[index]
