"""Runs over time: overlap as a recordable number, and the picture."""

import csv
import sys

import numpy as np
import pytest

import stepcore as sc
from stepcore import lesson
from stepcore.engine.trajectory import RECORDED


def drop():
    sim = sc.Sim(lesson.drop())
    sim.reset(key="start")
    return sim


def test_overlap_is_that_of_the_present_state():
    """−qpos while the ball is in the floor, else 0; at rest softness m g h² / β deep."""
    sim = drop()
    run = sim.run(1.0, record=("qpos", "overlap"))
    assert run.overlap.shape == (501,)
    assert run.overlap == pytest.approx(np.maximum(0.0, -run.qpos[:, 0]), abs=1e-15)
    assert run.overlap[0] == 0.0 < run.overlap.max()
    assert sim.overlap == pytest.approx(0.5 * 9.81 * 0.002**2 / 0.2, rel=1e-6)


def test_reading_overlap_changes_nothing():
    """The last solve stays as it is, whatever is written and read in between."""
    sim = drop()
    sim.step(200)
    before, state = sim.contacts.copy(), sim.state()
    sim.qpos = [-0.05]
    assert sim.overlap == pytest.approx(0.05, abs=1e-15)
    assert np.array_equal(sim.contacts, before)
    sim.restore(state)
    again = drop()
    again.step(200)
    sim.step(50)
    again.step(50)
    assert sim.qpos[0] == again.qpos[0]


def test_overlap_of_a_batch_and_of_the_deepest_pair():
    """Two balls in one another and in the floor: the deeper counts, world by world."""
    model = lesson.stack().compile()
    batch = sc.Batch(model, 3)
    batch.qpos = [[0.0, 0.0], [-0.02, -0.02], [-0.01, -0.04]]
    assert batch.overlap == pytest.approx([0.0, 0.02, 0.03], abs=1e-15)


@pytest.mark.parametrize(
    ("record", "labels"),
    (
        (
            ("qpos", "energy", "overlap"),
            ["position [m]", "energy [J]", "deepest overlap [m]"],
        ),
        (("qpos", "residual"), ["position [m]", "residual [m/s]"]),
    ),
)
def test_the_picture(tmp_path, record, labels):
    """Positions, energy and overlap where they are, else all; words are inside, nothing is cut."""
    figure = drop().run(0.5, record=record).plot(tmp_path / "run.png")
    assert (tmp_path / "run.png").read_bytes().startswith(b"\x89PNG")
    assert [axes.get_ylabel() for axes in figure.axes] == labels
    assert figure.axes[-1].get_xlabel() == "time [s]"
    if "energy" in record:
        words = [text.get_text() for text in figure.axes[1].get_legend().get_texts()]
        assert words == ["kinetic", "potential", "total"]


def test_nothing_recorded_cannot_be_drawn():
    with pytest.raises(ValueError, match="recorded nothing"):
        drop().run(0.1, record=()).plot()


EVERYTHING = """<mujoco><worldbody><geom type="plane" size="1 1 1"/>
<body name="box" pos="0 0 1"><freejoint name="root"/><geom name="g" size=".1"/><site name="s"/>
<body name="arm"><joint name="knee"/><geom size=".1"/>
<body><joint type="ball"/><geom size=".1"/></body></body></body></worldbody>
<actuator><motor name="m" joint="knee"/></actuator>
<sensor><jointpos name="angle" joint="knee"/><gyro name="imu" site="s"/></sensor></mujoco>"""
NAMED = {
    "qpos": [("knee",)],
    "sensordata": [("angle", "imu.0", "imu.1", "imu.2")],
    "xpos": [("world", "box", "arm", "body 3"), ("x", "y", "z")],
    "energy": [("kinetic", "potential")],
    "actuator_force": [("m",)],
}


def recorded(names=RECORDED):
    return sc.Sim(sc.loads(EVERYTHING), error_bar=names is RECORDED).run(0.02, record=names)


def test_arrays_by_their_names():
    run = recorded(("qpos", "energy"))
    assert run["qpos"] is run.qpos and run["time"] is run.time
    assert "qpos" in run and "time" in run and "qvel" not in run and 0 not in run
    with pytest.raises(KeyError, match='nearest: "qpos"'):
        run["qpso"]
    with pytest.raises(KeyError, match="0 was not recorded"):
        run[0]
    with pytest.raises(TypeError):
        list(run)


def test_the_axes_are_named_as_the_model_s_parts():
    run = recorded()
    free, ball = "xyz", ("qw", "qx", "qy", "qz")
    root, third = [f"root.{part}" for part in (*free, *ball)], "joint 2 of body 3"
    coordinates = (*root, "knee", *(f"{third}.{part}" for part in ball))
    for name, entries in (NAMED | {"qpos": [coordinates]}).items():
        assert [axis.entries for axis in run.axes(name)] == entries, name
    assert [axis.name for axis in run.axes("xpos")] == ["body", "xyz"]
    turning = ("root.wx", "root.wy", "root.wz")
    assert run.axes("qvel")[0].entries[3:8] == (*turning, "knee", f"{third}.wx")
    assert [axis.name for axis in run.axes("xmat")] == ["body", "xmat_1", "xmat_2"]
    # Everything that can be recorded has as many entries as it has numbers.
    for name, values in run.data.items():
        assert tuple(len(axis.entries) for axis in run.axes(name)) == values.shape[1:]
    plain = sc.Trajectory(run.time, run.data)
    assert plain.axes("qpos")[0].entries[:2] == ("0", "1")


def test_a_file_keeps_every_array_and_its_names(tmp_path):
    run = recorded()
    run.save(tmp_path / "run.data")
    again = sc.Trajectory.load(tmp_path / "run.data")
    assert np.array_equal(again.time, run.time) and list(again.data) == list(run.data)
    for name, values in run.data.items():
        assert again[name].dtype == values.dtype and np.array_equal(again[name], values)
        assert again.axes(name) == run.axes(name), name
    again.save(tmp_path / "again.npz")
    assert sc.Trajectory.load(tmp_path / "again.npz").axes("xpos") == run.axes("xpos")
    with pytest.raises(ValueError, match="has no snapshots"):
        again.save_html(tmp_path / "run.html")


def test_what_is_no_trajectory_is_refused(tmp_path):
    with pytest.raises(FileNotFoundError, match=r"none\.npz: no such file"):
        sc.Trajectory.load(tmp_path / "none.npz")
    with pytest.raises(IsADirectoryError, match="is a folder"):
        sc.Trajectory.load(tmp_path)
    (tmp_path / "text.npz").write_text("text")
    (tmp_path / "empty.npz").touch()
    np.savez(tmp_path / "other.npz", a=np.arange(3))
    np.save(tmp_path / "array.npy", np.arange(3))
    recorded(("qpos",)).save(tmp_path / "run.npz")
    (tmp_path / "half.npz").write_bytes((tmp_path / "run.npz").read_bytes()[:200])
    for name in ("text.npz", "empty.npz", "other.npz", "array.npy", "half.npz"):
        with pytest.raises(ValueError, match=rf"{name}: is not a trajectory"):
            sc.Trajectory.load(tmp_path / name)
    arrays = dict(np.load(tmp_path / "run.npz"))
    np.savez(tmp_path / "new.npz", **(arrays | {"version": np.array(99)}))
    with pytest.raises(ValueError, match=r"version 99 .*; this stepcore reads version 1"):
        sc.Trajectory.load(tmp_path / "new.npz")


def test_frames_of_pandas_and_xarray():
    run = recorded(("qpos", "xpos", "overlap"))
    frame = run.to_pandas()
    assert frame.index.name == "time [s]" and np.array_equal(frame.index, run.time)
    assert np.array_equal(frame["qpos[knee]"], run.qpos[:, 7])
    assert np.array_equal(frame["xpos[arm, z]"], run.xpos[:, 2, 2])
    assert np.array_equal(frame["overlap"], run.overlap)
    assert frame.shape == (len(run), 12 + 12 + 1)
    dataset = run.to_xarray()
    assert np.array_equal(dataset.xpos.sel(body="arm", xyz="z"), run.xpos[:, 2, 2])
    assert dataset.overlap.attrs["units"] == "m" and dataset.time.attrs["units"] == "s"
    assert dataset.qpos.dims == ("time", "coordinate")
    everything = recorded()
    assert set(everything.to_xarray().data_vars) == set(everything.data)
    assert len(everything.to_pandas().columns) == sum(
        values[0].size for values in everything.data.values()
    )


@pytest.mark.parametrize(("method", "package"), [("to_pandas", "pandas"), ("to_xarray", "xarray")])
def test_a_missing_package_is_named_with_its_extra(monkeypatch, method, package):
    monkeypatch.setitem(sys.modules, package, None)
    with pytest.raises(ImportError, match=rf"needs {package}: pip install '\.\[data\]'"):
        getattr(recorded(("qpos",)), method)()


@pytest.mark.parametrize(
    "change",
    [
        {"time": None},
        {"time": np.zeros((2, 2))},
        {"data/qpos": np.zeros(3)},
        {"axis/none": np.array(["a"])},
        {"axis/other/0/x": np.array(["a"])},
        {"version": np.array("x")},
        {"version": np.zeros(3)},
        {"unsolved": None},
        {"kind": None},
    ],
    ids=str,
)
def test_a_forged_file_is_refused_in_one_line(tmp_path, change):
    path = tmp_path / "run.npz"
    drop().run(0.1).save(path)
    with np.load(path) as file:
        arrays = dict(file) | change
    np.savez(path, **{name: value for name, value in arrays.items() if value is not None})
    with pytest.raises(ValueError, match=r"run\.npz: ") as caught:
        sc.Trajectory.load(path)
    assert "\n" not in str(caught.value)


def test_a_file_of_another_kind_is_refused_by_its_name(tmp_path):
    """What stood there before stays."""
    file = tmp_path / "x.xlsx"
    file.write_text("a,b")
    run = sc.Sim("lesson:drop").run(0.05)
    with pytest.raises(ValueError, match=r"must end in .npz or .csv; to_pandas\(\) has the frame"):
        run.save(file)
    assert file.read_text() == "a,b"


def test_a_table_has_every_number_by_name_and_time_from_the_beginning(tmp_path):
    """The keyframe's time is 59.5 s; a run lasts from 0 on."""
    arm = EVERYTHING.replace("</mujoco>", '<keyframe><key time="59.5"/></keyframe></mujoco>')
    sim = sc.Sim(sc.loads(arm))
    sim.reset(key=0)
    run = sim.run(0.1, record=("qpos", "xpos", "energy", "overlap"))
    assert run.time[0] == 59.5
    run.save(tmp_path / "run.csv")
    with open(tmp_path / "run.csv", encoding="utf-8", newline="") as file:
        names, *rows = csv.reader(file)
    assert names[:2] == ["time [s]", "qpos[root.x]"] and names[-1] == "overlap"
    values = np.array(rows, float)
    assert len(names) == values.shape[1] == 1 + 12 + 12 + 2 + 1
    assert values[0, 0] == 0.0 and values[-1, 0] == pytest.approx(0.1)
    assert np.array_equal(values[:, names.index("xpos[arm, z]")], run.xpos[:, 2, 2])
    assert np.array_equal(values[:, names.index("qpos[knee]")], run.qpos[:, 7])
    axes = run.plot().axes[-1]
    assert axes.get_xlim() == pytest.approx((0.0, 0.1)) and axes.lines[0].get_xdata()[0] == 0.0
