"""Threads that share the steps of one world: the same bits for any number, and their limits."""

import pickle

import numpy as np
import pytest

import stepcore as sc

HALF = 0.1


@pytest.fixture(scope="module")
def heap():
    """Columns of boxes with a ball on top, side by side: more pairs than are listed."""
    bodies = ""
    for i in range(648):
        x, y, z = i % 9, i // 9 % 9, i // 81
        geom = f'type="box" size="{HALF} {HALF} {HALF}"' if i % 10 < 9 else f'size="{HALF}"'
        off = 0.004 * (3 * i % 5)
        pos = f"{0.25 * x + off} {0.25 * y - off} {HALF + 0.2 * z}"
        bodies += f'<body pos="{pos}"><freejoint/><geom {geom} mass="1"/></body>'
    floor = '<geom type="plane" size="5 5 .1"/>'
    model = sc.loads(f"<mujoco><worldbody>{floor}{bodies}</worldbody></mujoco>").compile()
    assert model.is_heap
    return model


def pushed(model, threads, **settings):
    """A world whose columns fall over each other."""
    sim = sc.Sim(model, threads=threads, **settings)
    sim.qvel[::6] = 0.3 * (np.arange(model.nbody - 1) % 11 - 5.0)
    sim.step(25)
    return sim


@pytest.mark.parametrize("settings", [{}, {"solver": "pgs", "sweeps": 20}], ids=["newton", "pgs"])
def test_any_number_of_threads_gives_the_same_bits(heap, settings):
    alone = pushed(heap, 1, **settings)
    assert len(alone.contacts) > 1024
    for threads in (2, 3):
        sim = pushed(heap, threads, **settings)
        for name in ("qpos", "qvel", "qacc"):
            assert np.array_equal(getattr(sim, name), getattr(alone, name)), name
        assert np.array_equal(sim.contacts, alone.contacts)
        assert np.array_equal(sim.rows, alone.rows)


def test_a_copy_goes_on_alike(heap):
    sim = pushed(heap, 2)
    other = pickle.loads(pickle.dumps(sim))
    sim.step(5)
    other.step(5)
    assert np.array_equal(sim.qpos, other.qpos)


def test_few_bodies_are_one_threads_work():
    scene = "gymnasium:half_cheetah"
    alone, shared = sc.Sim(scene), sc.Sim(scene, threads=3)
    for sim in (alone, shared):
        sim.step(100)
    assert np.array_equal(alone.qpos, shared.qpos)


@pytest.mark.parametrize("threads", [0, -1, 1.5, "two", None, 1025, float("nan")])
def test_other_numbers_of_threads_are_refused(heap, threads):
    with pytest.raises(ValueError, match=r"threads = .*must be"):
        sc.Sim(heap, threads=threads)
