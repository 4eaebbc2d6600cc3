"""Nine gymnasium models against MuJoCo: 200 states each, every stage of the loop.

Law: same model, same state, same numbers. Poses, mass matrix and smooth forces
to 1e-10 of the largest entry; contact sets equal; constraint forces, qacc and
one step of every shared integrator to 1e-9.
"""

import mujoco
import peers
import pytest
from fallen import both, shipped, states_of, strict

import stepcore as sc

STATES = 200


@pytest.mark.parametrize("name", peers.GYM)
def test_shape(name):
    """Sizes, initial configuration and the file's options are MuJoCo's."""
    theirs = shipped(name)
    scene = sc.load(peers.gym_path(name))
    ours = scene.compile()
    for size in ("nq", "nv", "nu", "nbody", "ngeom"):
        assert getattr(ours, size) == getattr(theirs, size), size
    assert sc.Sim(ours).qpos == pytest.approx(theirs.qpos0, abs=1e-14)
    assert scene.settings.dt == theirs.opt.timestep
    assert scene.settings.integrator == peers.shipped_integrator(theirs)


@pytest.mark.parametrize("name", peers.GYM)
def test_states_reach_rows(name):
    """A good share of the states has an active limit or contact: the other tests see them."""
    theirs = strict(name)
    seen = peers.rows_seen(theirs, mujoco.MjData(theirs), states_of(name, STATES))
    assert seen["limit"] >= 0.05 * STATES
    if name in ("hopper", "walker2d", "half_cheetah", "ant"):
        assert seen["contact"] >= 0.25 * STATES


@pytest.mark.parametrize("name", peers.GYM)
def test_forward(name):
    sim, theirs, data, states = both(name, STATES)
    worst = peers.Worst()
    for index, state in enumerate(states):
        peers.note_forward(worst, index, sim, theirs, data, state)
    worst.check(peers.PLACED | peers.SOLVED, name)


@pytest.mark.parametrize("integrator", peers.INTEGRATORS)
@pytest.mark.parametrize("name", peers.GYM)
def test_step(name, integrator):
    sim, theirs, data, states = both(name, STATES, integrator=integrator)
    worst = peers.Worst()
    for index, state in enumerate(states):
        peers.note_step(worst, index, sim, theirs, data, state)
    worst.check(peers.STEPPED, f"{name} {integrator}")


@pytest.mark.parametrize("name", ("half_cheetah", "ant"))
@pytest.mark.parametrize(
    ("cone", "impratio"), (("elliptic", 1.0), ("elliptic", 10.0), ("pyramidal", 10.0))
)
def test_other_cones(name, cone, impratio):
    """The same states under cones that the files do not ask for."""
    sim, theirs, data, states = both(name, 100, cone=cone, impratio=impratio)
    worst = peers.Worst()
    for index, state in enumerate(states):
        peers.note_forward(worst, index, sim, theirs, data, state)
    worst.check(peers.PLACED | peers.SOLVED, f"{name} {cone} {impratio}")


@pytest.mark.parametrize("name", peers.GYM)
def test_residual_is_at_rounding(name):
    """Newton's own figure agrees: the rows are solved to far below a nanometre a second."""
    sim, _, _, states = both(name, 40)
    for state in states:
        state.to_stepcore(sim)
        sim.forward()
        assert sim.residual < 1e-10
