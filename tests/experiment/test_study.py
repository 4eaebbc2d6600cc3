"""A `Study` tells what steps do wrong from what another model does: beside plain loops."""

import numpy as np
import pytest

import stepcore as sc
from stepcore import deadline
from stepcore.engine.norm import Tracks
from stepcore.experiment import Change, Study
from stepcore.experiment.schedule import Schedule

DROP = """<mujoco><option timestep="0.004" gravity="0 0 -9.81"/><worldbody>
  <geom type="plane" size="5 5 .1" condim="1"/>
  <body pos="0 0 .13"><joint type="slide" axis="0 0 1"/><geom size=".1" mass="1"/></body>
  </worldbody></mujoco>"""

LINK = """<joint axis="0 1 0"/>
  <geom type="capsule" size=".02" fromto="0 0 0 .3 0 0" contype="0"/>"""
PENDULUM = f"""<mujoco><option integrator="RK4"/><worldbody>
  <body>{LINK}<body pos=".3 0 0">{LINK}</body></body></worldbody></mujoco>"""


def heights(scene: sc.Scene, dt: float) -> np.ndarray:
    """Of a plain loop, every 4 ms."""
    sim = sc.Sim(scene.with_settings(dt=dt))
    return sim.run(0.4, record="qpos")["qpos"][round(0.004 / dt) :: round(0.004 / dt), 0]


@pytest.mark.parametrize(
    "settings",
    [{"law": "penalty"}, {"law": "penalty", "penalty_stiffness": 2e3}, {"cone": "elliptic"}],
)
def test_another_law_has_a_numerical_and_a_modelling_error(settings: dict) -> None:
    """A law is a model, with a limit dt → 0 of its own. A ball has the same in either cone."""
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
    """Steps within an accuracy are short at impacts, which the first start may not have."""
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
    """What follows its 3 to 5 s moves however fine the rungs: it took a quarter of the effort."""
    study = Study(sc.loads(PENDULUM), sc.Motion(horizon=10.0))
    truth = study.truth(1e-3)
    assert study.spent < 0.04 * study.effort and truth.error < 1e-4
    assert truth.growth.ends.min() > 3 and truth.growth.ends.max() < 6


def test_where_time_is_short_the_truth_is_from_fewer_starts(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """A run as shipped takes a second: some of eight starts are known, with the same bits."""
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
