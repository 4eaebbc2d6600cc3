"""What a step leaves out changes nothing: pairs apart, constant dynamics; and Coriolis, if asked.

Laws: leaving out what cannot matter changes no number beyond rounding; without `coriolis` the
bias force is that at rest, at every velocity.
"""

import mujoco
import numpy as np
import oracle
import pytest

import stepcore as sc

ARM = """<mujoco><option timestep="0.002"/><compiler angle="radian"/><worldbody>
  <geom type="plane" size="3 3 .1" pos="0 0 -.7"/>
  <body name="upper"><joint name="shoulder" axis="0 1 0" damping=".1"/>
    <geom name="upper" type="capsule" size=".04" fromto="0 0 0 .4 0 0"/>
    <body name="lower" pos=".4 0 0"><joint name="elbow" axis="0 1 0" range="0 1.2"/>
      <geom name="lower" type="capsule" size=".04" fromto="0 0 0 .3 0 0"/>
      <body name="hand" pos=".3 0 0"><joint name="wrist" axis="0 0 1" range="-.5 .5"/>
        <geom name="hand" size=".05"/></body></body></body></worldbody></mujoco>"""
# The same, its ranges too wide to tell anything.
WIDE = ARM.replace('range="0 1.2"', 'range="-3 3"').replace('range="-.5 .5"', 'range="-3 3"')


def apart(model: sc.Model) -> set[tuple[str, str]]:
    return {pair for pair, a in zip(model.pairs, model.core.plan()["apart"], strict=True) if a}


def test_an_arm_that_cannot_fold_is_known_to_keep_its_hand_from_its_shoulder() -> None:
    assert apart(sc.loads(ARM).compile()) == {("hand", "upper")}
    assert apart(sc.loads(WIDE).compile()) == set()


def test_mujoco_finds_no_contact_where_ranges_keep_apart() -> None:
    """20 000 configurations inside the ranges."""
    model = mujoco.MjModel.from_xml_string(ARM)
    data = mujoco.MjData(model)
    rng = np.random.default_rng(0)
    for q in rng.uniform([-np.pi, 0, -0.5], [np.pi, 1.2, 0.5], (20_000, 3)):
        data.qpos[:] = q
        mujoco.mj_fwdPosition(model, data)
        pairs = {tuple(sorted(pair)) for pair in data.contact.geom}
        assert (1, 3) not in pairs


def test_beyond_the_ranges_everything_is_tested() -> None:
    """Folded by hand, far beyond its range, the hand lies in the upper arm."""
    sim = sc.Sim(sc.loads(ARM).compile())
    sim.qpos[:] = (0.0, 3.1, 0.0)
    sim.forward()
    pairs = {(c["geom1"], c["geom2"]) for c in sim.contacts}
    assert pairs == {(3, 1)}


@pytest.mark.parametrize("law", ["solref", "rigid"])
def test_a_pair_left_out_changes_no_bit(law: str) -> None:
    """Against the same scene whose pair is excluded, and which never tests it."""
    scene = sc.loads(ARM)
    bare = sc.loads(ARM)
    bare.exclude("upper", "hand")
    runs = []
    for one in (scene, bare):
        settings = {"solver": "pgs"} if law == "rigid" else {}
        sim = sc.Sim(one.compile(), law=law, **settings)
        sim.qvel[:] = (3.0, 8.0, 5.0)
        sim.step(1000)
        runs.append(np.concatenate([sim.qpos, sim.qvel]))
    np.testing.assert_array_equal(*runs)


BALL = """<mujoco><option timestep="0.002" integrator="{}"/><worldbody>
  <geom type="plane" size="3 3 .1"/>
  <body pos="0 0 .5"><freejoint/><inertial mass="1" pos="0 0 0" diaginertia="{}"/>
    <geom size=".1"/></body></worldbody></mujoco>"""


@pytest.mark.parametrize("integrator", ["Euler", "implicitfast", "RK4"])
def test_a_ball_has_no_gyroscopic_term(integrator: str) -> None:
    """The ball, whose dynamics are constant, moves as one that is 1e-12 out of round."""
    runs = []
    for inertia in ("4e-3 4e-3 4e-3", "4e-3 4e-3 4.000000000004e-3"):
        sim = sc.Sim(sc.loads(BALL.format(integrator, inertia)).compile())
        sim.qvel[:] = (0.5, 0, 0, 3, -20, 7)
        sim.step(500)
        runs.append(np.concatenate([sim.qpos, sim.qvel]))
    assert sc.loads(BALL.format("Euler", "1 1 1")).compile().core.plan()["constant"] == [True]
    np.testing.assert_allclose(*runs, rtol=1e-8, atol=1e-9)


def test_a_tied_ball_is_no_constant() -> None:
    text = BALL.format("Euler", "1 1 1").replace("<body", '<body name="b"')
    tie = '<equality><connect body1="b" anchor="0 0 .3"/></equality></mujoco>'
    model = sc.loads(text.replace("</mujoco>", tie)).compile()
    assert model.core.plan()["constant"] == [False]


SPIN = """<mujoco><worldbody><body><freejoint/><inertial pos="0 0 .1" mass="1"
  diaginertia=".1 .2 .25"/><body pos="1 0 0"><joint axis="0 1 0"/>
  <geom size=".1" contype="0" conaffinity="0"/></body></body></worldbody></mujoco>"""


def test_without_coriolis_the_bias_is_that_at_rest() -> None:
    scene = sc.loads(SPIN)
    rest = sc.Sim(scene.compile()).bias
    scene.features.coriolis = False
    sim = sc.Sim(scene.compile())
    sim.qvel[:] = np.linspace(-3, 5, 7)
    np.testing.assert_allclose(sim.bias, rest, rtol=1e-14, atol=1e-14)
    # The numpy engine agrees, and a file says it.
    again = sc.loads(scene.to_mjcf())
    assert again == scene and not again.features.coriolis
    other = oracle.Sim(scene.compile())
    other.qvel[:] = sim.qvel
    sim.step(5)
    other.step(5)
    np.testing.assert_allclose(sim.qpos, other.qpos, rtol=1e-12, atol=1e-13)


def test_without_coriolis_a_spinning_plate_keeps_its_axis() -> None:
    """Euler's equations without w × Iw: the angular velocity in body axes is constant."""
    scene = sc.loads(SPIN.replace('<body pos="1 0 0"><joint axis="0 1 0"/>', "<body>"))
    scene.features.coriolis, scene.features.gravity = False, False
    for integrator in ("euler", "implicitfast", "rk4"):
        sim = sc.Sim(scene.compile(), integrator=integrator)
        sim.qvel[3:] = (1.0, 10.0, 0.1)
        sim.step(100)
        # About the centre of mass, which is off the joint, the body translates too.
        np.testing.assert_allclose(sim.qvel[3:], (1.0, 10.0, 0.1), rtol=1e-9)
