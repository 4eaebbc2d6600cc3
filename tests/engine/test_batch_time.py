"""Time of each world of a batch, and the memory of all."""

from __future__ import annotations

import pickle

import numpy as np
import pytest
from small import ball, pendulum

import stepcore as sc


@pytest.mark.parametrize("lanes", [True, False])
def test_times_are_those_of_sims_that_were_reset_alike(lanes):
    batch = sc.Batch(pendulum(), 5, threads=1, lanes=lanes, dt=0.003)
    sims = [sc.Sim(pendulum(), dt=0.003) for _ in range(5)]
    for steps, mask in ((7, [1, 0, 0, 1, 0]), (4, [0, 0, 0, 1, 1]), (300, [0, 0, 0, 0, 0])):
        batch.step(steps)
        for sim in sims:
            sim.step(steps)
        assert batch.times.tolist() == [sim.time for sim in sims]
        batch.reset(worlds=np.array(mask, dtype=bool))
        for sim, over in zip(sims, mask, strict=True):
            if over:
                sim.reset()
        assert batch.times.tolist() == [sim.time for sim in sims]
    assert batch.time == sims[1].time
    times, time, state = batch.times.tolist(), batch.time, batch.state()
    assert pickle.loads(pickle.dumps(batch)).times.tolist() == times
    batch.step(3)
    batch.reset()
    batch.restore(state)
    assert batch.times.tolist() == times and batch.time == time
    # A world's snapshot is one of a Sim, at the world's time.
    for sim, snapshot in zip(sims, state, strict=True):
        later = sc.Sim(pendulum(), dt=0.003)
        later.restore(snapshot)
        assert later.time == sim.time
    batch.restore(sim.state() for sim in sims)
    assert batch.times.tolist() == times
    # In steps of another length they count on from there.
    other = sc.Batch(pendulum(), 5, dt=0.002)
    other.restore(state)
    assert other.times == pytest.approx(times, rel=1e-12)


def test_times_follow_what_all_worlds_are_set_to():
    scene = pendulum()
    scene.add_key("later", time=2.0)
    batch = sc.Batch(scene, 3, dt=0.01)
    batch.step(5)
    batch.reset("later", worlds=[1])
    batch.step(2)
    assert batch.times == pytest.approx([0.07, 2.02, 0.07])
    batch.time = 5.0
    assert batch.times.tolist() == [5.0] * 3
    batch.reset("later", worlds=[1])
    batch.reset()
    assert batch.times.tolist() == [0.0] * 3


def test_memory_is_told():
    few, many = (sc.Batch(ball(), n, threads=1, lanes=True).nbytes for n in (1024, 4096))
    assert few > 1024 * 8 * 20
    # What threads need is the same; worlds take the same each.
    assert 3.5 < many / few <= 4.0
    alone = sc.Batch(ball(), 4096, threads=1, lanes=False).nbytes
    assert alone > many


def test_so_many_worlds_that_a_sample_is_tried_have_the_bits_of_few():
    """Above 65,536 worlds "auto" tries the other way aside."""
    many = sc.Batch("gymnasium:inverted_pendulum", (1 << 16) + 8, threads=1)
    few = sc.Batch("gymnasium:inverted_pendulum", 16, threads=1, lanes=False)
    angles = np.linspace(-0.2, 0.2, 16)
    many.qpos[:, 1] = np.resize(angles, len(many))
    few.qpos[:, 1] = angles
    for steps in (1, 1, 1, 1, 8):
        many.step(steps)
        few.step(steps)
    assert np.array_equal(many.qpos[:16], few.qpos)
    assert np.array_equal(many.qpos[-8:], few.qpos[8:] if len(many) % 16 == 0 else few.qpos[:8])
    # Nothing of the way that was not taken is left.
    same = sc.Batch(many.model, len(many), threads=1, lanes=many.in_lanes)
    assert many.nbytes == same.nbytes
