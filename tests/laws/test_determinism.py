"""The same inputs give the same bits: alone, in a batch of any size, in lanes, over threads.

And a snapshot, of a Sim or of a Batch, through pickle or not, goes on with the same bits.
"""

import copy
import pickle
import threading

import numpy as np
import pytest
import test_laws
from covering import every_pair

import stepcore as sc

WORLDS = 19  # two whole registers of eight lanes and a part of one
STEPS = 30
SCENES = ["half_cheetah", "all_together", "plane_capsule", "marbles", "free_limb"]
WAYS = {
    "pgs": {"solver": "pgs", "sweeps": 20, "tolerance": 1e-6},
    "newton": {"solver": "newton", "sweeps": 50, "tolerance": 1e-10},
    "momentum": {"solver": "pgs", "sweeps": 20, "acceleration": "momentum", "tolerance": 1e-6},
    "rigid rk4": {
        "solver": "pgs",
        "sweeps": 20,
        "tolerance": 0.0,
        "law": "rigid",
        "cone": "elliptic",
        "integrator": "rk4",
    },
}


def worlds_of(name, count=WORLDS):
    """Perturbed starts, each an independent world: qpos, qvel, ctrl with a leading axis."""
    qpos, qvel, ctrl = test_laws.start_of(name)
    rng = np.random.default_rng(17)
    many = (count, 1)
    speeds = np.tile(qvel, many) + 0.3 * rng.normal(size=(count, len(qvel)))
    return np.tile(qpos, many), speeds, rng.normal(size=(count, len(ctrl)))


def batch_of(name, way, n=WORLDS, **options):
    batch = sc.Batch(test_laws.scene_of(name).compile(), n, **WAYS[way], **options)
    batch.qpos[:], batch.qvel[:], batch.ctrl[:] = (x[:n] for x in worlds_of(name))
    return batch


def alone(name, way, world, precision="f64"):
    sim = sc.Sim(test_laws.scene_of(name).compile(), precision=precision, **WAYS[way])
    sim.qpos[:], sim.qvel[:], sim.ctrl[:] = (x[world] for x in worlds_of(name))
    return sim


def bits(array):
    return np.ascontiguousarray(array).tobytes()


@every_pair(name=SCENES, way=WAYS)
def test_a_world_in_a_batch_is_a_world_alone(name, way):
    """Lanes, one thread, two threads, one by one, f32: all equal the worlds stepped alone."""
    for precision in ("f64", "f32"):
        sims = [alone(name, way, world, precision) for world in range(WORLDS)]
        for sim in sims:
            sim.step(STEPS)
        qpos, qvel = np.array([s.qpos for s in sims]), np.array([s.qvel for s in sims])
        for options in ({}, {"lanes": False}, {"threads": 2}, {"lanes": False, "threads": 3}):
            batch = batch_of(name, way, precision=precision, **options)
            batch.step(STEPS)
            for world in range(WORLDS):
                where = f"world {world} with {options}, {precision}"
                assert bits(batch.qvel[world]) == bits(qvel[world]), where
                assert bits(batch.qpos[world]) == bits(qpos[world]), where


@pytest.mark.parametrize("solver", [{"solver": "pgs", "tolerance": 1e-6}, {"solver": "newton"}])
def test_eight_cheetahs(solver):
    """Eight perturbed half_cheetahs in one register, different contacts alive, 500 steps."""
    model = test_laws.scene_of("half_cheetah").compile()
    batch = sc.Batch(model, 8, **solver)
    rng = np.random.default_rng(0)
    batch.qpos[:, 1] += np.linspace(-0.1, 0.3, 8)
    batch.qvel[:] = rng.normal(size=batch.qvel.shape)
    batch.ctrl[:] = rng.uniform(-1, 1, size=batch.ctrl.shape)
    sims = [sc.Sim(model, **solver) for _ in range(8)]
    for sim, *start in zip(sims, batch.qpos, batch.qvel, batch.ctrl, strict=True):
        sim.qpos[:], sim.qvel[:], sim.ctrl[:] = start
    different = 0
    for _ in range(500):
        batch.step()
        for sim in sims:
            sim.step()
        touching = {tuple(sim.rows["name"]) for sim in sims}
        different += len(touching) > 1
        assert bits(batch.qvel) == bits([sim.qvel for sim in sims])
        assert bits(batch.qpos) == bits([sim.qpos for sim in sims])
    assert different > 300, "the worlds did not have different rows"


def test_the_size_of_a_batch_changes_no_world():
    for way in WAYS:
        whole = batch_of("half_cheetah", way)
        whole.step(STEPS)
        for n in (1, 7, 8, 9):
            part = batch_of("half_cheetah", way, n)
            part.step(STEPS)
            assert bits(part.qpos) == bits(whole.qpos[:n]), f"{way}: {n} of {WORLDS} worlds"


def test_portions_of_steps():
    """One call of n steps is n calls of one."""
    for way in WAYS:
        one, many = alone("all_together", way, 0), alone("all_together", way, 0)
        one.step(STEPS)
        for _ in range(STEPS):
            many.step()
        assert one.state() == many.state()
        assert one.time == STEPS * one.settings.dt


def test_rollout_is_stepping():
    for way in WAYS:
        batch, rolled = batch_of("half_cheetah", way), batch_of("half_cheetah", way)
        ctrl = np.random.default_rng(2).uniform(-1, 1, (WORLDS, 12, rolled.model.nu))
        whole = rolled.rollout(ctrl)
        for step in range(12):
            batch.ctrl[:] = ctrl[:, step]
            batch.step()
            assert bits(batch.qpos) == bits(whole.qpos[:, step])
            assert bits(batch.qvel) == bits(whole.qvel[:, step])


@every_pair(way=WAYS, options=[{}, {"lanes": False}, {"threads": 2}, {"precision": "f32"}])
def test_a_snapshot_of_a_batch(way, options):
    """Restored into another batch, or pickled whole, a batch goes on with the same bits."""
    batch = batch_of("all_together", way, **options)
    batch.step(STEPS)
    snapshot = pickle.loads(pickle.dumps(batch.state()))
    copies = [pickle.loads(pickle.dumps(batch)), copy.deepcopy(batch)]
    other = sc.Batch(batch.model, WORLDS, lanes=not options.get("lanes", True))
    other.step(5)
    other.restore(snapshot)
    sims = [sc.Sim(batch.model) for _ in range(WORLDS)]
    for sim, state in zip(sims, snapshot, strict=True):
        sim.restore(state)
        sim.step(STEPS)
    batch.step(STEPS)
    for again in (*copies, other):
        again.step(STEPS)
        assert again.time == batch.time
        assert bits(again.qpos) == bits(batch.qpos)
        assert bits(again.qvel) == bits(batch.qvel)
    assert bits([sim.qvel for sim in sims]) == bits(batch.qvel)


@every_pair(way=WAYS, precision=["f64", "f32"])
def test_a_snapshot_of_a_sim(way, precision):
    """Pickle, deepcopy and state() are complete; reading changes nothing."""
    sim = alone("all_together", way, 0, precision)
    sim.qfrc_applied[:] = 0.1
    sim.xfrc_applied[1, 2] = 0.2
    sim.step(STEPS)
    copies = [pickle.loads(pickle.dumps(sim)), copy.deepcopy(sim)]
    assert all(again.state() == sim.state() for again in copies)
    for read in ("energy", "xpos", "geom_xmat", "momentum", "rows", "contacts", "residual"):
        getattr(copies[0], read)
    copies[0].mass_matrix()
    copies[0].jacobian(3)
    copies[1].forward()
    for again in (sim, *copies):
        again.step(STEPS)
    assert all(again.state() == sim.state() for again in copies)


def test_time_is_counted_in_whole_steps():
    """time = start + n dt, also across a restore: no sum of many small numbers."""
    sim = alone("free_limb", "pgs", 0)
    sim.time = 2.5
    sim.step(1000)
    other = pickle.loads(pickle.dumps(sim))
    other.step(1001)
    assert other.time == 2.5 + 2001 * sim.settings.dt


def test_sims_in_many_threads():
    """Sims of one model do not know of each other."""
    wanted = [alone("half_cheetah", "pgs", world) for world in range(4)]
    sims = [alone("half_cheetah", "pgs", world) for world in range(4)]
    for sim in wanted:
        sim.step(200)
    threads = [threading.Thread(target=sim.step, args=(200,)) for sim in sims]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    assert [sim.state() for sim in sims] == [sim.state() for sim in wanted]


def test_a_failed_step_keeps_the_last_finite_state():
    """After an error the state is the one before the step that failed, and nothing else moved."""
    sim, same = alone("half_cheetah", "pgs", 0), alone("half_cheetah", "pgs", 0)
    for each in (sim, same):
        each.step(10)
        each.qfrc_applied[:] = 1e200
    with pytest.raises(sc.SimulationError, match="step"):
        sim.step(50)
    done = round(sim.time / sim.settings.dt)
    assert np.isfinite(sim.qpos).all() and np.isfinite(sim.qvel).all()
    for _ in range(done - 10):
        same.step()
    assert same.state() == sim.state()
    with pytest.raises(sc.SimulationError):
        same.step()
    assert same.state() == sim.state()
