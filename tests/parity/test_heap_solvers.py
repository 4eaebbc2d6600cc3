"""Heaps against MuJoCo: accelerations, cold and from a warm start, by Newton and by PGS.

Law: same state, same acceleration, to 1e-9 of the largest entry where both are converged. From
eight trees on Newton eliminates bodies by minimum degree, and rows of free bodies have sums of
their own; a hinged arm among the bodies makes nodes of other sizes than six.
"""

import mujoco
import numpy as np
import pytest

import stepcore as sc

SPHERES, CAPSULES, ARM = "spheres", "capsules", "arm"
ARM_TEXT = """
  <body pos="-.3 0 .25"><joint axis="0 1 0"/><geom type="capsule" size=".04" fromto="0 0 0 .2 0 0"/>
    <body pos=".2 0 0"><joint axis="0 1 0" range="-60 60" limited="true" frictionloss=".1"/>
      <geom type="capsule" size=".04" fromto="0 0 0 .2 0 -.1"/></body></body>"""


def text(name, cone):
    """18 bodies in three layers on a floor between two walls; with `arm` also two hinges."""
    rng = np.random.default_rng(3)
    shape = 'type="capsule" size=".05 .08"' if name == CAPSULES else 'size=".05"'
    bodies = "" if name != ARM else ARM_TEXT
    for i in range(18):
        x, y, z = 0.09 * (i % 3), 0.09 * (i // 3 % 2), 0.07 + 0.09 * (i // 6)
        x, y, z = np.array([x, y, z]) + rng.uniform(-0.01, 0.01, 3)
        quat = " ".join(f"{q:.6f}" for q in rng.normal(size=4))
        bodies += f'<body pos="{x:.6f} {y:.6f} {z:.6f}" quat="{quat}"><freejoint/>'
        bodies += f'<geom {shape} mass="{1 + i % 3}"/></body>'
    return f"""<mujoco><option timestep="0.002" cone="{cone}"/><size memory="16M"/><worldbody>
      <geom type="plane" size="3 3 .1"/>
      <geom type="plane" size="3 3 .1" pos=".25 0 0" zaxis="-1 0 0"/>
      <geom type="plane" size="3 3 .1" pos="0 .2 0" zaxis="0 -1 0"/>{bodies}</worldbody></mujoco>"""


@pytest.mark.parametrize("cone", ("pyramidal", "elliptic"))
@pytest.mark.parametrize("name", (SPHERES, CAPSULES, ARM))
def test_acceleration(name, cone):
    theirs = mujoco.MjModel.from_xml_string(text(name, cone))
    theirs.opt.solver, theirs.opt.tolerance = mujoco.mjtSolver.mjSOL_NEWTON, 0.0
    theirs.opt.iterations, theirs.opt.ls_tolerance, theirs.opt.ls_iterations = 300, 1e-12, 200
    data = mujoco.MjData(theirs)
    model = sc.loads(text(name, cone)).compile()
    newton = sc.Sim(model, solver="newton", tolerance=0.0, sweeps=200)
    pgs = sc.Sim(model, solver="pgs", acceleration="momentum", tolerance=1e-13, sweeps=20_000)
    contacts = 0
    for _ in range(8):
        mujoco.mj_step(theirs, data, nstep=12)
        mujoco.mj_forward(theirs, data)
        contacts = max(contacts, data.ncon)
        scale = np.abs(data.qacc).max()
        for sim, limit in ((newton, 1e-9), (pgs, 1e-7)):
            sim.qpos[:], sim.qvel[:] = data.qpos, data.qvel
            sim.forward()
            cold = sim.qacc.copy()
            sim.step(1)  # from here a warm start
            sim.qpos[:], sim.qvel[:] = data.qpos, data.qvel
            sim.forward()
            for found in (cold, sim.qacc):
                assert found == pytest.approx(data.qacc, abs=limit * scale)
    assert contacts > 25


@pytest.mark.parametrize("solver", ("newton", "pgs"))
def test_lanes_are_their_worlds(solver):
    """Eight heaps side by side, whose contacts differ, are bit for bit those heaps alone."""
    model = sc.loads(text(ARM, "pyramidal")).compile()
    rng = np.random.default_rng(4)
    batch = sc.Batch(model, 8, solver=solver, sweeps=30)
    speeds = 0.5 * rng.normal(size=batch.qvel.shape)
    batch.qvel[:] = speeds
    batch.step(60)
    for world, speed in enumerate(speeds):
        sim = sc.Sim(model, solver=solver, sweeps=30)
        sim.qvel[:] = speed
        sim.step(60)
        assert (sim.qpos == batch.qpos[world]).all()
