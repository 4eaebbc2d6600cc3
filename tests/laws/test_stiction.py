"""Friction that holds: `stiction` against closed forms, and what noslip does of it."""

import math

import mujoco
import numpy as np
import pytest
import transforms
from covering import every_pair

import stepcore as sc

G, MASS = 9.81, 0.045
NANO = 1e-9


def pinch(dt=0.002, cone="elliptic", radius=0.002, condim=3, tilt="0 0 0"):
    """A ball between two boxes on slides; 20 times the friction that its weight needs."""
    grip = 20 * MASS * G / 2
    force = '<motor joint="left"/><motor joint="right"/>'
    text = f"""<mujoco><option timestep="{dt}" cone="{cone}" impratio="10"
      integrator="implicitfast"/>
    <default><geom friction="1 .0005 .0001" condim="{condim}" solref=".004 1"
      solimp=".95 .99 .001"/><motor ctrlrange="0 100"/></default><worldbody>
    <body name="hand"><joint name="wrist" axis="1 0 0" armature="1" damping="100"/>
      <geom size=".01" mass="1" contype="0" conaffinity="0"/>
      <body name="left" pos="{-radius - 0.01} 0 0"><joint name="left" type="slide" axis="1 0 0"
        damping="1"/><geom name="left" type="box" size=".01 .02 .02" mass=".05"/></body>
      <body name="right" pos="{radius + 0.01} 0 0"><joint name="right" type="slide" axis="-1 0 0"
        damping="1"/><geom name="right" type="box" size=".01 .02 .02" mass=".05"/></body></body>
    <body name="ball"><freejoint name="ball"/><geom name="ball" size="{radius}" mass="{MASS}"/>
    </body></worldbody>
    <contact><exclude body1="left" body2="right"/></contact>
    <actuator><motor name="wrist" joint="wrist" ctrlrange="-9 9"/>{force}</actuator></mujoco>"""
    return text, np.array([0.0, grip, grip])


def hanging(text, ctrl, **settings):
    sim = sc.Sim(sc.loads(text).compile(), **settings)
    sim.ctrl = ctrl
    return sim


def ball(sim):
    return np.array(sim.body("ball").xpos)


# The dof about which nothing resists.
FREE_SPIN = 7
SOLVERS = {"newton": {}, "pgs": {"solver": "pgs", "sweeps": 2000, "tolerance": 1e-13}}


@every_pair(dt=[0.001, 0.002, 0.005, 0.01], cone=["elliptic", "pyramidal"], solver=SOLVERS)
def test_a_pinched_ball_hangs(dt, cone, solver):
    """MuJoCo's friction lets it creep at 50 µm/s or more; held it moves below 1 nm/s for 9 s."""
    text, ctrl = pinch(dt, cone)
    model = mujoco.MjModel.from_xml_string(text)
    data = mujoco.MjData(model)
    data.ctrl[:] = ctrl
    speeds = []
    for _ in range(2):
        mujoco.mj_step(model, data, round(1 / dt))
        speeds.append(data.qpos[5])
    assert speeds[0] - speeds[1] > 50e-6
    sim = hanging(text, ctrl, stiction=True, **SOLVERS[solver])
    sim.step(round(1 / dt))
    start = ball(sim)
    sim.step(round(9 / dt))
    assert np.linalg.norm(ball(sim) - start) < 9 * NANO
    # Under condim 3 nothing holds a spin about the line between the fingers: y of the ball.
    held = np.delete(sim.qvel, FREE_SPIN)
    assert np.abs(held).max() < 1e-8 and abs(sim.qvel[FREE_SPIN]) < 1e-6


@every_pair(dt=[0.001, 0.002, 0.005, 0.01], condim=[3, 4, 6])
def test_a_pinched_ball_holds_what_pushes_and_spins_it(dt, condim):
    """Pushed for a tenth of a second, and spun about the pinch; afterwards it rests to 1 nm/s."""
    text, ctrl = pinch(dt, condim=condim)
    sim = hanging(text, ctrl, stiction=True)
    sim.step(round(0.5 / dt))
    sim.qvel[-3] += 5.0
    sim.xfrc_applied[-1, 1] = 2 * MASS * G
    sim.step(round(0.1 / dt))
    sim.xfrc_applied[:] = 0
    sim.step(round(2 / dt))
    start = ball(sim)
    sim.step(round(5 / dt))
    assert np.linalg.norm(ball(sim) - start) < 5 * NANO
    spin = abs(float(sim.qvel[-3]))
    assert spin < 1e-6 if condim > 3 else spin > 1.0


def test_the_hand_turns_and_the_ball_stays_in_it():
    """Gravity goes round the grip once; there the ball is where it was, to 1 % of its size."""
    text, ctrl = pinch(0.002)
    sim = hanging(text, ctrl, stiction=True)
    sim.step(1000)
    start = ball(sim)
    while float(sim.qpos[0]) < 2 * math.pi:
        sim.ctrl[0] = 9.0
        sim.step(10)
    sim.qvel[0], sim.ctrl[0] = 0.0, 0.0
    sim.step(1000)
    angle = float(sim.qpos[0])
    turned = np.array(
        [[1, 0, 0], [0, np.cos(angle), np.sin(angle)], [0, -np.sin(angle), np.cos(angle)]]
    )
    assert np.linalg.norm(turned @ ball(sim) - start) < 2e-5


def slider(cone="elliptic", impratio=1.0, condim=3, mu=0.5, dt=0.002, **options):
    """A ball that can move along x and z only, on a floor, pushed along x."""
    scene = sc.Scene()
    scene.options.update(dt=dt, cone=cone, impratio=impratio, stiction=True, **options)
    body = scene.add_body("block", pos=(0, 0, 0.1))
    scene.add_joint(body, "slide", axis=(1, 0, 0), name="x")
    scene.add_joint(body, "slide", axis=(0, 1, 0), name="y")
    scene.add_joint(body, "slide", axis=(0, 0, 1), name="z")
    scene.add_geom(body, "sphere", 0.1, mass=2.0, name="ball")
    scene.add_geom("world", "plane", name="floor")
    scene.add_pair(
        "ball", "floor", condim=condim, friction=(mu, mu), solimp=(0.9, 0.9, 0.001, 0.5, 2)
    )
    return scene


@every_pair(
    impratio=[1.0, 7.0],
    integrator=[
        "semi-implicit",
        "euler",
        "implicitfast",
        "implicit",
        "discrete",
        "rk4",
        "midpoint",
    ],
)
def test_a_held_load_rests_on_its_spring(integrator, impratio):
    """s = R f/(K d), R = (1 − d)/d/(m impratio), K = 1/(d T ζ)²: to 1e-9 of itself; and back."""
    scene = slider(impratio=impratio, integrator=integrator, tolerance=1e-15)
    sim = sc.Sim(scene.compile())
    sim.step(2000)
    start = float(sim.qpos[0])
    d, force = 0.9, 5.0
    sim.qfrc_applied[0] = force
    sim.step(4000)
    sag = (1 - d) / d / (2.0 * impratio) * force / (d / (d * 0.02) ** 2)
    assert float(sim.qpos[0]) - start == pytest.approx(sag, rel=1e-9)
    sim.qfrc_applied[0] = 0
    sim.step(4000)
    assert float(sim.qpos[0]) - start == pytest.approx(0, abs=1e-8 * sag)


@pytest.mark.parametrize("cone", ["elliptic", "pyramidal"])
def test_beyond_its_bound_it_slips_as_coulomb_says(cone):
    """v̇ = F/m − μ g in the mean, to a tenth: friction of `solref` lifts what slides and drops it.

    It stops when the force is gone.
    """
    sim = sc.Sim(slider(cone).compile())
    sim.step(1000)
    sim.qfrc_applied[0] = 2.0 * 0.5 * G * 1.5
    sim.step(500)
    before = float(sim.qvel[0])
    sim.step(500)
    assert float(sim.qvel[0]) - before == pytest.approx(0.25 * G, rel=0.1)
    sim.qfrc_applied[0] = 0
    sim.step(3000)
    assert abs(float(sim.qvel[0])) < 1e-9
    rest = float(sim.qpos[0])
    sim.step(1000)
    assert float(sim.qpos[0]) == pytest.approx(rest, abs=1e-9)


@pytest.mark.parametrize("condim", [3, 6])
def test_a_ball_on_a_slope_holds_by_rolling_friction(condim):
    """Under condim 3 it rolls away; with a rolling coefficient above r tan θ it hangs."""
    slope = math.radians(10)
    scene = sc.Scene(gravity=(G * math.sin(slope), 0, -G * math.cos(slope)))
    scene.options.update(dt=0.002, cone="elliptic", stiction=True)
    body = scene.add_body("ball", pos=(0, 0, 0.1))
    scene.add_joint(body, "free")
    scene.add_geom(body, "sphere", 0.1, mass=1.0, condim=condim, friction=(1, 0.01, 0.05))
    scene.add_geom("world", "plane")
    sim = sc.Sim(scene.compile())
    sim.step(2000)
    start = ball(sim)
    sim.step(1000)
    way = np.linalg.norm(ball(sim) - start)
    assert way < 2 * NANO if condim == 6 else way > 1


@pytest.mark.parametrize("warm_start", [True, False])
def test_a_snapshot_holds_the_slip(warm_start):
    text, ctrl = pinch()
    sim = hanging(text, ctrl, stiction=True, warm_start=warm_start)
    sim.step(100)
    kept = sim.state()
    sim.step(50)
    after = np.array(sim.qpos)
    other = hanging(text, ctrl, stiction=True, warm_start=warm_start)
    other.restore(kept)
    other.step(50)
    assert np.array_equal(np.array(other.qpos), after)


@every_pair(solver=SOLVERS, precision=["f64", "f32"])
def test_lanes_are_scalars(precision, solver):
    """Eight worlds with other grips, side by side and alone, bit for bit."""
    text, ctrl = pinch()
    settings = {"stiction": True, "precision": precision, "noslip_iterations": 2, **SOLVERS[solver]}
    settings |= {"tolerance": 1e-6, "sweeps": 50} if solver == "pgs" else {}
    model = sc.loads(text).compile()
    batch = sc.Batch(model, 8, **settings)
    # The weakest slip, one is open.
    grips = np.array([0.0, 0.01, 0.04, 0.06, 0.5, 1.0, 1.5, 2.0])
    batch.ctrl = ctrl * grips[:, None]
    batch.step(200)
    for world, grip in enumerate(grips):
        sim = sc.Sim(model, **settings)
        sim.ctrl = ctrl * grip
        sim.step(200)
        assert np.array_equal(np.array(batch.qpos)[world], np.array(sim.qpos)), world


def test_single_precision_hangs_too():
    """To what its roundings of a position are: 1e-10 m in a step of 2 ms would be 50 nm/s."""
    text, ctrl = pinch()
    sim = hanging(text, ctrl, stiction=True, precision="f32")
    sim.step(500)
    start = ball(sim)
    sim.step(2500)
    assert np.linalg.norm(ball(sim) - start) < 1e-8


def test_the_account_of_energy_is_balanced():
    text, ctrl = pinch()
    sim = hanging(text, ctrl, stiction=True, ledger=True)
    sim.step(640)
    sim.balance()


@pytest.mark.parametrize("cone", ["elliptic", "pyramidal"])
def test_springs_of_friction_give_no_more_than_they_took(cone):
    """A ball that slides, stops and swings back on its spring never has more energy than before."""
    scene = slider(cone, ledger=True)
    sim = sc.Sim(scene.compile())
    sim.step(2000)
    sim.qvel[:2] = 0.3, 0.2
    most = sum(sim.energy[:2])
    for _ in range(1000):
        sim.step(1)
        now = sum(sim.energy[:2])
        assert now <= most + 1e-9 * 20
    sim.balance()


@pytest.mark.parametrize("cone", ["elliptic", "pyramidal"])
def test_noslip_ends_creep_at_once(cone):
    """After enough sweeps the speed along friction is 0, as R = 0 says; nothing has sagged."""
    text, ctrl = pinch(cone=cone)
    sim = hanging(text, ctrl, noslip_iterations=50)
    sim.step(500)
    start = ball(sim)
    sim.step(2000)
    assert np.linalg.norm(ball(sim) - start) < 4e-6
    both = hanging(text, ctrl, noslip_iterations=50, stiction=True)
    both.step(500)
    start = ball(both)
    both.step(4500)
    assert np.linalg.norm(ball(both) - start) < 9 * NANO


def test_other_laws_take_no_notice():
    text, ctrl = pinch()
    runs = []
    for settings in ({}, {"stiction": True, "noslip_iterations": 3}):
        sim = hanging(text, ctrl, law="rigid", solver="pgs", integrator="semi-implicit", **settings)
        sim.step(100)
        runs.append(np.array(sim.qpos))
    assert np.array_equal(*runs)


@every_pair(units=[(3, 0, 0), (0, 4, 0), (0, 0, 5), (-2, 3, -4)], cone=["elliptic", "pyramidal"])
def test_units_scale_bit_for_bit(cone, units):
    """Metres, kilograms and seconds of other sizes, powers of two: the same run to the bit."""
    plain = slider(cone, condim=6, noslip_iterations=2)
    other = transforms.scaled(plain, *units)
    runs = []
    for transform, scene in ((None, plain), (other, other.scene)):
        sim = sc.Sim(scene.compile())
        sim.qvel = (0.3, 0.2, 0) if transform is None else other.qvel(np.array([0.3, 0.2, 0]))
        sim.step(300)
        runs.append(np.array(sim.qpos))
    assert np.array_equal(other.qpos(runs[0]), runs[1])
