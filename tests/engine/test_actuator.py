"""The one view of an actuator: its kind, gains, bounds, load and inertia, by laws of the engine."""

import numpy as np
import pytest

import stepcore as sc
from stepcore.engine.actuator import actuators, hold_load

ARM = """<mujoco><option timestep="0.001"/><worldbody>
  <body><joint name="shoulder" axis="0 1 0" actuatorfrcrange="-9 6"/>
    <geom type="capsule" size=".04" fromto="0 0 0 .5 0 0" mass="2"/>
    <body pos=".5 0 0"><joint name="elbow" axis="0 1 0" armature=".01"/>
      <geom type="capsule" size=".03" fromto="0 0 0 .4 0 0" mass="1"/>
      <body pos=".4 0 0"><joint name="lift" type="slide" axis="0 0 1"/>
        <geom size=".05" mass=".3"/></body></body></body>
  <body pos="2 0 0"><joint name="ball" type="ball"/><geom size=".1" mass="1"/></body>
</worldbody><tendon><fixed name="string"><joint joint="elbow" coef="1"/></fixed></tendon>
<actuator>
  <position name="servo" joint="elbow" kp="40" kv="3" gear="2" forcerange="-20 30"/>
  <velocity name="wheel" joint="shoulder" kv="5"/>
  <motor name="motor" joint="shoulder" gear="-3" ctrlrange="-1 2" ctrllimited="true"/>
  <general name="offset" joint="lift" gainprm="50" biastype="affine" biasprm="7 -100 -2"/>
  <intvelocity name="rate" joint="lift" kp="10" actrange="-1 1"/>
  <position name="filtered" joint="lift" kp="10" timeconst="0.1"/>
  <position name="string" tendon="string" kp="10"/>
  <motor name="turns" joint="ball" gear="1 0 0"/>
  <muscle name="muscle" joint="elbow" lengthrange="-1 1"/>
</actuator></mujoco>"""
MODEL = sc.loads(ARM).compile()
EACH = dict(zip(MODEL.actuator_names, actuators(MODEL), strict=True))


def test_kinds():
    assert {name: actuator.kind for name, actuator in EACH.items()} == {
        "servo": "servo",
        "wheel": "velocity servo",
        "motor": "motor",
        "offset": "servo",
        "rate": "velocity servo",
        "filtered": "servo",
        "string": "servo",
        "turns": "other",
        "muscle": "other",
    }
    assert [name for name, actuator in EACH.items() if actuator.direct] == [
        *("servo", "wheel", "motor", "offset")
    ]
    assert EACH["rate"].integrates and not EACH["wheel"].integrates
    assert EACH["turns"].joint is None and EACH["string"].joint is None


@pytest.mark.parametrize("name", ["servo", "wheel", "motor", "offset"])
def test_the_force_is_the_engines(name):
    """The law, with length = gear × coordinate, is `Sim.actuator_force` within its range."""
    actuator, sim = EACH[name], sc.Sim(MODEL)
    for ctrl, q, speed in ((0.3, 0.2, -0.1), (-0.4, 0.05, 0.3), (0.1, -0.2, 0.0)):
        sim.qpos[actuator.qposadr], sim.qvel[actuator.dof] = q, speed
        sim.ctrl[actuator.index] = ctrl
        sim.forward()
        length = actuator.gear * q
        assert sim.actuator_length[actuator.index] == pytest.approx(length, rel=1e-14)
        asked = actuator.force(ctrl, length, actuator.gear * speed)
        force = np.clip(asked, *actuator.forcerange)
        assert sim.actuator_force[actuator.index] == pytest.approx(force, rel=1e-12)


@pytest.mark.parametrize("name", ["servo", "offset"])
def test_a_servo_is_without_force_at_its_target(name):
    actuator = EACH[name]
    ctrl = actuator.holding(0.3)
    assert actuator.force(float(ctrl), 0.3) == pytest.approx(0, abs=1e-12)
    assert actuator.target(ctrl) == pytest.approx(0.3)


def test_gains_at_the_joint_are_the_slopes_of_the_engine():
    """−∂(joint force)/∂q and −∂/∂qvel, by differences of the generalised force of actuators."""
    servo, sim, eps = EACH["servo"], sc.Sim(MODEL), 1e-6

    def force(q=0.0, speed=0.0):
        qpos, qvel = sim.qpos.copy(), np.zeros(MODEL.nv)
        qpos[servo.qposadr], qvel[servo.dof] = q, speed
        act = np.zeros(MODEL.na)
        both = MODEL.element_force("actuator", np.zeros(MODEL.nu), act, qpos, qvel)
        # The string acts on the same joint, and is no part of the servo.
        return both[servo.dof] + 10 * q

    assert (force() - force(q=eps)) / eps == pytest.approx(servo.stiffness, rel=1e-6)
    assert (force() - force(speed=eps)) / eps == pytest.approx(servo.damping, rel=1e-6)
    assert (servo.stiffness, servo.damping) == (160, 12)


def test_bounds():
    """Before the gear: the force range, a motor's control range, and the range of its joint."""
    assert EACH["servo"].forces == (-20, 30) and EACH["servo"].bound == 20
    assert EACH["motor"].forces == (-1, 2)
    # Of 9 N·m at the joint, before a gear of -3.
    assert EACH["motor"].jointrange == (-2, 3) and EACH["motor"].bound == 2
    assert EACH["wheel"].bound == 9
    assert EACH["offset"].bound == np.inf
    free = sc.loads(ARM.replace("<option", '<option><flag clampctrl="disable"/></option><option'))
    assert actuators(free.compile())[2].forces == (-np.inf, np.inf)


def test_the_inertia_is_that_of_a_push():
    """Without other forces, a force f at a joint accelerates it by f / inertia."""
    sim = sc.Sim(MODEL.with_values({"gravity": (0, 0, 0)}))
    for name in ("servo", "motor", "offset"):
        actuator = EACH[name]
        sim.reset()
        sim.qfrc_applied[actuator.dof] = 1e-3
        # The offset of a servo pushes, too.
        sim.ctrl[EACH["offset"].index] = EACH["offset"].holding(0.0)
        sim.forward()
        assert 1e-3 / sim.qacc[actuator.dof] == pytest.approx(actuator.inertia, rel=1e-9)


def test_the_load_is_the_force_that_holds_still():
    sim = sc.Sim(MODEL)
    sim.forward()
    load = hold_load(sim)
    assert load[EACH["offset"].dof] == pytest.approx(0.3 * 9.81)
    sim.qfrc_applied[:] = load
    sim.ctrl[EACH["offset"].index] = EACH["offset"].holding(0.0)
    sim.forward()
    assert np.abs(sim.qacc).max() < 1e-9
