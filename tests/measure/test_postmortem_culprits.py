"""The element that a post-mortem names, its stable dt, and the data after a failure."""

import itertools
import warnings

import numpy as np
import pytest

import stepcore as sc


def failure(text, steps=600, speed=2.0, **settings):
    """The error of a run with the ledger on, or None; and its Sim."""
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", sc.StiffnessWarning)
        sim = sc.Sim(sc.loads(text), **{"ledger": True} | settings)
    sim.qvel[-1] = speed
    try:
        sim.step(steps)
        sim.balance()
    except sc.SimulationError as error:
        return error, sim
    return None, sim


@pytest.mark.parametrize("integrator", ["euler", "implicitfast", "rk4"])
def test_gravity_is_innocent_where_a_servo_is_at_its_bounds(integrator):
    """A rod of 50 g behind a servo that turns it by up to 17 rad in a step."""
    found = set()
    grid = itertools.product((0.002, 0.01, 0.03), (0.1, 0.4), (500, 1e4), (0, 50), (0.5, 5, 50))
    for dt, length, kp, kv, force in grid:
        text = f"""<mujoco><worldbody><body><joint name="j" axis="0 1 0"/>
        <geom type="capsule" size=".04" fromto="0 0 0 {length} 0 0" mass=".05"/></body></worldbody>
        <actuator><position name="servo" joint="j" kp="{kp}" kv="{kv}"
        forcerange="-{force} {force}"/></actuator></mujoco>"""
        error, _ = failure(text, dt=dt, integrator=integrator)
        if error is not None:
            found.add(error.element)
    assert found == {"servo `servo`"}


def test_a_servo_at_its_bounds_is_named_with_what_passed_its_energy_on():
    """The wrist of an arm: 1.5e-4 kg·m², kp 500, kv 50, 52 N·m, kicked at 2 rad/s."""
    text = """<mujoco><worldbody><body><joint axis="0 1 0" damping="1"/>
    <geom type="capsule" size=".04" fromto="0 0 0 .4 0 0" mass="2"/><body pos=".7 0 0">
    <joint name="wrist" axis="1 0 0"/><inertial pos="0 0 0" mass=".1"
    diaginertia="1.5e-4 1.5e-4 1.5e-4"/></body></body></worldbody><actuator>
    <position name="grip" joint="wrist" kp="500" kv="50" forcerange="-52 52"/></actuator>
    </mujoco>"""
    error, _ = failure(text, dt=0.002, integrator="euler")
    assert error.element == "servo `grip`" and error.element_id[:2] == ("actuator", 0)
    assert "servo `grip`, which was at the bounds of its force" in str(error)
    assert error.step == 64 and error.element not in error.shares


def test_an_element_that_is_not_there_is_not_blamed():
    """If the state is NaN, so is the force of a damper of zero."""
    text = """<mujoco><worldbody><body><joint/><geom size=".3"/><body><joint type="slide"/>
    <geom size=".3"/><body><joint axis="1 1 0" damping="6"/><geom size=".2" mass="7e-05"/></body>
    </body></body></worldbody></mujoco>"""
    kinds = set()
    for integrator, ledger in itertools.product(("explicit", "euler", "rk4"), (False, True)):
        for speed in (1e20, 1e80, 1e140, 1e160, 1e200, 1e300):
            error, _ = failure(text, 100, speed, integrator=integrator, ledger=ledger)
            assert error.element_id is not None
            kind, index, _ = error.element_id
            kinds.add(kind)
            assert kind not in ("spring", "qfrc_applied", "xfrc_applied"), error
            assert kind != "damper" or index == 2, error
    assert kinds


@pytest.mark.parametrize("dt", [0.01, 0.02])
@pytest.mark.parametrize("stiffness", [1e4, 1e6])
def test_a_stable_dt_under_penalty_was_tried_on_its_contacts(dt, stiffness):
    """A ball that starts in the air: ω of its contact is √(k/m), beyond 2/ω it is thrown."""
    text = """<mujoco><worldbody><geom type="plane" size="1 1 1"/><body pos="0 0 .3"><freejoint/>
    <geom size=".1" mass=".05"/></body></worldbody></mujoco>"""
    settings = {"law": "penalty", "penalty_stiffness": stiffness, "integrator": "semi-implicit"}
    error, sim = failure(text, 6000, 0.0, dt=dt, **settings)
    assert error is not None and "contact" in error.element
    if error.stable_dt is None:
        return
    start = sc.Sim(sim.model, dt=dt).energy.total
    again = sc.Sim(sc.loads(text), **settings, dt=error.stable_dt)
    for _ in range(100):
        again.step(200)
        assert again.energy.total < 1.5 * start


@pytest.mark.parametrize("integrator", ["midpoint", "rk4", "implicitfast"])
@pytest.mark.parametrize("precision", ["f64", "f32"])
def test_a_servo_comes_to_rest_below_all_normal_numbers(integrator, precision):
    """q decays as exp(−10 t) down to the last bit that there is, and stays there."""
    text = """<mujoco><option gravity="0 0 0"/><worldbody><body><joint name="j" axis="0 1 0"/>
    <geom size=".1" mass="1"/></body></worldbody>
    <actuator><position joint="j" kp="10" kv="1"/></actuator></mujoco>"""
    error, sim = failure(text, 12000, 0.1, dt=0.01, integrator=integrator, precision=precision)
    assert error is None, error
    assert abs(sim.qvel[0]) < 1e-37 and abs(sim.qpos[0]) < 1e-37


@pytest.mark.parametrize("call", ["forward", "step"])
def test_what_is_read_after_a_failure_is_finite(call):
    sim = sc.Sim(sc.loads(BALLS))
    sim.qpos[2] = 0.05
    sim.step(3)
    sim.qvel[3:6] = 1e200
    with pytest.raises(sc.SimulationError):
        getattr(sim, call)()
    for name in ("qacc", "constraint_force", "actuator_force"):
        assert np.isfinite(getattr(sim, name)).all(), name
    assert np.isfinite(sim.rows["impulse"]).all()
    assert all(np.isfinite(contact["force"]).all() for contact in sim.contacts)


CHAIN = """<mujoco><option timestep=".002" integrator="Euler"/><worldbody><body>
<joint name="j" axis="0 1 0"/><geom size=".05" mass=".1" pos=".2 0 0"/><body pos=".4 0 0">
<joint name="k" axis="0 1 0"/><geom size=".05" mass=".1" pos=".2 0 0"/></body></body></worldbody>
<actuator><velocity name="stiff" joint="j" kv="50"/><velocity joint="k" kv=".01"/></actuator>
</mujoco>"""


@pytest.mark.filterwarnings("ignore::stepcore.StiffnessWarning")
@pytest.mark.parametrize("ledger", [False, True])
def test_a_servo_that_throws_a_chain_about_answers_for_its_inertia(ledger):
    sim = sc.Sim(sc.loads(CHAIN), ledger=ledger)
    sim.ctrl[0] = 1.0
    with pytest.raises(sc.SimulationError) as caught:
        sim.step(100)
    assert caught.value.element == "servo `stiff`"


@pytest.mark.filterwarnings("ignore::stepcore.StiffnessWarning")
@pytest.mark.parametrize("ledger", [False, True])
@pytest.mark.parametrize(
    ("robot", "joint", "field", "value", "integrator"),
    [
        ("gymnasium:half_cheetah", "bthigh", "damping", 1e7, "semi-implicit"),
        ("gymnasium:half_cheetah", "bthigh", "damping", 1e4, "rk4"),
        ("gymnasium:ant", "hip_1", "stiffness", 1e6, "rk4"),
        ("gymnasium:ant", "hip_3", "damping", 1e6, "rk4"),
        ("gymnasium:hopper", "leg_joint", "damping", 1e6, "rk4"),
        ("dm_control:humanoid", "abdomen_z", "stiffness", 1e6, "rk4"),
        ("dm_control:humanoid", "abdomen_z", "damping", 1e4, "rk4"),
    ],
)
def test_a_joint_far_too_stiff_answers_for_the_inertia_of_the_robot(
    robot, joint, field, value, integrator, ledger
):
    """One spring or damper explodes in a few steps, in which the robot's inertia changes too."""
    scene = sc.load(robot)
    setattr(scene.joint(joint), field, value)
    sim = sc.Sim(scene, integrator=integrator, ledger=ledger)
    sim.qvel[:] = 0.05 * np.random.default_rng(1).standard_normal(sim.model.nv)
    with pytest.raises(sc.SimulationError) as caught:
        sim.step(3000)
    what = "spring" if field == "stiffness" else "damper"
    assert caught.value.element == f"{what} of joint `{joint}`"


@pytest.mark.parametrize("ledger", [False, True])
def test_inertia_answers_for_what_it_does_to_the_energy_that_was_there(ledger):
    """An ant that spins at 3,700 rad/s, integrated explicitly."""
    sim = sc.Sim("gymnasium:ant", integrator="explicit", ledger=ledger)
    sim.qvel[3:6] = [1e3, 2e3, 3e3]
    with pytest.raises(sc.SimulationError) as caught:
        sim.step(4000)
    assert caught.value.element == "inertial force of joint `root`"


BALLS = """<mujoco><worldbody><geom type="plane" size="1 1 1"/><body pos="0 0 .1"><freejoint/>
<geom type="capsule" size=".1 .2" mass="1"/></body></worldbody></mujoco>"""
