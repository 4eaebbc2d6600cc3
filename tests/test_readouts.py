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
