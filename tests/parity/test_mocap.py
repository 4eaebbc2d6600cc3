"""Mocap bodies and `eq_active`: inputs that move bodies and switch equalities, as MuJoCo's do.

Law: at random states with random poses of mocap bodies and random equalities switched off, poses,
contacts, forces, accelerations and steps are MuJoCo's to 1e-9.
"""

import pickle

import mujoco
import numpy as np
import peers
import pytest
from fallen import falls

import stepcore as sc

TEXT = """
<mujoco><option timestep=".004"/><worldbody>
  <geom name="floor" type="plane" size="3 3 .1"/>
  <body name="hand" mocap="true" pos=".3 0 .5" quat=".9 .1 .3 0">
    <geom type="box" size=".1 .08 .05"/>
    <body name="thumb" pos=".12 0 .05" euler="0 30 0"><geom size=".04"/></body>
  </body>
  <body name="target" mocap="true" pos="-.4 .1 .6"><geom size=".03" contype="0" conaffinity="0"/>
    <body name="flag" pos="0 .1 0"><joint name="flap" axis="1 0 0" damping=".05"/>
      <joint type="slide" axis="0 0 1" stiffness="40" damping="1"/>
      <geom type="box" size=".02 .05 .01" pos="0 .06 0"/></body></body>
  <body name="cube" pos=".32 .02 .62"><freejoint/><geom type="box" size=".06 .05 .04"/></body>
  <body name="arm" pos="-.8 0 .6"><joint axis="0 1 0"/>
    <geom type="capsule" size=".03" fromto="0 0 0 .3 0 0" contype="0" conaffinity="0"/>
    <body name="wrist" pos=".3 0 0"><joint name="twist" type="ball"/>
      <geom type="capsule" size=".025" fromto="0 0 0 .1 .05 0" contype="0" conaffinity="0"/>
    </body></body></worldbody>
  <equality><weld name="grab" body1="target" body2="wrist" torquescale=".5" solref=".03 1"/>
    <connect name="string" body1="cube" body2="hand" anchor="0 0 .1" solref=".1 1"/>
    <joint name="stuck" joint1="flap" polycoef=".2" active="false"/></equality>
  <keyframe><key name="up" mpos="0 0 1 -.4 .1 .7" mquat="1 0 0 0 .8 .6 0 0"/></keyframe>
</mujoco>
"""


def both(**options):
    theirs = peers.strict(mujoco.MjModel.from_xml_string(TEXT), **options)
    return sc.Sim(sc.loads(TEXT), **peers.EXACT, **options), theirs


def shaken(theirs, rng):
    """Poses of the mocap bodies near those of the scene, and which equalities act."""
    near = [theirs.body_pos[body] for body in np.flatnonzero(theirs.body_mocapid >= 0)]
    return {
        "mocap_pos": np.array(near) + 0.05 * rng.normal(size=(2, 3)),
        "mocap_quat": rng.normal(size=(2, 4)),
        "eq_active": rng.integers(2, size=3),
    }


@pytest.mark.parametrize("integrator", peers.INTEGRATORS)
def test_parity(integrator):
    sim, theirs = both(integrator=integrator)
    data, worst, rng = mujoco.MjData(theirs), peers.Worst(), np.random.default_rng(1)
    for index, state in enumerate(falls(theirs, 100, 2, 0.05)):
        inputs = shaken(theirs, rng)
        for step in (False, True):
            state.to_mujoco(theirs, data)
            state.to_stepcore(sim)
            for name, value in inputs.items():
                getattr(data, name)[:] = value
                getattr(sim, name)[:] = value
            if step:
                mujoco.mj_step(theirs, data)
                sim.step(1)
                worst.note("qpos", peers.apart(sim.qpos, data.qpos), index)
                worst.note("qvel", peers.apart(sim.qvel, data.qvel), index)
            else:
                mujoco.mj_forward(theirs, data)
                sim.forward()
                worst.note("xpos", peers.apart(sim.xpos, data.xpos), index)
                worst.note("geom_xpos", peers.apart(sim.geom_xpos, data.geom_xpos), index)
                worst.note("contacts", peers.contacts_apart(sim, data), index)
                worst.note("qacc", peers.apart(sim.qacc, data.qacc), index)
                worst.note(
                    "constraint",
                    peers.apart(sim.constraint_force, data.qfrc_constraint, 0.1),
                    index,
                )
    placed = dict.fromkeys(("xpos", "geom_xpos"), 1e-10)
    worst.check(placed | peers.SOLVED | peers.STEPPED, integrator)


def test_worlds_of_a_batch_are_those_of_a_sim():
    """Each has its own equalities and mocap bodies, bit for bit."""
    model = sc.loads(TEXT).compile()
    batch, rng = sc.Batch(model, 9), np.random.default_rng(4)
    theirs = mujoco.MjModel.from_xml_string(TEXT)
    sims = []
    for world in range(9):
        sim = sc.Sim(model)
        for name, value in shaken(theirs, rng).items():
            getattr(sim, name)[:] = value
            getattr(batch, name)[world] = value
        sims.append(sim)
    batch.step(50)
    for world, sim in enumerate(sims):
        sim.step(50)
        assert batch.qpos[world].tobytes() == sim.qpos.tobytes()
        assert batch.qvel[world].tobytes() == sim.qvel.tobytes()


def test_snapshots_and_pickles_keep_them():
    sim = sc.Sim(sc.loads(TEXT))
    sim.mocap_pos[0], sim.mocap_quat[1], sim.eq_active[:] = (0.3, 0.1, 0.5), (1, 1, 0, 0), (0, 1, 1)
    sim.step(20)
    snap, other = sim.state(), pickle.loads(pickle.dumps(sim))
    sim.step(20)
    end = sim.qpos.tobytes()
    other.step(20)
    assert other.qpos.tobytes() == end
    sim.reset()
    assert sim.mocap_pos[0].tolist() == [0.3, 0, 0.5] and sim.eq_active.tolist() == [1, 1, 0]
    sim.restore(snap)
    sim.step(20)
    assert sim.qpos.tobytes() == end


def test_keyframes_have_them():
    sim = sc.Sim(sc.loads(TEXT))
    sim.reset("up")
    assert sim.mocap_pos.tolist() == [[0, 0, 1], [-0.4, 0.1, 0.7]]
    assert sim.mocap_quat.tolist() == [[1, 0, 0, 0], [0.8, 0.6, 0, 0]]
    again = sc.loads(sc.loads(TEXT).to_mjcf())
    assert again == sc.loads(TEXT)


def test_a_weld_to_a_mocap_body_brings_a_body_there():
    scene = sc.Scene(gravity=(0, 0, 0))
    scene.add_body("hand", mocap=True)
    cube = scene.add_body("cube", mass=1.0, inertia=(0.01, 0.02, 0.03))
    scene.add_joint(cube, "free")
    scene.add_equality("weld", "hand", "cube")
    sim = sc.Sim(scene, dt=0.002)
    turn = np.array([0.8, 0, 0.6, 0])
    sim.mocap_pos[:], sim.mocap_quat[:] = (0.1, 0.2, 0.3), 2 * turn
    sim.step(2000)
    assert sim.body("cube").xpos == pytest.approx([0.1, 0.2, 0.3], abs=1e-9)
    assert abs(sim.body("cube").xquat @ turn) == pytest.approx(1, abs=1e-12)
    assert sim.body("hand").xquat == pytest.approx(turn)


def test_hard_laws_hold_what_is_active():
    """Under `rigid` a switched-off weld has no rows, at the stages of `rk4` too."""
    for integrator in ("semi-implicit", "rk4", "midpoint"):
        scene = sc.Scene()
        ball = scene.add_body("ball", pos=(0, 0, 1), mass=1.0, inertia=(1, 1, 1))
        scene.add_joint(ball, "free")
        scene.add_equality("weld", "ball", anchor=(0, 0, 1))
        sim = sc.Sim(scene, law="rigid", solver="pgs", sweeps="auto", integrator=integrator)
        sim.step(10)
        assert np.abs(sim.qvel).max() < 1e-12
        sim.eq_active[:] = False
        sim.step(10)
        assert sim.qvel[2] == pytest.approx(-9.81 * 10 * sim.settings.dt, rel=1e-9)
        assert len(sim.rows) == 0


def test_what_is_refused():
    sim = sc.Sim(sc.loads(TEXT))
    sim.mocap_quat[1] = 0
    with pytest.raises(ValueError, match=r"mocap_quat\[1\].*body `target`"):
        sim.step()
    sim.reset()
    sim.mocap_pos[0, 2] = np.nan
    with pytest.raises(ValueError, match=r"mocap_pos\[0, 2\].*body `hand`"):
        sim.step()
    scene = sc.Scene()
    hand = scene.add_body("hand", mocap=True, mass=1.0)
    scene.add_joint(hand)
    with pytest.raises(ValueError, match='body "hand": mocap'):
        scene.compile()
    scene = sc.Scene()
    arm = scene.add_body("arm", mass=1.0, inertia=(1, 1, 1))
    scene.add_joint(arm)
    scene.add_key("k", mpos=(0, 0, 0))
    with pytest.raises(ValueError, match="mpos"):
        scene.compile()
