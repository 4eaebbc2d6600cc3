"""Notes on logs whose rows, units or controls are doubtful, and recordings of ROS in a folder."""

import json

import numpy as np
import pytest

import stepcore as sc
from stepcore.cli import main
from stepcore.experiment.log import Log

ARM = """<mujoco><option timestep="{dt}"/><worldbody><body name="a"><joint name="hip" axis="0 1 0"
damping="1"/><geom type="capsule" size=".02" fromto="0 0 0 .3 0 0"/></body></worldbody><actuator>
<motor name="drive" joint="hip" ctrlrange="-5 5" ctrllimited="true"/></actuator></mujoco>"""
TIMES = np.arange(0, 1, 0.01)


def notes(positions, times=TIMES):
    log = Log({"time": times, "hip.position": positions})
    return log.placed(sc.loads(ARM.format(dt=0.002)).compile()).notes


def test_missing_rows_are_counted():
    assert notes(np.sin(TIMES)) == []
    kept = np.delete(np.arange(len(TIMES)), [10, 30, 31])
    (note,) = notes(np.sin(TIMES[kept]), TIMES[kept])
    assert "3 rows of 100" in note and "30 ms, at 290 ms" in note
    # A logger whose intervals vary by 20 %, and a schedule with irregular times, have no gaps.
    rng = np.random.default_rng(0)
    for apart in (rng.uniform(0.008, 0.012, 100), rng.exponential(0.01, 100)):
        assert notes(np.zeros(100), np.cumsum(apart)) == []


def test_positions_that_may_be_degrees():
    assert notes(np.radians(40) * np.sin(6 * TIMES)) == []
    (note,) = notes(40 * np.sin(6 * TIMES))
    assert '"hip.position [deg]"' in note
    # A wheel goes on turning.
    assert notes(40 * TIMES) == []


@pytest.mark.parametrize("measure", [sc.run, sc.check, sc.trade])
def test_controls_beyond_their_range_are_noted(measure):
    model = sc.loads(ARM.format(dt=0.002)).compile()
    quick = {"starts": 1, "effort": 1e5} if measure is sc.trade else {}
    for ctrl, clamped in ((4.0, False), (50.0, True)):
        result = measure(model, ctrl=[[ctrl]], horizon=0.02, progress=False, **quick)
        assert any("ctrlrange of -5 to 5" in note for note in result.notes) == clamped


@pytest.mark.parametrize(("dt", "noted"), [("2", True), ("0.02", False)])
def test_a_time_step_in_milliseconds_is_noted(dt, noted):
    assert any("2 ms is 0.002" in note for note in sc.loads(ARM.format(dt=dt)).notes) == noted


def write_mcap(path):
    writer = pytest.importorskip("mcap.writer")
    with open(path, "wb") as file:
        log = writer.Writer(file)
        log.start()
        channel = log.register_channel("/joints", "json", 0)
        for k in range(30):
            data = json.dumps({"hip.position": 0.01 * k}).encode()
            log.add_message(channel, k * 10**7, data, k * 10**7)
        log.finish()


def test_a_folder_of_rosbag2_is_its_mcap_file(tmp_path):
    folder = tmp_path / "bag"
    folder.mkdir()
    (folder / "metadata.yaml").write_text("")
    write_mcap(folder / "bag_0.mcap")
    for path in (str(folder), f"{folder}:/joints"):
        assert len(Log(path).times) == 30
    write_mcap(folder / "bag_1.mcap")
    with pytest.raises(ValueError, match=r"has 2 \.mcap files.*bag_0\.mcap"):
        Log(str(folder))


@pytest.mark.parametrize("name", ["a.db3", "a.bag", "bag"])
def test_other_recordings_of_ros_name_the_command_that_converts_them(name, tmp_path, capsys):
    path = tmp_path / name
    if name == "bag":
        path.mkdir()
        (path / "bag_0.db3").write_text("")
    else:
        path.write_text("")
    with pytest.raises(ValueError, match=rf"rosbags-convert --src {path} "):
        Log(str(path))
    (tmp_path / "arm.xml").write_text(ARM.format(dt=0.002))
    assert main(["run", str(tmp_path / "arm.xml"), "--ctrl", str(path)]) == 2
    assert "rosbags-convert" in capsys.readouterr().err
