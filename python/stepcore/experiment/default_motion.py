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

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from stepcore.engine.model import Model
from stepcore.engine.start import Start
from stepcore.experiment.control_log import ControlLog
from stepcore.experiment.drives import MOTOR, RATE, SERVO, Drives, actuators_in_words
from stepcore.experiment.move_words import MoveWords
from stepcore.experiment.moves import Moves
from stepcore.experiment.point_to_point import PointToPoint
from stepcore.experiment.sines import control_ranges, sines, sines_in_words, undriven, uniform
from stepcore.report.units import seconds

KINDS = ("hold", "move", "sines", "fall", "random")


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
    control: a control function, or None.
    words: the motion in words.
    remarks: what could not be reached.
    log: controls that change within periods; `ctrl` has their means. See `Schedule.log`.
    """

    ctrl: np.ndarray | None
    control: PointToPoint | None
    words: str
    remarks: tuple[str, ...] = ()
    log: ControlLog | None = None


def default_motion(
    model: Model,
    kind: str | None,
    home: Start,
    ctrl: np.ndarray,
    starts: Sequence[Start],
    seed: int,
    period: float,
    periods: int,
    *,
    whole: bool = False,
) -> DefaultMotion:
    """Return the controls of a motion without controls of its own.

    kind: one of `KINDS`; None chooses it. home, ctrl: the state and the controls of the keyframe.
    starts: the starts of the runs. period: the control period [s]. periods: their number.
    seed: of the controls; those of a start depend on its index alone, not on how many there are.
    whole: whether controls are constant over each period.
    """
    kind = kind or kind_of(model)
    what, count = actuators_in_words(model), len(starts)
    if not model.nu:
        return DefaultMotion(np.zeros((count, periods, 0)), None, "no motors")
    if kind == "fall":
        rows = np.zeros((count, periods, model.nu))
        return DefaultMotion(rows, None, f"{what} are held at zero")
    if kind in ("move", "hold"):
        moves = Moves(model, home, ctrl, period, keep=kind == "hold", whole=whole)
        chosen = moves.choose(starts, seed)
        control = PointToPoint.together([move.control for move in chosen])
        said = MoveWords(moves, chosen)
        told = said.motion, tuple(said.remarks())
        if control.gains is not None:
            return DefaultMotion(None, control, *told)
        log = control.log(periods, period, whole)
        means = log.steps(0.0, period, periods).reshape(periods, count, model.nu)
        return DefaultMotion(means.transpose(1, 0, 2), None, *told, None if whole else log)
    draws, ranges = [np.random.default_rng([seed, k]) for k in range(count)], control_ranges(model)
    if kind == "random":
        rows = np.stack([uniform(ranges, ctrl, periods, rng) for rng in draws])
        words = f"{what} get new random controls within their range every {seconds(period)}"
        return DefaultMotion(rows, None, words)
    rows = np.stack([sines(ranges, ctrl, periods, period, rng) for rng in draws])
    still = undriven(model.called("actuator"), ranges, ctrl)
    remarks = (
        [f"actuators without a control range are not driven: {', '.join(still)}"] if still else []
    )
    return DefaultMotion(rows, None, sines_in_words(ranges, what, still), tuple(remarks))
