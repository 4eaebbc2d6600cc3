"""Surfaces that move: belts and turntables, by closed forms and against MuJoCo."""

import mujoco
import numpy as np
import peers
import pytest
from covering import every_pair

import stepcore as sc

LAWS = ("solref", "lesson", "relaxed", "rigid", "penalty")
BELT = """<mujoco><option gravity="0 0 -10" timestep=".002"/><worldbody>
<body euler="0 0 30"><geom type="box" size="9 9 .1" pos="0 0 -.1" friction=".5" {0}/></body>
<body pos="{1} 0 .1"><freejoint/><geom type="box" size=".1 .1 .1" friction=".5"/></body>
</worldbody></mujoco>"""


def run(text: str, time: float, **settings) -> sc.Sim:
    sim = sc.Sim(sc.loads(text), **settings)
    sim.step(round(time / sim.model.settings.dt))
    return sim


@every_pair(cone=["pyramidal", "elliptic"], law=LAWS)
def test_a_box_is_taken_to_the_speed_of_its_belt_by_friction(law, cone):
    """μ g t until then, then the belt's own speed, along the belt: to 2 %."""
    text = BELT.format('surfacevel="1 0 3 0 0 0"', 0)
    along = np.array([np.cos(np.pi / 6), 0.5, 0.0])
    own = {"law": law, "cone": cone, "solver": "newton" if law == "solref" else "pgs"}
    own |= {"penalty_stiffness": 2e4} if law == "penalty" else {}
    early, late = (run(text, time, **own).qvel[:3] for time in (0.1, 0.6))
    # Askew to its edges a pyramid holds less under solref, and a box more under the others.
    low, high = (0.45, 0.52) if cone == "elliptic" else (0.36, 0.74)
    assert low <= early @ along <= high
    assert np.abs(late - along).max() < 0.02


def test_a_turntable_carries_a_box_round_with_it():
    """ω × r, and ω about the normal: to 2 %, for small ω² r."""
    text = BELT.format('surfacevel="0 0 0 0 0 .5"', 0.4)
    sim = run(text, 1.0, cone="elliptic", impratio=100)
    x, y = sim.qpos[:2]
    assert np.abs(sim.qvel[:2] - 0.5 * np.array([-y, x])).max() < 0.01
    assert abs(sim.qvel[5] - 0.5) < 0.01


def test_a_box_sticks_to_a_belt_as_it_would_to_a_body_that_moves():
    """With stiction a box that is held by a wall does not follow, and its anchor is no longer."""
    text = BELT.format('surfacevel="1 0 0 0 0 0"', 0)
    sim = run(text, 0.8, stiction=True)
    assert np.linalg.norm(sim.qvel[:2]) == pytest.approx(1.0, abs=1e-3)


@every_pair(of_class=[False, True], numbers=["1", ".5 1", ".5 1 2", "0 0 0 3", ".5 1 0 0 3"])
def test_of_fewer_numbers_the_rest_is_that_of_the_class(numbers, of_class):
    """Or zero."""
    own = '<default><geom surfacevel="9 8 7 6 5 4"/></default>' if of_class else ""
    text = BELT.format(f'surfacevel="{numbers}"', 0).replace("<worldbody>", own + "<worldbody>")
    theirs = mujoco.MjModel.from_xml_string(text)
    sim = sc.Sim(sc.loads(text), solver="newton", tolerance=0.0, sweeps=100)
    assert [
        list(geom.surfacevel) for geom in sc.loads(text).geoms
    ] == theirs.geom_surfacevel.tolist()
    theirs.opt.tolerance, theirs.opt.iterations = 0.0, 100
    data = mujoco.MjData(theirs)
    sim.qpos[2] = data.qpos[2] = 0.099
    sim.forward()
    mujoco.mj_forward(theirs, data)
    assert sim.qacc == pytest.approx(data.qacc, rel=1e-8, abs=1e-8)


MESH = '<mesh name="m" vertex="0 0 0 .4 0 0 0 .6 0 0 0 .3" refquat="1 .2 .3 .1"/>'
SHAPES = {
    "mesh": 'type="mesh" mesh="m"',
    "fitted": 'type="box" mesh="m"',
    "fromto": 'type="capsule" fromto="0 0 0 .3 .1 .05" size=".1"',
    "turned": 'type="ellipsoid" size=".2 .1 .15" euler="20 30 40" pos=".1 0 .05"',
}


@every_pair(cone=["pyramidal", "elliptic"], shape=SHAPES)
def test_the_frame_of_a_surface_is_that_of_its_geom_as_in_mujoco(shape, cone):
    """Acceleration and a step, to 1e-6: the contacts of convex shapes are found to that."""
    text = f"""<mujoco><compiler angle="degree"/><option cone="{cone}"/><asset>{MESH}</asset>
      <worldbody><geom type="plane" size="5 5 .1" surfacevel=".3 0 0 0 0 2"/>
      <body pos="0 0 .05"><freejoint/><geom {SHAPES[shape]} condim="4" friction="1 .1"
      surfacevel="1 2 3 4 5 6"/></body></worldbody></mujoco>"""
    model, sim = peers.strict(mujoco.MjModel.from_xml_string(text)), sc.Sim(sc.loads(text))
    sim = sc.Sim(sc.loads(text), **peers.EXACT)
    data = mujoco.MjData(model)
    data.qvel[:] = sim.qvel[:] = [0.3, 0.1, -0.5, 0.5, 0.2, 0.3]
    mujoco.mj_step(model, data)
    sim.step(1)
    assert data.ncon
    assert peers.apart(sim.qvel, data.qvel) < 1e-6


def test_who_moves_the_surface_is_named():
    scene = sc.loads(BELT.format('name="belt" surfacevel="1 0 0 0 0 0"', 0))
    assert "surfaces that move" in sc.plan(scene).text(1000, full=True)
    with pytest.raises(ValueError, match="surfacevel"):
        scene.geoms[0].surfacevel = (1, 2, 3, 4, 5, np.inf)


@every_pair(speed=[1, 5, 10, 30], cone=["pyramidal", "elliptic"], law=LAWS)
def test_the_work_of_a_belt_is_no_gained_energy(law, cone, speed):
    """What it puts in is the box's energy and as much heat, or more: no ledger finds a gain."""
    text = BELT.format(f'surfacevel="{speed} 0 0 0 0 {speed / 2}"', 0.3)
    own = {"law": law, "cone": cone, "solver": "newton" if law == "solref" else "pgs"}
    own |= {"penalty_stiffness": 2e4} if law == "penalty" else {}
    sim = run(text, 1.0, ledger=True, **own)
    assert sim.energy.kinetic > 0.3 * speed


@every_pair(
    axes=["001", "100 001"],
    surfacevel=["0 .5 0 0 0 0", "1 0 0 0 0 0"],
    cone=["pyramidal", "elliptic"],
)
def test_a_belt_asks_for_friction_where_nothing_moves(cone, surfacevel, axes):
    """Along tangents that no joint has its rows have a target, and so a share of the force."""
    joints = "".join(f'<joint type="slide" axis="{" ".join(axis)}"/>' for axis in axes.split())
    joints += '<joint axis="0 1 0"/>' if len(axes) > 3 else ""
    text = f"""<mujoco><option cone="{cone}"/><worldbody>
    <geom type="plane" size="1 1 1" surfacevel="{surfacevel}"/>
    <body pos="0 0 .09">{joints}<geom size=".1"/></body></worldbody></mujoco>"""
    theirs = peers.strict(mujoco.MjModel.from_xml_string(text))
    data, sim = mujoco.MjData(theirs), sc.Sim(sc.loads(text), **peers.EXACT)
    mujoco.mj_forward(theirs, data)
    sim.forward()
    assert abs(data.qacc[-1 if len(axes) == 3 else 1]) > 20
    assert np.abs(sim.qacc - data.qacc).max() < 1e-9 * np.abs(data.qacc).max()
