"""Meshes on planes: a block of vertices is a box; what rests keeps its weight."""

from __future__ import annotations

import mujoco
import numpy as np
import pytest

import stepcore as sc

HALF = (0.2, 0.15, 0.1)
CORNERS = [[x, y, z] for x in (-0.2, 0.2) for y in (-0.15, 0.15) for z in (-0.1, 0.1)]
GRAVITY = 9.81


def scene(kind: str) -> sc.Scene:
    scene = sc.Scene()
    body = scene.add_body("block", pos=(0.1, 0.05, 0.1))
    scene.add_joint(body, "free")
    if kind == "mesh":
        scene.add_geom(body, "mesh", mesh=scene.add_mesh("m", CORNERS))
    elif kind == "pillar":
        angles = 2 * np.pi * np.arange(60) / 60
        ring = np.column_stack([0.2 * np.cos(angles), 0.2 * np.sin(angles)])
        ends = [np.column_stack([ring, np.full(60, z)]) for z in (-0.1, 0.1)]
        scene.add_geom(body, "mesh", mesh=scene.add_mesh("m", np.concatenate(ends)))
    else:
        scene.add_geom(body, "box", HALF)
    scene.add_geom("world", "plane")
    return scene


@pytest.mark.parametrize("settings", [{}, {"solver": "pgs"}, {"law": "rigid", "solver": "pgs"}])
def test_a_block_of_vertices_moves_as_a_box(settings):
    """Dropped askew: the same corners are below the plane, so the same forces act."""
    ends = []
    for kind in ("mesh", "box"):
        sim = sc.Sim(scene(kind).compile(), sweeps=200, tolerance=0.0, **settings)
        sim.qpos[2] = 0.3
        sim.qpos[3:7] = np.array([9, 3, 2, 1]) / np.sqrt(95)
        if kind == "mesh":
            # The mesh's frame has its greatest moment about x; the body's frame is the file's.
            assert sim.geom_xpos[1] == pytest.approx(sim.xpos[1], abs=1e-12)
        path = []
        for _ in range(25):
            sim.step(10)
            path.append(sim.qpos.copy())
        ends.append(np.array(path))
    # Sweeps end where a row's order still shows.
    near = 2e-6 if "law" in settings else 1e-7
    assert ends[0] == pytest.approx(ends[1], abs=near)


@pytest.mark.parametrize("kind", ["mesh", "pillar"])
@pytest.mark.parametrize(
    "settings", [{}, {"law": "rigid", "solver": "pgs"}, {"law": "lesson", "solver": "pgs"}]
)
def test_what_rests_keeps_its_place_and_weight(kind, settings):
    model = scene(kind).compile()
    sim = sc.Sim(model, **settings)
    sim.step(1000)
    assert np.abs(sim.qvel).max() < 1e-4
    assert sim.qpos[:2] == pytest.approx([0.1, 0.05], abs=1e-4)
    contacts = sim.contacts
    assert len(contacts) == 4
    weight = model.body_mass[1] * GRAVITY
    assert contacts["force"][:, 2].sum() == pytest.approx(weight, rel=1e-3)


@pytest.mark.parametrize("degrees", [0, 22.5, 37, 45, 90])
def test_a_pillar_on_four_of_its_corners_tips_as_all_of_them_do(degrees):
    """A push at the height h of four radii: it stands at 0.85 of m g r/h and falls at 1.1."""
    turn = np.radians(degrees)
    tilts = []
    for share in (0.85, 1.1):
        sim = sc.Sim(scene("pillar").compile(), dt=0.001)
        sim.step(100)
        push = share * sim.model.body_mass[1] * GRAVITY / 4
        way = push * np.array([np.cos(turn), np.sin(turn)])
        # At the centre, and the torque of the rest of its height.
        sim.xfrc_applied[1] = [*way, 0, -0.7 * way[1], 0.7 * way[0], 0]
        sim.step(1500)
        tilts.append(np.hypot(*sim.qpos[4:6]))
    assert tilts[0] < 0.02 and tilts[1] > 0.1


def test_a_tumbling_mesh_ends_where_mujocos_does():
    """Random points dropped on a plane: 1 s of bounces and a rest on three vertices."""
    points = np.random.default_rng(3).normal(size=(60, 3)).astype(np.float32).astype(float)
    numbers = " ".join(repr(float(x)) for x in points.ravel())
    text = f"""<mujoco><option tolerance="0" iterations="200"/><asset>
    <mesh name="m" vertex="{numbers}"/></asset><worldbody><geom type="plane" size="1 1 1"/>
    <body pos="0 0 3"><freejoint/><geom type="mesh" mesh="m"/></body></worldbody></mujoco>"""
    theirs = mujoco.MjModel.from_xml_string(text)
    data = mujoco.MjData(theirs)
    mujoco.mj_step(theirs, data, 1500)
    sim = sc.Sim(sc.loads(text).compile())
    sim.step(1500)
    assert sim.qpos == pytest.approx(data.qpos, abs=1e-6)
