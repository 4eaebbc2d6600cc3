"""What is the model's error and what is the numbers': softness, cones, single precision."""

import math

import numpy as np
import pytest

import stepcore as sc
from stepcore import lesson
from stepcore.experiment.arguments import Workers
from stepcore.experiment.motion import Motion
from stepcore.experiment.other_models import ErrorSplit, stiffer, time_scale
from stepcore.experiment.reference import ReferenceRuns
from stepcore.experiment.runner import Runner
from stepcore.experiment.schedule import scheduled
from stepcore.report.progress import Progress

G = 9.81


def resting(**options):
    """A ball on a soft floor, starting where it just touches."""
    scene = sc.Scene(gravity=(0, 0, -G), name="resting")
    scene.add_geom("world", "plane", condim=1)
    scene.add_body("ball", pos=(0, 0, 0.1))
    scene.add_joint("ball", "slide", axis=(0, 0, 1))
    scene.add_geom("ball", "sphere", 0.1, mass=2.0, condim=1)
    scene.options = {"dt": 0.004, "integrator": "euler"} | options
    return scene


def slider(degrees, **options):
    """A ball that cannot roll slides on a floor at 2 m/s."""
    scene = sc.Scene(gravity=(0, 0, -G), name="slider")
    scene.add_geom("world", "plane", friction=0.5)
    body = scene.add_body("block", pos=(0, 0, 0.1))
    for axis in ((1, 0, 0), (0, 1, 0), (0, 0, 1)):
        scene.add_joint(body, "slide", axis=axis)
    scene.add_geom(body, "sphere", 0.1, mass=1.0, friction=0.5)
    angle = math.radians(degrees)
    scene.add_key(qvel=[2 * math.cos(angle), 2 * math.sin(angle), 0])
    scene.options = {"dt": 0.004, "integrator": "semi-implicit", "solver": "pgs"}
    scene.options |= {"law": "lesson", "cone": "elliptic", "sweeps": 100} | options
    return scene


def models(scene, horizon=0.16, period=0.008, finest=0.002):
    """The models of a scene, with their reference, one start."""
    model = scene.compile()
    runner = Runner(model, scheduled(Motion(horizon=horizon, starts=1), model, period))
    runs = ReferenceRuns(runner, model.settings, finest, 1e6, Workers())
    reference = runs.reference(Progress("", 1, False))
    return ErrorSplit(runs, reference, runs.size)


def test_softness_against_rigid_is_how_deep_it_rests():
    # Sixteen times shorter time constants rest 256 times less deep: what is left is the depth.
    found = models(resting(), horizon=0.4)
    gap = found.gaps()["softness"]
    sim = sc.Sim(resting(), dt=1e-4)
    depth = [0.0]
    for _ in range(50):
        sim.step(80)
        depth.append(float(sim.qpos[0]))
    rms = math.sqrt(np.mean(np.square(depth[1:])))
    assert gap.distance == pytest.approx(rms, rel=0.02) and gap.settled
    assert gap.against == "solref time constants / 16"
    assert "pyramid" not in found.gaps()


def test_a_penalty_is_soft_by_its_spring():
    # It sinks to m g / k, critically damped: x = m g / k (1 - (1 + ω t) e^(-ω t)).
    options = {"law": "penalty", "integrator": "semi-implicit", "solver": "pgs", "dt": 0.002}
    options |= {"penalty_stiffness": 1e4, "penalty_damping_ratio": 1.0}
    found = models(resting(**options), horizon=0.4)
    gap = found.gaps()["softness"]
    turn = math.sqrt(1e4 / 2.0) * found.runs.runner.schedule.times
    depth = 2.0 * G / 1e4 * (1 - (1 + turn) * np.exp(-turn))
    rms = math.sqrt(np.mean(depth**2))
    assert gap.distance == pytest.approx(rms * (1 - 1 / 256), rel=0.02) and gap.settled
    assert gap.against == "penalty_stiffness × 256"


def test_what_refsafe_clamps_is_another_model():
    # At dt 20 ms the time constant is 40 ms: it rests (40/20)² times as deep.
    found = models(resting(dt=0.02), horizon=0.64, period=0.04)
    shipped = found.runs.shipped
    errors = found.errors(shipped, [found.runs.runner.run(shipped, 0)])
    depth = []
    for tau in (0.02, 0.04):
        scene = resting()
        for geom in scene.geoms:
            geom.solref = (tau, 1.0)
        sim = sc.Sim(scene, dt=1e-4)
        depth.append([])
        for _ in range(len(found.runs.runner.schedule.times)):
            sim.step(round(10 * 1000 * found.runs.runner.schedule.times[0]))
            depth[-1].append(float(sim.qpos[0]))
    wanted = math.sqrt(np.mean(np.subtract(*depth) ** 2))
    assert errors.modelling == pytest.approx(wanted, rel=0.02)
    assert errors.numerical < errors.position


def test_a_stiffer_scene_is_stiffer_however_solref_is_given():
    scene = resting()
    scene.geoms[0].solref = (-1000.0, -20.0)
    hard = stiffer(scene, 4.0)
    assert hard.geoms[0].solref == (-16000.0, -80.0)
    assert hard.geoms[1].solref == (0.005, 1.0)
    assert scene.geoms[1].solref == (0.02, 1.0)


def test_the_box_against_the_cone_is_how_far_apart_they_slide():
    # At 45° the box slows both tangents by μ g, the cone by μ g / √2 each.
    found = models(slider(45))
    limit = found.limit(found.runs.shipped.replace(cone="pyramidal"))
    paths = [found.runs.runner.run(found.runs.shipped.replace(cone="pyramidal"), 0)]
    errors = found.errors(found.runs.shipped.replace(cone="pyramidal"), paths)
    times = found.runs.runner.schedule.times
    wanted = math.sqrt(2) * (1 - 1 / math.sqrt(2)) * 0.5 * G * times**2 / 2
    assert errors.modelling == pytest.approx(math.sqrt(np.mean(wanted**2)), rel=0.01)
    # Against its own limit it is wrong by what dt makes: v-first, μ g dt t / 2 each tangent.
    own = math.sqrt(2) * 0.5 * G * 0.004 * times / 2
    assert errors.numerical == pytest.approx(math.sqrt(np.mean(own**2)), rel=0.1)
    assert errors.position == pytest.approx(errors.modelling + errors.numerical, rel=0.1)
    assert limit.dt == found.base.dt
    # The shipped model has no modelling error, whatever its dt.
    shipped = found.errors(found.runs.shipped, [found.runs.runner.run(found.runs.shipped, 0)])
    assert shipped.modelling == 0 and shipped.numerical == shipped.position


def test_the_pyramid_as_shipped_is_told_from_the_cone():
    found = models(slider(45, cone="pyramidal"))
    gap = found.gaps()["pyramid"]
    times = found.runs.runner.schedule.times
    wanted = math.sqrt(2) * (1 - 1 / math.sqrt(2)) * 0.5 * G * times**2 / 2
    assert gap.distance == pytest.approx(math.sqrt(np.mean(wanted**2)), rel=0.01)
    # Along an axis there is no difference.
    assert models(slider(0, cone="pyramidal")).gaps()["pyramid"].distance < 1e-9


def test_single_precision_is_a_modelling_error():
    result = sc.trade(
        lesson.spring(),
        starts=1,
        horizon=0.4,
        dts=[0.01],
        integrators=["semi-implicit"],
        precisions=["f64", "f32"],
        by="flops",
        threads=1,
        progress=False,
    )
    rows = {row.settings.precision: row.errors for row in result.rows}
    assert rows["f64"].modelling == 0 and rows["f64"].numerical == rows["f64"].position
    assert rows["f32"].numerical == rows["f64"].position
    # A rounding a step, 40 steps, of a metre: some 1e-7.
    assert 1e-9 < rows["f32"].modelling < 1e-5
    record = result.table[0]
    assert set(record) >= {"numerical", "modelling", "momentum", "joint", "limit", "creep"}


def dropped(tau):
    """A ball let go 0.05 m above a floor that is given this time constant [s]."""
    scene = resting(dt=0.002)
    scene.body("ball").pos = (0, 0, 0.15)
    for geom in scene.geoms:
        geom.solref = (tau, 1.0)
    return scene


def test_the_softness_of_a_stiff_contact_is_measured_at_steps_that_resolve_it():
    # The ball with a sixteenth of the time constant, by plain steps of a 64th of that.
    found = models(dropped(0.004), horizon=0.2, finest=0.0005)
    gap = found.gaps()["softness"]
    times = found.runs.runner.schedule.times
    heights = []
    for tau in (0.004, 0.004 / 16):
        steps = round(times[0] * 64 / tau)
        sim = sc.Sim(dropped(tau), dt=times[0] / steps, integrator="rk4", refsafe=False)
        heights.append([])
        for _ in times:
            sim.step(steps)
            heights[-1].append(float(sim.qpos[0]))
    wanted = math.sqrt(np.mean(np.subtract(*heights) ** 2))
    assert gap.distance == pytest.approx(wanted, rel=0.02)
    # Five hundredths of a metre cannot move by more; what was printed here once was metres.
    assert gap.distance < 0.05


def test_softness_that_no_affordable_step_resolves_is_not_told():
    """1/16 of a time constant of 0.5 ms takes steps of 4 µs: more than the budget of 1e4 allows."""
    found = models(dropped(0.0005), horizon=0.2)
    found.runs.budget = 1e4
    assert found.acts and "softness" not in found.gaps()


def test_the_shortest_time_of_a_contact_is_that_of_its_oscillator_or_its_damper():
    scene = resting()
    scene.geoms[1].solref = (0.008, 0.5)
    assert time_scale(scene) == 0.004
    # 1/√k = 10 ms, 2/b = 1 ms.
    scene.geoms[1].solref = (-1e4, -2000.0)
    assert time_scale(scene) == pytest.approx(1e-3)
    scene.geoms[0].contype = scene.geoms[0].conaffinity = 0
    scene.geoms[1].contype = scene.geoms[1].conaffinity = 0
    assert time_scale(scene) == math.inf
