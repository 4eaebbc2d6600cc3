"""Height fields against the oracle: the nearest of the prisms under their triangles."""

import mujoco
import numpy as np
import peers
import pytest
from contact_oracle.convex import Convex, Posed
from contact_oracle.poses import quaternions, rotation, shape
from contact_oracle.search import search
from covering import every_value

import stepcore as sc

HALF, TALL, BASE = (1.0, 0.8), 0.4, 0.2
KINDS = ("sphere", "capsule", "ellipsoid", "cylinder", "box", "mesh")


def field(heights):
    """A field of these heights from 0 to 1, and a free geom over it."""
    nrow, ncol = heights.shape
    # MJCF lists rows from the top: from the largest y down.
    listed = " ".join(map(repr, heights[::-1].ravel().tolist()))
    return (
        f'<hfield name="land" nrow="{nrow}" ncol="{ncol}" size="{HALF[0]} {HALF[1]} {TALL} {BASE}" '
        f'elevation="{listed}"/>'
    )


def compiled(heights, one):
    mesh, geom = "", f'type="{one.kind}" size="{" ".join(map(repr, one.size))}"'
    if one.kind == "mesh":
        listed = " ".join(map(repr, one.vertices.ravel().tolist()))
        mesh, geom = f'<mesh name="b" vertex="{listed}"/>', 'type="mesh" mesh="b"'
    return sc.loads(
        f"<mujoco><asset>{field(heights)}{mesh}</asset><worldbody>"
        '<geom name="a" type="hfield" hfield="land"/><body><freejoint/>'
        '<inertial pos="0 0 0" mass="1" diaginertia="1 1 1"/>'
        f'<geom name="b" {geom}/></body></worldbody></mujoco>'
    ).compile()


def prisms(heights):
    """Two under each cell; the diagonal goes from its corner of least x and y."""
    nrow, ncol = heights.shape
    x, y = np.linspace(-HALF[0], HALF[0], ncol), np.linspace(-HALF[1], HALF[1], nrow)
    for row in range(nrow - 1):
        for col in range(ncol - 1):
            low, high = (row, col), (row + 1, col + 1)
            for third in ((row + 1, col), (row, col + 1)):
                top = [(x[c], y[r], TALL * heights[r, c]) for r, c in (low, third, high)]
                yield Convex("mesh", vertices=np.array(top + [(*p[:2], -BASE) for p in top]))


def deepest(touches):
    return np.where(touches.exists, touches.dist, np.inf).min(axis=-1)


def land(name, rng):
    """Heights from 0 to 1, as MuJoCo keeps them."""
    heights = rng.uniform(0, 1, (4, 5))
    if name == "cliffs":
        heights = np.where(heights > 0.5, 1.0, 0.0)
    heights.ravel()[:2] = 0, 1
    return np.float64(np.float32(heights))


@every_value(kind=KINDS, name=["hills", "cliffs"])
def test_distances_to_the_land(kind, name):
    """Over it, beside it and in it: apart, the least distance of all prisms, however far; else an
    overlap, be it in a pit with all ways out through other prisms."""
    rng = np.random.default_rng(37)
    heights = land(name, rng)
    one = shape(rng, kind, "generic", 0.2)
    n = 60
    turn = quaternions(rng, n)
    pos = rng.uniform(-1.3, 1.3, (n, 3)) * (*HALF, 0)
    pos[:, 2] = rng.uniform(0, TALL + 0.4, n)
    found = compiled(heights, one).touches("a", "b", np.concatenate([pos, turn], axis=1))
    dist = np.min(
        [search(Posed(p, one, pos, rotation(turn))).dist for p in prisms(heights)], axis=0
    )
    apart = dist > 1e-9
    assert 10 < apart.sum() < 50
    assert np.abs(deepest(found) - dist)[apart].max() < 1e-9
    assert deepest(found)[dist < -1e-9].max() < 0


@pytest.mark.parametrize("margin", [0.02, 0.1, 0.3])
def test_a_margin_wider_than_the_shape_reaches_a_cliff(margin):
    """A small ball beside a wall of one cell, 0.5 m high: MuJoCo's nearest contact, or none."""
    elevation = " ".join(["0 " * 11 + "1 " * 10] * 21)
    text = (
        '<mujoco><asset><hfield name="h" nrow="21" ncol="21" size="1 1 .5 .2" '
        f'elevation="{elevation}"/></asset><worldbody><geom type="hfield" hfield="h"/>'
        f'<body pos="-.02 .013 .2"><freejoint/><geom size=".01" margin="{margin}"/></body>'
        "</worldbody></mujoco>"
    )
    model = peers.strict(mujoco.MjModel.from_xml_string(text))
    data, sim = mujoco.MjData(model), sc.Sim(sc.loads(text))
    mujoco.mj_forward(model, data)
    sim.forward()
    theirs, ours = data.contact.dist, sim.contacts["dist"]
    assert bool(len(theirs)) == bool(len(ours)) == (margin > 0.05)
    if len(theirs):
        assert ours.min() == pytest.approx(theirs.min(), abs=1e-9)


@pytest.mark.parametrize("kind", KINDS)
def test_a_flat_field_is_a_plane(kind):
    """Shapes on it, not over its rim: the distance and the normal are a plane's."""
    rng = np.random.default_rng(41)
    one = shape(rng, kind, "generic", 0.2)
    heights = np.ones((4, 5))
    heights[0, 0] = 0  # MuJoCo scales heights by their range; only that corner is not flat
    n = 60
    turn = quaternions(rng, n)
    pos = rng.uniform(-0.3, 0.7, (n, 3)) * (*HALF, 0)
    down = np.broadcast_to([0, 0, -1.0], (n, 1, 3)) @ rotation(turn)
    overlap = rng.uniform(-0.05, 0.05, n)
    pos[:, 2] = TALL + one.height(down)[:, 0] - overlap
    found = compiled(heights, one).touches("a", "b", np.concatenate([pos, turn], axis=1))
    assert np.abs(deepest(found) + overlap).max() < 1e-9
    assert np.abs(found.normal[found.exists] - (0, 0, 1)).max() < 1e-7


CUBE = " ".join(f"{x} {y} {z}" for x in (-0.1, 0.1) for y in (-0.1, 0.1) for z in (-0.1, 0.1))
RESTS = {"box": 'type="box" size=".1 .1 .1"', "mesh": 'type="mesh" mesh="cube"'}
RESTS["cylinder"] = 'type="cylinder" size=".1 .1"'


def on_flat_cells(geom, cell, pos, quat):
    """A free body over a flat field of cells of this size [m]."""
    nodes = int(3 / cell) + 2
    half = cell * (nodes - 1) / 2
    return sc.Sim(
        sc.loads(
            f'<mujoco><asset><hfield name="f" nrow="{nodes}" ncol="{nodes}" '
            f'size="{half} {half} 1 .2" elevation="{"0 " * nodes**2}"/>'
            f'<mesh name="cube" vertex="{CUBE}"/></asset><worldbody>'
            f'<geom type="hfield" hfield="f"/><body pos="{pos}" quat="{quat}"><freejoint/>'
            f'<geom {geom} density="500"/></body></worldbody></mujoco>'
        )
    )


@every_value(kind=RESTS, cell=[0.05, 0.1, 0.25, 0.7])
def test_a_body_comes_to_rest_on_many_cells(kind, cell):
    """Its base lies on several prisms, each of which holds it where it is over it."""
    for quat in ("1 0 0 0", "1 0.3 0.2 0.1"):
        sim = on_flat_cells(RESTS[kind], cell, "0.03 0.04 0.15", quat)
        sim.step(2000)
        assert sim.qpos[2] == pytest.approx(0.1, abs=1e-3)
        for _ in range(20):
            sim.step(25)
            assert np.abs(sim.qvel).max() < 2e-3


@pytest.mark.parametrize("cell", [0.05, 0.1, 0.25])
def test_a_box_hardly_tilted_touches_with_every_corner(cell):
    sim = on_flat_cells(RESTS["box"], cell, "0.03 0.04 0.0999", "1 1e-5 -2e-5 0.1")
    sim.forward()
    corners = np.array([[x, y, -0.1] for x in (-0.1, 0.1) for y in (-0.1, 0.1)])
    corners = corners @ sim.geom_xmat[1].T + sim.geom_xpos[1]
    for corner in corners:
        apart = np.linalg.norm(sim.contacts["pos"][:, :2] - corner[:2], axis=1)
        assert apart.min() < 1e-6
        assert sim.contacts["dist"][apart.argmin()] == pytest.approx(corner[2], abs=1e-12)
