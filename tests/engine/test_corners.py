"""Laws with a corner: there derivatives are of one side, and `degenerate` names the element."""

import numpy as np
import pytest

import stepcore as sc
from stepcore import Sim

SLIDE = """<mujoco><option integrator="{integrator}" gravity="0 0 0"/><worldbody>
<geom type="plane" size="1 1 1"/><site name="fixed" pos="0 0 9"/>
<body pos="0 0 5"><joint name="rail" type="slide" axis="0 0 -1" {joint}/>
<geom type="sphere" size=".125" mass="1"/><site name="end"/></body></worldbody>
<tendon><spatial name="rope" {tendon}><site site="fixed"/><site site="end"/></spatial></tendon>
<actuator>{actuator}</actuator></mujoco>"""
MOTOR = '<general name="motor" joint="rail" gear="1" {}/>'
MUSCLE = MOTOR.format('dyntype="muscle" dynprm=".01 .04" ctrlrange="-1 2"')
# The scene, a state at a corner (q, v, control, activation), and a part of the name of who has it.
CORNERS = {
    "slack rope's end": ({"tendon": 'stiffness="50" springlength="3 4"'}, (0, 0), "rope"),
    "slack rope's start": ({"tendon": 'stiffness="50" springlength="4 5"'}, (0, 0), "rope"),
    "tendon limit": ({"tendon": 'limited="true" range="1 4"'}, (0, 0), "rope"),
    "joint limit": ({"joint": 'limited="true" range="-1 2"'}, (2, 0.1), "rail"),
    "joint limit's margin": (
        {"joint": 'limited="true" range="-1 2" margin=".5"'},
        (-0.5, 0),
        "rail",
    ),
    "touch": ({}, (4.875, 0), "contact"),
    "control": ({"actuator": MOTOR.format('ctrlrange="-2 1"')}, (0, 0, 1.0), "motor"),
    "force": ({"actuator": MOTOR.format('gainprm="2" forcerange="-1 1"')}, (0, 0, 0.5), "motor"),
    "servo": (
        {"actuator": '<position name="motor" joint="rail" kp="8" forcerange="-1 1"/>'},
        (0.25, 0.1, 0.125),
        "motor",
    ),
    "joint's sum": (
        {"joint": 'actuatorfrcrange="-1 3"', "actuator": MOTOR.format("")},
        (0, 0, 3.0),
        "rail",
    ),
    "tendon's sum": (
        {"tendon": 'actuatorfrcrange="-1 3"', "actuator": '<motor name="motor" tendon="rope"/>'},
        (0, 0, 3.0),
        "rope",
    ),
    "activation": (
        {"actuator": MOTOR.format('dyntype="integrator" actlimited="true" actrange="0 1"')},
        (0, 0, 0.0, 1.0),
        "motor",
    ),
    "muscle": ({"actuator": MUSCLE}, (0, 0, 0.5, 0.5), "motor"),
    "muscle at rest": ({"actuator": MUSCLE}, (0, 0, 0.0, 0.5), "motor"),
}
SMOOTH = {
    "rest length": ({"tendon": 'stiffness="50"'}, (0, 0)),
    "control": ({"actuator": MOTOR.format('ctrlrange="-2 1"')}, (0, 0, 0.999)),
    "muscle": ({"actuator": MUSCLE}, (0, 0, 0.5, 0.4)),
    "smoothed muscle": ({"actuator": MUSCLE.replace(".04", ".04 .2")}, (0, 0, 0.5, 0.5)),
    "touch": ({}, (4.874, 0)),
}


def _sim(fields, state, integrator="Euler"):
    blank = dict.fromkeys(("joint", "tendon", "actuator"), "")
    scene = sc.loads(SLIDE.format(integrator=integrator, **blank | fields))
    sim = Sim(scene, tolerance=0.0)
    _put(sim, state)
    return sim


def _put(sim, state):
    q, v, ctrl, act = (*state, 0.0, 0.0)[:4]
    sim.qpos[0], sim.qvel[0] = q, v
    if sim.model.nu:
        sim.ctrl[0] = ctrl
    if sim.model.na:
        sim.act[0] = act


def _after(sim, state):
    """Return x after a step from a state whose impulses nobody knows."""
    copy = sim.copy()
    copy.reset()
    _put(copy, state)
    copy.step()
    return np.array([*copy.qpos, *copy.qvel, *copy.act])


def _sides(sim, state, h=1e-7):
    """Return the derivatives of a step from both sides, (2, n, columns), and `linearize`'s."""
    step, n = sim.linearize(), 2 + sim.model.na
    columns = (0, 1, *((3,) if sim.model.na else ()), *((2,) if sim.model.nu else ()))
    state, own = np.array((*state, 0.0, 0.0)[:4], float), np.hstack([step.A, step.B])
    middle = _after(sim, state)
    sides = np.zeros((2, n, len(columns)))
    for k, column in enumerate(columns):
        for side, sign in enumerate((1, -1)):
            moved = state.copy()
            moved[column] += sign * h
            sides[side, :, k] = sign * (_after(sim, moved) - middle) / h
    return sides, own


@pytest.mark.parametrize("integrator", ["Euler", "RK4"])
@pytest.mark.parametrize("case", CORNERS)
def test_a_corner_is_named(case, integrator):
    fields, state, name = CORNERS[case]
    sim = _sim(fields, state, integrator)
    (forward, back), own = _sides(sim, state)
    step = sim.linearize()
    apart = np.abs(forward - back) > 1e-5
    assert apart.any(), "no corner"
    assert any(name in one for one in step.degenerate), step.degenerate
    assert len(step.degenerate) == 1
    if integrator == "Euler":
        nearest = np.minimum(np.abs(own - forward), np.abs(own - back))
        assert nearest.max() < 1e-5
    assert own[~apart] == pytest.approx(forward[~apart], abs=2e-5)


@pytest.mark.parametrize("case", SMOOTH)
def test_beside_a_corner_nothing_is_named(case):
    fields, state = SMOOTH[case]
    sim = _sim(fields, state)
    (forward, back), own = _sides(sim, state)
    assert np.abs(forward - back).max() < 2e-4
    assert sim.linearize().degenerate == ()
    assert own == pytest.approx((forward + back) / 2, abs=1e-4)
