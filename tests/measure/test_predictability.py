"""The time for which scenes can be predicted, against closed forms; the report after it."""

import json
import math
from concurrent.futures import ProcessPoolExecutor
from dataclasses import dataclass

import numpy as np
import pytest

import stepcore as sc
from stepcore import lesson
from stepcore.cli import main
from stepcore.experiment import predictable
from stepcore.experiment.engines import Way
from stepcore.experiment.predictable import Growth, _end
from stepcore.measure.predictability import growing

QUIET = {"threads": 1, "progress": False}


def pendulum(links=2, **options):
    """Point masses of 1 kg on rods of 1 m, all horizontal."""
    scene = sc.Scene(gravity=(0, 0, -9.81), name="pendulum")
    parent = "world"
    for i in range(links):
        at = (0, 0, -1.0) if i else (0, 0, 0)
        body = scene.add_body(f"rod{i}", parent, pos=at, mass=1.0, ipos=(0, 0, -1))
        body.inertia = (1e-9, 1e-9, 1e-9)
        # The axis for which a growing angle is to the right of one who looks along +y.
        scene.add_joint(body, "hinge", axis=(0, -1, 0))
        parent = body
    scene.add_key(qpos=[math.pi / 2, *[0.0] * (links - 1)])
    scene.options = {"dt": 0.01, "integrator": "rk4"} | options
    return scene


SMALL = """<mujoco><option timestep=".001"/><worldbody><body><joint name="a" axis="0 1 0"/>
<geom type="capsule" size=".002" fromto="0 0 0 .02 0 0" contype="0"/><body pos=".02 0 0">
<joint name="b" axis="0 1 0" damping="1e-9"/>
<geom type="capsule" size=".002" fromto="0 0 0 .02 0 .01" contype="0"/></body></body></worldbody>
</mujoco>"""
OWN = {
    "trade": {"starts": 2},
    "converge": {"starts": 2},
    "ablate": {"starts": 2, "further": 0},
    "stability_map": {"path": "joint/b/damping", "values": [1e-9, 2e-9], "dts": [0.001]},
}


@pytest.mark.parametrize("measure", OWN)
def test_every_error_of_a_part_of_the_horizon_says_so(measure):
    """Errors over the predictable 1.6 s of this motion do not bound the rest of it."""
    of = "from 2 of 2 starts" if "starts" in OWN[measure] else "at 2 of 2 values"
    said = f"Errors count only while the motion can be predicted: {of}"
    for horizon, whole in ((2.0, False), (1.0, True)):
        result = getattr(sc, measure)(sc.loads(SMALL), horizon=horizon, **OWN[measure], **QUIET)
        assert (said in " ".join(result.text().split())) is not whole


def test_the_double_pendulum_from_the_horizontal():
    # Runs of point masses part 13 times in 8 s, 1.4e2 in 10 s, 1.5e4 in 15 s, 9.4e5 in 20 s, to
    # a factor of three, which depends on the initial states.
    found = sc.predict(pendulum(), horizon=20.0, starts=1, **QUIET)
    factor, times = found.growth.factor[0], found.growth.times
    for time, wanted in ((8, 13), (10, 1.4e2), (20, 9.4e5)):
        near = np.abs(times - time) <= 0.81
        assert wanted / 3 < factor[near].max() < 3 * wanted
    assert 10 < found.time < 15
    # The figures are for this scene: its angles from below at 5 s.
    sim = sc.Sim(pendulum(), dt=1e-3)
    sim.reset(key=0)
    sim.step(5000)
    angles = np.cumsum(sim.qpos)
    assert angles == pytest.approx([-0.62718670507, -1.30131553021], abs=1e-7)


def test_a_single_pendulum_can_be_predicted():
    # Periods differ with the amplitude: perturbed runs part as t, not as an exponential.
    found = sc.predict(pendulum(1), horizon=20.0, starts=2, **QUIET)
    assert found.time == math.inf
    assert 5 < found.growth.factor.max() < 50
    half = found.growth.factor[0][found.growth.times <= 10].max()
    assert found.growth.factor[0].max() == pytest.approx(2 * half, rel=0.25)


def billiard():
    """A ball between two fixed ones of its size, 1 m away; everything elastic, no friction."""
    scene = sc.Scene(gravity=(0, 0, 0), name="billiard")
    for x in (-1.5, 1.5):
        scene.add_geom("world", "sphere", 0.5, pos=(x, 0, 0), condim=1)
    scene.add_body("ball", mass=1.0, inertia=(1, 1, 1))
    for axis in ((1, 0, 0), (0, 1, 0)):
        scene.add_joint("ball", "slide", axis=axis)
    scene.add_geom("ball", "sphere", 0.5, condim=1)
    scene.add_key(qvel=[1.0, 0.0])
    scene.options = {"dt": 0.01, "integrator": "semi-implicit", "solver": "pgs"}
    scene.options |= {"law": "rigid", "restitution": 1.0, "sweeps": 20}
    return scene


def test_bounces_part_perturbed_runs_as_mirrors_part_rays():
    # The round mirror's matrix: y' = y + l θ', θ' = θ + 2 y / ρ, with the flight l = 1 m and the
    # sum of radii ρ = 1 m: eigenvalue 2 + √3 a bounce. Impacts fall exactly on ends of steps.
    found = sc.predict(billiard(), horizon=8.0, starts=1, **QUIET)
    factor, times = found.growth.factor[0], found.growth.times
    at = [float(np.interp(t, times, factor)) for t in (4.0, 5.0, 6.0, 7.0)]
    assert np.array(at[1:]) / at[:-1] == pytest.approx([2 + math.sqrt(3)] * 3, rel=0.02)
    # About 1.5 of them have gone by when growth begins at the first bounce, 0.5 s.
    assert found.time == pytest.approx(0.5 + math.log(1e3) / math.log(2 + math.sqrt(3)), abs=0.6)


def test_a_contact_met_one_step_later_is_no_loss():
    """A capsule falls on a floor and rolls to rest: nothing in it is unpredictable."""
    capsule = """<mujoco><option timestep="0.002"/><worldbody><geom type="plane" size="1 1 .1"/>
      <body pos="0 0 .5"><freejoint/><geom type="capsule" size=".03 .1" mass="1"/></body>
      </worldbody></mujoco>"""
    found = sc.predict(sc.loads(capsule), horizon=1.0, starts=24, **QUIET)
    assert found.time == math.inf and found.growth.factor.max() < 50


def test_one_motion_has_one_answer_whatever_the_horizon():
    short, long = (sc.predict(billiard(), horizon=t, starts=2, **QUIET) for t in (6.4, 9.6))
    assert short.time < 6.4 and long.growth.ends.tolist() == short.growth.ends.tolist()
    count = len(short.growth.times)
    assert np.array_equal(long.growth.factor[:, :count], short.growth.factor)


def test_growth_ends_between_samples_and_masks_what_follows():
    samples = np.array([1.0, 2.0, 3.0])
    growth = Growth(samples, np.ones((2, 3)), np.array([1.5, np.inf]))
    assert growth.scored(samples).tolist() == [[True, False, False], [True, True, True]]
    assert growth.overall == 1.5


def test_perturbed_runs_that_close_again_are_not_lost():
    def end(*factor):
        times = np.arange(1.0, 1 + len(factor))
        return _end(times, np.array(factor))

    assert end(1, 10, 1e2, 20, 1) == math.inf
    assert end(1, 1e4, 1e2, 20, 1) == math.inf
    # As if exponential between 1 at 1 s and 1e6 at 2 s.
    assert end(1, 1e6, 1e2, 1e7) == pytest.approx(1.5)
    assert end(1, 1e6, 1.0, 1e6) == pytest.approx(3.5)
    assert end(1e6) == pytest.approx(0.5) and end(1, np.nan) == pytest.approx(1.0)


def test_a_predictability_prints_exports_and_plots(tmp_path):
    found = sc.predict("lesson:spring", horizon=1.0, starts=2, **QUIET)
    assert "over all of 1 s" in str(found) and found.to_dict()["predictable"] is None
    assert len(found.to_dict()["growth"]) == 2
    figure = found.plot(tmp_path / "growth.png")
    assert figure.axes[0].get_yscale() == "log"
    with pytest.raises(ValueError, match="nothing in it can move"):
        sc.predict(sc.Scene(), **QUIET)
    with pytest.raises(ValueError, match="horizon"):
        sc.predict(lesson.spring(), horizon=-1.0, **QUIET)


def test_processes_find_the_same():
    options = {"horizon": 0.4, "starts": 2, "progress": False}
    here = sc.predict(lesson.drop(), threads=1, **options)
    with ProcessPoolExecutor(1) as pool:
        there = sc.predict(lesson.drop(), executor=pool, **options)
    assert here.to_json() == there.to_json()


def test_the_command_predicts(capsys, tmp_path):
    arguments = ["predict", "lesson:spring", "--horizon", "0.5", "--starts", "1"]
    assert main([*arguments, "--json", "--plot", str(tmp_path / "growth.png")]) == 0
    data = json.loads(capsys.readouterr().out)
    assert data["predictable"] is None and data["limit"] == 1e3
    assert len(data["growth"][0]) == len(data["times"])
    assert main([*arguments, "--key", "nowhere"]) == 2


def test_runs_that_reconverge_count_as_predictable():
    """Near the top of a pendulum each passage separates the runs by e^λt, and closes them again."""
    scene = sc.Scene(gravity=(0, 0, -9.81))
    bob = scene.add_body("bob", mass=1.0, ipos=(0, 0, -1), inertia=(1e-9, 1e-9, 1e-9))
    scene.add_joint(bob, "hinge", axis=(0, 1, 0))
    scene.add_key(qpos=[math.pi - 1e-4])
    scene.options = {"dt": 0.01}
    short, long = (sc.predict(scene, horizon=t, starts=1, progress=False) for t in (10.0, 16.0))
    assert short.time == pytest.approx(9.3, abs=0.05) and "reconverge" in short.text()
    assert long.time == math.inf and long.growth.factor.max() > 1e4


# Two links whose servos damp quickly, within the bounds of their forces: an explicit step chatters.
SERVOS = """<mujoco><option timestep=".002" integrator="implicitfast"/><worldbody>
<body><joint name="p" axis="0 1 0" damping=".5"/>
<geom type="capsule" size=".02" fromto="0 0 0 .3 0 0" mass=".6" contype="0" conaffinity="0"/>
<body pos=".3 0 0"><joint name="q" axis="0 1 0"/>
<geom type="capsule" size=".01" fromto="0 0 0 .05 0 0" mass="{}" contype="0" conaffinity="0"/>
</body></body></worldbody><actuator>
<position name="p" joint="p" kp="{}" kv="{}" forcerange="-40 40"/>
<position name="q" joint="q" kp="200" kv="{}" forcerange="-5 5"/></actuator></mujoco>"""


def waved(time, sim):
    return [0.5 * np.sin(3 * time), 0.5 * np.sin(5 * time)]


def grown_plainly(model, horizon):
    """The largest growth of a difference of 1e-8, in runs of a sixteenth of the step."""
    one, other = (sc.Sim(model, dt=model.settings.dt / 16) for _ in "ab")
    other.qpos[:] += 1e-8
    most = 0.0
    for k in range(round(horizon / model.settings.dt)):
        for sim in (one, other):
            sim.ctrl[:] = waved(k * model.settings.dt, sim)
            sim.step(16)
        most = max(most, float(np.abs(one.qpos - other.qpos).max()) / 1e-8)
    return most


@pytest.mark.parametrize("seed", range(3))
def test_servos_too_quick_for_rk4_are_no_chaos(seed):
    mass, kp, kv, small = np.random.default_rng(seed).uniform(
        [0.005, 200, 20, 5], [0.05, 800, 80, 40]
    )
    model = sc.loads(SERVOS.format(mass, kp, kv, small)).compile()
    found = sc.predict(
        model, control=waved, control_dt=0.002, horizon=0.5, starts=1, progress=False
    )
    assert grown_plainly(model, 0.5) < 10
    assert math.isinf(found.time) and found.growth.factor.max() < 10


def test_what_falls_freely_beside_a_damper_that_rk4_does_not_bear():
    """As gymnasium_robotics' goals next to its hands: 490 m of a free fall are no failure."""
    locked = '<joint type="slide" axis="1 0 0" damping="1e4"/><geom size=".1" mass="1"/>'
    falls = '<freejoint/><geom size=".1" mass="1"/>'
    scene = sc.loads(
        f"""<mujoco><worldbody><body>{locked}</body><body pos="1 0 0">{falls}</body>
        </worldbody></mujoco>"""
    )
    found = sc.predict(scene, horizon=10.0, starts=2, progress=False)
    assert found.time == math.inf and found.growth.factor.max() == pytest.approx(1.0, abs=0.2)


@dataclass(frozen=True)
class Steps:
    period: float = 0.1
    every: int = 1
    periods: int = 100


def ladder(monkeypatch, rungs, known):
    """`converged_growth` for the ends of rungs, which may fail, and another method's end."""

    def grown(engine, change, schedule, starts, size, directions):
        end, failure = rungs[change]
        times = schedule.period * np.arange(1, schedule.periods + 1)
        return Growth(times, np.ones((1, len(times))), np.array([end]), failure)

    monkeypatch.setattr(predictable, "growth", grown)
    whole = Growth(0.1 * np.arange(1, 101), np.ones((1, 100)), np.array([known]), "")
    return predictable.converged_growth(None, range(len(rungs)), Steps(), [0], 1.0, 1, whole)[1]


@pytest.mark.parametrize(
    ("rungs", "rung"),
    [
        # One that agrees with the other method is enough, unless it fails.
        ([(2.1, "")], 0),
        ([(2.1, "diverged"), (2.0, "")], 1),
        # So are two that fall short of it, unless one fails.
        ([(0.5, ""), (1.0, ""), (0.4, ""), (0.8, "")], 0),
        ([(0.5, "diverged"), (1.0, ""), (1.9, "")], 2),
        # A longer end has to occur twice.
        ([(3.0, ""), (4.0, ""), (4.1, "")], 1),
    ],
)
def test_a_second_method_ends_where_it_cannot_matter(monkeypatch, rungs, rung):
    assert ladder(monkeypatch, rungs, known=2.0) == rung


class Ways:
    """An engine of two methods."""

    def ways(self, schedule, goal):
        return [Way(name, lambda k, name=name: (name, k)) for name in ("implicitfast", "rk4")]


def asked_and_answered(told):
    """The runs that `growing` requests, and its result. told: end and growth of each run."""
    schedule, asked = Driven(), []
    asking = growing(Ways(), schedule)
    run, over = next(asking)
    while True:
        asked.append(run)
        end, most = told[run]
        times = 0.1 * np.arange(1, over.periods + 1)
        factor = np.full((1, len(times)), most)
        try:
            run, over = asking.send(Growth(times, factor, np.array([end])))
        except StopIteration as stop:
            return asked, stop.value[0].overall


@dataclass(frozen=True)
class Driven(Steps):
    control: object = None
    driven: str = ""


INF, COARSE, FINEST, OTHER = math.inf, ("implicitfast", 2), ("implicitfast", 5), ("rk4", 2)


@pytest.mark.parametrize(
    ("told", "end"),
    [
        # A run without growth is accepted at once; one that grows, if the other method agrees.
        ({COARSE: (INF, 3.0)}, INF),
        ({COARSE: (INF, 300.0), OTHER: (INF, 900.0)}, INF),
        # If it does not, the shortest steps of the first decide.
        (
            {COARSE: (INF, 300.0), OTHER: (2.3, 1e6), ("rk4", 3): (2.3, 1e6), FINEST: (2.4, 1e6)},
            2.4,
        ),
        (
            {COARSE: (INF, 300.0), OTHER: (2.3, 1e6), ("rk4", 3): (2.3, 1e6), FINEST: (INF, 9e2)},
            INF,
        ),
    ],
)
def test_a_start_that_coarse_steps_do_not_lose_must_be_kept_by_another_method(told, end):
    asked, found = asked_and_answered(told)
    assert asked == list(told) and found == end


def test_a_fall_that_coarse_steps_miss_is_found():
    """Steps of a quarter and an eighth let a perturbation of the humanoid grow 64 and 38 times;
    a 32nd, and rk4 at three steps, lose the motion between 1.5 s and 2.8 s."""
    found = sc.predict("gymnasium:humanoid", horizon=3.0, starts=1, **QUIET)
    assert 1.5 < found.time < 2.8
