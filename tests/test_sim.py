"""`Sim`: its arrays, what can be read of it, snapshots, and what happens when it is interrupted."""

import copy
import pickle
import signal
import threading

import numpy as np
import pytest

import stepcore as sc


def pendulum(**options):
    """Two hinged rods over a floor, a motor, a site, a limit and a keyframe."""
    scene = sc.Scene(name="pendulum").with_settings(**options)
    upper = scene.add_body("upper", pos=(0, 0, 0.6))
    scene.add_joint(upper, "hinge", name="shoulder", axis=(0, 1, 0), damping=0.02)
    scene.add_geom(upper, "capsule", 0.04, fromto=(0, 0, 0, 0.4, 0, 0), name="rod", mass=1.0)
    lower = scene.add_body("lower", parent=upper, pos=(0.4, 0, 0))
    scene.add_joint(lower, "hinge", name="elbow", axis=(0, 1, 0), range=(-1.0, 1.0))
    scene.add_geom(lower, "capsule", 0.04, fromto=(0, 0, 0, 0.5, 0, 0), name="tip", mass=0.5)
    scene.add_site(lower, name="hand", pos=(0.5, 0, 0))
    scene.add_geom("world", "plane", name="floor")
    scene.add_actuator("elbow", name="motor", gear=(2.0,), ctrlrange=(-1, 1))
    scene.add_key("bent", time=0.5, qpos=(0.3, -0.5), qvel=(0.1, 0.2), ctrl=(0.7,))
    return scene


def ball(**options):
    scene = sc.Scene().with_settings(**options)
    body = scene.add_body("ball", pos=(0, 0, 0.099))
    scene.add_joint(body, "free", name="root")
    scene.add_geom(body, "sphere", 0.1, mass=2.0, name="ball")
    scene.add_geom("world", "plane", name="floor")
    return scene


@pytest.fixture(scope="module")
def model():
    return pendulum().compile()


@pytest.fixture
def sim(model):
    return sc.Sim(model)


# The arrays.


@pytest.mark.parametrize("precision", ["f64", "f32"])
def test_arrays_are_float64_views_that_stay_the_sims(model, precision):
    sim = sc.Sim(model, precision=precision)
    before = sim.qpos
    sim.qpos[:] = [0.25, 0.5]
    sim.step(3)
    assert sim.qpos is before
    assert before[0] != 0.25
    assert all(
        array.dtype == np.float64
        for array in (sim.qpos, sim.qvel, sim.act, sim.ctrl, sim.qfrc_applied, sim.xfrc_applied)
    )
    shapes = [a.shape for a in (sim.qpos, sim.qvel, sim.act, sim.ctrl, sim.xfrc_applied)]
    assert shapes == [(2,), (2,), (0,), (1,), (3, 6)]


def test_an_array_outlives_its_sim(model):
    qpos = sc.Sim(model).qpos
    assert qpos.tolist() == [0.0, 0.0]


def test_assignment_fills_the_array(sim):
    array = sim.qpos
    sim.qpos = [0.5, 1]
    assert sim.qpos is array
    assert array.tolist() == [0.5, 1.0]


def test_whatever_is_done_to_a_view_the_sim_keeps_its_numbers(sim):
    sim.qpos[:] = [0.1, 0.2]
    sim.qpos.shape = (2, 1) if np.lib.NumpyVersion(np.__version__) < "2.5.0" else (2,)
    sim.qvel.flags.writeable = False
    sim.step()
    assert sim.time == sim.settings.dt
    with pytest.raises(ValueError, match="resize"):
        sim.ctrl.resize(5)


# Stepping.


def test_free_fall_is_what_its_integrator_says():
    # v ← v + dt g, then q ← q + dt v: after n steps q falls by g dt² n (n + 1) / 2.
    sim = sc.Sim(ball(), dt=0.01, integrator="semi-implicit")
    sim.qpos[2] = 10.0
    sim.step(7)
    assert sim.qvel[2] == pytest.approx(-9.81 * 0.07, rel=1e-14)
    assert 10.0 - sim.qpos[2] == pytest.approx(9.81 * 0.01**2 * 28, rel=1e-12)
    assert sim.time == 7 * 0.01


def test_step_n_is_n_steps(model):
    once, often = sc.Sim(model), sc.Sim(model)
    for sim in (once, often):
        sim.ctrl[0] = 0.4
    once.step(50)
    for _ in range(50):
        often.step()
    assert once.state() == often.state()


def test_forward_moves_nothing(sim):
    sim.qpos[:] = [0.3, 0.2]
    before = sim.state()
    sim.forward()
    assert sim.state() == before
    assert sim.qacc.shape == (2,)


def test_applied_forces_act(sim):
    sim.forward()
    free = sim.qacc.copy()
    sim.qfrc_applied[1] = 3.0
    sim.forward()
    pushed = np.linalg.solve(sim.mass_matrix(), [0.0, 3.0])
    assert sim.qacc - free == pytest.approx(pushed, rel=1e-9)
    sim.qfrc_applied[:] = 0.0
    sim.xfrc_applied[2] = [0, 0, 5.0, 0, 0.5, 0]
    sim.forward()
    centre = sim.model.body_ipos[2]
    lower = sim.jacobian("lower")
    arm = sim.body("lower").xmat @ centre
    at_centre = lower[:3] + np.cross(lower[3:].T, arm).T
    generalised = at_centre.T @ [0, 0, 5.0] + lower[3:].T @ [0, 0.5, 0]
    assert sim.qacc - free == pytest.approx(
        np.linalg.solve(sim.mass_matrix(), generalised), rel=1e-9
    )


def test_reset_goes_to_the_pose_of_the_scene_or_to_a_key(sim):
    sim.step(20)
    sim.xfrc_applied[1, 2] = 1.0
    sim.reset(key="bent")
    assert (sim.time, sim.qpos.tolist(), sim.ctrl.tolist()) == (0.5, [0.3, -0.5], [0.7])
    assert sim.qvel.tolist() == [0.1, 0.2]
    assert not sim.xfrc_applied.any()
    sim.step()
    assert sim.time == 0.5 + sim.settings.dt
    sim.reset()
    assert sim.state() == sc.Sim(sim.model).state()
    assert sim.reset(key=0) is None
    assert sim.time == 0.5


# Reading.


def test_positions_follow_the_state_that_is_written(sim):
    sim.step()
    sim.qpos[:] = [-np.pi / 2, 0.0]
    assert sim.body("lower").xpos == pytest.approx([0, 0, 1.0], abs=1e-15)
    assert sim.site("hand").xpos == pytest.approx([0, 0, 1.5], abs=1e-15)
    assert sim.geom("tip").xpos == pytest.approx([0, 0, 1.25], abs=1e-15)
    assert sim.xmat[2] == pytest.approx(sim.geom_xmat[0] @ np.linalg.inv(sim.geom_xmat[0]) @ sim.xmat[2])
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
    assert sim.residual >= 0.0
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


# Runs.


def test_run_records_every_step(model):
    sim = sc.Sim(model, dt=0.01)
    trajectory = sim.run(0.5, control=lambda time, sim: [np.sin(time)], record=("qpos", "energy"))
    assert len(trajectory) == 51
    assert trajectory.qpos.shape == (51, 2)
    assert trajectory.energy.shape == (51, 2)
    assert trajectory.time == pytest.approx(np.arange(51) * 0.01)
    other = sc.Sim(model, dt=0.01)
    for _ in range(50):
        other.ctrl[:] = np.sin(other.time)
        other.step()
    assert (trajectory.qpos[-1] == other.qpos).all()
    assert "qpos (51, 2)" in repr(trajectory)
    assert copy.deepcopy(trajectory).qpos.shape == (51, 2)


def test_run_holds_controls_for_their_period(model):
    table, dts = np.array([[0.5], [-0.5], [1.0]]), (0.01, 0.005)
    for dt in dts:
        run = sc.Sim(model, dt=dt).run(0.1, table, control_dt=0.02, record=("ctrl",))
        each = round(0.02 / dt)
        expected = np.repeat([0.5, -0.5, 1.0, 1.0, 1.0], each)
        # What is recorded at an instant is the control that led there.
        assert (run.ctrl[1:, 0] == expected).all()


def test_run_draws_itself(model, tmp_path):
    run = sc.Sim(model, dt=0.01).run(0.05, record="qpos")
    run.plot(str(tmp_path / "run.png"))
    assert (tmp_path / "run.png").stat().st_size > 1000


# Snapshots and copies.


@pytest.mark.parametrize("precision", ["f64", "f32"])
@pytest.mark.parametrize("solver", ["pgs", "newton"])
def test_a_restored_snapshot_continues_bit_for_bit(solver, precision):
    sim = sc.Sim(pendulum(), solver=solver, precision=precision, sweeps=5, tolerance=0.0)
    sim.qpos[:] = [1.3, 0.9]
    sim.ctrl[0] = 0.9
    sim.step(100)
    snapshot = sim.state()
    sim.step(200)
    later = sim.state()
    sim.reset()
    sim.step(3)
    sim.restore(snapshot)
    assert sim.state() == snapshot
    sim.step(200)
    assert sim.state() == later
    for twin in (pickle.loads(pickle.dumps(sim)), copy.deepcopy(sim)):
        assert twin.settings == sim.settings
        assert twin.state() == later
        twin.step(50)
        sim.restore(later)
        sim.step(50)
        assert twin.state() == sim.state()


def test_time_goes_on_from_a_snapshot_under_another_dt(model):
    sim, other = sc.Sim(model, dt=0.01), sc.Sim(model, dt=0.004)
    sim.step(10)
    other.restore(sim.state())
    assert other.time == sim.time
    other.step()
    assert other.time == sim.time + 0.004
    other.time = 2.0
    other.step(3)
    assert other.time == 2.0 + 3 * 0.004


def test_time_is_counted_not_summed(model):
    sim = sc.Sim(model, dt=1e-3)
    sim.step(1000)
    assert sim.time == 1000 * 1e-3


def test_model_pickles_and_copies(model):
    for twin in (pickle.loads(pickle.dumps(model)), copy.deepcopy(model), copy.copy(model)):
        assert twin.settings == model.settings
        assert twin.names == model.names
        assert (twin.body_inertia == model.body_inertia).all()
        assert sc.Sim(twin).state() == sc.Sim(model).state()


def test_settings_pickle_copy_compare_and_show_what_is_special():
    settings = sc.Settings(dt=0.01, solver="pgs")
    assert repr(settings) == "Settings(dt=0.01, solver='pgs')"
    assert settings.replace(dt=0.002, solver="newton") == sc.Settings()
    assert settings != sc.Settings()
    assert settings != "pgs"
    assert len({settings, sc.Settings(solver="pgs", dt=0.01)}) == 1
    assert pickle.loads(pickle.dumps(settings)) == copy.deepcopy(settings) == settings
    assert sc.Settings(**settings.as_dict()) == settings


def test_overrides_come_before_the_scenes_own_settings():
    scene = pendulum(dt=0.01, sweeps=7)
    sim = sc.Sim(scene, sweeps=9)
    assert (sim.settings.dt, sim.settings.sweeps) == (0.01, 9)
    assert sc.Sim(scene, sc.Settings(), dt=0.5).settings == sc.Settings(dt=0.5)
    assert sc.Sim(scene.compile(), cone="elliptic").settings.dt == 0.01


# The model.


def test_model_tables(model):
    assert (model.nq, model.nv, model.nu, model.nbody) == (2, 2, 1, 3)
    assert (model.njnt, model.ngeom, model.nsite) == (2, 3, 1)
    assert model.body_names == ("world", "upper", "lower")
    assert model.body_mass == pytest.approx([0, 1.0, 0.5])
    assert model.jnt_type == ("hinge", "hinge")
    assert model.jnt_range.tolist() == [[-np.inf, np.inf], [-1.0, 1.0]]
    assert model.geom_type == ("plane", "capsule", "capsule")
    assert ("floor", "tip") in model.pairs
    assert model.actuator_gear[0, 0] == 2.0
    assert model.keys[0].qpos.tolist() == [0.3, -0.5]
    with pytest.raises(ValueError, match="read-only"):
        model.body_mass[1] = 3.0


def test_with_values_changes_a_copy(model):
    changed = model.with_values(
        {"body/lower/mass": 2.0, "joint/shoulder/damping": 0.5, "geom/tip/friction": 0.25}
    )
    assert model.body_mass[2] == 0.5
    assert changed.body_mass[2] == pytest.approx(2.0)
    assert changed.body_inertia[2] == pytest.approx(4.0 * model.body_inertia[2])
    assert changed.body_ipos[2] == pytest.approx(model.body_ipos[2])
    assert changed.scene.geom("tip").friction == (0.25, 0.005, 0.0001)
    assert changed.scene.joint("shoulder").damping == 0.5
    assert model.with_values({"gravity": (0, 0, 0)}).scene.gravity == (0, 0, 0)


@pytest.mark.parametrize(
    ("values", "text"),
    [
        ({"body/lowr/mass": 1.0}, 'nearest: "lower"'),
        ({"bodies/lower/mass": 1.0}, 'nearest: "body"'),
        ({"body/lower/mas": 1.0}, 'nearest: "mass"'),
        ({"body/lower/mass": -1.0}, "mass = -1.0: must be"),
        ({"body/lower/mass": np.nan}, "mass = nan: must be"),
        ({"geom/tip/condim": 2}, "condim = 2: must be one of"),
        ({"gravity": (0, 0)}, "gravity"),
        ({"mass": 1.0}, "kind/name/field"),
        ("gravity", "must be a dict"),
    ],
)
def test_with_values_refuses(model, values, text):
    with pytest.raises(ValueError, match=text):
        model.with_values(values)


# What goes wrong.


def unstable(**options):
    """A stiff spring far beyond the step that its integrator can take: ω dt = 10."""
    scene = sc.Scene(gravity=(0, 0, 0)).with_settings(dt=0.1, integrator="semi-implicit")
    for name, stiffness in (("calm", 1.0), ("wild", 1e4)):
        body = scene.add_body(name)
        scene.add_joint(body, "slide", name=name, stiffness=stiffness)
        scene.add_geom(body, "sphere", 0.1, mass=1.0, contype=0, conaffinity=0)
    return scene.with_settings(**options)


@pytest.mark.parametrize("precision", ["f64", "f32"])
def test_divergence_names_its_element_and_keeps_the_last_finite_state(precision):
    sim = sc.Sim(unstable(), precision=precision)
    sim.qpos[:] = [1.0, 1.0]
    with pytest.raises(sc.SimulationError, match="spring of joint `wild`") as caught:
        sim.step(10_000)
    error = caught.value
    assert isinstance(error, RuntimeError)
    assert error.element == "spring of joint `wild`"
    assert error.world == 0
    assert error.time == sim.time == pytest.approx(error.step * 0.1)
    assert np.isfinite(sim.qpos).all() and np.isfinite(sim.qvel).all()
    assert abs(sim.qpos[1]) > 1e10
    again = sc.Sim(unstable(), precision=precision)
    again.qpos[:] = [1.0, 1.0]
    again.step(error.step)
    assert again.state() == sim.state()
    twin = pickle.loads(pickle.dumps(error))
    assert (twin.step, twin.element, str(twin)) == (error.step, error.element, str(error))


def test_an_interrupt_stops_a_long_call_between_two_steps_and_a_second_thread_is_refused(model):
    sim = sc.Sim(model, dt=1e-4)
    refused = []

    def meddle():
        # This thread runs only because the stepping one gave up the GIL.
        for call in (sim.step, sim.forward, sim.state, lambda: sim.xpos, lambda: sim.time):
            try:
                call()
            except RuntimeError as error:
                refused.append(str(error))
        signal.raise_signal(signal.SIGINT)

    started = threading.Timer(0.1, meddle)
    with pytest.raises(KeyboardInterrupt):
        started.start()
        sim.step(10**12)
    started.join()
    assert refused == ["this Sim is busy in another thread"] * 5
    steps = round(sim.time / 1e-4)
    assert 0 < steps < 10**12
    other = sc.Sim(model, dt=1e-4)
    other.step(steps)
    assert other.state() == sim.state()
