"""`Model.touches`: a step's test of two geoms, at poses that are asked for."""

import numpy as np
import pytest

import stepcore as sc


def two(first, size1, second, size2):
    scene = sc.Scene()
    for name, kind, size in (("a", first, size1), ("b", second, size2)):
        body = scene.add_body(name)
        scene.add_joint(body, "free")
        scene.add_geom(body, kind, size, name=name, mass=1.0)
    return scene.compile()


@pytest.fixture(scope="module")
def capsules():
    return two("capsule", (0.1, 0.3), "capsule", (0.2, 0.2))


@pytest.fixture(scope="module")
def qpos():
    rng = np.random.default_rng(1)
    qpos = rng.normal(size=(101, 14))
    qpos[:, [0, 1, 2, 7, 8, 9]] *= 0.3
    return qpos


def test_it_is_what_a_step_finds(capsules, qpos):
    """At every pose: the contacts that a Sim lists there."""
    touches = capsules.touches("a", "b", qpos)
    sim = sc.Sim(capsules)
    overlaps = 0
    for k, q in enumerate(qpos):
        sim.qpos[:] = q
        sim.forward()
        listed = touches.exists[k] & (touches.dist[k] < 0)
        overlaps += listed.any()
        assert [c["dist"] for c in sim.contacts] == touches.dist[k][listed].tolist()
        for ours, theirs in ((touches.pos, "pos"), (touches.normal, "normal")):
            assert np.array_equal([c[theirs] for c in sim.contacts], ours[k][listed].tolist())
    assert overlaps > 10


def test_lanes_are_scalars_and_f32_is_near(capsules, qpos):
    alone = capsules.touches("a", "b", qpos)
    for one, other in zip(alone, capsules.touches("a", "b", qpos, lanes=True), strict=True):
        assert np.array_equal(one, other)
    short = capsules.touches("a", "b", qpos, precision="f32")
    assert np.abs(short.dist - alone.dist)[:, 0].max() < 1e-5


def test_the_other_order_turns_the_normal(qpos):
    model = two("sphere", 0.2, "capsule", (0.2, 0.2))
    one, other = model.touches(0, 1, qpos), model.touches("b", "a", qpos)
    assert np.array_equal(one.dist, other.dist)
    assert np.array_equal(one.normal, -other.normal)


def test_shapes_follow_those_of_qpos(capsules, qpos):
    assert capsules.touches(0, 1, qpos[0]).dist.shape == (2,)
    assert capsules.touches(0, 1, qpos[:0]).pos.shape == (0, 2, 3)
    assert capsules.touches(0, 1, qpos[:100].reshape(4, 25, 14)).normal.shape == (4, 25, 2, 3)


@pytest.mark.parametrize(
    ("given", "text"),
    [
        ({"geom1": "c"}, r'no geom is named "c"; known: "a", "b"'),
        ({"geom2": 2}, "geom = 2: must be the name of a geom or an index below 2"),
        ({"geom2": -3}, "geom = -3: must be"),
        ({"qpos": np.zeros(13)}, r"qpos has shape \(13,\): must be \(…, 14\)"),
        ({"qpos": np.full(14, np.nan)}, "qpos has entries that are not finite"),
        ({"precision": "f16"}, "precision = 'f16': must be 'f64' or 'f32'"),
    ],
)
def test_bad_input_is_refused(capsules, given, text):
    with pytest.raises(ValueError, match=text):
        capsules.touches(**({"geom1": "a", "geom2": "b", "qpos": np.zeros(14)} | given))
