"""Two roofs, one upside down, that touch where their ridges cross.

A ridge of three corners in one line, as of a mesh in single precision, has no edge of its own:
the corner that a search sees first may be any of them, and the contact lies at none.
"""

import numpy as np
import pytest

import stepcore as sc

DEPTH = 0.002


def roof(rng: np.random.Generator) -> np.ndarray:
    """A ridge along x at height 0, whose corners are in one line but for rounding."""
    along = np.array([-0.1, rng.uniform(-0.1, 0.1), 0.1])
    ridge = np.c_[along, [0, rng.uniform(-1e-7, 1e-7), 0], rng.uniform(-1e-10, 1e-10, 3)]
    base = [[x, y, -0.03] for x in (-0.1, 0.1) for y in (-0.02, 0.02)]
    return np.r_[ridge, base]


@pytest.mark.parametrize("seed", range(40))
def test_the_contact_is_where_ridges_cross(seed):
    rng = np.random.default_rng(seed)
    one, two, turn = roof(rng), roof(rng), rng.uniform(0.1, 0.6)
    at, there = rng.uniform(-0.09, 0.09, 2)
    cos, sin = np.cos(turn), np.sin(turn)
    turned = (two * [1, -1, -1]) @ np.array([[cos, -sin, 0], [sin, cos, 0], [0, 0, 1]]).T
    turned += [at - there * cos, -there * sin, -DEPTH]
    meshes = "".join(
        f'<mesh name="{name}" vertex="{" ".join(map(repr, corners.ravel().tolist()))}"/>'
        for name, corners in (("one", one), ("two", turned))
    )
    sim = sc.Sim(
        sc.loads(f"""<mujoco><asset>{meshes}</asset><worldbody><geom type="mesh" mesh="one"/>
<body><freejoint/><geom type="mesh" mesh="two"/></body></worldbody></mujoco>""").compile()
    )
    sim.forward()
    assert len(sim.contacts)
    for contact in sim.contacts:
        assert contact["dist"] == pytest.approx(-DEPTH, abs=1e-9)
        assert contact["pos"] == pytest.approx([at, 0, -DEPTH / 2], abs=1e-5)
