"""What is read of the last step or `forward`: it is that solve's, and reading changes nothing."""

import pickle
import time

import numpy as np
import pytest
from covering import every_pair
from zoo import ZOO

import stepcore as sc

READ = ("cfrc_int", "cfrc_ext", "cacc", "sensordata", "actuator_force", "constraint_force", "qacc")


def moving(name, **settings):
    entry = ZOO[name]
    model = sc.loads(entry.text).compile()
    sim = sc.Sim(model, **settings)
    rng = np.random.default_rng(1)
    sim.qvel[:] = 0.3 * rng.normal(size=model.nv)
    return model, sim, rng


@every_pair(
    name=list(ZOO)[::5], integrator=["euler", "implicitfast", "implicit", "discrete", "rk4"]
)
def test_reading_changes_nothing_and_is_of_the_step(name, integrator):
    """A batch solves again for what it reads, and has the same bits."""
    model, sim, rng = moving(name, integrator=integrator)
    unread, batch = sim.copy(), sc.Batch(model, 1, integrator=integrator)
    batch.qvel[:] = sim.qvel
    for _ in range(8):
        ctrl = rng.uniform(-1, 1, model.nu)
        for each in (sim, unread, batch):
            each.ctrl[...] = ctrl
            each.step(1)
        # What is written after the step is none of it.
        sim.ctrl[:] = 7
        first = {field: np.array(getattr(sim, field)) for field in READ}
        for field in READ:
            assert np.array_equal(first[field], getattr(batch, field)[0]), field
        sim.ctrl[:] = ctrl
        assert all(np.array_equal(first[field], getattr(sim, field)) for field in READ)
        assert sim.state() == unread.state()


@pytest.mark.parametrize("between", ["balance", "linearize", "element_slopes", "time", "step 0"])
def test_it_is_still_read_after_something_else_was_computed(between):
    _, sim, _ = moving("all_together")
    sim.step(3)
    wanted = {field: np.array(getattr(sim, field)) for field in READ}
    forces = sim.element_forces()
    sim.ctrl[:] = 0.5
    sim.qpos[:1] += 0.0
    sim.qvel[:] *= 0.5
    if between == "time":
        sim.time = 3.0
    elif between == "step 0":
        sim.step(0)
    else:
        getattr(sim, between)()
    for field, value in wanted.items():
        assert np.array_equal(getattr(sim, field), value), field
    again = sim.element_forces()
    assert forces.keys() == again.keys()
    assert all(np.array_equal(forces[key], again[key]) for key in forces)


def readings(world):
    """What is read of the last solve, by name."""
    found = {field: np.array(getattr(world, field)) for field in READ}
    tables = [world.contacts, world.rows] if isinstance(world, sc.Sim) else []
    tables += [*world.contacts, *world.rows] if isinstance(world, sc.Batch) else []
    return [*found.values(), *tables, np.array(world.residual)]


def same(one, other):
    return len(one) == len(other) and all(map(np.array_equal, one, other))


def started(name, n, integrator, lanes):
    model = sc.loads(ZOO[name].text).compile()
    rng = np.random.default_rng(1)
    if n is None:
        world = sc.Sim(model, integrator=integrator)
    else:
        world = sc.Batch(model, n, integrator=integrator, lanes=lanes)
    world.qvel[:] = 0.3 * rng.normal(size=world.qvel.shape)
    world.ctrl[:] = rng.uniform(-1, 1, world.ctrl.shape)
    return world


@every_pair(
    **{"n, lanes": [(None, None), (3, False), (9, True)]},
    solve=["step", "forward"],
    name=list(ZOO)[2::5],
    integrator=["euler", "discrete", "rk4"],
)
def test_it_is_read_after_restore_and_of_copies(name, n, lanes, integrator, solve):
    """Once qacc was 0 in a copy, and that of a later motion after `restore`."""
    world = started(name, n, integrator, lanes)
    world.step(20)
    getattr(world, solve)()
    # What was written since is none of it.
    world.qvel[:] *= 0.5
    world.ctrl[:] = 0.25
    state, wanted = world.state(), readings(world)
    copied = world.copy()
    assert copied.state() == state and same(readings(copied), wanted)
    assert copied.state() == state
    world.step(7)
    assert not same(readings(world), wanted)
    world.restore(state)
    assert world.state() == state and same(readings(world), wanted)
    assert world.state() == state
    again = pickle.loads(pickle.dumps(world))
    for each in (copied, world, again):
        each.step(3)
    assert same(readings(copied), readings(world)) and same(readings(again), readings(world))
    assert copied.state() == world.state() == again.state()


def test_a_reset_forgets_it():
    for world in (
        started("all_together", None, "euler", None),
        started("all_together", 9, "euler", True),
    ):
        world.step(5)
        world.reset()
        assert not world.qacc.any() and not world.actuator_force.any()
        assert not world.constraint_force.any()
    # In the other worlds it stays.
    world = started("all_together", 9, "euler", True)
    world.step(5)
    first = {
        field: np.array(getattr(world, field))
        for field in ("qacc", "actuator_force", "constraint_force")
    }
    world.reset(worlds=[3])
    for field, value in first.items():
        value[3] = 0.0
        assert np.array_equal(getattr(world, field), value), field


def test_a_batch_reads_forces_of_actuators_without_a_solve():
    """They once cost fifteen steps."""
    world = started("all_together", 9, "euler", True)
    # The least of several rounds: a busy machine slows single ones.
    least = [np.inf, np.inf]
    for _ in range(5):
        for read in (False, True):
            begin = time.thread_time()
            for _ in range(50):
                world.step()
                if read:
                    world.actuator_force.sum()
            least[read] = min(least[read], time.thread_time() - begin)
    assert least[1] < 2 * least[0]
