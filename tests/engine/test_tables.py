"""What can be read of a `Sim`: the present state, the last solve, and elements by name."""

import numpy as np
import pytest
from small import ball, pendulum

import stepcore as sc


@pytest.fixture(scope="module")
def model():
    return pendulum().compile()


@pytest.fixture
def sim(model):
    return sc.Sim(model)


def test_positions_follow_the_state_that_is_written(sim):
    sim.step()
    sim.qpos[:] = [-np.pi / 2, 0.0]
    assert sim.body("lower").xpos == pytest.approx([0, 0, 1.0], abs=1e-15)
    assert sim.site("hand").xpos == pytest.approx([0, 0, 1.5], abs=1e-15)
    assert sim.geom("tip").xpos == pytest.approx([0, 0, 1.25], abs=1e-15)
    assert sim.xmat[2] == pytest.approx(
        sim.geom_xmat[0] @ np.linalg.inv(sim.geom_xmat[0]) @ sim.xmat[2]
    )
    assert sim.xquat[2] == pytest.approx([np.sqrt(0.5), 0, -np.sqrt(0.5), 0])


def test_reading_changes_no_bit_of_what_follows(model):
    read, unread = sc.Sim(model), sc.Sim(model)
    for _ in range(40):
        read.step()
        unread.step()
        _ = read.xpos, read.energy, read.momentum, read.contacts, read.rows, read.residual
        _ = read.mass_matrix(), read.jacobian("lower"), read.state()
    assert read.state() == unread.state()


def test_reading_leaves_the_last_solve(sim):
    sim.reset(key="bent")
    sim.step()
    before = sim.constraint_force.copy(), sim.qacc.copy()
    sim.qpos[:] = [0.7, 0.1]
    _ = sim.xpos, sim.mass_matrix()
    assert (sim.constraint_force == before[0]).all()
    assert (sim.qacc == before[1]).all()


def test_energy_momentum_and_jacobian_agree(sim):
    rng = np.random.default_rng(3)
    sim.qpos[:], sim.qvel[:] = rng.normal(size=2), rng.normal(size=2)
    model = sim.model
    kinetic, potential, linear = 0.0, 0.0, np.zeros(3)
    for body in (1, 2):
        jacobian, xmat = sim.jacobian(body), sim.xmat[body]
        twist = jacobian @ sim.qvel
        arm = xmat @ model.body_ipos[body]
        velocity = twist[:3] + np.cross(twist[3:], arm)
        inertia = xmat @ model.body_inertia[body] @ xmat.T
        kinetic += 0.5 * model.body_mass[body] * velocity @ velocity
        kinetic += 0.5 * twist[3:] @ inertia @ twist[3:]
        potential += 9.81 * model.body_mass[body] * (sim.xpos[body] + arm)[2]
        linear += model.body_mass[body] * velocity
    assert sim.energy.kinetic == pytest.approx(kinetic, rel=1e-12)
    assert sim.energy.kinetic == pytest.approx(0.5 * sim.qvel @ sim.mass_matrix() @ sim.qvel)
    assert sim.energy.potential == pytest.approx(potential, rel=1e-12)
    assert sim.energy.total == sim.energy.kinetic + sim.energy.potential
    assert sim.momentum.linear == pytest.approx(linear, abs=1e-12)
    assert sim.body("lower").velocity == pytest.approx(sim.jacobian("lower") @ sim.qvel)


def test_forces_balance_what_the_last_solve_did(sim):
    # M qacc + bias = passive + gear·actuator + applied + constraint, at the state of the solve.
    sim.qpos[:], sim.qvel[:] = [0.2, 1.2], [0.5, 1.0]
    sim.ctrl[0] = 3.0
    sim.qfrc_applied[:] = [0.3, -0.2]
    sim.forward()
    assert sim.actuator_force == pytest.approx([1.0])  # clamped to ctrlrange
    driven = np.array([0.0, 2.0 * sim.actuator_force[0]])
    right = sim.passive + driven + sim.qfrc_applied + sim.constraint_force
    assert sim.constraint_force[1] < 0  # the elbow is beyond its limit
    assert sim.mass_matrix() @ sim.qacc + sim.bias == pytest.approx(right, rel=1e-9)


@pytest.mark.parametrize("cone", ["pyramidal", "elliptic"])
@pytest.mark.parametrize("law", ["solref", "lesson", "rigid"])
def test_contact_forces_carry_the_ball_and_brake_it(cone, law):
    sim = sc.Sim(ball(), law=law, cone=cone, solver="pgs", sweeps=500, tolerance=1e-12, softness=0)
    sim.step(1500)
    contact = sim.contacts[0]
    assert sim.contacts.shape == (1,)
    assert (contact["geom1"], contact["geom2"]) == (0, 1)
    assert contact["normal"].tolist() == [0, 0, 1]
    assert contact["force"] == pytest.approx([0, 0, 2.0 * 9.81], rel=1e-6, abs=1e-6)
    sim.qvel[:2] = [3.0, 4.0]
    sim.forward()
    force = sim.contacts[0]["force"]
    assert sim.constraint_force[:3] == pytest.approx(force, rel=1e-9)
    assert force[0] < 0 and force[1] < 0


def test_rows_name_their_elements(sim):
    sim.qpos[:] = [1.3, 1.2]
    sim.forward()
    rows = sim.rows
    assert set(rows["kind"]) == {"limit", "contact"}
    assert any("elbow" in name for name in rows["name"])
    assert any("floor" in name and "tip" in name for name in rows["name"])
    assert (rows["impulse"] >= rows["lo"]).all() and (rows["impulse"] <= rows["hi"]).all()
    assert rows["residual"].max() <= 1e-6
    assert sim.residual <= 1e-6
    empty = sc.Sim(sim.model)
    assert empty.rows.shape == empty.contacts.shape == (0,)
    assert empty.residual == 0.0


def test_views_by_name(sim):
    sim.joint("elbow").qpos[:] = 0.5
    sim.joint("elbow").qvel[:] = -1.0
    assert sim.qpos.tolist() == [0.0, 0.5]
    assert sim.qvel.tolist() == [0.0, -1.0]
    sim.body("lower").xfrc_applied[2] = 1.0
    assert sim.xfrc_applied[2, 2] == 1.0
    assert sim.body("lower").name == "lower"
    assert "elbow" in repr(sim.joint(1))
    with pytest.raises(ValueError, match='no joint is named "elbo"; nearest: "elbow"'):
        sim.joint("elbo")
    with pytest.raises(ValueError, match="index below 3"):
        sim.body(3)


def test_bodies_that_cannot_move_have_potential_energy():
    """As in MuJoCo: the shelf, what is fixed to it, and what is fixed to the ball count."""
    import mujoco

    text = """<mujoco><worldbody><geom type="plane" size="1 1 1"/><geom size="0.3" pos="0 0 2"/>
    <body pos="0 0 1"><geom type="box" size=".5 .5 .1" pos="0 0 .1"/>
    <body pos="0 0 1"><geom size=".1" mass="3"/></body></body>
    <body pos="0 0 5"><freejoint/><geom size=".1" mass="1"/><body pos=".2 0 .3">
    <geom size=".1" mass="2"/></body></body></worldbody></mujoco>"""
    theirs = mujoco.MjModel.from_xml_string(text)
    data = mujoco.MjData(theirs)
    mujoco.mj_forward(theirs, data)
    mujoco.mj_energyPos(theirs, data)
    sim = sc.Sim(sc.loads(text))
    assert sim.energy.potential == pytest.approx(data.energy[0], rel=1e-14)


def test_contacts_have_names_and_rows_have_forces(sim):
    sim.reset(key="bent")
    sim.step(300)
    contact = sim.contacts[0]
    names = sim.model.geom_names
    assert contact["name1"] == names[contact["geom1"]] == "floor"
    assert contact["name2"] == names[contact["geom2"]] == "tip"
    rows = sim.rows
    assert len(rows) > 0 and rows["impulse"].any()
    assert (rows["force"] == rows["impulse"] / sim.settings.dt).all()
    touching = rows["kind"] == "contact"
    # A pyramid's edges each press with their whole force.
    assert rows["force"][touching].sum() == pytest.approx(contact["force"][2], rel=1e-12)


def test_contacts_of_geoms_without_a_name():
    """They are called by their body, which is found in the file."""
    scene = sc.Scene()
    body = scene.add_body(pos=(0, 0, 0.099))
    scene.add_joint(body, "free")
    scene.add_geom(body, "sphere", 0.1)
    scene.add_geom("world", "plane")
    sim = sc.Sim(scene)
    sim.step()
    contacts, model = sim.contacts, sim.model
    assert contacts["name1"].tolist() == ["geom 0 of the world"]
    assert contacts["name2"].tolist() == ["geom 1 of body 1"]
    name = "contact geom 0 of the world/geom 1 of body 1"
    assert model.element_name("contact", 0) == name and sim.rows["name"][0] == name
    assert model.called("geom") == ("geom 0 of the world", "geom 1 of body 1")
    assert model.called("joint") == ("joint 0 of body 1",)


RESULTS = (
    *("xpos", "xquat", "xmat", "geom_xpos", "geom_xmat", "site_xpos", "bias", "passive"),
    *("qacc", "constraint_force", "actuator_force", "contacts", "rows"),
)


def test_results_are_read_only(model):
    sim, batch = sc.Sim(model), sc.Batch(model, 2)
    for world in (sim, batch):
        world.reset(key="bent")
        world.step(300)
        results = [getattr(world, name) for name in RESULTS]
        results += [world.mass_matrix(), world.jacobian("lower"), *world.momentum]
    for sim_or_batch, more in ((sim, ()), (batch, (batch.energy, batch.residual))):
        for result in [*(getattr(sim_or_batch, name) for name in RESULTS), *more]:
            for array in result if isinstance(result, list) else [result]:
                assert len(array)
                with pytest.raises(ValueError, match="read-only"):
                    array[0] = array[0]
    for array in results[-4:]:
        assert not array.flags.writeable


def test_a_view_by_name_can_be_assigned(sim):
    sim.joint("elbow").qpos = 0.5
    sim.joint("elbow").qvel = [0.25]
    sim.joint("elbow").qfrc_applied = 2.0
    sim.body("lower").xfrc_applied = np.arange(6)
    assert sim.qpos.tolist() == [0.0, 0.5] and sim.qvel.tolist() == [0.0, 0.25]
    assert sim.qfrc_applied.tolist() == [0.0, 2.0]
    assert sim.xfrc_applied[2].tolist() == [0, 1, 2, 3, 4, 5]
    with pytest.raises(ValueError, match=r'qpos of joint "elbow" has shape \(2,\)'):
        sim.joint("elbow").qpos = [1.0, 2.0]
    with pytest.raises(ValueError, match=r'qvel of joint "elbow" = .*numbers'):
        sim.joint("elbow").qvel = "fast"
    with pytest.raises(AttributeError, match='nearest: "qpos"'):
        sim.joint("elbow").qpso = 1.0


def test_an_attribute_that_is_not_there_cannot_be_assigned(model):
    for thing, wrong, right in (
        (sc.Sim(model), "crtl", "ctrl"),
        (sc.Batch(model, 2), "qpso", "qpos"),
        (sc.Scene(), "gravty", "gravity"),
        (sc.Scene(), "geom_", "geom"),
    ):
        with pytest.raises(AttributeError, match=f'no "{wrong}"; nearest: .*"{right}"'):
            setattr(thing, wrong, 1.0)
    with pytest.raises(AttributeError, match="xpos"):
        sc.Sim(model).xpos = 1.0
