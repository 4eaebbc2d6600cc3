"""The load of servos while a robot rests on its feet, and whether gains hold the robot up.

The load is found by inverse statics. With rigid joints the robot settles on the ground. There the
contact forces of least norm that balance the base determine the forces of the joints; see
`stepcore.experiment.moves.support`.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Callable, Sequence
from typing import NamedTuple

import numpy as np

from stepcore.engine.actuator import SERVO, Actuator, actuators
from stepcore.engine.model import Model
from stepcore.engine.sim import Sim
from stepcore.engine.start import Start
from stepcore.experiment.change import Change
from stepcore.experiment.moves import SHOCK, Moves, Seen, driven_roots, moves_about, support
from stepcore.measure.tune.goal import ROUNDS, WITHIN, At, Goal
from stepcore.report.units import seconds

# The armature of held joints, relative to the mass of the scene.
HEAVY = 1e6
# Time for which a robot must not fall [s]. A quadruped of 12 kg with kp 30 falls after 3.3 s.
STANDS = 5.0


class Ground(NamedTuple):
    """The pose in which a robot with rigid joints comes to rest on the ground.

    model, at: the robot, the pose, and the controls that hold it. end: the state at rest.
    contacts: the Jacobian of its contacts there, (3 contacts, nv).
    """

    model: Model
    at: At
    end: Start
    contacts: np.ndarray

    def load(self, dofs: list[int]) -> np.ndarray:
        """Return the forces at some dofs when the robot rests on its feet [N or N·m]."""
        sim = Sim(self.model)
        self.end.put(sim)
        sim.forward()
        return support(sim, dofs, self.contacts)

    def run(self, change: Change) -> Seen:
        """Run a change of the model on the ground."""
        moves, still = _held(change.of(self.model), self.at), np.zeros((1, self.model.nu))
        if moves.held.failure or moves.held.fell is not None:
            return moves.held
        return moves.trials([self.at.start], still, still, STANDS)[0]

    def sag(
        self,
        drives: Sequence[Actuator],
        goal: Goal,
        change: Callable[..., Change],
    ) -> tuple[np.ndarray, np.ndarray, str]:
        """Return requests to the closed form with which no servo sags more than the goal, the
        measured sags, and the reason if the goal is not reached, else "".

        The joints of a leg whose foot does not slip sag together, so most sag less than by the
        closed form. If the robot falls, all servos get twice the stiffness.

        change: returns the gains for the requests and other settings.
        """
        first = asked = np.full(len(drives), goal.value)
        for last in reversed(range(ROUNDS)):
            shown, why, falls = self._sags(drives, goal, change(asked))
            over = np.nan_to_num(shown) / goal.value
            if not last or (why and not falls) or not (why or over.max() > 1 + WITHIN):
                break
            asked = asked / (2.0 if falls else np.maximum(1.0, over))
        if why and self.model.settings.integrator != "implicitfast":
            _, fails, _ = self._sags(drives, goal, change(first, integrator="implicitfast"))
            why += "" if fails else "; under implicitfast it stands"
        return asked, shown, why

    def _sags(
        self, drives: Sequence[Actuator], goal: Goal, change: Change
    ) -> tuple[np.ndarray, str, bool]:
        """Return each servo's sag, why it is unknown or "", and whether the robot falls."""
        seen, shown = self.run(change), np.full(len(drives), np.nan)
        why = fall(seen)
        if not why and seen.end is not None:
            shown = np.array([self._off(drive, seen.end) for drive in drives])
            if np.abs(seen.end.qvel).max() * SHOCK > WITHIN * goal.value:
                step = seconds(self.model.settings.dt)
                why = f"On the ground the robot does not come to rest with steps of {step}"
        return shown, why, seen.fell is not None

    def _off(self, drive: Actuator, end: Start) -> float:
        """Return the distance of a servo from its target at the end of a run [rad or m]."""
        target = float(drive.target(self.at.ctrl[drive.index]))
        return abs(target - drive.gear * float(end.qpos[drive.qposadr])) / abs(drive.gear)


def fall(seen: Seen) -> str:
    """Return why a robot does not stay up in a run on the ground; "" if it does."""
    if seen.failure:
        return f"On the ground the run fails: {seen.failure}"
    if seen.fell is not None:
        return f"The robot falls within {seconds(seen.fell)} on the ground"
    return ""


def _held(model: Model, at: At) -> Moves:
    return Moves(model, at.start, at.ctrl, keep=True)


def held_joints(model: Model) -> tuple[list[int], list[int]]:
    """Return the joints by which robots move about, and the robots' other joints."""
    drives = actuators(model)
    trees, driven = driven_roots(model, drives), {drive.joint for drive in drives}
    base, others = list[int](), list[int]()
    for joint, body in enumerate(model.jnt_body.tolist()):
        if model.root(body) in trees:
            (base if body in trees and joint not in driven else others).append(joint)
    return base, others


def stiffened(model: Model, joints: list[int]) -> Model:
    """Return the model with a large armature on some joints, which holds them."""
    heavy = HEAVY * float(model.body_mass.sum())
    return Change({f"joint/#{joint}/armature": heavy for joint in joints}).of(model)


def ground_of(model: Model, at: At, goal: str) -> tuple[Ground | None, str, str]:
    """Return where a mobile robot with rigid joints comes to rest on the ground, how it is held, in
    words, and why its load on the ground is unknown, or "".

    The first is None if nothing moves about, or if the robot falls, which no gains change.
    """
    if not moves_about(model, actuators(model)):
        return None, "", ""
    rigid, air = _held(stiffened(model, held_joints(model)[1]), at), ", the base held in the air"
    seen = rigid.held
    if seen.failure or seen.fell is not None:
        why = "the robot falls on the ground, even with rigid joints"
        return None, f"{air} ({why})", f"In this pose {why}"
    if seen.end is None or not len(rigid.kept):
        return None, f"{air} (in this pose nothing carries it)", ""
    stands = f"{seconds(STANDS)} on the ground"
    said = f", {stands}" if goal == "sag" else f"{air}, then {stands}"
    return Ground(model, at, seen.end, rigid.kept), said, ""


def asking(model: Model, at: At) -> At:
    """Return a start whose controls have the start's pose as the servos' target."""
    ctrl, qpos = at.ctrl.copy(), at.start.qpos
    for drive in actuators(model):
        if drive.kind == SERVO and drive.joint is not None and drive.gain:
            asked = drive.holding(drive.gear * qpos[drive.qposadr])
            ctrl[drive.index] = np.clip(asked, *drive.ctrlrange)
    return At(at.start, ctrl)


def hung(model: Model, at: At, size: float) -> tuple[Model, At]:
    """Return a mobile robot whose base is held in the air by a large armature.

    On its feet it could fall before a servo is measured. size: the height it is lifted by [m].
    """
    if not moves_about(model, actuators(model)):
        return model, at
    base, _ = held_joints(model)
    qpos, gravity = at.start.qpos.copy(), np.array(model.scene.gravity)
    up = -gravity / max(float(np.linalg.norm(gravity)), 1e-9)
    for joint in base:
        if model.jnt_type[joint] == "free":
            qpos[model.jnt_qposadr[joint] :][:3] += size * up
    return stiffened(model, base), at._replace(start=dataclasses.replace(at.start, qpos=qpos))
