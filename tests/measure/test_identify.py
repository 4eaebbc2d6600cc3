"""Values of a model from logs: hidden ones found again, in logs of ours and of MuJoCo."""

import itertools

import numpy as np
import pytest
from arm_log import DAMPING, HIDDEN, RANGES, SENSORS, TRUE, controls, guess, mujoco_log, noisy

import stepcore as sc
from stepcore import deadline, lesson
from stepcore.experiment.control_table import ControlLog
from stepcore.measure.identification.log import MeasuredLog, read_log
from stepcore.measure.identification.predictions import Predictions

pytest.importorskip("scipy")


def test_hidden_values_of_a_log_that_mujoco_made():
    found = sc.identify(guess(), mujoco_log(), RANGES)
    assert found.values == pytest.approx(HIDDEN, rel=1e-6)
    assert found.alike == [] and found.unknown == []
    assert max(found.residuals.values()) < 1e-6 < min(found.before.values())
    # The effect of the step is reported: it is more than the residual.
    assert found.integration["qpos[elbow]"] > found.residuals["qpos[elbow]"]
    assert found.model.with_values({}).scene.joint("shoulder").damping == pytest.approx(0.3)


def test_noise_gaps_and_velocities_that_were_not_measured():
    log, rng = mujoco_log(), np.random.default_rng(0)
    del log["qvel"]
    log["qpos"] += rng.normal(0, 1e-3, log["qpos"].shape)
    log["qpos"][20:40, 1] = np.nan
    found = sc.identify(guess(), log, RANGES)
    for path, value in HIDDEN.items():
        low, high = found.intervals[path]
        middle, half = (low + high) / 2, (high - low) / 2
        # 95 % intervals, half as wide again, because there are four.
        assert abs(middle - value) <= 1.5 * half, path
        assert half < 0.5 * value
    assert set(found.residuals) == {"qpos[shoulder]", "qpos[elbow]"}
    for residual in found.residuals.values():
        assert residual == pytest.approx(1e-3, rel=0.3)


# By path: values of the model that are wrong and not searched, and others in MuJoCo's.
LACKS = {
    "joint/shoulder/armature": ({}, {"dof_armature": 0.05}),
    "joint/elbow/frictionloss": ({"loss": 0.0}, {}),
    DAMPING: ({"damping": 0.0}, {}),
    "body/fore/mass": ({"mass": 0.5}, {}),
    "actuator/a/kp": ({"kp": 50.0}, {}),
}
WIDE = {path: RANGES[path] for path in ("body/fore/mass", "actuator/a/kp")}


@pytest.mark.parametrize("path", LACKS)
def test_a_missing_value_is_named_before_the_others(path):
    """In noisy logs of MuJoCo; without intervals, which would not hold the truth."""
    wrong, hidden = LACKS[path]
    wanted = {key: ends for key, ends in WIDE.items() if key != path}
    found = sc.identify(guess(**TRUE | wrong), noisy(mujoco_log(**hidden)), wanted)
    assert found.quality.missing.label == path and found.quality.missing.share > 0.5
    assert found.quality.missing.absent == (0.0 in wrong.values())
    assert found.quality.verdict == "bad"
    assert all(np.isinf(interval).all() for interval in found.intervals.values())
    full = sc.identify(guess(**TRUE), noisy(mujoco_log()), wanted)
    assert full.quality.verdict == "noise"


@pytest.mark.parametrize(
    "wanted",
    [
        WIDE,
        pytest.param(dict.fromkeys((DAMPING, "joint/elbow/damping")), marks=pytest.mark.long),
        pytest.param(RANGES | {"delay": (0, 0.05)}, marks=pytest.mark.long),
    ],
    ids=["mass and gain", "dampings", "all and a delay"],
)
def test_the_intervals_hold_the_truth(wanted):
    """95 % of them in 20 repetitions: at least 80 %, and errors of about the reported size."""
    log, true = mujoco_log(400), HIDDEN | {"joint/elbow/damping": 0.05, "delay": 0.0}
    wanted, off = {path: ends or (0.01, 2.0) for path, ends in wanted.items()}, []
    for seed in range(20):
        found = sc.identify(guess(**TRUE), noisy(log, seed), wanted)
        assert found.quality.verdict == "noise"
        for path, (low, high) in found.intervals.items():
            off.append((found.values[path] - true[path]) / ((high - low) / 2))
    off = np.array(off)
    assert np.mean(np.abs(off) <= 1) >= 0.8 and 0.3 < np.sqrt(np.mean(off**2)) < 0.75


def test_what_steps_do_not_read_as_a_number_is_not_looked_for():
    """The gear of a force at a site changes which way it points, not a number alone."""
    pushed = sc.loads("""<mujoco><worldbody><body><joint name="rail" type="slide" axis="1 0 0"
    damping="1"/><geom size=".1" mass="1"/><site name="nose"/></body></worldbody>
    <actuator><motor name="push" site="nose" gear="1 0 0 0 0 0"/></actuator></mujoco>""").compile()
    true = pushed.with_values({"joint/rail/damping": 2.5})
    run = sc.Sim(true).run(
        1.0, control=np.sin(np.arange(500) / 40)[:, None], record=("qpos", "ctrl")
    )
    noise = np.random.default_rng(0).normal(0, 1e-4, run.qpos.shape)
    log = {"time": run.time, "qpos": run.qpos + noise, "ctrl": np.roll(run.ctrl, -1, axis=0)}
    found = sc.identify(pushed, log, {"joint/rail/damping": (0.1, 10)})
    low, high = found.intervals["joint/rail/damping"]
    assert low <= 2.5 <= high and found.quality.verdict == "noise"


def test_pieces_that_the_time_leaves_out_leave_what_was_found(monkeypatch):
    """A log beyond the predictable time is fitted whole first, and that fit is kept."""
    double = """<mujoco><option timestep="0.01"/><default><geom contype="0" conaffinity="0"
    size=".02" mass="1"/></default><worldbody><body><joint name="a" axis="0 1 0" damping=".01"/>
    <geom type="capsule" fromto="0 0 0 0 0 -1"/><body pos="0 0 -1"><joint name="b" axis="0 1 0"/>
    <geom type="capsule" fromto="0 0 0 0 0 -1"/></body></body></worldbody></mujoco>"""
    sim = sc.Sim(sc.loads(double))
    sim.qpos[:] = 2.0, 0.5
    log = sim.run(8.0)

    def late(*asked):
        raise deadline.OutOfTime("the time of the measurement is over")

    monkeypatch.setattr(MeasuredLog, "split", late)
    guess = sc.loads(double).compile().with_values({"joint/a/damping": 0.02})
    found = sc.identify(guess, log, {"joint/a/damping": (0.001, 0.1)}, most=2)
    assert min(found.predictable) < 8.0 and found.alike == []
    assert "the fit of pieces of" in found.unfinished


def wheels(damping, armature):
    """Servos that saturate one after the other: fits of a whole log end where they start."""
    body = """<body pos="{k} 0 0"><joint name="j{k}" axis="0 0 1" damping="{d}" armature="{a}"
      frictionloss=".05"/><geom size=".05" mass=".1"/></body>"""
    servo = """<position name="s{k}" joint="j{k}" kp="1000" kv="3" forcerange="-3 3"/>"""
    bodies = "".join(body.format(k=k, d=damping, a=armature) for k in range(3))
    servos = "".join(servo.format(k=k) for k in range(3))
    return sc.loads(
        '<mujoco><option timestep=".005" integrator="implicitfast"/>'
        f"<worldbody>{bodies}</worldbody><actuator>{servos}</actuator></mujoco>"
    )


RANGED = {"joint/*/damping": (0.01, 5), "joint/*/armature": (0.001, 1)}


def turning():
    """A run of these wheels, in which each follows another sine."""
    rng = np.random.default_rng(0)
    rate, phase = rng.uniform(0.3, 1.5, 3), rng.uniform(0, 6, 3)

    def sines(time, sim):
        return 0.2 * np.sin(2 * np.pi * rate * time + phase)

    sim = sc.Sim(wheels(0.84, 0.036))
    return sim.run(2.0, record=("qpos", "qvel", "ctrl"), control=sines, control_dt=0.01)


def test_short_pieces_lead_to_the_values_where_the_whole_log_does_not():
    found = sc.identify(wheels(0.6, 0.028), turning(), RANGED, progress=False)
    assert any("fits of short pieces" in note for note in found.notes)
    assert set(found.start.values()) == {0.6, 0.028}
    for path, value in found.values.items():
        # From 30 % off; to all digits here, but such fits may end elsewhere by rounding.
        assert value == pytest.approx(0.84 if "damping" in path else 0.036, rel=0.15)


def test_what_is_measured_at_the_end_alone_is_in_no_short_piece():
    """The search goes on with the values of the pieces; once an internal error."""
    ran = turning()
    speeds = np.where(np.arange(len(ran["qvel"])) < 395, np.nan, ran["qvel"][:, 2])
    columns = {"time": 0.005 * np.arange(len(speeds)), "j2.velocity": speeds}
    for k in range(3):
        columns |= {f"j{k}.position": ran["qpos"][:, k], f"s{k}.control": ran["ctrl"][:, k]}
    found = sc.identify(wheels(0.6, 0.028), sc.Log(columns), RANGED, progress=False)
    assert "qvel[j2]" in found.residuals and found.quality.verdict != "noise"


def test_a_log_that_leaves_out_a_body_is_cut_into_pieces():
    """A slide that nothing measures is where the model has it; once an internal error."""
    scene = sc.loads(
        """<mujoco><option timestep="0.005"/><worldbody><body><joint name="j" axis="0 1 0"
        damping="0.03"/><geom type="capsule" size=".02" fromto="0 0 0 .3 0 0"/></body>
        <body pos="2 0 0"><joint name="other" type="slide"/><geom size=".1"/></body></worldbody>
        <actuator><motor name="m" joint="j"/></actuator></mujoco>"""
    )
    ran = sc.Sim(scene).run(1.0, record=("qpos", "ctrl"), control=lambda time, sim: [time])
    columns = {"j.position": ran["qpos"][:, 0], "m.control": ran["ctrl"][:, 0]}
    log = sc.Log({"time": 0.005 * np.arange(201)} | columns)
    found = sc.identify(scene, log, {"joint/j/damping": (0.001, 0.1)}, pieces=0.2)
    assert found.logs == 5 and found.values["joint/j/damping"] == pytest.approx(0.03, rel=0.05)


def test_several_entries_and_pieces_of_a_log():
    """If a motion is cut every 0.4 s, each piece has a separate first state."""
    damping = {"joint/*/damping": (0.01, 2.0)}
    found = sc.identify(guess(**TRUE), mujoco_log(), damping, pieces="0.4s")
    true = {DAMPING: 0.3, "joint/elbow/damping": 0.05}
    assert found.values == pytest.approx(true, rel=1e-6) and found.logs == 3
    with pytest.raises(ValueError, match="pieces = 'x'"):
        sc.identify(guess(), mujoco_log(20), damping, pieces="x")


def test_the_time_ends_the_search_and_threads_change_nothing(monkeypatch):
    """A clock that counts: from too early for any answer to all the time that it takes."""
    log, ends, values = mujoco_log(100), [], {}
    for power in range(1, 12):
        monkeypatch.setattr(deadline, "clock", itertools.count().__next__)
        try:
            found = sc.identify(guess(), log, WIDE, seconds=2.0**power, threads=1)
            end = "part" if found.unfinished.startswith("Stopped after") else "all"
            values[end] = found.values
        except deadline.OutOfTime:
            end = "nothing"
        ends.append(end)
    assert sorted(set(ends), key=ends.index) == ["nothing", "part", "all"]
    assert values["all"] == sc.identify(guess(), log, WIDE, threads=2).values


def test_what_cannot_be_told_apart_is_named():
    """For a spring alone, mass and stiffness give only one frequency."""
    model = lesson.spring().compile().with_settings(dt=0.005, integrator="semi-implicit")
    sim = sc.Sim(model)
    sim.reset("start")
    log = sim.run(0.5)
    mass = model.body_names[1]
    found = sc.identify(
        model, log, {"joint/spring/stiffness": (20, 500), f"body/{mass}/mass": (0.1, 10)}
    )
    assert [set(paths) for paths in found.alike] == [set(found.values)]


def test_a_value_that_is_zero_in_the_model_is_found():
    """It starts in the middle of its range: a missing damper has no derivative."""
    text = """<mujoco><option timestep=".005"/><worldbody><body><joint name="z" type="slide"
     axis="0 0 1" damping="{}"/><joint name="x" type="slide" axis="1 0 0"/>
     <geom name="g" size=".1" mass="1"/></body></worldbody></mujoco>"""
    sim = sc.Sim(sc.loads(text.format(2.0)))
    found = sc.identify(sc.loads(text.format(0.0)), sim.run(0.25), {"joint/z/damping": (0.1, 10)})
    assert found.start["joint/z/damping"] == pytest.approx(1.0)
    assert found.values["joint/z/damping"] == pytest.approx(2.0, rel=1e-9)
    # Given by a pattern, as one that is not zero; within the smallest numbers too.
    again = sc.identify(sc.loads(text.format(0.0)), sim.run(0.25), {"joint/z*/damping": (0.1, 10)})
    assert again.values["joint/z/damping"] == pytest.approx(2.0, rel=1e-9)
    tiny = {"joint/z/damping": (1e-200, 1e-180)}
    assert sc.identify(sc.loads(text.format(0.0)), sim.run(0.25), tiny).start == {
        "joint/z/damping": pytest.approx(1e-190)
    }
    with pytest.raises(
        ValueError, match=r"parameters\['joint/z/damping'\] = \(-10, -0.1\): must be"
    ):
        sc.identify(sc.loads(text.format(0.0)), sim.run(0.25), {"joint/z/damping": (-10, -0.1)})
    with pytest.raises(ValueError, match=r"parameters = \[3\]: must be paths of values"):
        sc.identify(sc.loads(text.format(0.0)), sim.run(0.25), {3: (0.1, 1)})


def test_a_search_that_is_cut_off_says_so():
    log, wanted = mujoco_log(200), {DAMPING: RANGES[DAMPING]}
    found = sc.identify(guess(), log, wanted, most=1)
    assert found.unfinished.startswith("The search was cut off by most = 1")
    assert sc.identify(guess(), log, wanted).unfinished == ""
    with pytest.raises(ValueError, match="most = 0"):
        sc.identify(guess(), log, wanted, most=0)


def test_a_delay_of_the_controls_is_found_with_the_values():
    """A delay of 12.3 ms, no multiple of 2 ms, under controls that change every 10 ms."""
    ctrl, dt = controls(600)[::5], 0.002
    late = ControlLog(5 * dt * np.arange(120), ctrl).steps(-0.0123, dt, 600)
    run = sc.Sim(guess().with_values(HIDDEN)).run(1.2, control=late, record=("qpos", "qvel"))
    log = {"time": run.time[:-1:5], "qpos": run.qpos[:-1:5], "qvel": run.qvel[:-1:5], "ctrl": ctrl}
    found = sc.identify(guess(), log, RANGES | {"delay": (0, 0.05)})
    assert found.values == pytest.approx(HIDDEN | {"delay": 0.0123}, rel=1e-6)
    assert found.predictable == [np.inf] and found.findings == []


def test_what_was_measured_late_is_found_with_the_values():
    """Positions 31.7 ms late, no whole number of steps, and speeds without delay."""
    ctrl, dt, begin = controls(600)[::5], 0.002, 25
    control = ControlLog(5 * dt * np.arange(120), ctrl).steps(0.0, dt, 600)
    run = sc.Sim(guess().with_values(HIDDEN)).run(1.2, control=control, record=("qpos", "qvel"))
    times = run.time[begin:-1:5]

    def seen(rows, late):
        return np.column_stack([np.interp(times - late, run.time, row) for row in rows.T])

    log = {"time": times, "qpos": seen(run.qpos, 0.0317), "qvel": seen(run.qvel, 0.0)}
    found = sc.identify(guess(), log | {"ctrl": ctrl[5:]}, RANGES | {"delay/qpos": (0, 0.1)})
    assert found.values == pytest.approx(HIDDEN | {"delay/qpos": 0.0317}, rel=1e-6)
    with pytest.raises(ValueError, match='no sensor is named "tipp"'):
        sc.identify(guess(SENSORS), log, {"delay/tipp": (0, 0.1)})


def test_the_jacobian_is_that_of_the_residuals():
    """For parameters, delays and first states: differences of residuals, to 1e-5 of them."""
    sensor = guess(SENSORS).called("sensor")[0]
    labels = [*RANGES, "delay", f"delay/{sensor}", "delay/qvel"]
    log = mujoco_log(100, sensors=SENSORS)
    fit = Predictions(guess(SENSORS), [read_log(guess(SENSORS), log, "log")], labels)
    x = np.array([0.1, 0.1, 0.4, 30.0, 0.0071, 0.0033, -0.0021, 0.01, -0.01, 0.4, -0.6])
    exact = fit.jacobian(x)
    for k, value in enumerate(x):
        way = 1e-6 * max(abs(value), 0.01) * np.eye(len(x))[k]
        slope = (fit.residual(x + way) - fit.residual(x - way)) / (2 * way[k])
        assert np.abs(exact[:, k] - slope).max() <= 1e-5 * np.abs(slope).max()


FLYER = """<mujoco><option timestep=".004"/><worldbody><body name="box" pos="0 0 .3">
<freejoint name="root"/><geom type="box" size=".1 .12 .08" mass="2"/><site name="s" pos=".1 0 0"/>
<body name="arm" pos="0 0 .1"><joint name="b" type="ball" damping="{}"/>
<geom type="capsule" size=".03" fromto="0 0 0 .05 .02 .2" mass=".4"/></body></body></worldbody>
<sensor><framequat name="q" objtype="site" objname="s"/><gyro name="w" site="s"/></sensor>
<keyframe><key qpos="0 0 .3 .9 .1 .2 .1 1 0 0 0" qvel=".4 .2 0 1 2 .5 .3 .2 .1"/></keyframe>
</mujoco>"""


def test_a_body_that_turns_freely():
    """The Jacobian by turns of the first state: differences, 1e-6 of them; and the value found."""
    sim, model = sc.Sim(sc.loads(FLYER.format(0.05))), sc.loads(FLYER.format(0.02)).compile()
    sim.reset(0)
    run = sim.run(0.4, record=("qpos", "qvel", "sensordata"))
    fit = Predictions(model, [read_log(model, run, "log")], ["joint/b/damping"])
    x = np.concatenate([[0.03], np.random.default_rng(0).normal(0, 0.01, 18)])
    exact = fit.jacobian(x)
    for k in range(len(x)):
        way = 1e-6 * np.eye(len(x))[k]
        slope = (fit.residual(x + way) - fit.residual(x - way)) / 2e-6
        assert np.abs(exact[:, k] - slope).max() <= 1e-6 * np.abs(slope).max()
    found = sc.identify(model, run, {"joint/b/damping": (0.005, 0.5)})
    assert found.values["joint/b/damping"] == pytest.approx(0.05, rel=1e-9)


def test_sensors_alone_tell_the_values():
    """Angle, gyro, accelerometer, place of the hand and a force, of MuJoCo; the first pose."""
    log = mujoco_log(400, sensors=SENSORS)
    del log["qvel"]
    log["qpos"][1:] = np.nan
    found = sc.identify(guess(SENSORS), log, RANGES)
    assert found.values == pytest.approx(HIDDEN, rel=1e-5)
    names = {label for label in found.residuals if not label.startswith("qpos")}
    vectors = {f"sensordata[{name}.{k}]" for name in ("gyro", "imu", "hand") for k in range(3)}
    assert names == {"sensordata[angle]", "sensordata[pull]", *vectors}
    assert found.residuals["sensordata[imu.0]"] < 1e-4 < found.before["sensordata[imu.0]"]


def test_sensors_under_the_rigid_law():
    """It has no Newton solver."""
    text = """<mujoco><option timestep=".005"/><worldbody><body><joint name="z" type="slide"
     axis="0 0 1" damping="{}"/><geom size=".1" mass="1"/></body></worldbody>
     <sensor><jointvel joint="z"/></sensor></mujoco>"""
    true, model = (
        sc.loads(text.format(d)).compile().with_settings(law="rigid", solver="pgs") for d in (2, 1)
    )
    run = sc.Sim(true).run(0.25, record=("qpos", "sensordata"))
    found = sc.identify(model, run, {"joint/z/damping": (0.1, 10)})
    assert found.values["joint/z/damping"] == pytest.approx(2, rel=1e-9)


def test_a_sensor_without_derivative_is_refused_by_name():
    sensors = '<contact name="felt" body1="fore" data="found"/>'
    log = mujoco_log(20) | {"sensordata": np.zeros((4, 1))}
    with pytest.raises(ValueError, match='sensor "felt" is a contact: identify has no derivative'):
        sc.identify(guess(sensors), log, {DAMPING: RANGES[DAMPING]})


def test_what_a_finer_step_would_change():
    """The estimates of a second fit with shorter steps, to the first order: a quarter."""
    log = mujoco_log()
    wanted = {key: RANGES[key] for key in (DAMPING, "actuator/a/kp", "body/fore/mass")}
    model = guess(loss=0.04)
    found = sc.identify(model, log, wanted)
    again = sc.identify(model.with_settings(dt=0.0005), log, wanted)
    for path, value in again.values.items():
        moved = value - found.values[path]
        assert abs(found.finer[path] - value) <= 0.25 * abs(moved)


def test_plot_and_tables(tmp_path):
    pytest.importorskip("matplotlib")
    log = mujoco_log(200)
    log["qpos"][5:8] = np.nan
    found = sc.identify(guess(), log, {DAMPING: RANGES[DAMPING], "body/fore/mass": (0.1, 3)})
    found.plot(tmp_path / "found.png")
    assert (tmp_path / "found.png").stat().st_size > 0
    assert len(found.curves) == len(found.residual_table) == 4
    shoulder = found.curves[0]
    assert shoulder.quantity == "qpos[shoulder]" and np.isnan(shoulder.measured).sum() == 3
    rms = np.sqrt(np.nanmean((shoulder.after - shoulder.measured) ** 2))
    assert rms == pytest.approx(found.residuals["qpos[shoulder]"], rel=1e-12)
    assert found.correlations.shape == (2, 2)
    assert found.correlations[0, 1] == pytest.approx(found.correlations[1, 0], abs=1e-9)
    assert found.to_dict()["finer"] == found.finer


@pytest.mark.parametrize(
    "change, message",
    [
        ({"parameters": {}}, "parameters = {}: must be a dict of paths and ranges"),
        ({"parameters": {"joint/elbow/damping": 3}}, r"must be a range \(low, high\)"),
        ({"parameters": {"joint/elbow/damping": (1, 2)}}, "must be a range around 0.05"),
        ({"parameters": {"joint/elbo/damping": (1, 2)}}, 'no joint is named "elbo"'),
        ({"parameters": {"geom/rod/friction": (0.1, 2)}}, r"friction\[1\].* around 0.005"),
        ({"logs": []}, "logs: must be at least one"),
        ({"logs": {"qpos": [1.0]}}, r"logs\[0\] has shape \(1, 1\): must be \(n, 2\)"),
        ({"logs": {"time": [0.0, 0.1], "qpos": np.zeros((2, 2))}}, "has no controls"),
        ({"logs": {"time": [0.1, 0.0], "qpos": np.zeros((2, 2))}}, "increase"),
        (
            {"logs": {"time": [0, 0.1], "qpos": np.zeros((2, 3)), "ctrl": np.zeros((2, 2))}},
            r"qpos has shape \(2, 3\): must be \(n, 2\)",
        ),
        (
            {"logs": {"time": [0, 1], "qpos": np.full((2, 2), np.nan), "ctrl": np.zeros((2, 2))}},
            "has no positions",
        ),
    ],
)
def test_what_does_not_fit_is_told(change, message):
    given = {"logs": {"time": [0.0, 0.1], "qpos": np.zeros((2, 2)), "ctrl": np.zeros((2, 2))}}
    given |= {"parameters": {"joint/elbow/damping": (0.01, 1)}} | change
    with pytest.raises(ValueError, match=message):
        sc.identify(guess(), **given)
