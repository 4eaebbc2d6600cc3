"""Every row kind and shape pair against MuJoCo, under both cones, two impratios, three integrators.

Law: the same as for the models (`test_parity_models`). The scenes are in `zoo`.
"""

import copy

import mujoco
import peers
import pytest
import zoo
from covering import every_pair
from fallen import SCENES, both, states_of, strict

import stepcore as sc


def limits(name, usual):
    """The usual ones, or 1e-6 where MuJoCo's contacts are not exact. Its search ends at a distance
    of 1e-12 m, and so between bent surfaces at a direction of some 1e-6, by which forces go."""
    if name not in zoo.INEXACT:
        return usual
    return dict.fromkeys(usual, 1e-5 if name == "ellipsoid_ellipsoid" else 1e-6)


@pytest.mark.parametrize("name", SCENES)
def test_states_reach_rows(name):
    """The states of a scene reach the rows that the scene is there for."""
    entry = SCENES[name]
    theirs, states = strict(name), states_of(name)
    seen = peers.rows_seen(theirs, mujoco.MjData(theirs), states)
    for row in entry.rows:
        assert 4 * seen[row] >= len(states), f"{row} at {seen[row]} of {len(states)} states"
    if zoo.FRICTION in entry.rows:
        assert 4 * min(seen["slips"], seen["sticks"]) >= len(states), "saturated and not"


@every_pair(cone=peers.CONES, impratio=(1.0, 10.0), name=SCENES)
def test_forward(name, cone, impratio):
    sim, theirs, data, states = both(name, cone=cone, impratio=impratio)
    worst = peers.Worst()
    for index, state in enumerate(states):
        peers.note_forward(worst, index, sim, theirs, data, state)
    worst.check(limits(name, peers.PLACED | peers.SOLVED), f"{name} {cone} {impratio}")


@every_pair(cone=peers.CONES, integrator=peers.INTEGRATORS, name=SCENES)
def test_step(name, integrator, cone):
    sim, theirs, data, states = both(name, integrator=integrator, cone=cone)
    worst = peers.Worst()
    for index, state in enumerate(states):
        peers.note_step(worst, index, sim, theirs, data, state)
    worst.check(limits(name, peers.STEPPED), f"{name} {integrator} {cone}")


@every_pair(name=("all_together", "solmix_priority", "connect", "free_offset"), dt=(0.0005, 0.02))
def test_other_dt(name, dt):
    """Softness is tied to dt (a time constant below 2 dt is raised to it), and so is damping."""
    for integrator in peers.INTEGRATORS:
        sim, theirs, data, states = both(name, integrator=integrator, dt=dt)
        theirs.opt.timestep = dt
        worst = peers.Worst()
        for index, state in enumerate(states[:16]):
            peers.note_step(worst, index, sim, theirs, data, state)
        worst.check(peers.STEPPED, f"{name} {integrator} dt {dt}")


@every_pair(spin=(1e-7, 1.0, 40.0, 200.0), integrator=peers.INTEGRATORS)
def test_fast_spin(integrator, spin):
    """Free and ball joints at any turn per step: rk4's correction is exact, not a series."""
    sim, theirs, data, states = both("ball_joints", integrator=integrator)
    free, free_theirs, free_data, free_states = both("free_offset", integrator=integrator)
    worst = peers.Worst()
    for index, (state, other) in enumerate(zip(states[:8], free_states[:8], strict=True)):
        state, other = copy.deepcopy((state, other))
        state.qvel[:3] *= spin
        other.qvel[3:6] *= spin
        peers.note_step(worst, index, sim, theirs, data, state)
        peers.note_step(worst, index, free, free_theirs, free_data, other)
    worst.check(peers.STEPPED, f"{integrator} spin {spin}")


@pytest.mark.parametrize(
    "flag",
    (
        "gravity",
        "contact",
        "limit",
        "frictionloss",
        "equality",
        "spring",
        "damper",
        "actuation",
        "clampctrl",
        "filterparent",
        "constraint",
        "eulerdamp",
        "refsafe",
    ),
)
def test_flags(flag):
    """Each flag of `<option>` switches off the same thing in both engines."""
    text = zoo.ZOO["all_together"].text.replace(
        "<worldbody>", f'<option><flag {flag}="disable"/></option><worldbody>', 1
    )
    theirs = peers.strict(mujoco.MjModel.from_xml_string(text))
    data = mujoco.MjData(theirs)
    sim = sc.Sim(sc.loads(text).compile(), **peers.EXACT)
    worst = peers.Worst()
    for index, state in enumerate(states_of("all_together")[:12]):
        peers.note_forward(worst, index, sim, theirs, data, state)
        peers.note_step(worst, index, sim, theirs, data, state)
    worst.check(peers.PLACED | peers.SOLVED | peers.STEPPED, flag)
