"""F16, a Kapla wall after SimBenchmark: six floors of nine posts and the eight planks on them,
each 0.05 by 0.2 by 0.1 m and of 10 kg, at 10 ms a step. Planks meet over the inner posts."""

import numpy as np
import pytest

import stepcore as sc

G, MASS, FLOORS = 9.81, 10.0, 6
THICK, LONG, WIDE = 0.05, 0.2, 0.1


def wall():
    """Centre and half sizes of every block."""
    post, plank = (0.5 * np.array(size) for size in ((THICK, WIDE, LONG), (LONG, WIDE, THICK)))
    inner = LONG * np.arange(1, 8)
    for floor in range(FLOORS):
        ground = floor * (LONG + THICK)
        for x in (THICK, *inner, 8 * LONG - THICK):
            yield (x, 0.0, ground + post[2]), post
        for index in range(8):
            yield ((index + 0.5) * LONG, 0.0, ground + LONG + plank[2]), plank


@pytest.mark.parametrize(
    ("settings", "still"),
    [
        ({}, 5e-3),
        ({"cone": "elliptic"}, 5e-3),
        ({"solver": "pgs", "sweeps": 1000, "tolerance": 1e-6, "acceleration": "momentum"}, 5e-2),
    ],
    ids=["newton", "elliptic", "pgs"],
)
def test_f16_a_kapla_wall_stands(settings, still):
    """The measure of F16 is when the top has sunk by a block's thickness. Twelve soft contacts give
    one after another, at once and no more later; planks slide by less than half the posts, and the
    floor bears all. (`rigid` needs sweeps until it is solved: 200 let the wall sway.)"""
    scene = sc.Scene(gravity=(0, 0, -G))
    scene.add_geom("world", "plane", (0, 0, 1), name="floor")
    start = np.array([place for place, _ in wall()])
    for index, (place, half) in enumerate(wall()):
        body = scene.add_body(f"block{index}", pos=place)
        scene.add_joint(body, "free")
        scene.add_geom(body, "box", half, mass=MASS)
    assert len(start) == 102
    sim = sc.Sim(scene, dt=0.01, **settings)
    sim.step(50)
    early = np.array(sim.qpos).reshape(-1, 7)[:, 2] - start[:, 2]
    sim.step(150)
    moved = np.array(sim.qpos).reshape(-1, 7)[:, :3] - start
    assert moved[:, 2].min() > -0.2 * THICK and moved[:, 2].max() < 0
    assert np.abs(moved[:, 2] - early).max() < 0.01 * THICK
    assert np.abs(moved[:, :2]).max() < 0.4 * THICK
    assert np.abs(sim.qvel).max() < still
    borne = sum(c["force"][2] for c in sim.contacts if c["name1"] == "floor")
    assert borne == pytest.approx(102 * MASS * G, rel=1e-2)
