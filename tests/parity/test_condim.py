"""condim 1, 3, 4 and 6 against MuJoCo and against the numpy reference.

Laws: acceleration, constraint force and each contact's force and torque (`mj_contactForce`) are
MuJoCo's, from Newton and from converged PGS, under both cones and impratios; steps of the reference
are the engine's, where both have the law; explicit pairs have coefficients of their own along each
axis, and `solreffriction`; slopes are those of the step.
"""

import mujoco
import numpy as np
import oracle
import peers
import pytest
import zoo
from covering import every_pair
from fallen import falls

import stepcore as sc

SCENES = ("condim_mixed", "condim_4", "condim_6", "condim_all")
CONVERGED = {"solver": "pgs", "sweeps": 20000, "tolerance": 1e-13, "acceleration": "momentum"}
PAIRS = """<mujoco><option timestep="0.004"/><worldbody>
<geom name="floor" type="plane" size="3 3 .1"/>
<body pos="0 0 .099"><freejoint/><geom name="a" size=".1"/></body>
<body pos=".19 .01 .1"><freejoint/><geom name="b" size=".1"/></body>
<body pos="1 0 .06"><freejoint/><geom name="c" type="capsule" size=".06 .1" euler="0 88 0"/></body>
</worldbody><contact>
<pair geom1="floor" geom2="a" condim="6" friction=".9 .3 .05 .02 .04" solreffriction=".05 .7"/>
<pair geom1="a" geom2="b" condim="4" friction=".2 .8 .1" solreffriction="-100 -20"/>
<pair geom1="b" geom2="floor" condim="3" friction=".4 1.2" solreffriction=".03 1"/>
<pair geom1="floor" geom2="c" condim="6" friction=".5 1 .03 .1 .002"/>
</contact></mujoco>"""


def text_of(name):
    return PAIRS if name == "pairs" else zoo.ZOO[name].text


def states_of(name, theirs, count):
    spread, speed = (0.02, 1.5) if name == "pairs" else (zoo.ZOO[name].spread, zoo.ZOO[name].speed)
    return falls(theirs, count, 17, spread, speed)


def wrenches(theirs, data):
    """Force and torque of each contact on geom 2 in world axes, by MuJoCo."""
    found = np.zeros((data.ncon, 6))
    for i in range(data.ncon):
        mujoco.mj_contactForce(theirs, data, i, found[i])
        frame = data.contact[i].frame.reshape(3, 3)
        found[i] = np.concatenate([found[i, :3] @ frame, found[i, 3:] @ frame])
    return found


@every_pair(name=[*SCENES, "pairs"], cone=["pyramidal", "elliptic"], impratio=[1.0, 10.0])
def test_forces_and_torques_are_mujocos(name, cone, impratio):
    """1e-9 beside the largest, by Newton and by sweeps to rounding."""
    options = {"cone": cone, "impratio": impratio}
    theirs = peers.strict(mujoco.MjModel.from_xml_string(text_of(name)), **options)
    data, model = mujoco.MjData(theirs), sc.loads(text_of(name)).compile()
    newton = sc.Sim(model, **peers.EXACT, **options)
    swept = sc.Sim(model, **{**peers.EXACT, **CONVERGED, **options})
    torques = 0
    for state in states_of(name, theirs, 30):
        state.to_mujoco(theirs, data)
        mujoco.mj_forward(theirs, data)
        want = wrenches(theirs, data)
        torques += bool(np.abs(want[:, 3:]).max(initial=0.0) > 0)
        scale = max(1.0, np.abs(data.qfrc_constraint).max(initial=0.0))
        for sim, limit in ((newton, 1e-9), (swept, 1e-8)):
            for field, value in vars(state).items():
                getattr(sim, field)[:] = value
            sim.forward()
            got = np.hstack([sim.contacts["force"], sim.contacts["torque"]])
            assert got.shape == want.shape
            assert np.abs(got - want).max(initial=0.0) < limit * scale
            assert np.abs(sim.constraint_force - data.qfrc_constraint).max() < limit * scale
    assert (torques > 3) == (name != "condim_mixed")


@every_pair(
    name=["condim_4", "condim_6", "condim_all", "pairs"],
    cone=["pyramidal", "elliptic"],
    law=["lesson", "relaxed", "rigid", "penalty"],
)
def test_the_reference_takes_the_same_steps(name, law, cone):
    """From random states 1e-10 after one step, with the same sweeps; residuals too."""
    text = text_of(name).replace('type="capsule" size=".06 .12"', 'size=".1"')
    text = text.replace('type="capsule" size=".06 .1"', 'size=".06"')
    scene = sc.loads(text)
    own = {"law": law, "cone": cone, "solver": "pgs", "sweeps": 7, "tolerance": 0.0}
    own |= {"integrator": "semi-implicit", "acceleration": "none", "warm_start": False}
    own |= {"penalty_stiffness": 1e4, "dt": 0.002}
    ours, plain = sc.Sim(scene.compile(), **own), oracle.Sim(scene, **own)
    rng, rows = np.random.default_rng(5), 0
    for _ in range(12):
        qvel = rng.normal(size=len(ours.qvel)) * np.resize([1, 1, 0.3, 3, 3, 3], len(ours.qvel))
        for sim in (ours, plain):
            sim.reset()
            sim.qpos[2] -= 1e-3
            sim.qvel[:] = qvel
            sim.step(2)
        rows += len(ours.rows)
        assert np.abs(ours.qvel - plain.qvel).max() < 1e-10
        assert np.abs(ours.qpos - plain.qpos).max() < 1e-12
        assert ours.residual == pytest.approx(plain.residual, rel=1e-6, abs=1e-12)
    assert rows == 0 if law == "penalty" else rows > 20
