"""A mesh of a box behaves as the box; a flat height field as a plane."""

import numpy as np
import pytest

import stepcore as sc

SIGNS = [(x, y, z) for x in (-1, 1) for y in (-1, 1) for z in (-1, 1)]


def _sim(assets, floor, body, **settings):
    text = f"""<mujoco><option timestep=".002" cone="elliptic"/><asset>{assets}</asset>
      <worldbody>{floor}<body pos="0 0 .1">{body}</body></worldbody></mujoco>"""
    return sc.Sim(sc.loads(text).compile(), solver="newton", **settings)


def _cube(name, half):
    """A cube's mesh: halves of powers of two keep its inertia exact."""
    vertices = " ".join(str(half * x) for sign in SIGNS for x in sign)
    return f'<mesh name="{name}" vertex="{vertices}"/>'


@pytest.mark.parametrize("turn", [(1, 0, 0, 0), (0.9, 0, 0, 0.4), (0.99, 0.01, 0.02, 0.1)])
def test_a_mesh_of_a_box_has_its_forces(turn):
    """Against another box, both shapes of which may be meshes: the same contacts and forces."""
    assets = _cube("small", 0.125) + _cube("large", 0.5)
    floors = [
        '<geom type="box" size=".5 .5 .5" pos="0 0 -.5"/>',
        '<geom type="mesh" mesh="large" pos="0 0 -.5"/>',
    ]
    bodies = [
        '<freejoint/><geom type="box" size=".125 .125 .125" mass="2"/>',
        '<freejoint/><geom type="mesh" mesh="small" mass="2"/>',
    ]
    turn = np.array(turn) / np.linalg.norm(turn)
    found = []
    for floor, body in ((0, 1), (1, 1)):
        sim = _sim(assets, floors[floor], bodies[body])
        sim.qpos[:] = [0.03, -0.02, 0.1245, *turn]
        sim.qvel[:] = [0.1, -0.2, -0.1, 0.3, 0.1, 0.2]
        sim.forward()
        assert len(sim.contacts) > 0
        found.append(sim.qacc.copy())
    assert np.abs(found[0] - found[1]).max() < 1e-9 * np.abs(found[0]).max()


def test_a_mesh_stands_on_a_mesh():
    assets = _cube("small", 0.125) + _cube("large", 0.5)
    floor = '<geom type="mesh" mesh="large" pos="0 0 -.5"/>'
    sim = _sim(assets, floor, '<freejoint/><geom type="mesh" mesh="small"/>')
    sim.qpos[2] = 0.125
    sim.step(500)
    assert len(sim.contacts) == 4
    assert np.abs(sim.qvel).max() < 1e-9


@pytest.mark.parametrize(
    "shape",
    [
        'type="sphere" size=".1"',
        'type="capsule" size=".05 .1" euler="80 0 0"',
        'type="ellipsoid" size=".1 .08 .15"',
        'type="cylinder" size=".1 .08" euler="30 0 0"',
        'type="box" size=".1 .08 .15" euler="20 30 0"',
    ],
)
def test_a_flat_field_is_a_plane(shape):
    """The deepest contact of a convex shape that is not level: where and how deep as on a plane."""
    field = '<hfield name="flat" nrow="4" ncol="4" size="1 1 .5 .2" elevation="{}"/>'
    level = field.format(" ".join(["0"] * 16))
    deepest = []
    for floor in ('<geom type="plane" size="1 1 1"/>', '<geom type="hfield" hfield="flat"/>'):
        sim = _sim(level, floor, f"<freejoint/><geom {shape}/>")
        sim.qpos[:3] = 0.04, 0.11, 0.06
        sim.forward()
        contact = min(sim.contacts, key=lambda contact: contact["dist"])
        deepest.append((contact["dist"], *contact["pos"], *contact["normal"]))
    assert np.abs(np.subtract(*deepest)).max() < 1e-12
