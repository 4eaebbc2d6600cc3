"""Terrain: its heights against closed forms, its contacts against its heights."""

import numpy as np
import pytest

import stepcore as sc

KINDS = ("stairs", "pit", "slope", "bowl", "rough", "flat")
TILE, TREAD, CELL = 6.0, 0.5, 0.1


@pytest.fixture(scope="module")
def ground():
    return sc.terrain(
        KINDS, levels=3, tile=TILE, cell=CELL, step=(0.1, 0.2), tread=TREAD, grade=(0.1, 0.3)
    )


def closed_form(kind, level, inside):
    """The height at a distance from the edge of a tile."""
    inside = np.minimum(inside, TILE / 2 - 1.0)
    steps = (0.1 + 0.05 * level) * np.floor(inside / TREAD)
    ramp = (0.1 + 0.1 * level) * inside
    return {"stairs": steps, "pit": -steps, "slope": ramp, "bowl": -ramp, "flat": 0 * inside}[kind]


def test_heights_are_those_of_closed_forms(ground):
    """Along both axes of each tile, at the middle of treads, where no riser is."""
    inside = np.arange(0.25, TILE / 2, TREAD)
    for level in range(3):
        for column, kind in enumerate(KINDS):
            if kind == "rough":
                continue
            x, y, z = ground.origins[level, column]
            expected = closed_form(kind, level, inside)
            way = TILE / 2 - inside
            for side in (-1, 1):
                np.testing.assert_allclose(ground.height(x + side * way, y), expected, atol=1e-12)
                np.testing.assert_allclose(ground.height(x, y + side * way), expected, atol=1e-12)
            assert z == pytest.approx(closed_form(kind, level, TILE / 2), abs=1e-12)


def test_rough_ground_has_its_range_and_a_level_middle(ground):
    for level, most in enumerate((0.01, 0.055, 0.1)):
        x, y, z = ground.origins[level, KINDS.index("rough")]
        at = np.linspace(-TILE / 2, TILE / 2, 61)
        heights = ground.height(x + at[:, None], y + at[None])
        assert 0.9 * most < np.abs(heights).max() <= most
        assert z == 0 and not heights[20:41, 20:41].any() and not heights[0].any()


@pytest.mark.parametrize("kind", ["stairs", "pit"])
def test_a_ball_rests_on_a_step(ground, kind):
    scene = sc.Scene()
    ground.add_to(scene)
    body = scene.add_body("ball", pos=(0, 0, 0))
    scene.add_joint(body, "free")
    scene.add_geom(body, "sphere", 0.05, mass=1.0)
    sim = sc.Sim(scene, dt=0.001)
    x, y, _ = ground.origins[2, KINDS.index(kind)]
    # Half way to the edge, 10 cm inside a tread, so that the riser is not touched.
    place = x - TILE / 2 + 1.25
    sim.qpos[:3] = place, y + 0.03, ground.height(place, y) + 0.05
    sim.step(1000)
    # MuJoCo's soft contact sinks in by some 0.1 mm under 9.81 N.
    assert sim.qpos[2] == pytest.approx(ground.height(place, y) + 0.05, abs=1e-3)
    assert sim.qpos[:2] == pytest.approx([place, y + 0.03], abs=1e-6)
    assert np.abs(sim.qvel).max() < 1e-6


def test_contacts_are_at_the_heights(ground):
    """A small ball that is moved over all tiles touches the surface that `height` returns."""
    scene = sc.Scene(gravity=(0, 0, 0))
    ground.add_to(scene)
    body = scene.add_body("ball", pos=(0, 0, 0))
    scene.add_joint(body, "free")
    scene.add_geom(body, "sphere", 0.002, mass=1.0)
    sim = sc.Sim(scene)
    rng = np.random.default_rng(0)
    most = (np.array(ground.elevation.shape) - 1) * CELL / 2
    checked = 0
    while checked < 50:
        x, y = rng.uniform(-most, most)
        near = ground.height(
            x + np.array([0, 0.01, -0.01, 0, 0]), y + np.array([0, 0, 0, 0.01, -0.01])
        )
        if np.ptp(near) > 0.004:
            continue
        for above, count in ((0.0015, 1), (0.0030, 0)):
            sim.qpos[:3] = x, y, near[0] + above
            sim.forward()
            assert (len(sim.contacts) > 0) == bool(count), (x, y, above)
        checked += 1


def test_what_is_no_terrain_is_refused():
    with pytest.raises(ValueError, match=r'no kind "stair"; nearest: "stairs"'):
        sc.terrain(("stair",))
    with pytest.raises(ValueError, match=r"tread = 0\.25 m: must be a multiple of cell = 0\.1 m"):
        sc.terrain(tread=0.25)
    with pytest.raises(ValueError, match=r"tile = 2\.0 m: must be > 2 m"):
        sc.terrain(tile=2.0)
