"""Stability of the runs of a Study: the three criteria on arrays, and against closed forms."""

import math
from dataclasses import replace

import numpy as np
import pytest
import stiff

import stepcore as sc
from stepcore.experiment import Change, Study
from stepcore.experiment.engines import Recording
from stepcore.experiment.judge import Judge, Outcome
from stepcore.experiment.pairs import Pair, continued, power

pytestmark = [
    pytest.mark.filterwarnings("ignore::stepcore.EnergyWarning"),
    pytest.mark.filterwarnings("ignore::stepcore.StiffnessWarning"),
]
TIMES = np.linspace(0.0, 1.0, 101)


def pair(energy=1.0, apart=1e-6, force=0.0, failure=""):
    """A pair of runs with an energy, a perturbation and a force over time."""
    energy, apart, force = (np.broadcast_to(x, TIMES.shape) for x in (energy, apart, force))
    ran = Recording(TIMES, {"actuator_force": force[:, None]}, failure, 1.0)
    ranges = np.array([[-2.0, 2.0]])
    return Pair(0.01, TIMES, apart, energy, energy - 1, failure, 1.0, ran, ranges, slow=1e-3)


class Still:
    """The figures that a judge needs of its motions."""

    floor, horizon = 1e-3, 1.0

    def falling(self, dt):
        return 0.0


FINE = pair()
SWITCHING = 2.0 * (-1.0) ** np.arange(len(TIMES))


@pytest.mark.parametrize(
    "run, kind, time",
    [
        (pair(failure="diverged"), "diverges", 1.0),
        (pair(energy=1 + 100 * TIMES), "gains energy", 0.5),
        (pair(apart=1e-6 * 100**TIMES), "grows", 0.74),
        (pair(energy=49.0, apart=29e-6), "holds", 1.0),
        # A pulse in the first three quarters is no growth without end.
        (pair(apart=np.where(TIMES < 0.7, 1e-3, 1e-6)), "holds", 1.0),
    ],
)
def test_energy_and_growth_judge_a_run(run, kind, time):
    outcome = Judge(Still(), FINE, True).judged(run)
    assert outcome.kind == kind and outcome.time == pytest.approx(time, abs=0.011)
    assert outcome.holds == (kind == "holds") == (outcome.failure == "")


def test_forces_that_jump_or_saturate_are_chatter():
    calm, chatter, pressed = pair(), pair(force=SWITCHING), pair(force=2.0)
    swing = pair(force=1.9 * np.sin(40 * TIMES))
    assert [run.jumps for run in (calm, chatter, pressed, swing)] == [False, True, False, False]
    assert [run.presses for run in (calm, pressed, swing)] == [False, True, False]
    assert chatter.jumping()[0][0] == pytest.approx(4.0) and chatter.saturated.all()
    # A run that rests, or fails, does not chatter.
    for still in (replace(chatter, energy=np.full(101, 1e-9)), pair(force=SWITCHING, failure="x")):
        assert still.rests and not still.jumps and not still.presses


def test_growth_by_a_power_of_time_is_continued_and_exponential_growth_is_unbounded():
    later = np.array([0.5, 2.0])
    assert power(TIMES, TIMES**2) == pytest.approx(2)
    np.testing.assert_allclose(continued(TIMES, TIMES**2, later), [0.25, 4.0])
    assert continued(TIMES, np.exp(20 * TIMES), later)[1] == math.inf


@pytest.mark.parametrize("engine", ["stepcore", "mujoco"])
@pytest.mark.parametrize("integrator, factor", [("euler", 2), ("rk4", 2.7853)])
def test_both_engines_chatter_above_the_closed_form_of_a_bounded_servo(engine, integrator, factor):
    """The run without stability does not fail: a force range bounds its motion."""
    study = Study(sc.loads(stiff.damped_servo()), "hold", engine=engine, horizon=0.1)
    limit, change = factor / stiff.POLE, Change(integrator=integrator)
    stable, unstable = (study.judge().outcome(change, part * limit) for part in (0.97, 1.05))
    assert stable.holds and unstable.kind in ("chatters", "gains energy", "grows")


def test_a_trial_has_the_stability_that_was_requested():
    study = Study(sc.loads(stiff.damped_servo()), "hold", horizon=0.1, period=0.01)
    change = Change(integrator="euler", dt=0.01)
    plain, judged = study.run(change), study.run(change, stability=True)
    assert plain.stability is None and math.isnan(plain.energy) and math.isnan(plain.growth)
    assert not plain.failure and "stability" not in plain.record()
    assert isinstance(judged.stability, Outcome) and judged.failure and math.isinf(judged.error)
    assert judged.growth > 30 or judged.energy > 50 or judged.chatter
    assert judged.record()["stability"]["kind"] == judged.stability.kind
    calm = study.run(Change(dt=0.01 / 10_000), stability=True)
    assert calm.stability.holds and not calm.failure


def test_a_change_of_the_physics_is_judged_against_its_converged_motion():
    """A spring 200 times as stiff has more energy, and the limit 2/ω of its closed form."""
    study = Study(sc.lesson.spring(), horizon=0.48, starts=2)
    stiffer, limit = Change({"joint/spring/stiffness": 2e4}), 2 / math.sqrt(2e4)
    outcomes = [study.judge(stiffer).outcome(Change(), part * limit) for part in (0.96, 1.04)]
    assert [outcome.holds for outcome in outcomes] == [True, False]
    assert study.run(stiffer.also(Change(dt=0.005)), stability=True).stability.holds


def test_diagnose_finds_limits_of_mujoco():
    """The limit of the closed form; elements by stepcore's model; no change is searched for."""
    scene = sc.loads(stiff.damped_servo())
    options = {"integrators": ["euler"], "progress": False, "horizon": 0.1}
    theirs = sc.diagnose(scene, engine="mujoco", **options)
    assert theirs.limit("euler") == pytest.approx(2 / stiff.POLE, rel=0.03)
    assert theirs.limit("euler") == pytest.approx(sc.diagnose(scene, **options).limit("euler"))
    assert not theirs.advice and theirs.engine.startswith("MuJoCo")
    with pytest.raises(ValueError, match="semi-implicit"):
        sc.diagnose(scene, engine="mujoco", integrators=["semi-implicit"])


# A body on a servo, and two points of a flex, which stepcore does not have.
FLEX = """<mujoco><option timestep="0.001" gravity="0 0 0"/><worldbody>
<body><joint name="lift" type="slide" axis="0 0 1"/>
<geom type="box" size=".2 .2 .02" mass="1" contype="0" conaffinity="0"/></body>
<flexcomp name="rope" type="grid" count="2 1 1" spacing=".1 .1 .1" pos="1 0 0" radius=".01"
mass="1" dim="1"><contact contype="0" conaffinity="0" selfcollide="none"/></flexcomp></worldbody>
<actuator><position name="push" joint="lift" kp="4000" kv="4000"/></actuator></mujoco>"""


def test_diagnose_runs_files_that_stepcore_cannot_load():
    """Under euler kv is explicit: dt < 2 m / kv, about."""
    d = sc.diagnose(FLEX, engine="mujoco", integrators=(), horizon=0.02, progress=False)
    assert d.states == [] and d.rows == [] and d.together() == [] and math.isnan(d.held())
    assert d.limit() == pytest.approx(2 / 4000, rel=0.03) and d.fails
    assert d.to_dict()["limits"]["euler"]["held"] is None and d.text() and d.to_html()
