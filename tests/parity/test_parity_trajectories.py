"""Whole motions against MuJoCo: 200 steps of the seven models under their shipped integrators.

Law: the engines part no faster than MuJoCo parts from itself. The limit is
1e-9, or ten times the distance between two MuJoCo runs started 1e-13 apart
where that is larger (a contact event moved by one step is not an error), on at
least four seeds of five.
"""

import mujoco
import numpy as np
import peers
import zoo
from covering import every_value, first

import stepcore as sc

STEPS = 200


def start(theirs, seed):
    """A seeded start near the initial configuration, and controls held for five steps each."""
    rng = np.random.default_rng(1000 + seed)
    qpos = theirs.qpos0.copy()
    peers.nudge(theirs, qpos, rng, 0.02)
    qvel = 0.1 * rng.normal(size=theirs.nv)
    held = [peers.random_ctrl(theirs, rng) for _ in range(STEPS // 5)]
    return qpos, qvel, np.repeat(held, 5, axis=0)


def their_run(theirs, qpos, qvel, ctrl):
    data = mujoco.MjData(theirs)
    data.qpos[:], data.qvel[:] = qpos, qvel
    path = np.empty((STEPS, theirs.nq + theirs.nv))
    for i in range(STEPS):
        data.ctrl[:] = ctrl[i]
        mujoco.mj_step(theirs, data)
        path[i] = np.concatenate((data.qpos, data.qvel))
    return path


def our_run(sim, qpos, qvel, ctrl):
    sim.reset()
    sim.qpos[:], sim.qvel[:] = qpos, qvel
    path = np.empty((STEPS, len(qpos) + len(qvel)))
    for i in range(STEPS):
        sim.ctrl[:] = ctrl[i]
        sim.step(1)
        path[i] = np.concatenate((sim.qpos, sim.qvel))
    return path


def seeds_passed(theirs, sim):
    """How many of five seeds stay within the limit, and the figures."""
    passed, figures = 0, []
    for seed in range(5):
        qpos, qvel, ctrl = start(theirs, seed)
        reference = their_run(theirs, qpos, qvel, ctrl)
        sign = np.random.default_rng(seed).choice((-1.0, 1.0), size=theirs.nv)
        moved = qpos.copy()
        mujoco.mj_integratePos(theirs, moved, 1e-13 * sign, 1.0)
        own = np.abs(their_run(theirs, moved, qvel, ctrl) - reference).max()
        error = np.abs(our_run(sim, qpos, qvel, ctrl) - reference).max()
        passed += error <= max(1e-9, 10.0 * own)
        figures.append(f"{error:.1e} (MuJoCo from itself {own:.1e})")
    return passed, figures


# The two humanoids take as long as the others together.
@first(len(peers.GYM) - 2, name=peers.GYM)
def test_models(name):
    theirs = peers.strict(mujoco.MjModel.from_xml_path(peers.gym_path(name)))
    sim = sc.Sim(sc.load(peers.gym_path(name)).compile(), **peers.EXACT)
    passed, figures = seeds_passed(theirs, sim)
    assert passed >= 4, figures


# One step of every scene under every integrator is in test_parity_zoo.py.
@every_value(
    name=("all_together", "connect", "friction_loss", "several_joints", "free_limb"),
    integrator=peers.INTEGRATORS,
)
def test_zoo(name, integrator):
    theirs = peers.strict(mujoco.MjModel.from_xml_string(zoo.ZOO[name].text), integrator=integrator)
    sim = sc.Sim(sc.loads(zoo.ZOO[name].text).compile(), **peers.EXACT, integrator=integrator)
    passed, figures = seeds_passed(theirs, sim)
    assert passed >= 4, figures
