"""Controls from files, DataFrames and dicts: columns by name, rows held from their times on."""

import pickle

import numpy as np
import pytest

import stepcore as sc
from stepcore.experiment.schedule import scheduled

ARM = """<mujoco><option timestep="0.01"/><worldbody><body name="a"><joint name="hip"/>
<geom size="0.1"/><body pos="1 0 0"><joint name="knee"/><geom size="0.1"/></body></body></worldbody>
<actuator><motor name="lift" joint="hip"/><motor name="kick" joint="knee"/></actuator>
<keyframe><key ctrl="0.5 0.25"/></keyframe></mujoco>"""


@pytest.fixture(scope="module")
def model():
    return sc.loads(ARM).compile()


def controls(model, ctrl, period=0.01, **fields):
    """The controls of each period of 0.06 s."""
    motion = sc.Motion(horizon=0.06, starts=1, ctrl=ctrl, **fields)
    return scheduled(motion, model, period).ctrl[0]


def test_columns_are_named_by_actuator_or_joint_in_any_order(model, tmp_path):
    file = tmp_path / "log.csv"
    file.write_text("knee,lift\n1,2\n3,4\n")
    expected = [[2.0, 1.0], [4.0, 3.0]]
    for ctrl in (file, str(file), {"knee": [1, 3], "lift": [2, 4]}):
        assert controls(model, ctrl)[:2].tolist() == expected
    assert (controls(model, file)[2:] == [4.0, 3.0]).all()


def test_an_actuator_without_a_column_keeps_the_keyframes_control(model):
    assert controls(model, {"kick": 3.0}).tolist() == [[0.5, 3.0]] * 6


def test_rows_are_held_from_their_own_times(model, tmp_path):
    """A log from 17.3 s on, at uneven times: sampled by the row that holds, never in between."""
    file = tmp_path / "log.csv"
    file.write_text("time [s];lift;kick\n17.3;1;0\n17.32;2;0\n17.35;3;0\n")
    assert controls(model, file)[:, 0].tolist() == [1, 1, 2, 2, 2, 3]
    assert sc.Motion(ctrl=file).period(0.01) is None


@pytest.mark.parametrize(
    ("gap", "period"),
    [
        *[(0.04, 0.04), (0.08, 0.04), (0.1, 0.05), (0.07, 0.07)],
        *[(0.02, None), (0.01, None), (0.015, None), (0.045, None), (0.005, None)],
    ],
)
def test_the_period_of_a_log_ends_with_its_rows_and_leaves_room_for_coarser_steps(gap, period):
    times = gap * np.arange(4)
    motion = sc.Motion(ctrl={"time": times, "lift": [0, 1, 0, 1]})
    found = motion.period(0.01)
    assert found is None if period is None else found == pytest.approx(period, rel=1e-12)
    assert sc.Motion(ctrl={"time": times, "lift": 1.0}).period(0.01) is None
    assert (
        sc.Motion(ctrl={"time": times, "lift": [0, 1, 0, 1]}, control_dt=0.03).period(0.01) == 0.03
    )


def test_dataframes_arrays_and_numpy_files(model, tmp_path):
    import pandas

    rows = np.array([[1.0, 2.0], [3.0, 4.0]])
    np.save(tmp_path / "u.npy", rows)
    np.savez(tmp_path / "u.npz", lift=rows[:, 0], kick=rows[:, 1])
    np.savez(tmp_path / "rows.npz", ctrl=rows)
    np.savetxt(tmp_path / "u.csv", rows, delimiter=",")
    np.savetxt(tmp_path / "named.csv", rows, delimiter=",", header="lift,kick")
    np.savetxt(tmp_path / "remark.csv", rows, delimiter=",", header="of Tuesday")
    frame = pandas.DataFrame(rows, columns=["lift", "kick"])
    structured = np.rec.fromarrays(rows.T, names="lift,kick")
    files = [tmp_path / name for name in ("u.npy", "u.npz", "rows.npz", "u.csv", "named.csv")]
    for ctrl in (rows, rows.tolist(), frame, structured, tmp_path / "remark.csv", *files):
        assert controls(model, ctrl)[:2].tolist() == rows.tolist()
    timed = frame.assign(t=[0.0, 0.02])
    assert controls(model, timed)[:, 0].tolist() == [1, 1, 3, 3, 3, 3]
    assert controls(model, timed.set_index("t"))[:, 0].tolist() == [1, 1, 3, 3, 3, 3]


def test_a_recorded_run_is_played_again(model, tmp_path):
    """The same motion, step by step, from the file that `Trajectory.save` writes."""
    sim = sc.Sim(model)
    sim.reset(key=0)
    run = sim.run(0.06, lambda time, sim: [np.sin(90 * time), time], record=("qpos", "ctrl"))
    run.save(tmp_path / "run.npz")
    again = sc.Sim(model)
    again.reset(key=0)
    rows = controls(model, tmp_path / "run.npz")
    np.testing.assert_array_equal(controls(model, run), rows)
    for row in rows:
        again.ctrl = row
        again.step()
    np.testing.assert_array_equal(again.qpos, run["qpos"][-1])


@pytest.mark.parametrize(
    ("ctrl", "text"),
    [
        ({"lfit": 1.0}, 'ctrl: no actuator is named "lfit"; nearest: "lift"'),
        ({"hip.control": 1.0, "lift": 2.0}, '"lift" is controlled by two columns'),
        ({"lift": [1.0, np.nan]}, "ctrl, row 1, column lift is empty or nan: must be finite"),
        ({"time": [0.0, 0.0], "lift": [1, 2]}, "times must be finite and increase"),
        ({"lift": [1, 2, 3], "kick": [1, 2]}, '"kick" has another length'),
        ({}, "is empty"),
        ("log.txt", r"must end in .csv, .npz, .npy"),
        ([[1.0, 2.0, 3.0]], r"ctrl has shape \(1, 3\): must be \(n, 2\)"),
        ([[1.0, np.inf]], "ctrl, row 0, column kick = inf: must be finite"),
        ([], "is empty"),
        ("abc", "must end in"),
    ],
)
def test_what_is_no_table_is_refused(model, ctrl, text):
    with pytest.raises(ValueError, match=text):
        controls(model, ctrl)


def test_a_bad_file_is_named(model, tmp_path):
    file = tmp_path / "log.csv"
    empty = ("lift,kick\n1,2\n3,\n", "log.csv, row 3, column kick is empty or nan: must be finite")
    other = ("lift,kick\n1,x\n", "log.csv, row 2, column kick: 'x': must be a number")
    twice = ("lift,lift\n1,2\n", 'several columns are named "lift"')
    for text, said in (other, empty, twice, ("", "is empty")):
        file.write_text(text)
        with pytest.raises(ValueError, match=said):
            controls(model, file)
    with pytest.raises(FileNotFoundError):
        sc.Motion(ctrl=tmp_path / "none.csv")


def test_a_motion_of_a_file_is_data(tmp_path):
    file = tmp_path / "log.csv"
    file.write_text("time,lift\n0,1\n0.03,2\n")
    motion = sc.Motion(horizon=0.06, ctrl=file)
    assert repr(motion) == "Motion(horizon=0.06, ctrl=log.csv)"
    other = pickle.loads(pickle.dumps(motion))
    np.testing.assert_array_equal(other.ctrl.rows, motion.ctrl.rows)
    trade = sc.converge(sc.loads(ARM), motion, progress=False)
    assert "motors driven by log.csv (30 ms at 33.33 Hz: control of lift)" in trade.ran
    with pytest.raises(
        ValueError, match=r'ctrl = \'sines\': write kind="sines" \(--motion sines\)'
    ):
        sc.converge(sc.loads(ARM), horizon=0.06, ctrl="sines", progress=False)
