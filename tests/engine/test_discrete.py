"""`discrete` and `implicit`: closed forms, stability, orders, and rows solved in the metric M̂."""

import itertools
import math

import menagerie
import numpy as np
import pytest

import stepcore as sc

SERVO = """<mujoco><option timestep="{dt}" integrator="{integrator}" gravity="0 0 0"/><worldbody>
 <body><joint name="rail" type="slide" damping="{damping}"/><geom size=".1" mass="2"/></body>
 </worldbody><actuator><position joint="rail" kp="{kp}" kv="{kv}"/></actuator></mujoco>"""
# Fingers on one palm and a wheel of another tree, tied by two stiff tendons.
TIED = """<mujoco>
 <option timestep="{dt}" integrator="discrete" solver="{solver}" iterations="2000"/>
 <worldbody><geom type="plane" size="2 2 .1" pos="0 0 {floor}"/>
 <body name="palm" pos="0 0 1"><joint name="palm" type="slide" axis="0 0 1"/>
  <geom type="box" size=".2 .1 .05" mass="1"/>
  <body pos=".2 0 0"><joint name="left" axis="0 1 0"/>
   <geom type="capsule" size=".03" fromto="0 0 0 .1 0 -.3" mass=".2"/></body>
  <body pos="-.2 0 0"><joint name="right" axis="0 1 0"/>
   <geom type="capsule" size=".03" fromto="0 0 0 -.1 0 -.3" mass=".3"/></body>
  <body pos="0 .2 0"><joint name="third" axis="1 0 0"/>
   <geom type="capsule" size=".03" fromto="0 0 0 0 .1 -.3" mass=".3"/></body></body>
 <body name="wheel" pos="3 0 1"><joint name="wheel" axis="0 1 0"/>
  <geom type="cylinder" size=".1 .02" mass="1"/></body></worldbody>
 <tendon><fixed name="grip" stiffness="{k}" damping="{d}"><joint joint="left" coef="1"/>
   <joint joint="right" coef="-1"/><joint joint="third" coef=".5"/></fixed>
  <fixed name="belt" stiffness="{k}" damping="{d}"><joint joint="wheel" coef="1"/>
   <joint joint="left" coef="2"/></fixed></tendon></mujoco>"""


def servo(kp, kv, dt, integrator="discrete", damping=0.0):
    text = SERVO.format(kp=kp, kv=kv, dt=dt, integrator=integrator, damping=damping)
    sim = sc.Sim(sc.loads(text))
    sim.qpos[0], sim.qvel[0] = 0.3, -0.7
    return sim


@pytest.mark.parametrize("kp", (10.0, 1e6, 1e12))
@pytest.mark.parametrize("dt", (1e-3, 0.02, 10.0))
def test_a_servo_decays_as_its_map_says(kp, dt):
    """Law: v⁺ = (m v − h kp q)/(m + h kv + h² kp), q⁺ = q + h v⁺, at any stiffness and step."""
    m, kv, h = 2.0, 0.1 * math.sqrt(kp), dt
    sim, state = servo(kp, kv, dt), np.array([0.3, -0.7])
    for _ in range(20):
        v = (m * state[1] - h * kp * state[0]) / (m + h * kv + h * h * kp)
        state = np.array([state[0] + h * v, v])
        sim.step()
        assert abs(sim.qpos[0] - state[0]) < 1e-12
        assert abs(sim.qvel[0] - state[1]) < 1e-12 * max(1.0, 1 / h)
    energy = 0.5 * m * state[1] ** 2 + 0.5 * kp * state[0] ** 2
    assert energy < 0.5 * m * 0.49 + 0.5 * kp * 0.09


def test_a_force_at_its_bound_is_explicit():
    """Law: where the bound of a servo's force is reached it is a constant force."""
    text = SERVO.format(kp=1e6, kv=0, dt=0.01, integrator="discrete", damping=0)
    text = text.replace("<position ", '<position forcelimited="true" forcerange="-3 3" ')
    sim = sc.Sim(sc.loads(text))
    sim.ctrl[0] = 1.0
    sim.step()
    assert float(sim.qvel[0]) == pytest.approx(0.01 * 3 / 2, rel=1e-14)


def test_orders():
    """Law: both are of first order: half the step, half the error."""
    for integrator in ("implicit", "discrete"):
        errors = []
        for count in (400, 800, 1600):
            sim = servo(50.0, 1.0, 1.0 / count, integrator, damping=2.0)
            sim.step(count)
            rate = np.array([[0, 1], [-25.0, -1.5]])
            values, vectors = np.linalg.eig(rate)
            exact = vectors @ np.diag(np.exp(values)) @ np.linalg.inv(vectors) @ [0.3, -0.7]
            errors.append(abs(sim.qpos[0] - exact[0].real))
        ratios = [a / b for a, b in itertools.pairwise(errors)]
        assert ratios == pytest.approx([2, 2], rel=0.05), integrator


def metric(sim, k, d, dt):
    """M̂, and dt K v."""
    arms = np.zeros((2, sim.model.nv))
    at = {name: int(sim.model.jnt_dofadr[i]) for i, name in enumerate(sim.model.joint_names)}
    arms[0, [at["left"], at["right"], at["third"]]] = 1, -1, 0.5
    arms[1, [at["wheel"], at["left"]]] = 1, 2
    square = arms.T @ arms
    return sim.mass_matrix() + (dt * d + dt * dt * k) * square, dt * k * square @ sim.qvel


@pytest.mark.parametrize("k", (10.0, 1e4, 1e8))
def test_tendons_across_branches_and_trees(k):
    """Law: M̂ (v⁺ − v) = dt (f − dt K v), M̂ with every entry that a tendon makes, made by numpy."""
    dt, d = 0.02, 0.01 * k
    sim = sc.Sim(sc.loads(TIED.format(dt=dt, solver="Newton", floor=-9, k=k, d=d)))
    rng = np.random.default_rng(1)
    for _ in range(10):
        sim.qpos[:], sim.qvel[:] = 0.1 * rng.normal(size=5), rng.normal(size=5)
        sim.forward()
        whole, shift = metric(sim, k, d, dt)
        start = np.array(sim.qvel)
        force = np.array(sim.passive) - np.array(sim.bias) - shift
        wanted = start + dt * np.linalg.solve(whole, force)
        sim.step()
        # What the condition of M̂ leaves of digits.
        assert np.abs(sim.qvel - wanted).max() < 1e-10 + 1e-15 * np.linalg.cond(whole)
    sim.step(500)
    assert np.abs(sim.qvel).max() < 1e3 and np.isfinite(sim.qpos).all()


def test_rows_are_solved_in_that_metric():
    """Law: M̂ (v⁺ − v) = dt (f − dt K v) + Jᵀλ, and PGS and Newton agree."""
    dt, k, d = 0.005, 2e4, 50.0
    last = {}
    for solver in ("PGS", "Newton"):
        text = TIED.format(dt=dt, solver=solver, floor=0.65, k=k, d=d)
        sim = sc.Sim(sc.loads(text).with_settings(tolerance=1e-13, cost_tolerance=0.0))
        touched = 0
        for _ in range(60):
            sim.forward()
            whole, shift = metric(sim, k, d, dt)
            start = np.array(sim.qvel)
            force = np.array(sim.passive) - np.array(sim.bias) - shift
            force += np.array(sim.constraint_force)
            touched += len(sim.contacts) > 0
            wanted = start + dt * np.linalg.solve(whole, force)
            sim.step()
            assert np.abs(sim.qvel - wanted).max() < 1e-9
        assert touched > 20
        last[solver] = np.concatenate([sim.qpos, sim.qvel])
    assert np.abs(last["PGS"] - last["Newton"]).max() < 1e-6


def test_lanes_and_single_precision():
    """Law: a world of a batch is that world alone; f32 is near it."""
    text = TIED.format(dt=0.005, solver="Newton", floor=0.65, k=1e4, d=10.0)
    model = sc.loads(text).compile()
    batch = sc.Batch(model, 9)
    rng = np.random.default_rng(2)
    batch.qvel[:] = 0.3 * rng.normal(size=(9, 5))
    sims = [sc.Sim(model) for _ in range(9)]
    for sim, qvel in zip(sims, batch.qvel, strict=True):
        sim.qvel[:] = qvel
    rough = sc.Sim(model.with_settings(precision="f32"))
    rough.qvel[:] = batch.qvel[0]
    batch.step(40)
    for sim, qpos in zip(sims, batch.qpos, strict=True):
        sim.step(40)
        assert np.array_equal(sim.qpos, qpos)
    rough.step(40)
    assert np.abs(rough.qpos - sims[0].qpos).max() < 1e-3


def test_linearize_is_a_difference():
    """Law: the derivative of the step is the limit of differences, tendons and contacts in it."""
    text = TIED.format(dt=0.01, solver="Newton", floor=-9, k=300.0, d=3.0)
    for integrator in ("discrete", "implicit"):
        sim = sc.Sim(sc.loads(text).with_settings(integrator=integrator))
        sim.qpos[:], sim.qvel[:] = 0.1, (0.1, 2, -1, 1, 3)
        start = sim.state()
        step, h = sim.linearize(), 1e-6
        for way in range(10):
            ends = []
            for sign in (1, -1):
                sim.restore(start)
                (sim.qpos if way < 5 else sim.qvel)[way % 5] += sign * h
                sim.step()
                ends.append(np.concatenate([sim.qpos, sim.qvel]))
            slope = (ends[0] - ends[1]) / (2 * h)
            assert np.abs(step.A[:, way] - slope).max() < 1e-6


def test_the_ledger_balances_and_the_limit_is_infinite():
    """Law: a stiff servo under `discrete` loses energy and no more; diagnose finds no limit."""
    sim = sc.Sim(servo(1e5, 1.0, 0.02).model, ledger=True)
    sim.qpos[0], sim.qvel[0] = 0.3, -0.7
    sim.step(2000)
    assert abs(sim.qpos[0]) < 1e-6
    for solver in ("PGS", "Newton"):
        text = TIED.format(dt=0.005, solver=solver, floor=0.65, k=1e5, d=10.0)
        sc.Sim(sc.loads(text), ledger=True).step(1000)
    diagnosis = sc.diagnose(servo(1e5, 1.0, 0.02).model)
    assert math.isinf(diagnosis.limit("discrete"))
    assert diagnosis.limit("implicitfast") < 0.02


@menagerie.needed
@pytest.mark.parametrize(
    ("path", "key"),
    ((menagerie.SO101, None), (menagerie.UR5E, "home"), (menagerie.PANDA, "home")),
    ids=("so101", "ur5e", "panda"),
)
def test_robots_hold_their_pose_at_20_ms(path, key):
    """Law: position servos of a real arm hold it for 10 s at dt 20 ms, near where 1 ms holds it."""
    scene = sc.load(path)
    ends = []
    for dt in (0.02, 0.001):
        sim = sc.Sim(scene.with_settings(integrator="discrete", dt=dt))
        sim.reset(key)
        if key is None:
            sim.ctrl[:] = sim.qpos[: sim.model.nu]
        sim.step(round(10 / dt))
        assert np.abs(sim.qvel).max() < 1e-6
        ends.append(np.array(sim.qpos))
    # The Panda's fingers are tied by a soft equality, which `refsafe` makes softer at 20 ms.
    limit = 1e-5 if scene.equalities else 1e-6
    assert np.abs(ends[0] - ends[1]).max() < limit
