"""Logs of identify: from every kind of source, and what is doubtful about them."""

import json

import numpy as np
import pytest
from arm_log import DAMPING, HIDDEN, RANGES, TRUE, controls, guess, mujoco_log, noisy

import stepcore as sc
from stepcore.measure.identification.doubts import log_findings
from stepcore.measure.identification.log import read_log

pytest.importorskip("scipy")
WANTED = {DAMPING: RANGES[DAMPING]}
TEXT = """<mujoco><option timestep="0.01" gravity="0 0 0"/><worldbody>
<body><joint name="hip" axis="0 1 0" damping="1" limited="true" range="-90 90"/>
<geom size=".1" mass="100"/></body></worldbody>
<actuator><motor name="hip" joint="hip"/></actuator></mujoco>"""


def known():
    """The arm whose damping alone is wrong."""
    return guess(**{key: value for key, value in TRUE.items() if key != "damping"})


def columns(log, names=("shoulder", "elbow"), drives=("a", "elbow.control")):
    """The numbers of a log by column."""
    table = {"t": log["time"]}
    table |= {name: log["qpos"][:, k] for k, name in enumerate(names)}
    table |= {f"{name}.velocity": log["qvel"][:, k] for k, name in enumerate(names)}
    return table | {name: log["ctrl"][:, k] for k, name in enumerate(drives)}


def found_in(log, model=None):
    return sc.identify(known() if model is None else model, log, WANTED).values[DAMPING]


def write_mcap(path, log):
    """Joint states of ROS on one topic, commands by name on another, which starts later."""
    writer = pytest.importorskip("mcap.writer").Writer
    with open(path, "wb") as file:
        out = writer(file)
        out.start()
        schema = out.register_schema("Any", "jsonschema", b"{}")
        states, commands = (out.register_channel(t, "json", schema) for t in ("/states", "/drive"))
        for k, time in enumerate(log["time"]):
            at = 1_700_000_000_000_000_000 + round(1e9 * time)
            joints = {"name": ["elbow", "shoulder"]}
            joints |= {"position": log["qpos"][k][::-1].tolist()}
            joints |= {"velocity": log["qvel"][k][::-1].tolist()}
            drive = dict(zip(("a", "elbow"), log["ctrl"][k].tolist(), strict=True))
            for channel, message in ((states, joints), (commands, drive)):
                data = json.dumps(message).encode()
                out.add_message(channel, log_time=at, publish_time=at, data=data)
        out.finish()


def test_recorded_runs_and_their_files_are_logs(tmp_path):
    true = guess().with_values(HIDDEN)
    run = sc.Sim(true).run(0.4, control=controls(200), record=("qpos", "qvel", "ctrl"))
    for name in ("run.csv", "run.npz"):
        run.save(tmp_path / name)
    logs = (run, tmp_path / "run.csv", str(tmp_path / "run.npz"), run.to_pandas(), [run, run])
    assert [found_in(log) for log in logs] == pytest.approx([0.3] * 5, rel=1e-6)


def test_tables_have_columns_by_joint_and_actuator(tmp_path):
    """The same estimate from arrays, a frame, CSV with empty cells, Parquet and messages."""
    pandas = pytest.importorskip("pandas")
    log = mujoco_log(200)
    log["qvel"][3] = np.nan
    scene = known().scene
    scene.actuators[1].name = "elbow"
    model, exact = scene.compile(), found_in(log)
    frame = pandas.DataFrame(columns(log, drives=("a", "elbow.control")))
    both = r'column "elbow": must be elbow.position or elbow.control'
    with pytest.raises(ValueError, match=both):
        found_in(frame.drop(columns="elbow.control"), model)
    frame.to_csv(tmp_path / "log.csv", index=False)
    frame.to_parquet(tmp_path / "log.parquet")
    drives = {"a": log["ctrl"][:, 0], "t": log["time"], "elbow": log["ctrl"][:, 1]}
    apart = {"qpos": frame.drop(columns=["a", "elbow.control"]), "qvel": frame, "ctrl": drives}
    for source in (frame, tmp_path / "log.csv", tmp_path / "log.parquet", apart):
        assert found_in(source, model) == pytest.approx(exact, rel=1e-6)


def test_messages_of_joint_states_and_commands(tmp_path):
    log, path = mujoco_log(200), tmp_path / "log.mcap"
    write_mcap(path, log)
    apart = {
        "qpos": f"{path}:/states",
        "qvel": f"{path}:/states.velocity",
        "ctrl": f"{path}:/drive",
    }
    assert found_in(apart) == pytest.approx(found_in(log), rel=1e-6)
    with pytest.raises(
        ValueError,
        match=r"log\.mcap: has no controls: it has position and velocity of elbow, shoulder",
    ):
        found_in(f"{path}:/states")
    recorded = read_log(known(), apart, "log")
    assert np.array_equal(recorded.measured["qvel"].values, log["qvel"])


def test_columns_that_are_nothing_of_the_model_are_named():
    log = mujoco_log(100) | {"battery": np.zeros(20)}
    found = sc.identify(known(), log, WANTED)
    read, unread = found.notes
    assert read.startswith(
        "logs[0]: 190 ms at 100 Hz: position and velocity of shoulder, elbow; control"
    )
    assert unread == "logs[0] has columns that are nothing of the model: battery"


def test_sensors_of_a_recorded_run_belong_to_the_step_before():
    """A run records with each instant the sensor readings at the start of the step."""
    sensors = '<jointvel name="speed" joint="elbow"/>'
    model = guess(sensors)
    run = sc.Sim(model).run(0.1, control=controls(50), record=("qpos", "ctrl", "sensordata"))
    log = read_log(model, run, "log")
    speeds = log.measured["sensordata"].values[:, 0]
    again = sc.Sim(model).run(0.1, control=controls(50), record=("qvel",))
    assert np.isnan(speeds[-1])
    assert speeds[:-1] == pytest.approx(again.qvel[:-1, 1], abs=1e-12)


def test_times_in_milliseconds_are_refused():
    log = mujoco_log(100)
    log["time"] = 1e3 * log["time"]
    with pytest.raises(
        ValueError, match=r"column time: rows are 10 s apart, which looks like millisec"
    ):
        found_in(log)


def swing(seconds=2.0):
    """A hinge that turns to and fro, at 100 Hz."""
    time = np.arange(0, seconds, 0.01)
    return {
        "time": time,
        "qpos": np.sin(3 * time)[:, None],
        "qvel": 3 * np.cos(3 * time)[:, None],
        "ctrl": np.zeros((len(time), 1)),
    }


@pytest.mark.parametrize(
    "change, said",
    [
        ({}, None),
        ({"qvel": 57.2958}, "velocity is 57.3× the change of its position: it looks like degrees"),
        ({"time": 0.001}, "changes 1000× its velocity: times must be in seconds"),
    ],
)
def test_units_are_doubted(change, said):
    """Degrees and times by the velocity; positions in degrees are refused."""
    degrees = swing() | {"qpos": np.degrees(swing()["qpos"])}
    with pytest.raises(ValueError, match=r"changes 57.3 times .*: it looks like degrees"):
        sc.identify(sc.loads(TEXT), degrees, {"joint/hip/damping": (0.1, 10)})
    log = {key: value * change.get(key, 1.0) for key, value in swing().items()}
    found = sc.identify(sc.loads(TEXT), log, {"joint/hip/damping": (0.1, 10)}, most=1)
    units = [finding for finding in found.findings if finding.kind == "units"]
    if said is None:
        assert not units
    else:
        assert units[0].severity == "error" and said in units[0].text
        assert units[0].text in found.sentences


def spoiled(kind):
    """A noisy log, one of whose columns does not match its name; None: a clean one."""
    log, ahead = noisy(mujoco_log()), slice(3, None)
    if kind == "sign":
        log["ctrl"][:, 0] *= -1
    elif kind == "swapped":
        log["qvel"] = log["qvel"][:, ::-1]
    elif kind == "delay":
        log["qvel"][ahead] = log["qvel"][:-3]
    return log


@pytest.mark.parametrize("kind", ["sign", "swapped", "delay", None])
def test_columns_that_are_not_what_they_say_are_doubted_before_the_run(kind):
    read = read_log(known(), spoiled(kind), "log")
    assert [finding.kind for finding in log_findings(known(), [read], [])] == [kind] * bool(kind)


def test_a_sensor_in_another_unit_is_doubted_by_the_fit():
    sensors = '<framepos name="hand" objtype="site" objname="hand"/>'
    log = mujoco_log(200, sensors=sensors)
    log["sensordata"] *= 1e3
    model = guess(sensors, **{key: value for key, value in TRUE.items() if key != "damping"})
    found = sc.identify(model, log, WANTED, most=2)
    texts = [finding.text for finding in found.findings]
    assert any("sensordata[hand.0]: measured 1001× the prediction" in text for text in texts)


def test_gaps_of_the_controls_are_told():
    log = mujoco_log(200)
    kept = np.r_[:10, 25:40]
    cut = {key: value[kept] for key, value in log.items()}
    found = sc.identify(known(), cut, WANTED)
    (finding,) = found.findings
    assert finding.kind == "gap"
    assert "no controls for 160 ms from 90 ms on" in finding.text
    log["ctrl"][7, 1] = np.nan
    with pytest.raises(
        ValueError, match=r"logs\[0\], row 7, column ctrl.* is empty or nan: must be finite"
    ):
        found_in(log)


def test_what_is_small_is_not_taken_for_degrees():
    """An axis has a range of 2 degrees, and a soft row lets it go four times as far."""
    text = """<mujoco><worldbody><body><joint name="axis" axis="0 1 0" range="-2 2" damping="1"
    solreflimit=".2 1"/><geom type="capsule" size=".02" fromto="0 0 0 .3 0 0"/></body></worldbody>
    </mujoco>"""
    run = sc.Sim(sc.loads(text)).run(1.0)
    assert 3 * np.radians(2) < np.abs(run.qpos).max() < 1.0
    found = sc.identify(sc.loads(text), run, {"joint/axis/damping": (0.1, 10)})
    assert found.values["joint/axis/damping"] == pytest.approx(1.0, rel=1e-3)


PENDULUM = """<mujoco><option timestep="0.01" integrator="RK4"/>
<default><geom contype="0" conaffinity="0" size="0.02" mass="1"/></default><worldbody>
<body><joint name="upper" axis="0 1 0" damping="0.01"/><geom type="capsule" fromto="0 0 0 0 0 -1"/>
<body pos="0 0 -1"><joint name="lower" axis="0 1 0"/><geom type="capsule" fromto="0 0 0 0 0 -1"/>
</body></body></worldbody></mujoco>"""


def test_a_log_beyond_what_can_be_predicted_says_from_when():
    """A double pendulum from a raised pose: the time agrees with `predict` to a third."""
    sim = sc.Sim(sc.loads(PENDULUM))
    sim.qpos[:] = 2.0, 0.5
    run = sim.run(8.0)
    found = sc.identify(sc.loads(PENDULUM), run, {"joint/upper/damping": (0.001, 0.1)}, most=2)
    (end,) = found.predictable
    scene = sc.loads(
        PENDULUM.replace("</mujoco>", '<keyframe><key qpos="2 .5"/></keyframe></mujoco>')
    )
    known = sc.predict(scene, horizon=8.0, starts=1, progress=False, threads=1).time
    assert end == pytest.approx(known, rel=1 / 3)
    (finding,) = [finding for finding in found.findings if finding.kind == "horizon"]
    assert finding.value == end and "cut it into pieces" in finding.text
    first = {"time": run.time[:200], "qpos": run.qpos[:200], "qvel": run.qvel[:200]}
    short = sc.identify(sc.loads(PENDULUM), first, {"joint/upper/damping": (0.001, 0.1)}, most=2)
    assert short.predictable == [np.inf]


def test_a_run_that_fails_with_the_present_values_is_told():
    text = TEXT.replace('damping="1"', 'damping="1" stiffness="-1e9"')
    with pytest.raises(ValueError, match="must be values with which the logs can be run"):
        sc.identify(sc.loads(text), swing(), {"joint/hip/damping": (0.1, 10)})


@pytest.mark.parametrize(
    "given, message",
    [
        ((-0.1, 0.1), "must be a range that"),
        ((0.1, 0.0), r"must be a range \(low, high\)"),
    ],
)
def test_delays_are_times_of_a_model_with_controls(given, message):
    with pytest.raises(ValueError, match=message):
        sc.identify(known(), mujoco_log(20), {"delay": given})
    still = {"time": [0.0, 0.1], "qpos": np.zeros((2, 2))}
    with pytest.raises(ValueError, match="of a model with controls"):
        sc.identify(sc.loads(PENDULUM), still, {"delay": (0, 0.1)})
    late = PENDULUM.replace(
        "</mujoco>", '<actuator><motor joint="upper" delay=".1" nsample="9"/></actuator></mujoco>'
    )
    with pytest.raises(ValueError, match='without delays of actuators: make these 0, and "delay"'):
        sc.identify(sc.loads(late), still, {"joint/hip/damping": (0.1, 10)})


def shifted(rows):
    """A noisy log whose motion is recorded this many rows late."""
    log = noisy(mujoco_log())
    states = {key: log[key][: len(log["time"]) - rows] for key in ("qpos", "qvel")}
    return {key: log[key][rows:] for key in ("time", "ctrl")} | states


def test_a_motion_that_is_late_beside_its_controls_is_doubted():
    read = read_log(known(), shifted(6), "log")
    (finding,) = log_findings(known(), [read], [])
    assert finding.kind == "delay" and 'search "delay" too' in finding.text
    assert "its motion is about 70 ms late, beside its controls" in finding.text
    assert not log_findings(known(), [read], ["delay"])


def test_controls_in_another_unit_and_positions_that_jump_are_doubted():
    log = noisy(mujoco_log())
    log["ctrl"] = 1e3 * log["ctrl"]
    (finding,) = log_findings(known(), [read_log(known(), log, "log")], [])
    assert finding.kind == "units" and "what its motion needs" in finding.text
    log = noisy(mujoco_log())
    log["qpos"][30:34] = log["qvel"][30:34] = 0.0
    found = log_findings(known(), [read_log(known(), log, "log")], [])
    assert [finding.kind for finding in found] == ["jump"] and " jumps by " in found[0].text


def test_names_are_found_in_another_letter_case():
    log = mujoco_log(200)
    table = {key.replace("shoulder", "Shoulder").upper(): v for key, v in columns(log).items()}
    assert found_in(table) == pytest.approx(found_in(log), rel=1e-6)


def test_a_long_log_is_cut_into_pieces_where_it_cannot_be_predicted():
    """Noisy positions of a double pendulum, whose small errors grow ten thousand times in 8 s."""
    sim = sc.Sim(sc.loads(PENDULUM.replace('damping="0.01"', 'damping="0.05"')))
    sim.qpos[:] = 2.0, 0.5
    run = sim.run(8.0)
    log = {
        "time": run.time,
        "qpos": run.qpos + 1e-3 * np.random.default_rng(0).normal(size=(801, 2)),
    }
    found = sc.identify(sc.loads(PENDULUM), log, {"joint/upper/damping": (0.001, 0.5)})
    low, high = found.intervals["joint/upper/damping"]
    assert low < 0.05 < high < 2 * 0.05 and found.quality.verdict == "noise"
    assert any("cut into pieces of" in note for note in found.notes)
