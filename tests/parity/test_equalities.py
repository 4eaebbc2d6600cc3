"""Equalities against MuJoCo: each row's numbers, forces and steps, on drawn scenes too.

Law: J v, the target J v + dt a_ref, R, J M⁻¹ Jᵀ and the force of every row are MuJoCo's to 1e-9 at
a hundred random states, and so are accelerations and one step of every integrator that both have.
"""

import mujoco
import numpy as np
import peers
import pytest
from fallen import falls
from hypothesis import given, settings
from hypothesis import strategies as st

import stepcore as sc

TREES = """
<body name="a" pos="0 0 1"><freejoint/>
  <geom type="box" size=".1 .2 .15" pos=".1 0 .05"/><site name="s0" pos=".1 .2 0" euler="20 0 30"/>
  <body name="b" pos=".3 0 0"><joint name="j0" axis="1 2 3" pos=".05 .02 0" ref="10"/>
    <geom type="capsule" size=".05 .1" pos="0 .1 0" quat=".3 .4 .5 .6"/>
    <site name="s1" pos="0 .2 .05" euler="20 30 40"/></body></body>
<body name="c" pos="0 1 1" euler="0 20 0"><joint type="ball" pos="0 0 .1"/>
  <geom type="box" size=".1 .1 .3"/><site name="s2" pos=".1 0 .3" euler="0 0 30"/>
  <body name="d" pos="0 0 .3"><joint name="j1" type="slide" axis="0 1 1" ref=".1" armature=".1"/>
    <geom type="box" size=".1 .05 .1"/></body></body>
<body name="e" pos="-.5 .5 1"><joint name="j2" type="slide" axis="1 0 .3"/>
  <joint name="j3" axis="0 1 0"/><geom type="ellipsoid" size=".1 .06 .04" pos=".1 0 0"/>
  <site name="s3" pos=".2 0 .1"/></body>
<site name="s4" pos="0 .3 1" euler="10 20 30"/>
"""
BODIES, SITES, JOINTS = ("a", "b", "c", "d", "e", "world"), range(5), range(4)
SITE_OF = ("a", "b", "c", "e", "world")


def text(equalities):
    return f"""<mujoco><option timestep=".004"><flag contact="disable"/></option>
      <worldbody>{TREES}</worldbody><equality>{equalities}</equality></mujoco>"""


def both(equalities, **options):
    theirs = peers.strict(mujoco.MjModel.from_xml_string(text(equalities)), **options)
    return sc.Sim(sc.loads(text(equalities)), **peers.EXACT, **options), theirs


KINDS = {
    "weld": '<weld body1="b" body2="c" anchor=".1 .2 .3" torquescale=".4"/>',
    "weld relpose": '<weld body1="a" body2="e" relpose=".3 .1 -.2 .9 .1 -.3 .2"/>',
    "weld to the world": '<weld body1="e" anchor=".5 0 0" solref="-200 -10"/>',
    "weld sites": '<weld site1="s1" site2="s2" torquescale="3" solimp=".5 .9 .3 .4 3"/>',
    "connect sites": '<connect site1="s0" site2="s4" solimp=".5 .9 .3 .4 3"/>',
    "joints": '<joint joint1="j0" joint2="j1" polycoef=".1 .5 -.3 .2 .4" solimp=".5 .9 .3 .4 1"/>',
    "one joint": '<joint joint1="j3" polycoef=".2" solref=".05 .7"/>',
    "one body": '<joint joint1="j2" joint2="j3" polycoef="0 .3"/>',
}


def rows_apart(sim, data, model):
    """How far the numbers of all rows are apart, relative to the largest of their kind."""
    rows, dt = sim.rows, model.opt.timestep
    J = data.efc_J.reshape(data.nefc, model.nv)
    W = np.linalg.solve(peers.mass_matrix(model, data), J.T)
    pairs = {
        "velocity": (rows["velocity"], data.efc_vel),
        "target": (rows["target"], data.efc_vel + dt * data.efc_aref),
        "regulariser": (rows["regulariser"], data.efc_R),
        "force": (rows["force"], data.efc_force),
        "A": (sim.delassus(), J @ W),
    }
    return {name: peers.apart(ours, theirs) for name, (ours, theirs) in pairs.items()}


@pytest.mark.parametrize("kind", KINDS)
def test_rows(kind):
    sim, theirs = both(KINDS[kind])
    data, worst = mujoco.MjData(theirs), peers.Worst()
    for index, state in enumerate(falls(theirs, 100, 3, 0.2)):
        peers.note_forward(worst, index, sim, theirs, data, state)
        for name, value in rows_apart(sim, data, theirs).items():
            worst.note(name, value, index)
    names = ("velocity", "target", "regulariser", "force", "A")
    worst.check(peers.PLACED | peers.SOLVED | dict.fromkeys(names, 1e-9), kind)


@pytest.mark.parametrize("integrator", peers.INTEGRATORS)
def test_steps(integrator):
    sim, theirs = both("".join(KINDS.values()), integrator=integrator)
    data, worst = mujoco.MjData(theirs), peers.Worst()
    for index, state in enumerate(falls(theirs, 100, 4, 0.1)):
        peers.note_step(worst, index, sim, theirs, data, state)
    worst.check(peers.STEPPED, integrator)


def test_two_joints_of_one_body_are_each_tied():
    """Their chains of dofs start alike, and are two lists all the same."""
    ties = "".join(f'<joint joint1="j0" joint2="j{second}"/>' for second in (2, 3))
    sim, theirs = both(ties)
    data, worst = mujoco.MjData(theirs), peers.Worst()
    for index, state in enumerate(falls(theirs, 10, 4, 0.1)):
        peers.note_forward(worst, index, sim, theirs, data, state)
    worst.check(peers.PLACED | peers.SOLVED, ties)


numbers = st.floats(-0.5, 0.5).map(lambda x: round(x, 3))
softness = st.sampled_from(
    ["", 'solref=".05 .8"', 'solref="-300 -20"', 'solimp=".6 .95 .1 .3 2"', 'solimp=".9 .9"']
)


def words(values):
    return " ".join(str(value) for value in values)


@st.composite
def drawn(draw):
    """One equality between things that stand in different places."""
    soft, kind = draw(softness), draw(st.sampled_from(("connect", "weld", "joint")))
    if kind == "joint":
        one, two = draw(st.permutations(JOINTS))[:2]
        poly = words(draw(st.lists(numbers, min_size=1, max_size=5)))
        second = f'joint2="j{two}"' if draw(st.booleans()) else ""
        return f'<joint joint1="j{one}" {second} polycoef="{poly}" {soft}/>'
    scale = f'torquescale="{draw(st.floats(0, 3))}"' if kind == "weld" else ""
    if draw(st.booleans()):
        one, two = draw(st.permutations(SITES))[:2]
        return f'<{kind} site1="s{one}" site2="s{two}" {scale} {soft}/>'
    one, two = draw(st.permutations(BODIES))[:2]
    anchor = words(draw(st.tuples(numbers, numbers, numbers)))
    pose = ""
    if kind == "weld" and draw(st.booleans()):
        pose = f'relpose="{words(draw(st.tuples(*[numbers] * 3)))} 1 {draw(numbers)} .2 .1"'
    return f'<{kind} body1="{one}" body2="{two}" anchor="{anchor}" {pose} {scale} {soft}/>'


@settings(max_examples=40, deadline=None)
@given(equalities=st.lists(drawn(), min_size=1, max_size=3), seed=st.integers(0, 100))
def test_drawn_equalities(equalities, seed):
    """Rows that say the same twice leave forces open, which only their R decides: not drawn."""
    sim, theirs = both("".join(equalities))
    data, worst = mujoco.MjData(theirs), peers.Worst()
    for index, state in enumerate(falls(theirs, 4, seed, 0.1)):
        peers.note_forward(worst, index, sim, theirs, data, state)
        peers.note_step(worst, index, sim, theirs, data, state)
    limits = peers.PLACED | peers.STEPPED | dict.fromkeys(peers.SOLVED, 1e-8)
    worst.check(limits, text("".join(equalities)))
