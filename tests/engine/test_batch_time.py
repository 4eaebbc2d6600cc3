"""Time of each world of a batch."""

from __future__ import annotations

import pickle

import numpy as np
import pytest
from small import pendulum

import stepcore as sc


@pytest.mark.parametrize("lanes", [True, False])
def test_times_are_those_of_sims_that_were_reset_alike(lanes):
    batch = sc.Batch(pendulum(), 5, 1, lanes=lanes, dt=0.003)
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
    assert pickle.loads(pickle.dumps(batch)).times.tolist() == batch.times.tolist()
    batch.restore(batch.state())
    assert batch.times.tolist() == [batch.time] * 5


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
