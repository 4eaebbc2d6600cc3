"""Whether the real step of a model stays bounded: what the linearised step may not show."""

from __future__ import annotations

import numpy as np

from stepcore._core import SimulationError
from stepcore.engine.control import fresh
from stepcore.engine.model import Model
from stepcore.measure.diagnosis.control import steps_held
from stepcore.measure.diagnosis.linear_step import State, ask_control, sim_at
from stepcore.measure.diagnosis.saturation import FASTEST, FASTEST_SLIDE, KICK
from stepcore.measure.diagnosis.servo_range import driven_dof, reaching_speed

# The most steps of a run, and in how many shorter ones it is repeated where it grows.
STEPS, SHORTER = 500, 4
# A push in every dof, to alternate sides [m/s or rad/s].
PUSH = 1e-3
# A speed is of the motion itself if shorter steps reach this part of it.
PART = 0.1
# A kicked joint may become faster by this factor.
THROWN = 1.2


def stays_bounded(model: Model, state: State, integrator: str, dt: float, horizon: float) -> bool:
    """Whether a run from a state, pushed a little, reaches no speed that shorter steps do not.

    dt [s]; horizon [s]: the time of the run, at most `STEPS` steps.
    """
    count = max(1, min(STEPS, round(horizon / dt)))
    first = np.abs(state.qvel).max(initial=PUSH)
    speed = _largest_speed(model, state, integrator, dt, count)
    if speed is None:
        return False
    if PART * speed <= first:
        return True
    finer = _largest_speed(model, state, integrator, dt / SHORTER, count * SHORTER)
    # Where shorter steps end as well, nothing is learned of this one.
    return finer is None or PART * speed <= finer


def settles(model: Model, state: State, integrator: str, dt: float, servo: int) -> bool:
    """Whether a servo that is kicked beyond its force range throws its joint no faster.

    Its control is held; in fine steps it comes to rest. A kick that is faster than any motion of
    use is not made. dt [s].
    """
    if model.actuator_joint[servo] < 0:
        # Not along one joint, which alone could be kicked.
        return True
    dof, kick = driven_dof(model, servo), KICK * reaching_speed(model, servo)
    turns = model.jnt_type[int(model.actuator_joint[servo])] != "slide"
    if not kick <= (FASTEST if turns else FASTEST_SLIDE):
        return True
    sim = sim_at(model, state, integrator=integrator, dt=dt)
    sim.qvel[dof] += kick
    begun = abs(float(sim.qvel[dof]))
    try:
        for _ in range(STEPS):
            sim.step()
            if abs(float(sim.qvel[dof])) > THROWN * begun:
                return False
    except SimulationError:
        return False
    return True


def _largest_speed(
    model: Model, state: State, integrator: str, dt: float, count: int
) -> float | None:
    """The largest speed of any dof in a run; None where it does not stay finite."""
    sim = sim_at(model, state, integrator=integrator, dt=dt)
    sim.qvel[:] += PUSH * (-1.0) ** np.arange(model.nv)
    largest, hold = 0.0, steps_held(state, dt)[0]
    function = None if state.feedback is None else fresh(state.feedback.function)
    try:
        for step in range(count):
            if step % hold == 0 and not ask_control(sim, function):
                return None
            sim.step()
            largest = max(largest, float(np.abs(sim.qvel).max()))
    except SimulationError:
        return None
    return largest
