"""The default motion, of a measurement without controls: one that the machine could make.

`kind_of` chooses it from the model alone:

- Nothing is actuated: "fall". The scene falls, rolls and comes to rest. (A URDF has no actuators,
  but got motors before, on the joints whose effort it bounds: see `change.powered`.)
- Servos, or motors on a fixed base or with controls in N or N·m: "move". All joints move together,
  from the start to a random pose near it in 0.8 s (minimum jerk), rest for 0.2 s, and return. A
  joint goes up to a tenth of its range and at most 0.5 rad, to a different pose from each start.
  Contacts that support the robot keep their places. Position servos get these poses as their
  controls, velocity servos get the velocities. Motors are replaced by servos, which carry the
  static load of the start; see `stepcore.experiment.moves`.
- Motors with controls within ±1 on a body that moves about (the walkers of gymnasium and
  dm_control), muscles and all else: "sines", which resemble policies.

A motion is tested by running it under the shipped settings, from all starts at once. It is reduced
until no force takes more than half of the range that holding the start leaves, no actuator is
saturated for more than 5 % of the time, and no limit or contact is met that holding the start does
not meet. The result reports moves that cannot be made.

The other kinds are for comparison: "hold" holds the start, "random" draws new controls in every
control period, and "fall" sets all controls to 0.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from typing import NamedTuple

import numpy as np

from stepcore.engine.actuator import MOTOR, OTHER, SERVO, VELOCITY_SERVO, actuators
from stepcore.engine.element import name_list
from stepcore.engine.model import Model
from stepcore.engine.sim import Sim
from stepcore.engine.start import Start
from stepcore.experiment.control_table import ControlLog, Controls, PositionTable
from stepcore.experiment.moves import HELD, MOVE, WAIT, Chosen, Moves, moves_about, profile, support
from stepcore.report.units import counted, metres, percent, radians, seconds

KINDS = ("hold", "move", "sines", "fall", "random")
# The sines of a control: their number, frequencies [Hz], and amplitude as a share of the control
# range. They grow over `RAMP` [s], because a jump would shock a stiff servo.
SINES, HERTZ, RANGED, RAMP = 3, (0.3, 3.0), 0.4, 0.25


def kind_of(model: Model) -> str:
    """Return the kind of motion that is chosen for a model."""
    if not model.nu or not model.scene.features.actuation:
        return "fall"
    drives = actuators(model)
    if any(drive.kind in (SERVO, VELOCITY_SERVO) for drive in drives):
        return "move"
    # A control range within ±1 has no unit: it is an action, as in gymnasium and dm_control.
    actions = all(abs(end) <= 1.0 for drive in drives for end in drive.ctrlrange)
    moves = any(drive.kind == MOTOR for drive in drives)
    return "move" if moves and not (actions and moves_about(model, drives)) else "sines"


class MotionRequest(NamedTuple):
    """The inputs from which controls are made.

    home, key_ctrl: the state and the controls of the keyframe, (nu,). starts: of the runs.
    seed: of the controls, which depend on a start's index, but not on the number of starts.
    period: the control period [s]. periods: the number of periods.
    constant: whether controls are constant over each period.
    """

    home: Start
    key_ctrl: np.ndarray
    starts: Sequence[Start]
    seed: int
    period: float
    periods: int
    constant: bool


def default_motion(model: Model, kind: str | None, request: MotionRequest) -> Controls:
    """Return the controls of a motion for which the user gave none.

    kind: one of `KINDS`; None chooses it.
    """
    kind, period = kind or kind_of(model), request.period
    if kind not in ("move", "hold") or not model.nu:
        ranges = np.reshape([drive.ctrlrange for drive in actuators(model)], (-1, 2))
        names = model.called("actuator")
        return by_rule(kind, actuators_in_words(model), names, ranges, request)
    moves = Moves(model, request.home, request.key_ctrl, keep=kind == "hold")
    chosen = moves.choose(request.starts, request.seed)
    parts = 1 if request.constant else 1 << max(0, math.ceil(math.log2(period / HELD)))
    horizon = request.periods * period
    log = moves.log(chosen.spans, chosen.rates, horizon, period / parts)
    words = "; ".join(_said(moves, chosen, horizon))
    others = [_name(model, "actuator", drive.index) for drive in moves.of(OTHER)]
    remark = "actuators that are no servos, and no motors of a joint, keep their controls: "
    remarks = (remark + name_list(others),) if others else ()
    return Controls(log, None, words, remarks, moves.servos)


# --- moves in words -------------------------------------------------------------------------------


def actuators_in_words(model: Model) -> str:
    """Return the word for the actuators of a model, in the plural."""
    words = {"motor": "motor", "muscle": "muscle", "damper": "damper", "cylinder": "cylinder"}
    words |= dict.fromkeys(("position", "velocity", "intvelocity"), "servo")
    kinds = {words.get(actuator.type, "actuator") for actuator in model.scene.actuators}
    return f"{kinds.pop()}s" if len(kinds) == 1 else "motors and servos"


def _said(moves: Moves, chosen: Chosen, horizon: float) -> Iterator[str]:
    """Describe the motion and its loads, and why the machine or some starts do not move."""
    far, motors = _far(moves, chosen), bool(moves.servos)
    if far:
        who = "a PD controller drives the joints" if motors else "servos move"
        back = " and back" * (horizon > MOVE + WAIT)
        how = f"point to point over {seconds(MOVE)} {far}{back} (minimum jerk)"
        yield f"test motion: {who} {how}"
    else:
        yield f"test motion: {'a PD controller holds' if motors else 'servos hold'} the start"
    if moves.held.failure:
        yield f"it only holds the start, and that fails: {moves.held.failure}"
        return
    yield ", ".join(_loads(moves, chosen))
    if moves.held.fell is not None:
        after = seconds(moves.held.fell)
        yield f"nothing holds this pose: the robot falls over within {after}"
    elif not moves.keep and chosen.still:
        some = f"{chosen.still} of {counted(len(chosen.spans), 'start')}"
        who = f"{some} only hold their pose" if chosen.still > 1 else f"{some} only holds its pose"
        if len(chosen.spans) == 1:
            who = "it only holds its pose"
        yield f"{who}, because even small moves meet contacts, limits or the bounds of forces"


def _far(moves: Moves, chosen: Chosen) -> str:
    """Describe the largest moves: "to poses up to 0.35 rad and 5 mm away"; "" if nothing moves."""
    slides = np.array([moves.model.jnt_type[joint] == "slide" for joint in moves.joints], bool)
    ends = (radians, chosen.far[~slides]), (metres, chosen.far[slides])
    parts = [write(float(far.max())) for write, far in ends if far.max(initial=0.0) > 1e-6]
    most = float(np.abs(chosen.spans).max(initial=0.0))
    if not parts and most > 1e-6:
        parts = [f"{most:.2g} of control"]
    speed = float(np.abs(chosen.rates).max(initial=0.0)) * profile(np.array([MOVE / 2]))[1][0]
    if not parts and speed > 1e-6:
        return f"under controls up to {speed:.2g}"
    return f"to poses up to {' and '.join(parts)} away" if parts else ""


def _loads(moves: Moves, chosen: Chosen) -> Iterator[str]:
    """Describe the top speed of a joint, the largest force, and the saturation."""
    model = moves.model
    speed = np.max([seen.speed[moves.dofs] for seen in chosen.seen], axis=0)
    turns = [model.jnt_type[joint] == "hinge" for joint in moves.joints]
    # Speeds below 1 mrad/s or 1 mm/s are settling.
    if len(speed) and speed.max() > 1e-3:
        fast = int(np.where(turns, speed, 0).argmax()) if any(turns) else int(speed.argmax())
        joint = _name(model, "joint", moves.joints[fast])
        yield f"top speed {speed[fast]:.2g} {'rad/s' if turns[fast] else 'm/s'} ({joint})"
    force = np.max([seen.force for seen in chosen.seen], axis=0)
    full = np.max([seen.full for seen in chosen.seen], axis=0)
    most = int(full.argmax() if full.any() else force.argmax())
    name = _name(model, "actuator", most)
    if full.any():
        yield f"{name} saturated {percent(float(full[most]))} of the time"
    else:
        if force.max(initial=0.0) > 1e-6:  # Less is rounding.
            yield f"largest force {percent(float(force[most]))} of its bound ({name})"
        yield "never saturated"


def _name(model: Model, kind: str, index: int) -> str:
    name = model.names[kind][index]
    return f"`{name}`" if name else model.called(kind)[index]


# --- controls by a rule ---------------------------------------------------------------------------


def by_rule(
    kind: str, drives: str, names: Sequence[str], ranges: np.ndarray, request: MotionRequest
) -> Controls:
    """Return controls that follow from their ranges alone: "hold", "fall", "random" or "sines".

    drives: the actuators in words. names: their names. ranges: of the controls, (nu, 2); infinite
    for a control without a range.
    """
    key_ctrl, periods = request.key_ctrl, request.periods
    times = request.period * np.arange(periods)
    if not len(names):
        return Controls(ControlLog(times[:1], np.zeros((1, 0))), words="no motors")
    if kind in ("hold", "fall"):
        row = key_ctrl if kind == "hold" else np.zeros(len(names))
        words = "at the keyframe's controls" if kind == "hold" else "at zero"
        return Controls(ControlLog(times[:1], row[None]), words=f"{drives} are held {words}")
    draws = [np.random.default_rng([request.seed, k]) for k in range(len(request.starts))]
    if kind == "random":
        ranged = np.isfinite(ranges).all(axis=1)
        rows = np.tile(key_ctrl, (len(draws), periods, 1))
        for start_rows, rng in zip(rows, draws, strict=True):
            low, high = ranges[ranged].T
            start_rows[:, ranged] = rng.uniform(low, high, (periods, len(low)))
        pace = f"every {seconds(request.period)}"
        words = f"{drives} get new random controls within their range {pace}"
        return Controls(ControlLog(times, rows), words=words)
    rows = np.stack([_sines(ranges, key_ctrl, times, rng) for rng in draws])
    free = ~np.isfinite(ranges).all(axis=1)
    return Controls(ControlLog(times, rows), words=_sines_in_words(drives, names, free, key_ctrl))


def _sines(
    ranges: np.ndarray, key_ctrl: np.ndarray, times: np.ndarray, rng: np.random.Generator
) -> np.ndarray:
    """Return smooth controls: random sines around the keyframe's, within their ranges."""
    ramp, values = np.minimum(1.0, times / RAMP), np.empty((len(times), len(ranges)))
    for k, (low, high) in enumerate(ranges):
        hertz, phase = rng.uniform(*HERTZ, SINES), rng.uniform(0.0, 2 * math.pi, SINES)
        share = rng.dirichlet(np.ones(SINES))
        wave = ramp * (np.sin(2 * math.pi * np.outer(times, hertz) + phase) @ share)
        if math.isfinite(high - low):
            centre = key_ctrl[k] if key_ctrl[k] else (low + high) / 2
            begun = np.clip(key_ctrl[k], low, high)
            middle = begun + ramp * (centre - begun)
            values[:, k] = np.clip(middle + RANGED * (high - low) * wave, low, high)
        else:
            values[:, k] = key_ctrl[k]
    return values


def _sines_in_words(drives: str, names: Sequence[str], free: np.ndarray, ctrl: np.ndarray) -> str:
    """Describe sines; free: which controls have no range, and keep the keyframe's value."""
    at = "at the keyframe's controls" if ctrl[free].any() else "at zero"
    if free.all():
        return f"{drives} are held {at}, because nothing gives their range"
    low, high = HERTZ
    words = f"test motion: random sines of {low:g} to {high:g} Hz, "
    words += f"±{RANGED:.0%} of the control range, as policies look".replace("%", " %")
    if free.any():
        some = names[int(free.argmax())] if free.sum() == 1 else f"{free.sum()} of them"
        words += f"; {some} without a range held {at}"
    return words


# --- recorded positions ---------------------------------------------------------------------------


def following_controls(table: PositionTable, model: Model, request: MotionRequest) -> Controls:
    """Return the controls that follow the positions; between rows they are interpolated.

    Servos that replace motors are made for the first pose.
    """
    start = request.home
    poses = table.poses(model, start.qpos)
    moves = Moves(model, start, request.key_ctrl, keep=True)
    servos, motors = moves.of(SERVO), moves.of(MOTOR)
    if not servos and not motors:
        kinds = "position servo or motor, which could follow"
        raise ValueError(f"{table.source}: no actuator is a {kinds}")
    times = request.period * np.arange(len(poses))
    if table.times is not None:
        times = table.times - table.times[0]
    rates = np.gradient(poses, times, axis=0) if len(poses) > 1 else np.zeros_like(poses)
    sim, rows = Sim(model), np.tile(moves.ctrl, (len(poses), 1))
    gains = {servo.actuator: servo.kp for servo in moves.servos}
    dofs = [motor.dof for motor in motors]
    first: np.ndarray | None = None
    for row, pose, rate in zip(rows, poses, rates, strict=True):
        sim.qpos = pose
        lengths = sim.actuator_length
        for servo in servos:
            row[servo.index] = servo.holding(lengths[servo.index])
        if not motors:
            continue
        # The load in addition to the first pose's, which servos carry.
        sim.forward()
        load = support(sim, dofs, np.zeros((0, model.nv)))
        first = load if first is None else first
        for motor, more in zip(motors, load - first, strict=True):
            k, at = motor.index, motor.qposadr
            ahead = pose[at] - poses[0, at] + moves.lag[k] * rate[at]
            kp = gains[model.actuator_names[k] or k]
            share = more / dofs.count(motor.dof) / motor.gear
            row[k] += motor.gear * ahead + share / kp
    log = ControlLog(times, rows, linear=table.times is not None)
    return Controls(log, servos=moves.servos)
