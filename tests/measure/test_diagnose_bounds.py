"""`diagnose` reports only limits that were found, below which no run fails."""

import itertools
import math
from pathlib import Path

import numpy as np
import pytest

import stepcore as sc
from stepcore import deadline
from stepcore.deadline import OutOfTime
from stepcore.measure import diagnosis

# Steps beyond a limit are run on purpose.
pytestmark = [
    pytest.mark.filterwarnings("ignore::stepcore.EnergyWarning"),
    pytest.mark.filterwarnings("ignore::stepcore.StiffnessWarning"),
]
HERE = Path(__file__).parent

# kv on so little inertia is explicit under euler: dt must be below 2 I / kv = 120 µs.
WRIST = """<mujoco><option timestep="0.002" integrator="Euler" gravity="0 0 0"/><worldbody><body>
<joint name="j" axis="0 0 1"/><inertial pos="0 0 0" mass=".5" diaginertia="3e-3 3e-3 3e-3"/>
</body></worldbody><actuator><position name="wrist" joint="j" kp="500" kv="50"
forcerange="-52 52"/></actuator></mujoco>"""
WRIST_LIMIT = 2 * 3e-3 / 50


def clocked(monkeypatch, step=1):
    """A clock that advances at each reading: nothing depends on the machine."""
    ticks = itertools.count(0, step)
    monkeypatch.setattr(deadline, "clock", lambda: next(ticks))


@pytest.mark.parametrize("measure", [sc.diagnose, sc.check])
def test_a_limit_is_stated_only_after_it_was_found(monkeypatch, measure):
    """For every deadline: NaN, the steps that were run, and no limit in text, data or plot."""
    known = set()
    for power in range(8, 30):
        clocked(monkeypatch)
        try:
            result = measure(
                sc.loads(WRIST), seconds=1.7**power, horizon=0.1, progress=False, threads=1
            )
        except OutOfTime:
            continue
        d = result if measure is sc.diagnose else result.diagnosis
        if d is None:
            continue
        own = d.own
        if d.observed is not None:
            assert d.fails and own.fails <= 0.002
            if measure is sc.check:
                kinds = {finding.kind for finding in result.findings}
                assert kinds & {"time step", "failure"}
                assert "No problems found" not in result.text()
        for text in (d.sentences[0], d.text()):
            assert "No element limits" not in text
        data = d.to_dict()["limits"]["euler"]
        if math.isnan(d.limit()):
            assert data["dt"] is None and data["limited"] is None and d.together() == []
            assert own.holds < WRIST_LIMIT * 1.02 and math.isnan(own.dt)
        else:
            assert d.limit() == pytest.approx(WRIST_LIMIT, rel=0.03)
            assert d.stiffest() == "servo `wrist`" and own.holds < own.fails
        known.add(own.known)
        for one in d.limits.values():
            assert not math.isinf(one.dt) or one.longest >= one.holds > 0
        if own.known:
            break
    assert known == {False, True}


def test_the_limit_of_a_step_that_fails_is_found_first(monkeypatch):
    """The arm of a public question: 13.5 µs under euler, in fewer than 30 runs."""
    from stepcore.experiment.pairs import Motions

    own, count = Motions.pair, itertools.count(1)
    monkeypatch.setattr(Motions, "pair", lambda *a, **k: (next(count), own(*a, **k))[1])
    d = sc.diagnose(str(HERE / "arm_euler.xml"), integrators=(), progress=False, dt="2ms")
    monkeypatch.undo()
    assert d.limit() == pytest.approx(13.5e-6, rel=0.02) and d.stiffest() == "servo `j7`"
    assert any(a.met and a.settings.get("integrator") == "implicitfast" for a in d.advice)
    # It saturates because it chatters.
    assert "saturated" not in d.sentences[0] and not d.untried


def test_a_plot_shows_no_limit_beyond_the_steps_that_were_run():
    d = sc.diagnose(sc.loads(WRIST), horizon=0.1, progress=False, integrators=["discrete"])
    discrete, own = d.limits["discrete"], d.limits["euler"]
    assert discrete.ends[0] == min(discrete.dt, discrete.longest) <= 1.0
    unknown = type(own)("euler", math.nan, math.nan, longest=0.002, fails=0.002)
    d.limits["euler"] = unknown
    (axes,) = d.plot().axes
    assert unknown.ends[0] == 0.0
    assert "?" in [text.get_text() for text in axes.texts]


# --- limits of sensitive motions ------------------------------------------------------------------


def survives(scene, integrator, dt, steps):
    sim = sc.Sim(scene.compile(), dt=dt, integrator=integrator)
    try:
        sim.step(steps)
    except sc.SimulationError:
        return False
    return bool(np.isfinite(sim.qvel).all())


LINK = """<body pos=".1 0 0"><joint axis="0 1 0" damping="0.001"/>
<geom type="capsule" fromto="0 0 0 .1 0 0" size=".01" mass=".05" contype="0" conaffinity="0"/>"""
CABLE = f"""<mujoco><option timestep="0.005"/><worldbody>{10 * LINK}{10 * "</body>"}</worldbody>
</mujoco>"""


@pytest.mark.parametrize("integrator", ["euler", "rk4"])
def test_plain_loops_survive_below_the_limit_of_a_sensitive_motion(integrator):
    """A cable of ten links: 0.95 of its limit diverged, in MuJoCo, too."""
    scene = sc.loads(CABLE).with_settings(integrator=integrator)
    d = sc.diagnose(scene, integrators=(), progress=False)
    for share in (0.98, 0.95, 0.9, 0.85, 0.8):
        dt = share * d.limit()
        assert survives(scene, integrator, dt, max(3000, math.ceil(1 / dt)))
    assert not d.limits[integrator].erratic or d.own.fails == pytest.approx(1.03 * d.limit())


def test_steps_that_hold_by_luck_are_an_erratic_range_and_no_limit():
    """Under implicitfast, 0.95 of 123 ms diverged: 116 ms."""
    d = sc.diagnose(str(HERE / "fourbar.xml"), integrators=["implicitfast"], progress=False)
    limit = d.limits["implicitfast"]
    assert limit.dt < 0.116 and limit.fails == pytest.approx(1.03 * limit.dt)
    d.limits["implicitfast"] = type(limit)("implicitfast", 0.1, 0.2, fails=0.103, holds=0.12)
    assert d.limits["implicitfast"].erratic == (0.103, 0.12)
    assert d.to_dict()["limits"]["implicitfast"]["erratic"] == [0.103, 0.12]
    assert "erratic up to 120 ms" in d.text(width=200)


# --- names ----------------------------------------------------------------------------------------


def test_of_chatter_an_actuator_is_named():
    """A spring has the limit by chance: softening it moves the limit by 1.6, the servo by 3.5."""
    d = sc.diagnose(str(HERE / "tendon_finger.xml"), integrators=(), progress=False)
    assert d.own.outcome == "chatters" and d.stiffest() == "servo `a`" and d.own.state == -1


def test_an_undamped_servo_that_saturates_is_no_chatter():
    """kv is 0: it swings between its bounds in the converged motion, too."""
    ctrl = np.array([[0, 0]] * 20 + [[0.6, 0.3]] * 100 + [[-0.6, -0.2]], float)
    motion = {"ctrl": ctrl, "control_dt": 0.01}
    d = sc.diagnose(str(HERE / "head_kv0.xml"), integrators=(), progress=False, **motion)
    assert not d.fails and d.limit() > 0.01
    found = sc.check(str(HERE / "head_kv0.xml"), progress=False, **motion).findings
    (servo,) = [one for one in found if one.kind == "servo does not follow"]
    assert "kv 0 damps nothing" in servo.problem and "kv" in servo.fix


ARM = """<mujoco><option timestep=".002" integrator="implicitfast"/><worldbody><body>
<joint name="a" axis="0 1 0" armature=".01"/>
<geom type="capsule" fromto="0 0 0 .3 0 0" size=".03" mass="1"/>
<body pos=".3 0 0"><joint name="b" axis="0 1 0" armature=".001"/>
<geom type="capsule" fromto="0 0 0 .3 0 0" size=".03" mass=".5"/></body></body></worldbody>
<actuator><motor joint="a"/><motor joint="b"/></actuator></mujoco>"""


def stiff_pd(time, sim):
    q, v = sim.qpos, sim.qvel
    return [200 * (0.5 - q[0]) - 5 * v[0], 200 * (0.4 - q[1]) - 30 * v[1]]


def test_a_control_that_feeds_a_failure_is_named_before_the_limit_is_known(monkeypatch):
    def over(case, integrator):
        raise OutOfTime

    monkeypatch.setattr(diagnosis.Case, "limit", over)
    monkeypatch.setattr(diagnosis.Case, "advice", lambda *known: iter(()))
    d = sc.diagnose(
        sc.loads(ARM), control=stiff_pd, horizon=0.1, integrators=(), progress=False, seconds=1e6
    )
    assert math.isnan(d.limit()) and d.fails and d.own.holds == 0
    assert {element.kind for element in d.limiters["implicitfast"]} == {"control"}


# --- changes --------------------------------------------------------------------------------------


def test_changes_that_remain_untried_are_counted(monkeypatch):
    """For every deadline: all kinds of changes are tried or untried."""
    scene, seen = sc.loads(WRIST).with_settings(dt=1e-3), set()
    for power in range(14, 36):
        clocked(monkeypatch)
        try:
            d = sc.diagnose(
                scene, seconds=1.5**power, horizon=0.05, integrators=(), progress=False, threads=1
            )
        except OutOfTime:
            continue
        if d.observed is not None and not any(a.met for a in d.advice) and d.advice:
            assert bool(d.untried) == bool("not tried" in d.text().lower())
        seen.add(len(d.untried))
        assert d.to_dict()["untried"] == list(d.untried)
        if not d.not_done:
            break
    assert 0 in seen and len(seen) > 2
