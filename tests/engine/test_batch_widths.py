"""Registers hold eight worlds, in single precision sixteen: full, half full or with one world."""

import numpy as np
import peers
import pytest

import stepcore as sc


@pytest.fixture(scope="module", params=["f64", "f32"])
def cheetah(request):
    model = sc.load(peers.gym_path("half_cheetah")).compile()
    return model.with_settings(precision=request.param)


def spread(model, n):
    """From lying on its back in the floor to flying, with controls."""
    rng = np.random.default_rng(n)
    qpos = model.qpos0 + 0.2 * rng.normal(size=(n, model.nq))
    qpos[:, 1] = np.linspace(-0.15, 0.6, n)
    qpos[:, 2] += np.linspace(0.0, 3.0, n)
    return qpos, rng.normal(size=(n, model.nv)), rng.uniform(-1, 1, size=(n, model.nu))


@pytest.mark.parametrize("solver", ["pgs", "newton"])
@pytest.mark.parametrize("n", [15, 16, 33])
def test_worlds_side_by_side_are_worlds_alone(cheetah, solver, n):
    model = cheetah.with_settings(solver=solver)
    seen, rows = set(), set()
    for lanes in (True, False):
        batch = sc.Batch(model, n, threads=1, lanes=lanes)
        batch.qpos, batch.qvel, batch.ctrl = spread(model, n)
        for _ in range(4):
            batch.step(40)
            rows |= {len(own) for own in batch.rows}
        seen.add((batch.qpos.tobytes(), batch.qvel.tobytes(), batch.qacc.tobytes(), batch.state()))
    assert len(seen) == 1 and len(rows) > 4


def test_one_world_of_a_register_fails_and_the_others_go_on(cheetah):
    ways = (True, False)
    batch, other = (sc.Batch(cheetah, 33, threads=1, lanes=way, on_failure="go on") for way in ways)
    fast = 1e30 if cheetah.settings.precision == "f32" else 1e200
    for each in (batch, other):
        each.qpos, each.qvel, each.ctrl = spread(cheetah, 33)
        each.qvel[20, 4] = fast
        each.step(5)
        assert list(each.failures) == [20]
    assert batch.state() == other.state()


def test_forces_on_some_worlds_come_and_go(cheetah):
    """What is written counts in its world alone, and no longer than it stands there."""
    n = 20
    batch = sc.Batch(cheetah, n, threads=1, lanes=True)
    sims = [sc.Sim(cheetah) for _ in range(n)]
    everyone = (batch, *sims)
    batch.qpos[:] = spread(cheetah, n)[0]
    for world, sim in enumerate(sims):
        sim.qpos[:] = batch.qpos[world]
    for force in (0.0, 5.0, 0.0, -0.0, 7.0, 0.0):
        for world in (3, 17, 18):
            batch.qfrc_applied[world, 2] = sims[world].qfrc_applied[2] = force
        batch.xfrc_applied[9, 1, 2] = sims[9].xfrc_applied[1, 2] = 10 * force
        batch.ctrl[5, 0] = sims[5].ctrl[0] = force / 10
        for each in everyone:
            each.step(7)
        for world, sim in enumerate(sims):
            assert batch.qpos[world].tobytes() == sim.qpos.tobytes()
            assert batch.qvel[world].tobytes() == sim.qvel.tobytes()
            assert batch.state()[world] == sim.state()
