"""Momentum against MuJoCo's own accelerated PGS: after 20 and 100 cold sweeps no worse a residual.

Both start from zero impulses and run every sweep. One function measures both problems: the natural
map δ = λ − proj(λ − w/s) of every row, as the speed max |δ| √(A/m).
"""

import functools

import mujoco
import numpy as np
import peers
import pytest
import zoo
from covering import every_pair

import stepcore as sc

SWEEPS = (20, 100)
# Least rows of a state that counts.
LEAST = {"ant": 7, "capsules27": 60, "marbles": 60}
STATES = 20
# Where both have solved a state to the last digit, nobody is worse [m/s].
FLOOR = 1e-13


def both(name):
    """The scene in both engines."""
    if name == "ant":
        path = peers.gym_path(name)
        model, theirs = sc.load(path).compile(), mujoco.MjModel.from_xml_path(path)
    else:
        text = zoo.ZOO[name].text
        model, theirs = sc.loads(text).compile(), mujoco.MjModel.from_xml_string(text)
    theirs.opt.jacobian = mujoco.mjtJacobian.mjJAC_DENSE
    return model, theirs


@functools.cache
def states_of(name):
    """States on the way of seeded falls with many active contacts."""
    _, theirs = both(name)
    entry = zoo.ZOO.get(name, zoo.Entry("", spread=0.2))
    count = 200 if name == "ant" else 30
    states, data = [], mujoco.MjData(theirs)
    for state in peers.fall_states(theirs, count, 3, entry.spread, entry.speed):
        state.to_mujoco(theirs, data)
        mujoco.mj_forward(theirs, data)
        if np.count_nonzero(data.efc_force) >= LEAST[name] // 2 and data.nefc >= LEAST[name]:
            states.append(state)
    assert len(states) >= STATES, f"only {len(states)} states with many rows"
    return states[:STATES]


def theirs_at(model, data, state, sweeps, islands):
    """MuJoCo's PGS at `state`: exactly so many sweeps from no force at all."""
    flags = mujoco.mjtDisableBit
    model.opt.solver = mujoco.mjtSolver.mjSOL_PGS
    model.opt.tolerance, model.opt.iterations = 0.0, sweeps
    model.opt.disableflags = int(flags.mjDSBL_WARMSTART) | (
        0 if islands else int(flags.mjDSBL_ISLAND)
    )
    state.to_mujoco(model, data)
    mujoco.mj_forward(model, data)
    if not sweeps:
        data.efc_force[:] = 0.0
    elif not islands:
        assert data.solver_niter[0] == sweeps


def residual(model, data):
    """The residual [m/s] of MuJoCo's forces on its own rows."""
    rows = data.nefc
    jac = data.efc_J.reshape(rows, model.nv)
    a = jac @ np.linalg.solve(peers.mass_matrix(model, data), jac.T)
    force, diagonal = data.efc_force, np.diag(a)
    slack = jac @ data.qacc_smooth + a @ force + data.efc_R * force - data.efc_aref
    # Limits, contacts and the edges of pyramids are all that these scenes have.
    kind = mujoco.mjtConstraint
    one_sided = (
        kind.mjCNSTR_LIMIT_JOINT,
        kind.mjCNSTR_CONTACT_FRICTIONLESS,
        kind.mjCNSTR_CONTACT_PYRAMIDAL,
    )
    assert np.isin(data.efc_type, [int(k) for k in one_sided]).all()
    delta = force - np.maximum(force - slack / (diagonal + data.efc_R), 0.0)
    masses = np.bincount(model.body_treeid[1:], model.body_mass[1:], model.ntree)
    touched = np.zeros((rows, model.ntree), dtype=bool)
    for tree in range(model.ntree):
        touched[:, tree] = (jac[:, model.dof_treeid == tree] != 0.0).any(axis=1)
    return model.opt.timestep * float(
        (np.abs(delta) * np.sqrt(diagonal / (touched @ masses))).max()
    )


def residuals(name, sweeps, islands):
    """Both engines' residuals at every state."""
    model, theirs = both(name)
    data = mujoco.MjData(theirs)
    settings = {"law": "solref", "solver": "pgs", "tolerance": 0.0, "warm_start": False}
    sim = sc.Sim(model, sweeps=sweeps, acceleration="momentum", **settings)
    found = []
    for state in states_of(name):
        state.to_stepcore(sim)
        sim.forward()
        assert sim.sweeps_done == sweeps
        theirs_at(theirs, data, state, sweeps, islands)
        found.append((sim.residual, residual(theirs, data)))
    return np.array(found).T


@pytest.mark.parametrize("name", LEAST)
def test_one_measure(name):
    """Without a sweep both hold the same impulses, none, and must read the same residual."""
    ours, theirs = residuals(name, 0, islands=False)
    assert (ours > 1e-3).sum() >= STATES // 2
    np.testing.assert_allclose(ours, theirs, rtol=1e-9, atol=1e-12)


@every_pair(name=LEAST, sweeps=SWEEPS, islands=[True, False])
def test_not_worse_than_mujoco(name, sweeps, islands):
    """The median and the worst state, and nineteen states of twenty one by one."""
    ours, theirs = residuals(name, sweeps, islands)
    assert np.median(ours) <= max(np.median(theirs), FLOOR)
    assert ours.max() <= max(theirs.max(), FLOOR)
    worse = ours > np.maximum(theirs, FLOOR)
    assert worse.sum() <= STATES // 20, f"{ours[worse]} against {theirs[worse]}"
