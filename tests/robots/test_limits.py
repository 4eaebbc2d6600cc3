"""The steps that limit real arms, against MuJoCo's own linearisation of its step."""

from __future__ import annotations

from pathlib import Path

import menagerie
import mujoco
import numpy as np
import pytest

import stepcore as sc

pytestmark = menagerie.needed

INTEGRATORS = {
    "euler": mujoco.mjtIntegrator.mjINT_EULER,
    "implicitfast": mujoco.mjtIntegrator.mjINT_IMPLICITFAST,
}


class Linearised:
    """MuJoCo's step at the start of a file, without rows, as a function of dt and integrator."""

    def __init__(self, path: Path):
        self.model = mujoco.MjModel.from_xml_path(str(path))
        self.model.opt.disableflags |= mujoco.mjtDisableBit.mjDSBL_CONSTRAINT
        self.data = mujoco.MjData(self.model)

    def matrix(self, integrator: str, dt: float) -> np.ndarray:
        model, data = self.model, self.data
        model.opt.integrator, model.opt.timestep = INTEGRATORS[integrator], dt
        mujoco.mj_resetData(model, data)
        if model.nkey:
            mujoco.mj_resetDataKeyframe(model, data, 0)
        map_ = np.zeros((2 * model.nv, 2 * model.nv))
        mujoco.mjd_transitionFD(model, data, 1e-6, True, map_, None, None, None)
        return map_

    def flips(self, integrator: str, dt: float) -> tuple[bool, str]:
        """Whether a real eigenvalue is beyond -1, as a servo's is; the joint that moves most."""
        values, vectors = np.linalg.eig(self.matrix(integrator, dt))
        worst = int(np.argmin(np.where(np.abs(values.imag) < 1e-9, values.real, 0.0)))
        dof = int(np.argmax(np.abs(vectors[: self.model.nv, worst])))
        return values[worst].real < -1.0, self.model.joint(self.model.dof_jntid[dof]).name

    def limit(self, integrator: str) -> tuple[float, str]:
        """The shortest step at which a servo's oscillation grows [s], and its joint."""
        high = next(dt for dt in np.geomspace(1e-4, 2.0, 80) if self.flips(integrator, dt)[0])
        low = high / 1.2
        for _ in range(20):
            middle = 0.5 * (low + high)
            low, high = (low, middle) if self.flips(integrator, middle)[0] else (middle, high)
        return high, self.flips(integrator, high)[1]


def test_so101_by_its_gripper():
    """8.67 ms under euler, 14.45 ms under implicitfast."""
    scene = sc.load(menagerie.SO101)
    for joint in scene.joints:
        joint.frictionloss = 0.0
    diagnosis = sc.diagnose(scene, horizon=0.02)
    assert "servo `gripper`" in diagnosis.together("euler")
    peer = Linearised(menagerie.SO101)
    for integrator, known in (("euler", 8.67e-3), ("implicitfast", 14.45e-3)):
        theirs, joint = peer.limit(integrator)
        assert (joint, theirs) == ("gripper", pytest.approx(known, abs=6e-6))
        assert diagnosis.held(integrator) == pytest.approx(theirs, rel=1e-2)


def test_ur5e_by_its_servos():
    """1.89 ms under euler, of the wrist's servos together; 402 ms under implicitfast, of each."""
    diagnosis = sc.diagnose(menagerie.UR5E, horizon=0.02)
    peer = Linearised(menagerie.UR5E)
    theirs, joint = peer.limit("euler")
    assert (joint, theirs) == ("wrist_1_joint", pytest.approx(1.89e-3, abs=5e-6))
    # Held at the end of the motion, a little away from the start.
    assert diagnosis.held("euler") == pytest.approx(theirs, rel=5e-3)
    assert "servo `wrist_1`" in diagnosis.together("euler")
    theirs, _ = peer.limit("implicitfast")
    assert theirs == pytest.approx(0.402, abs=5e-4)
    assert diagnosis.held("implicitfast") == pytest.approx(theirs, rel=2e-2)


def test_panda_by_its_first_and_third_servo():
    """0.59 ms under euler, though the fingers leave their limits at the start."""
    diagnosis = sc.diagnose(menagerie.PANDA, horizon=0.02, dt=5e-4)
    theirs, joint = Linearised(menagerie.PANDA).limit("euler")
    assert (joint, theirs) == ("joint3", pytest.approx(0.593e-3, abs=1e-6))
    assert diagnosis.held("euler") == pytest.approx(theirs, rel=1e-3)
    assert diagnosis.stiffest("euler") in ("servo `actuator1`", "servo `actuator3`")


@pytest.mark.parametrize(
    "path", [menagerie.SO101, menagerie.UR5E, menagerie.PANDA], ids=["so101", "ur5e", "panda"]
)
@pytest.mark.parametrize("integrator", INTEGRATORS)
def test_the_linearised_step_is_mujocos(path, integrator):
    """Every entry, to what MuJoCo's central differences leave, below and at the limit."""
    peer = Linearised(path)
    for dt in (5e-4, peer.limit(integrator)[0]):
        scene = sc.load(path).with_settings(integrator=integrator, dt=dt)
        for thing in (*scene.joints, *scene.tendons):
            thing.range, thing.frictionloss = None, 0.0
        scene.equalities.clear()
        sim = sc.Sim(scene)
        if scene.keys:
            sim.reset(scene.keys[0].name)
        theirs = peer.matrix(integrator, dt)
        ours = sim.linearize().A
        assert np.abs(ours - theirs).max() < 1e-6 * np.abs(theirs).max()
