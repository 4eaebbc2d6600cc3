"""`Batch`: many worlds are the same worlds alone, bit for bit, however they are computed."""

import copy
import os
import pickle
import signal

import numpy as np
import peers
import pytest
from busy import when_busy
from small import ball, pendulum, unstable

import stepcore as sc
from stepcore.engine.batch import _threads as batch_threads

WAYS = {
    "pgs": {"solver": "pgs", "tolerance": 1e-6, "sweeps": 50},
    "newton": {"solver": "newton", "tolerance": 1e-10, "sweeps": 50},
}


@pytest.fixture(scope="module")
def cheetah():
    return sc.load(peers.gym_path("half_cheetah")).compile()


def cheetah_starts(model):
    """Eight states and controls: from lying on its back in the floor to flying."""
    rng = np.random.default_rng(5)
    qpos = model.qpos0 + 0.2 * rng.normal(size=(8, model.nq))
    qpos[:, 1] = np.linspace(-0.15, 0.6, 8)
    qpos[:, 2] += np.linspace(0.0, 3.0, 8)
    return qpos, rng.normal(size=(8, model.nv)), rng.uniform(-1, 1, size=(8, model.nu))


@pytest.mark.parametrize("way", WAYS)
def test_eight_cheetahs_in_lanes_are_eight_cheetahs_alone(cheetah, way):
    qpos, qvel, ctrl = cheetah_starts(cheetah)
    batch = sc.Batch(cheetah, 8, **WAYS[way])
    batch.qpos, batch.qvel, batch.ctrl = qpos, qvel, ctrl
    sims = [sc.Sim(cheetah, **WAYS[way]) for _ in range(8)]
    for world, sim in enumerate(sims):
        sim.qpos, sim.qvel, sim.ctrl = qpos[world], qvel[world], ctrl[world]
    alive = set()
    for _ in range(5):
        batch.step(100)
        for world, sim in enumerate(sims):
            sim.step(100)
            alive.add((world, tuple(sim.contacts["geom2"])))
            assert batch.qpos[world].tobytes() == sim.qpos.tobytes()
            assert batch.qvel[world].tobytes() == sim.qvel.tobytes()
            assert batch.state()[world] == sim.state()
    # The lanes did not do the same: other contacts were alive in them.
    assert len({contacts for _, contacts in alive}) >= 5


@pytest.mark.parametrize("law", ["solref", "rigid", "penalty"])
@pytest.mark.parametrize("n", [1, 7, 8, 9, 20])
def test_neither_lanes_nor_threads_nor_size_change_a_bit(law, n):
    model = ball(law=law, solver="pgs", sweeps=30, cone="elliptic").compile()
    rng = np.random.default_rng(n)
    qvel = rng.normal(size=(n, 6))
    seen = set()
    for lanes, threads in ((True, 1), (True, 3), (False, 1), (False, 3)):
        batch = sc.Batch(model, n, threads=threads, lanes=lanes)
        batch.qvel = qvel
        batch.step(150)
        seen.add((batch.qpos.tobytes(), batch.qvel.tobytes(), batch.qacc.tobytes(), batch.state()))
    assert len(seen) == 1


def test_single_precision_is_the_sim_in_single_precision(cheetah):
    qpos, qvel, ctrl = cheetah_starts(cheetah)
    batch = sc.Batch(cheetah, 8, threads=2, precision="f32", solver="pgs")
    batch.qpos, batch.qvel, batch.ctrl = qpos, qvel, ctrl
    batch.step(50)
    sim = sc.Sim(cheetah, precision="f32", solver="pgs")
    sim.qpos, sim.qvel, sim.ctrl = qpos[3], qvel[3], ctrl[3]
    sim.step(50)
    assert batch.state()[3] == sim.state()
    assert (batch.qpos == batch.qpos.astype(np.float32)).all()


@pytest.mark.parametrize("lanes", [True, False])
def test_a_rollout_is_steps_with_those_controls(lanes):
    model = pendulum().compile()
    rng = np.random.default_rng(2)
    ctrl = rng.uniform(-2, 2, size=(11, 60, 1))
    batch = sc.Batch(model, 11, threads=2, lanes=lanes)
    result = batch.rollout(ctrl)
    assert result.qpos.shape == (11, 60, 2)
    assert result.act.shape == (11, 60, 0)
    assert batch.time == pytest.approx(60 * model.settings.dt)
    for world in (0, 7, 8, 10):
        sim = sc.Sim(model)
        for step in range(60):
            sim.ctrl[:] = ctrl[world, step]
            sim.step()
            assert (result.qpos[world, step] == sim.qpos).all()
            assert (result.qvel[world, step] == sim.qvel).all()
        assert batch.state()[world] == sim.state()
    assert batch.rollout(np.zeros((11, 0, 1))).qpos.shape == (11, 0, 2)


@pytest.mark.parametrize("precision", ["f64", "f32"])
def test_a_rollout_records_what_is_asked_for(precision):
    """The same bits as stepping and reading; refused before the first step."""
    model = sc.load("gymnasium:hopper").compile()
    ctrl = np.random.default_rng(7).uniform(-1, 1, size=(9, 20, 3))
    batch, stepped, plain = (sc.Batch(model, 9, precision=precision) for _ in range(3))
    run = batch.rollout(ctrl, record=("sensordata", "energy", "xpos"))
    assert list(run.recorded) == ["sensordata", "energy", "xpos"]
    assert (run.qpos == plain.rollout(ctrl).qpos).all()
    for step in range(20):
        stepped.ctrl[:] = ctrl[:, step]
        stepped.step()
        for name, values in run.recorded.items():
            assert (values[:, step] == getattr(stepped, name)).all()
    assert batch.state() == stepped.state()
    empty = batch.rollout(ctrl[:, :0], record="energy")
    assert empty.qpos.shape == (9, 0, 6) and empty.recorded["energy"].shape == (9, 0, 2)
    before = batch.state()
    ctrl[3, 19, 1] = np.nan
    with pytest.raises(ValueError, match=r"ctrl\[3, 19, 1\] = NaN: must be finite"):
        batch.rollout(ctrl, record="energy")
    for bad in ("sensordatum", "momentum", "sweeps_done", 5):
        with pytest.raises(ValueError, match="record"):
            batch.rollout(ctrl, record=bad)
    with pytest.raises(ValueError, match="ctrl has shape"):
        batch.rollout(ctrl[:4], record="energy")
    assert batch.state() == before
    # What is written before a rollout counts, in one of no step too.
    batch.reset()
    batch.rollout(ctrl[:, :0])
    assert (batch.qpos == stepped.model.qpos0).all()
    ctrl[3, 19, 1] = 0.0
    stepped.reset()
    assert (batch.rollout(ctrl, record="energy").qpos == stepped.rollout(ctrl).qpos).all()


def test_worlds_do_not_reach_each_other():
    batch = sc.Batch(ball(), 3)
    batch.xfrc_applied[1, 1] = [0, 0, 100, 0, 0, 0]
    batch.step(20)
    assert (batch.qpos[0] == batch.qpos[2]).all()
    assert batch.qpos[1, 2] > batch.qpos[0, 2] + 0.01


def test_reading_a_batch_reads_each_world():
    model = pendulum().compile()
    batch = sc.Batch(model, 9, dt=0.003)
    batch.reset(key="bent")
    assert batch.time == 0.5
    batch.qpos += np.linspace(-0.1, 0.1, 9)[:, None]
    batch.forward()
    for world in (0, 8):
        sim = sc.Sim(model, dt=0.003)
        sim.reset(key="bent")
        sim.qpos = batch.qpos[world]
        sim.forward()
        for name in (
            *("xpos", "xquat", "xmat", "geom_xpos", "geom_xmat", "site_xpos", "energy"),
            *("bias", "passive", "qacc"),
        ):
            assert (getattr(batch, name)[world] == np.asarray(getattr(sim, name))).all(), name
        assert (batch.mass_matrix()[world] == sim.mass_matrix()).all()
        assert (batch.jacobian("lower")[world] == sim.jacobian("lower")).all()
        for ours, alone in zip(batch.momentum, sim.momentum, strict=True):
            assert (ours[world] == alone).all()
    assert len(batch) == 9
    assert "9 worlds" in repr(batch)


@pytest.mark.parametrize("lanes", [True, False])
def test_a_restored_batch_continues_bit_for_bit(lanes):
    batch = sc.Batch(ball(), 10, lanes=lanes, solver="pgs", sweeps=4, tolerance=0)
    batch.qvel[:, 0] = np.linspace(-1, 1, 10)
    batch.step(40)
    start = batch.state()
    twins = [pickle.loads(pickle.dumps(batch)), copy.deepcopy(batch)]
    other = sc.Batch(ball(), 10, lanes=not lanes, solver="pgs", sweeps=4, tolerance=0)
    other.restore(start)
    batch.step(40)
    later = batch.state()
    batch.restore(start)
    for again in (batch, other, *twins):
        assert again.state() == start
        again.step(40)
        assert again.state() == later


@pytest.mark.filterwarnings("ignore::stepcore.EnergyWarning")
@pytest.mark.parametrize(("lanes", "threads"), [(True, 1), (True, 2), (False, 1), (False, 2)])
def test_divergence_stops_every_world_at_the_same_step(lanes, threads):
    batch = sc.Batch(unstable(), 20, threads=threads, lanes=lanes)
    batch.qpos[:] = [1.0, 0.0]
    batch.qpos[17, 1] = 1e100
    batch.qpos[13, 1] = 1.0
    with pytest.raises(sc.SimulationError, match=r"in world 17\. .*`wild`") as caught:
        batch.step(1000)
    assert caught.value.world == 17
    assert np.isfinite(batch.qpos).all()
    alone = sc.Sim(unstable())
    for world, start in ((17, 1e100), (13, 1.0), (2, 0.0)):
        alone.reset()
        alone.qpos = [1.0, start]
        alone.step(caught.value.step)
        assert batch.state()[world] == alone.state()
    assert batch.time == alone.time
    # The same within a rollout that already did some steps.
    batch.reset()
    batch.qpos[17, 1] = 1e100
    with pytest.raises(sc.SimulationError):
        batch.rollout(np.zeros((20, 1000, 0)))
    assert batch.time == alone.time


def test_an_interrupted_batch_stands_between_two_steps():
    model = pendulum(dt=1e-4).compile()
    batch = sc.Batch(model, 9, threads=2)
    refused = []

    def meddle():
        try:
            batch.step()
        except RuntimeError as error:
            refused.append(str(error))
        signal.raise_signal(signal.SIGINT)

    with pytest.raises(KeyboardInterrupt):
        when_busy(batch, meddle)
        batch.step(10**9)
    assert refused == ["this Batch is busy in another thread"]
    sim = sc.Sim(model)
    sim.step(round(batch.time / 1e-4))
    assert set(batch.state()) == {sim.state()}


@pytest.mark.parametrize("integrator", ["euler", "rk4"])
@pytest.mark.parametrize(
    "way", [{"lanes": True}, {"lanes": False}, {"precision": "f32"}], ids=["lanes", "alone", "f32"]
)
def test_the_last_solve_of_each_world_is_that_of_a_sim(integrator, way):
    model = pendulum().compile().with_settings(integrator=integrator)
    batch = sc.Batch(model, 9, threads=2, **way)
    sims = [sc.Sim(batch.model) for _ in range(9)]
    assert batch.contacts[8].size == batch.rows[8].size == 0
    batch.reset(key="bent")
    batch.qpos += np.linspace(-0.1, 0.1, 9)[:, None]
    for world, sim in enumerate(sims):
        sim.reset(key="bent")
        sim.qpos = batch.qpos[world]
    seen = 0
    for advance in (
        lambda each: each.step(300),
        lambda each: each.forward(),
        lambda each: each.step(1),
        lambda each: each.step(0),
    ):
        for each in (batch, *sims):
            advance(each)
        before = batch.state()
        contacts, rows = batch.contacts, batch.rows
        for world, sim in enumerate(sims):
            assert contacts[world].tobytes() == sim.contacts.tobytes()
            assert rows[world].tobytes() == sim.rows.tobytes()
            seen += len(rows[world])
            for name in ("residual", "constraint_force", "actuator_force", "qacc"):
                assert np.array_equal(getattr(batch, name)[world], getattr(sim, name)), name
        assert batch.state() == before
        # What is written afterwards does not reach the last solve.
        for each in (batch, *sims):
            each.ctrl += 0.125
    assert seen > 9


def test_the_last_solve_of_a_rollout_and_of_a_step_that_failed():
    model = pendulum().compile()
    batch, sim = sc.Batch(model, 3), sc.Sim(model)
    ctrl = np.random.default_rng(4).uniform(-2, 2, size=(3, 200, 1))
    batch.rollout(ctrl)
    for row in ctrl[1]:
        sim.ctrl = row
        sim.step()
    assert batch.rows[1].tobytes() == sim.rows.tobytes()
    assert (batch.actuator_force[1] == sim.actuator_force).all()
    wild = sc.Batch(unstable(), 3)
    wild.qpos[1] = 1.0
    with pytest.raises(sc.SimulationError):
        wild.step(100_000)
    assert [len(rows) for rows in wild.rows] == [0, 0, 0]


def test_views_by_name_have_a_world_axis():
    model = pendulum().compile()
    batch, sim = sc.Batch(model, 3), sc.Sim(model)
    batch.joint("elbow").qpos = 0.5
    batch.joint("elbow").qvel = [[0.0], [1.0], [2.0]]
    batch.body("lower").xfrc_applied[1, 2] = 3.0
    assert batch.qpos.tolist() == [[0.0, 0.5]] * 3
    assert batch.xfrc_applied[1, 2, 2] == 3.0
    sim.joint("elbow").qpos, sim.joint("elbow").qvel = 0.5, 2.0
    for name in ("xpos", "xquat", "xmat", "velocity", "jacobian"):
        ours, alone = getattr(batch.body("lower"), name), getattr(sim.body("lower"), name)
        assert ours[2] == pytest.approx(alone, abs=1e-15) and ours.shape == (3, *alone.shape)
    batch.forward()
    for kind, element, name in (
        ("joint", "elbow", "qacc"),
        ("joint", "elbow", "constraint_force"),
        ("geom", "tip", "xmat"),
        ("site", "hand", "xpos"),
    ):
        view, alone = getattr(batch, kind)(element), getattr(sim, kind)(element)
        assert getattr(view, name).shape == (3, *getattr(alone, name).shape)
    with pytest.raises(ValueError, match='nearest: "elbow"'):
        batch.joint("elbw")


def test_the_time_of_a_batch_can_be_set():
    batch, sim = sc.Batch(ball(), 9, dt=0.01), sc.Sim(ball(), dt=0.01)
    for each in (batch, sim):
        each.step(20)
        each.time = 2.5
        each.step(3)
    assert batch.time == sim.time == 2.5 + 3 * 0.01
    # Impulses are kept.
    assert batch.state()[8] == sim.state()
    with pytest.raises(ValueError, match="time = NaN: must be finite"):
        batch.time = np.nan
    assert batch.time == sim.time


def test_threads_are_used_where_they_gain():
    """By default one a core for a large batch, one for a small one; a number is taken as it is."""
    cores = os.cpu_count() or 1
    assert [batch_threads(None, n, nv) for n, nv in ((8, 9), (1999, 1), (2000, 1), (512, 9))] == [
        *(1, 1),
        *(cores, cores),
    ]
    assert batch_threads(3, 1, 1) == 3
    with pytest.raises(ValueError, match="threads = 0"):
        batch_threads(0, 5000, 1)


def test_a_large_batch_has_the_bits_of_one_thread():
    model = ball().compile()
    batches = [sc.Batch(model, 2001 // model.nv + 1, threads=threads) for threads in (None, 1)]
    for batch in batches:
        batch.qvel[:, 0] = np.linspace(-1, 1, len(batch))
        batch.step(5)
    assert (batches[0].qpos == batches[1].qpos).all()


@pytest.mark.parametrize("lanes", [True, False])
def test_arrays_go_in_and_out_over_threads(lanes):
    """Of worlds that cannot be stepped the first is named, and none moves."""
    batches = [sc.Batch(ball(), 1501, threads=threads, lanes=lanes) for threads in (1, 3)]
    for batch in batches:
        batch.qvel[:, 0] = np.linspace(-1, 1, len(batch))
        batch.step(2)
        batch.qpos[::7, 2] += 0.25
        batch.step(2)
    for name in ("qpos", "qvel"):
        assert getattr(batches[0], name).tobytes() == getattr(batches[1], name).tobytes()
    for batch in batches:
        batch.qvel[[1400, 77, 800], 1] = np.nan
        before = batch.qpos.copy()
        with pytest.raises(ValueError, match=r"qvel\[1\] = NaN.*world 77\)"):
            batch.step()
        assert (batch.qpos == before).all()
        batch.qvel[[1400, 77, 800], 1] = 0.0
        batch.step()
    assert batches[0].qpos.tobytes() == batches[1].qpos.tobytes()


@pytest.mark.parametrize("lanes", [True, False])
def test_forces_come_and_go_in_each_world(cheetah, lanes):
    """Most worlds have none, which a batch does not write: one that has, had or has -0 shows."""
    qpos, qvel, _ = cheetah_starts(cheetah)
    pushes = [{}, {5: 3.0}, {2: -0.0, 6: 2.0}, {2: -1.0, 5: -0.0}, {}, {0: 4.0}]
    batch = sc.Batch(cheetah, 8, lanes=lanes)
    sims = [sc.Sim(cheetah) for _ in range(8)]
    batch.qpos[:], batch.qvel[:] = qpos, qvel
    for sim, q, v in zip(sims, qpos, qvel, strict=True):
        sim.qpos[:], sim.qvel[:] = q, v
    for push in pushes:
        batch.qfrc_applied[:] = batch.xfrc_applied[:] = 0.0
        for world, force in push.items():
            batch.qfrc_applied[world, 1] = batch.xfrc_applied[world, 3, 2] = force
        batch.step(2)
        for world, sim in enumerate(sims):
            sim.qfrc_applied[1] = sim.xfrc_applied[3, 2] = push.get(world, 0.0)
            sim.step(2)
    ends = np.array([[*sim.qpos, *sim.qvel] for sim in sims])
    assert np.hstack([batch.qpos, batch.qvel]).tobytes() == ends.tobytes()
