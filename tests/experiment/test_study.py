"""A `Study` separates errors of steps from effects of a model: compared with plain loops."""

import dataclasses
import json
import math
import re
from pathlib import Path

import numpy as np
import pytest

import stepcore as sc
from stepcore import deadline, lesson
from stepcore.engine.norm import Tracks
from stepcore.experiment import Change, Study
from stepcore.experiment.schedule import Schedule
from stepcore.report.units import metres

DROP = """<mujoco><option timestep="0.004" gravity="0 0 -9.81"/><worldbody>
  <geom type="plane" size="5 5 .1" condim="1"/>
  <body pos="0 0 .13"><joint type="slide" axis="0 0 1"/><geom size=".1" mass="1"/></body>
  </worldbody></mujoco>"""

LINK = """<joint axis="0 1 0"/>
  <geom type="capsule" size=".02" fromto="0 0 0 .3 0 0" contype="0"/>"""
PENDULUM = f"""<mujoco><option integrator="RK4"/><worldbody>
  <body>{LINK}<body pos=".3 0 0">{LINK}</body></body></worldbody></mujoco>"""


def heights(scene: sc.Scene, dt: float) -> np.ndarray:
    """The states of a plain loop, every 4 ms."""
    sim = sc.Sim(scene.with_settings(dt=dt))
    return sim.run(0.4, record="qpos")["qpos"][round(0.004 / dt) :: round(0.004 / dt), 0]


@pytest.mark.parametrize(
    "settings",
    [{"law": "penalty"}, {"law": "penalty", "penalty_stiffness": 2e3}, {"cone": "elliptic"}],
)
def test_another_law_has_a_numerical_and_a_modelling_error(settings: dict) -> None:
    """A law is a model, with its separate limit dt → 0. A ball has the same in either cone."""
    scene = sc.loads(DROP)
    other = scene.with_settings(**settings)
    (trial,) = Study(scene, sc.Motion(horizon=0.4, starts=1)).run([Change(**settings)], error=1e-4)
    exact, own, fine = heights(scene, 2e-5), heights(other, 2e-5), heights(other, 4e-3)

    def rms(gap: np.ndarray) -> float:
        return float(np.sqrt(np.mean(gap**2)))

    sure = {"rel": 0.05, "abs": 5e-5}
    assert trial.error == pytest.approx(rms(fine - own), **sure)
    assert trial.modelled[0] == pytest.approx(rms(own - exact), **sure)


def test_measured_times_are_of_all_starts(monkeypatch: pytest.MonkeyPatch) -> None:
    """Adaptive steps are short at impacts, which the first start may not have."""
    study = Study(sc.loads(DROP), sc.Motion(horizon=0.4, starts=4))
    change = Change(accuracy=1e-3)
    study.run([change, Change()], error=1e-2)
    monkeypatch.setattr(study.engine, "seconds", lambda change, schedule: 0.4)
    made = [study._tracks[change, k].evaluations[0] for k in study.schedule.indices]
    assert len(set(made)) > 1
    told = {Change(): 1e6, change: pytest.approx(1e6 * np.mean(made) / made[0])}
    assert study.times([change, Change()]) == told


def test_work_is_counted_where_a_step_can_be_made() -> None:
    """A shipped motion that blows up has late states from which no step ends."""
    study = Study(sc.loads(PENDULUM), sc.Motion(horizon=0.4, starts=1))
    engine, fine = study.engine, Change(integrator="rk4")
    study.work(fine)
    (qpos, qvel, act, ctrl), *_ = engine._looks
    expected = []
    for looks in ([engine._looks[0]], [engine._looks[0], (qpos, 1e200 + qvel, act, ctrl)]):
        engine._looks = looks
        engine._counts.clear()
        expected.append(study.work(fine))
    assert 0 < expected[0] == expected[1] < np.inf
    engine._looks = engine._looks[1:]
    engine._counts.clear()
    assert study.work(fine) == np.inf


def test_a_motion_that_parts_is_looked_for_where_it_can_be_predicted() -> None:
    """After 3 to 5 s the motion changes with every rung; that took a quarter of the effort."""
    study = Study(sc.loads(PENDULUM), sc.Motion(horizon=10.0))
    truth = study.truth(1e-3)
    assert study.spent < 0.04 * study.effort and truth.error < 1e-4
    assert truth.growth.ends.min() > 3 and truth.growth.ends.max() < 6


def test_where_time_is_short_the_truth_is_from_fewer_starts(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """A run as shipped takes a second: some of eight starts are done, with the same bits."""
    whole, study = (Study(sc.loads(DROP), sc.Motion(horizon=0.4, starts=8)) for _ in "ab")
    exact, now, follow = whole.truth(1e-3), [0.0], study.engine.follow

    def slow(change: Change, schedule: Schedule, starts: list[int], **more: int) -> Tracks:
        now[0] += study.price(change, len(starts)) / study.price(Change(), 1)
        return follow(change, schedule, starts, **more)

    monkeypatch.setattr(deadline, "clock", lambda: now[0])
    monkeypatch.setattr(study.engine, "follow", slow)
    with deadline.Deadline(60.0).opened() as limit:
        known = study.truth(1e-3)
    some = len(known.starts)
    assert 1 < some < 8 and study.starts == known.starts == tuple(range(some)), some
    assert limit.left_out[0] == f"{8 - some} of 8 starts"
    np.testing.assert_array_equal(known.tracks.com, exact.tracks.com[:some])
    (trial,) = study.run([Change(dt=0.002)])
    assert trial.starts == known.starts


JOINT = """<mujoco><option timestep="0.002" integrator="RK4"/><worldbody><body pos="0 0 1">
  <joint name="j" axis="0 1 0"/><geom type="capsule" size=".02" fromto="0 0 0 .3 0 0" mass="1"/>
  </body></worldbody><actuator>{}</actuator></mujoco>"""
ENGINES = ("stepcore", "mujoco")


@pytest.mark.parametrize("engine", ENGINES)
def test_a_step_is_scored_only_if_it_divides_the_control_period(engine: str) -> None:
    """3 ms in a period of 8 ms was "wrong by 82 mm"; rk4 is wrong by nanometres there."""
    study = Study(sc.loads(JOINT.format("")), horizon=0.4, starts=1, engine=engine)
    period, rng = study.schedule.period, np.random.default_rng(7)
    for dt in [0.003, *np.geomspace(5e-4, 0.02, 12) * rng.uniform(0.9, 1.1, 12)]:
        ran = study.runs
        with pytest.raises(ValueError, match="must divide the control period") as refused:
            study.run(Change(dt=float(dt)), error=1e-4)
        assert study.runs == ran
        nearest = [float(step) for step in re.findall(r"([\d.e-]+) s\b", str(refused.value))[2:]]
        counts = sorted({int(period / dt) + 1, max(1, int(period / dt))}, reverse=True)
        assert nearest == pytest.approx([period / n for n in counts])
        for step in nearest:
            assert study.run(Change(dt=step), error=1e-4).error < 1e-5


@pytest.mark.parametrize("engine", ENGINES)
@pytest.mark.parametrize(
    ("values", "named"),
    [
        ({"joint/jj/damping": 1.0}, '"j"'),
        ({"actuator/servoo/kp": 1.0}, '"servo"'),
        ({"actuator/motor/kp": 1.0}, "kp"),
        ({"joint/j/dampin": 1.0}, "damping"),
    ],
)
def test_a_change_that_the_model_lacks_is_refused_before_a_run(
    engine: str, values: dict, named: str
) -> None:
    """It was "the converged motion fails"."""
    two = '<position name="servo" joint="j" kp="1"/><general name="motor" joint="j"/>'
    study = Study(sc.loads(JOINT.format(two)), horizon=0.1, starts=1, engine=engine)
    for ask in (study.run, lambda change: study.truth(1e-3, physics=change)):
        with pytest.raises(ValueError, match=f"{next(iter(values))}.*{named}|kp = 1") as refused:
            ask(Change(values))
        assert study.runs == 0 and "converged" not in str(refused.value)


def test_kp_of_a_general_servo_is_a_value() -> None:
    """Compared with the same servo as a position, in both engines; the set point stays."""
    servos = (
        '<position name="a" joint="j" kp="20" kv="1"/>',
        '<general name="a" joint="j" gainprm="20" biastype="affine" biasprm="0 -20 -1"/>',
        '<general name="a" joint="j" gainprm="5" biastype="affine" biasprm="3 -20 -1"/>',
    )
    # 5 × control + 3 is 20 × 0.3 where the control is 0.6.
    controls = (0.3, 0.3, 0.6)
    for values in ({"kp": 45.3}, {"kv": 0.37}, {"kp": 3.0, "kv": 0.2}):
        change = Change({f"actuator/a/{gain}": value for gain, value in values.items()})
        ends = []
        for servo, control in zip(servos, controls, strict=True):
            for engine in ENGINES:
                how = {"horizon": 0.4, "starts": 1, "engine": engine}
                study = Study(sc.loads(JOINT.format(servo)), ctrl=[[control]], **how)
                assert [study.value(f"actuator/a/{gain}") for gain in ("kp", "kv")] == [20, 1]
                ends.append(study.tracks([change], [0])[0].com[0, -1, 0])
        np.testing.assert_allclose(ends, ends[:1] * len(ends), rtol=0, atol=1e-9)


def test_a_study_takes_what_a_measurement_takes() -> None:
    by_text = Study(lesson.spring(), "fall", horizon="480ms", starts=2)
    by_motion = Study(lesson.spring(), sc.Motion(kind="fall", horizon=0.48, starts=2))
    one = by_text.run(Change({"joint/spring/stiffness": 20.0}, dt="5ms"), error="1mm")
    (other,) = by_motion.run([Change({"joint/spring/stiffness": 20.0}, dt=0.005)], error=1e-3)
    assert one.record() == other.record() and one.record()["modelled"] == one.modelled.max() > 0
    assert one.record()["unsure"] == one.unsure.max() > 0
    for wrong in ({"horizn": 1.0}, {"motion": "hop"}, {"by": "price"}, {"period": -1}):
        with pytest.raises(ValueError, match=r"horizn|hop|price|period"):
            Study(lesson.spring(), **wrong)
    for wrong in ({"error": "1 foot"}, {"starts": [9]}):
        with pytest.raises(ValueError, match=r"error|starts"):
            by_text.run(Change(), **wrong)


def test_a_question_of_a_user_has_an_answer_like_a_measurement(tmp_path: Path) -> None:
    study = Study(lesson.spring(), horizon=0.5, starts=1)
    values = [20.0, 80.0]
    trials = study.run([Change({"joint/spring/stiffness": k}) for k in values])
    rows = [{"k": k, "error": trial.error} for k, trial in zip(values, trials, strict=True)]
    answer = study.answer("error", ["It grows."], rows, units={"k": "N/m", "error": "m"})
    data = json.loads(answer.to_json())
    assert data["rows"] == rows and data["units"]["k"] == "N/m" and data["kind"] == "answer"
    assert "It grows." in answer.text() and metres(trials[0].error) in answer.text()
    lines = answer.plot(tmp_path / "a.png").axes[0].lines
    np.testing.assert_allclose(lines[0].get_ydata(), [trial.error for trial in trials])
    assert "It grows." in answer.to_html()


def test_a_single_run_fails_in_no_world() -> None:
    study = Study(lesson.spring(k=1e10, dt=1e-3, integrator="explicit"), horizon=0.04, starts=2)
    assert "world" not in study.tracks([Change()], [0, 1])[0].failure


def test_effort_for_a_start_of_unlimited_uncertainty_is_unknown():
    """Its last rungs failed, so that the uncertainty and its gain are infinite."""
    study = Study(lesson.spring(), horizon=0.2, starts=1)
    study.run(Change())
    converging = study._truths[Change()]
    lost = dataclasses.replace(converging.known[0], moved=math.inf, gain=math.inf)
    converging.known[0] = lost
    assert math.isinf(lost.unsure) and math.isinf(converging._needs([0], 1e-6))
