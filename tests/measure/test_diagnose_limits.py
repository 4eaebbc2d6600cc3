"""`diagnose` names limits that a run confirms: the same for every wanted dt, none where a
motion is stable by luck, with the elements that move the limit."""

import math

import numpy as np
import pytest
import stiff
from covering import every_pair
from stiff import diagnosed

import stepcore as sc

# Steps beyond a limit are run on purpose.
pytestmark = pytest.mark.filterwarnings("ignore::stepcore.EnergyWarning")


def run(scene, dt, seconds=1.0, integrator=None):
    """A Sim after a run from the first keyframe, or from the scene's pose."""
    sim = sc.Sim(scene.compile(), dt=dt, **({"integrator": integrator} if integrator else {}))
    if scene.keys:
        sim.reset(key=0)
    sim.step(round(seconds / dt))
    return sim


# --- both were run --------------------------------------------------------------------------------


def apart(scene, integrator, dt, key=None):
    """How much further apart two runs are towards the end of a thousand steps than at the start,
    in velocity; inf if one explodes. One starts 1e-6 m or rad away."""
    ways = []
    for nudge in (0.0, 1e-6):
        sim = sc.Sim(scene.compile(), integrator=integrator, dt=dt)
        if scene.keys:
            sim.reset(key=0)
        sim.qpos[: sim.model.nv] += nudge * (-1.0) ** np.arange(sim.model.nv)
        ways.append([])
        try:
            for _ in range(1000):
                sim.step()
                ways[-1].append(np.array(sim.qvel))
        except sc.SimulationError:
            return math.inf
    far = np.abs(np.subtract(*ways)).max(axis=1)
    return far[-250:].max() / 1e-6


def servo(**gains):
    return sc.loads(f"""<mujoco><option timestep="0.0002" gravity="0 0 0"/><worldbody>
    <body><joint name="j" axis="0 0 1" damping="1"/>
    <inertial pos="0 0 0" mass="1" diaginertia="1 1 .01"/></body></worldbody>
    <actuator><position name="servo" joint="j" kp="{gains["kp"]}" kv="{gains["kv"]}"/></actuator>
    </mujoco>""")


SCENES = {
    "slider": lambda: stiff.slider(1e4, 2.0, dt=1e-3),
    "chain": lambda: stiff.chain((50.0, 20.0, 4000.0, 20.0), dt=1e-3),
    "arm": lambda: stiff.arm((200.0, 200.0, 2e5, 200.0, 200.0, 200.0), kv=0.02, dt=1e-3),
    "servo": lambda: servo(kp=400, kv=20),
    "pad": lambda: stiff.pad((-1e6, -1000.0), dt=5e-3),
}


@every_pair(name=list(SCENES), integrator=["euler", "semi-implicit", "implicitfast", "rk4"])
def test_a_run_holds_below_the_limit_and_fails_above(name, integrator):
    """Law: at 0.98 of the limit two runs that start 1e-6 apart come no further apart than a spring
    swings, at 1.03 of it by orders of magnitude; stepped here, both held at the start."""
    scene = SCENES[name]()
    limit = diagnosed(scene, [integrator], kind=None if not scene.actuators else "hold").limit(
        integrator
    )
    assert 0 < limit < 1
    fast = 2 / limit
    holds, fails = (apart(scene, integrator, share * limit) for share in (0.98, 1.03))
    assert holds < 30 * fast and fails > max(100 * holds, 10 * fast)


def test_every_wanted_dt_names_the_same_limit():
    """Law: the limit belongs to the motion, so it does not depend on the requested step."""
    every = [diagnosed(SCENES["chain"](), dt=dt) for dt in (0.0011, 0.02)]
    limits = [d.limit() for d in every]
    assert math.isfinite(limits[0]) and limits == [limits[0]] * len(limits)
    assert {d.stiffest() for d in every} == {"spring of joint `joint2`"}


def test_a_robot_held_at_its_keyframe_has_the_limit_of_its_linearised_step():
    """Law: 2ζ/ω and more of it: kv implicit, kp explicit, and a range of force that a held pose
    does not reach."""
    with pytest.warns(sc.StiffnessWarning, match="servo `servo`"):
        scene = servo(kp=4000, kv=200)
    scene.actuators[0].forcerange = (-5.0, 5.0)
    d = diagnosed(scene, ["implicitfast"], kind="hold")
    limit = d.limit("implicitfast")
    assert limit == pytest.approx(d.held("implicitfast"), rel=0.05)
    c = (200 + 1) / 0.01
    assert limit == pytest.approx((c + math.sqrt(c**2 + 4 * 4e5)) / 4e5, rel=0.05)


# --- what is a failure, and what is not -----------------------------------------------------------


def stack(count=3):
    """Boxes that touch at rest, on a floor."""
    boxes = "".join(
        f'<body name="b{i}" pos="0 0 {0.05 + 0.1 * i}"><freejoint/>'
        '<geom type="box" size=".05 .05 .05" mass="1"/></body>'
        for i in range(count)
    )
    return sc.loads(
        '<mujoco><option timestep="0.005"/><worldbody><geom type="plane" size="2 2 .1"/>'
        f"{boxes}</worldbody></mujoco>"
    )


def test_a_stack_that_settles_has_not_exploded():
    """Law: a step of free fall gives a box ½ m (g dt)², before its contact can hold it. The stack
    comes to rest at 30 ms, stepped here, so no limit lies below."""
    scene = stack(2)
    assert run(scene, 0.03, 2.0).energy.kinetic < 1e-6
    assert diagnosed(scene).limit() > 0.03


def plate(height=0.3):
    """A ball that falls onto a thin plate without a floor below."""
    return sc.loads(f"""<mujoco><option timestep="0.002"/><worldbody>
    <geom name="plate" type="box" size=".5 .5 .005"/>
    <body name="ball" pos="0 0 {height}"><freejoint/><geom name="ball" size=".03" mass=".1"/></body>
    </worldbody></mujoco>""")


def test_a_ball_that_falls_through_a_plate_has_failed():
    """Stepped here: at 0.9 of the limit the ball ends on the plate, and at some step above, tried
    at small intervals up to twice the limit, below it."""
    scene = plate()
    d = diagnosed(scene, dt=0.004)
    limit = d.limits["euler"]
    assert limit.outcome == "gains energy" and d.stiffest() == "contact `ball`/`plate`"
    assert run(scene, 0.9 * limit.dt).xpos[1, 2] > 0
    beyond = [run(scene, part * limit.dt).xpos[1, 2] for part in np.geomspace(1.01, 2, 20)]
    assert min(beyond) < -0.1
