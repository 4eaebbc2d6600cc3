"""What random models found: each is a scene in which the engine once differed from MuJoCo."""

import mujoco
import numpy as np
import peers
import pytest
from covering import every_pair

import stepcore as sc

INERT = 'contype="0" conaffinity="0"'


def pair(text: str) -> tuple[mujoco.MjModel, mujoco.MjData, sc.Sim]:
    model = peers.strict(mujoco.MjModel.from_xml_string(text))
    return model, mujoco.MjData(model), sc.Sim(sc.loads(text), **peers.EXACT)


@pytest.mark.parametrize("shape", ['size=".2"', 'type="ellipsoid" size=".2 .1 .15"'])
def test_implicitfast_takes_the_drag_of_a_free_body_as_implicit_does(shape):
    """The derivative of its drag is not symmetric, and is not made so: to 1e-12."""
    geoms = f'<geom {shape} fluidshape="ellipsoid"/><geom pos=".2 .1 0" size=".05"/>'
    text = """<mujoco><option integrator="{}" density="500" viscosity=".3"/>
      <worldbody><body><freejoint/>{}</body></worldbody></mujoco>"""
    ends = []
    for integrator in ("implicitfast", "implicit"):
        model, data, sim = pair(text.format(integrator, geoms))
        sim.qvel[:] = data.qvel[:] = [1, 2, 3, 4, 5, 6]
        mujoco.mj_step(model, data)
        sim.step(1)
        assert peers.apart(sim.qvel, data.qvel) < 1e-12
        ends.append(sim.qvel.copy())
    assert peers.apart(*ends) < 1e-12


def test_the_axes_of_an_inertia_are_right_to_rounding():
    """No products of inertia are left in them, to 1e-11 of the greatest moment."""
    rng = np.random.default_rng(1)
    for _ in range(30):
        geoms = "".join(
            f'<geom type="box" size=".1 .2 .15" pos="{x} {y} {z}" euler="{a} {b} {c}"/>'
            for x, y, z, a, b, c in rng.normal(size=(2, 6)) * [0.2, 0.2, 0.2, 50, 50, 50]
        )
        _, _, sim = pair(
            f"""<mujoco><worldbody><body name="b"><freejoint/>{geoms}</body></worldbody>
            <sensor><framequat objtype="body" objname="b"/></sensor></mujoco>"""
        )
        sim.forward()
        mass, centre = sim.model.body_mass[1], sim.subtree_com[1]
        about = mass * (centre @ centre * np.eye(3) - np.outer(centre, centre))
        turn = np.zeros(9)
        mujoco.mju_quat2Mat(turn, sim.sensordata)
        own = turn.reshape(3, 3).T @ (sim.mass_matrix()[3:, 3:] - about) @ turn.reshape(3, 3)
        assert np.abs(own - np.diag(np.diag(own))).max() < 1e-11 * own.max()


def test_a_tendon_between_points_of_one_body_has_no_arms():
    """Past a geom that it does not touch too: the force of a row of roundings has no bound."""
    text = f"""<mujoco><worldbody><geom name="drum" pos="0 0 2" size=".1" {INERT}/>
      <body><joint name="j" axis=".3 .5 .1" pos=".1 .2 .3"/><geom size=".1"/>
        <site name="a" pos=".11 .23 .05"/><site name="b" pos="-.31 .17 .23"/></body></worldbody>
      <tendon><spatial name="t" range=".1 .2" frictionloss=".3"><site site="a"/>
        <geom geom="drum"/><site site="b"/></spatial></tendon></mujoco>"""
    _, _, sim = pair(text)
    sim.qpos[:], sim.qvel[:] = 0.3, 0.7
    sim.forward()
    assert not sim.ten_J.any() and not sim.constraint_force.any()
    sim.step(100)
    assert np.isfinite(sim.qpos).all()


def test_the_sensor_of_potential_energy_leaves_out_gravity_compensation():
    text = """<mujoco><worldbody><body pos="0 0 1" gravcomp=".7"><joint axis="0 1 0"/>
      <geom size=".1" pos=".2 0 0"/></body></worldbody><sensor><e_potential/></sensor></mujoco>"""
    model, data, sim = pair(text)
    sim.qpos[:] = data.qpos[:] = 0.4
    mujoco.mj_forward(model, data)
    sim.forward()
    assert sim.sensordata == pytest.approx(data.sensordata, rel=1e-12)


def test_an_automatic_damper_leaves_that_of_actuators():
    text = """<mujoco><worldbody><body><joint name="j" springdamper=".3 .8" damping=".6"/>
      <geom size=".1" pos=".2 0 0"/></body></worldbody>
      <actuator><motor joint="j" gear="1.5" damping=".2 .1"/></actuator></mujoco>"""
    model, data, sim = pair(text)
    sim.qvel[:] = data.qvel[:] = 0.8
    mujoco.mj_forward(model, data)
    sim.forward()
    assert sim.passive == pytest.approx(data.qfrc_passive, rel=1e-12)


def test_turns_of_a_weld_that_nothing_makes_carry_no_load_of_rounding():
    """A body that only slides, welded to the world: torques in it to 1e-9 of the largest."""
    text = """<mujoco><worldbody><body pos=".45 .33 .44" quat=".66 -.67 -.53 -.58">
      <joint type="slide" axis=".75 .67 .84"/><geom size=".1" pos=".1 .2 .3"/>
      <site name="s" pos=".1 0 -.2" euler="10 20 30"/><body pos=".1 .2 .3" euler="10 50 20">
      <joint axis=".7 .1 .9" pos=".1 0 0"/><geom size=".1" pos=".2 .1 0"/></body></body></worldbody>
      <equality><weld body1="{0}" anchor="-.2 -.1 -.1"/></equality>
      <sensor><torque site="s"/><force site="s"/></sensor></mujoco>"""
    text = text.replace("<body pos", '<body name="a" pos', 1).format("a")
    model, data, sim = pair(text)
    rng = np.random.default_rng(1)
    for _ in range(20):
        sim.qpos[:] = data.qpos[:] = 0.4 * rng.normal(size=2)
        mujoco.mj_forward(model, data)
        sim.forward()
        assert peers.apart(sim.sensordata, data.sensordata) < 1e-9
        assert peers.apart(sim.cfrc_int, data.cfrc_int) < 1e-9


def test_the_bound_of_a_tendon_comes_before_those_of_its_actuators():
    """Where both act, the tendon's share is that of the forces without bounds: to 1e-12."""
    text = """<mujoco><worldbody><body><joint name="j" type="slide"/><geom size=".1"/></body>
      </worldbody><tendon><fixed name="t" actuatorfrcrange="-3 4.5"><joint joint="j" coef="1"/>
      </fixed></tendon><actuator><motor tendon="t" gear=".5" forcerange="-1 2.7"/>
      <motor tendon="t" gear="2"/></actuator></mujoco>"""
    model, data, sim = pair(text)
    for ctrl in ((6, 1), (2, 1), (3, 3), (-5, 1), (-5, -5), (9, -5)):
        data.ctrl[:] = sim.ctrl[:] = ctrl
        mujoco.mj_forward(model, data)
        sim.forward()
        assert peers.apart(sim.actuator_force, data.actuator_force) < 1e-12
        assert peers.apart(sim.qacc, data.qacc) < 1e-12


@every_pair(bounds=["", 'actuatorfrcrange="-1 1"'], actuator=["", '<motor joint="j"/>'])
def test_the_force_on_a_joint_counts_what_adhesion_pulls(bounds, actuator):
    """MuJoCo's `qfrc_actuator` is that of all actuators, to 1e-12; after a step too."""
    model, data, sim = pair(
        f"""<mujoco><worldbody><geom type="plane" size="3 3 .1"/>
        <body name="b" pos="0 0 .09"><joint name="j" type="slide" axis="0 0 1" {bounds}/>
          <geom size=".1"/></body></worldbody>
        <actuator><adhesion body="b" ctrlrange="0 1" gain="5"/>{actuator}</actuator>
        <sensor><jointactuatorfrc joint="j"/></sensor></mujoco>"""
    )
    data.ctrl[:] = sim.ctrl[:] = 0.5
    mujoco.mj_forward(model, data)
    sim.forward()
    assert data.sensordata[0] != 0
    assert sim.sensordata == pytest.approx(data.sensordata, abs=1e-12)
    mujoco.mj_step(model, data)
    sim.step(1)
    assert sim.sensordata == pytest.approx(data.sensordata, abs=1e-12)


def test_a_weld_asks_in_vain_for_a_turn():
    """Of bodies that only slide: what else is solved is what it is without that, to 1e-9.

    MuJoCo's rows of the turn are 1e-15 soft and its solver loses its digits, but with
    `torquescale="0"`, under which they ask for nothing.
    """
    text = """<mujoco><worldbody>
      <body name="a" pos="0 0 .3"><joint name="j" type="slide" axis="1 0 .3" frictionloss=".3"/>
        <geom size=".1"/></body>
      <body name="b" pos="0 .5 .3"><joint name="k" type="slide" axis=".2 1 0" frictionloss=".1"/>
        <geom size=".1"/></body></worldbody>
      <equality><weld body1="a" body2="b" relpose="0 .4 .1 1 .2 .3 .4" torquescale="{}"/></equality>
      <option gravity="1 2 -9"/></mujoco>"""
    model, data, _ = pair(text.format(0))
    _, _, sim = pair(text.format(1))
    mujoco.mj_forward(model, data)
    sim.forward()
    assert peers.apart(sim.qacc, data.qacc) < 1e-9


@every_pair(
    dyntype=["filter", "filterexact", "integrator"],
    extra=["", 'actearly="true"', 'ctrlrange="-3 3"', 'actrange="-4 4"'],
)
def test_the_filter_of_a_servo_on_a_circle_goes_the_shorter_way_round(dyntype, extra):
    """Its control is the one of those a turn apart that is nearest to the activation: to 1e-9.

    After a step the activation is the one of those that is nearest to the length, be it out of its
    range. With controls and activations two turns either way; an integrator takes a rate, and a
    general actuator that is not a servo is on no circle.
    """
    filtered = f'dyntype="{dyntype}" dynprm=".03" biastype="affine" {extra}'
    servo = filtered + ' gainprm="8" biasprm="0 -8 -.5"'
    text = f"""<mujoco><option gravity="0 0 0"/><worldbody><site name="world"/>
      <body><joint name="j" type="ball"/><geom pos=".05 .02 .1" size=".1"/>
        <site name="s" pos=".1 0 0"/></body></worldbody><actuator>
      <general joint="j" gear="1 .3 0" {servo}/>
      <general jointinparent="j" gear=".14 -.3 .12" {servo}/>
      <general site="s" refsite="world" gear="0 0 0 0 .5 .2" {servo}/>
      <general joint="j" {filtered} gainprm="8" biasprm="0 -5 0"/>
      </actuator></mujoco>"""
    model = peers.strict(mujoco.MjModel.from_xml_string(text))
    data, compiled = mujoco.MjData(model), sc.loads(text).compile()
    turn = 2 * np.pi * np.linalg.norm(model.actuator_gear, axis=1)
    for name, integrator in peers.INTEGRATORS.items():
        model.opt.integrator = integrator
        sim, rng = sc.Sim(compiled, **peers.EXACT, integrator=name), np.random.default_rng(0)
        for _ in range(20):
            quat = rng.normal(size=4)
            data.qpos[:] = sim.qpos[:] = quat / np.linalg.norm(quat)
            data.qvel[:] = sim.qvel[:] = rng.normal(size=3)
            data.act[:] = sim.act[:] = rng.uniform(-2, 2, 4) * turn
            data.ctrl[:] = sim.ctrl[:] = rng.uniform(-2, 2, 4) * turn
            mujoco.mj_forward(model, data)
            sim.forward()
            assert peers.apart(sim.actuator_force, data.actuator_force) < 1e-9
            mujoco.mj_step(model, data)
            sim.step(1)
            assert peers.apart(sim.act, data.act) < 1e-9
            assert peers.apart(sim.qvel, data.qvel) < 1e-9


@every_pair(servo=["position", "intvelocity", "pid"], limited=["auto", "false"])
def test_servos_inherit_the_range_of_a_tendon(servo, limited):
    """Whether that limits the tendon or not, as of a joint."""
    text = f"""<mujoco><worldbody><body><joint name="j" type="slide"/><geom size=".1"/></body>
      </worldbody><tendon><fixed name="t" range="-1 2" limited="{limited}">
        <joint joint="j" coef="1"/></fixed></tendon>
      <actuator><{servo} tendon="t" kp="3" inheritrange=".5"/></actuator></mujoco>"""
    model, data, sim = pair(text)
    for ctrl in (-4, 0.3, 4):
        data.ctrl[:] = sim.ctrl[:] = ctrl
        for _ in range(40):
            mujoco.mj_step(model, data)
            sim.step()
        assert sim.qpos == pytest.approx(data.qpos, abs=1e-9)


@every_pair(speed=[-1e4, -1e8, 1e12, -1e20], solver=["newton", "pgs"])
def test_a_motion_that_was_broken_off_leaves_no_rounding(solver, speed):
    """A limit alone, whose last impulse was of another motion: the force of one that was not."""
    text = """<mujoco><option timestep=".005"/><worldbody><body>
      <joint type="slide" axis="1 0 0" range="-.1 .1"/><geom size=".1" mass="1"/></body>
      </worldbody></mujoco>"""
    sims = [sc.Sim(sc.loads(text), solver=solver) for _ in range(2)]
    sims[0].qpos[:], sims[0].qvel[:] = -0.2, speed
    sims[0].step()
    for sim in sims:
        sim.qpos[:], sim.qvel[:] = -0.2, 0.0
        sim.forward()
    assert sims[0].qacc == pytest.approx(sims[1].qacc, rel=1e-12)
    assert sims[1].qacc == pytest.approx([250.0], rel=1e-9)


def test_a_weld_that_nothing_moves_leaves_others_their_digits():
    """Its rows hold 1e18 N where a body only slides; from the impulses of the stage before, the
    limit and the friction beside it are solved as well as from none: to 1e-12 of the velocity."""
    text = """<mujoco><option timestep=".001" integrator="RK4"/><worldbody>
      <body pos="0 0 .3"><joint type="slide" axis="1 .2 .3" range="-.1 .1"/>
        <joint type="slide" axis="0 1 .1"/><geom size=".1"/><site name="s" pos=".1 .2 .1"/>
        <body pos="0 0 .2"><joint axis="0 1 0" range="-10 10" frictionloss=".4"/>
          <geom size=".05" pos=".1 0 0"/></body></body>
      <site name="t" pos=".3 .1 .4" euler="20 40 10"/></worldbody>
      <equality><weld site1="s" site2="t"/></equality></mujoco>"""
    rng = np.random.default_rng(1)
    _, _, warm = pair(text)
    cold = sc.Sim(warm.model, **(peers.EXACT | {"warm_start": False}))
    for _ in range(60):
        warm.qpos[:] = cold.qpos[:] = 0.3 * rng.normal(size=3)
        warm.qvel[:] = cold.qvel[:] = 60 * rng.normal(size=3)
        warm.step()
        cold.step()
        assert peers.apart(warm.qvel, cold.qvel) < 1e-12
        assert warm.residual < 1e-9


@pytest.mark.parametrize("first", ["", "<e_potential/>", "<e_kinetic/>"])
def test_a_sensor_of_energy_leaves_the_forces_that_others_read(first):
    """An adhesion that pulls through contacts is among the forces of a joint's actuators."""
    text = f"""<mujoco><worldbody><geom type="plane" size="3 3 .1"/><body name="b" pos="0 0 .09">
      <joint name="z" type="slide" axis="0 0 1"/><geom size=".1" mass="1"/></body></worldbody>
      <actuator><adhesion body="b" ctrlrange="0 1" gain="5"/></actuator>
      <sensor>{first}<jointactuatorfrc joint="z"/></sensor></mujoco>"""
    model, data, sim = pair(text)
    sim.ctrl[0] = data.ctrl[0] = 0.6
    mujoco.mj_forward(model, data)
    sim.forward()
    assert sim.sensordata[-1] == data.sensordata[-1] == -3.0
    assert sim.sensordata == pytest.approx(data.sensordata, rel=1e-12)
