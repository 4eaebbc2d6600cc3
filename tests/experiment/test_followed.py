"""Recorded positions of joints, followed by position servos."""

import numpy as np
import pytest

import stepcore as sc
from stepcore.cli import main
from stepcore.experiment.schedule import scheduled

ARM = """<mujoco model="arm"><option timestep="0.002" integrator="implicitfast" gravity="0 0 0"/>
<worldbody><body><joint name="hip" axis="0 1 0"/>
<geom type="capsule" size=".03" fromto="0 0 0 0 0 .3"/>
<body pos="0 0 .3"><joint name="knee" axis="0 1 0"/>
<geom type="capsule" size=".03" fromto="0 0 0 0 0 .3"/></body></body></worldbody>
<actuator><position name="lift" joint="knee" kp="400" kv="8" gear="3"/>
<position name="push" joint="hip" kp="600" kv="20"/></actuator>
<keyframe><key name="home" qpos="0.3 -0.2" ctrl="0.3 -0.6"/></keyframe></mujoco>"""
TIMES = np.arange(41) / 40


def path(times):
    return np.column_stack([0.4 * np.cos(3 * times), 0.2 - 0.3 * np.sin(2 * times)])


@pytest.fixture(scope="module")
def model():
    return sc.loads(ARM).compile()


def log(tmp_path, header="t,hip,knee"):
    file = tmp_path / "walk.csv"
    rows = np.column_stack([7 + TIMES, path(TIMES)])
    np.savetxt(file, rows, delimiter=",", header=header, comments="")
    return file


def test_servos_follow_a_log_of_40_hz_from_its_first_row(model, tmp_path):
    """The lag of kv over kp of each servo: 0.02 to 0.033 s times the speed, and some inertia."""
    run = sc.run(model, follow=log(tmp_path), horizon=1.0, record=("qpos", "ctrl"))
    expected = path(run.trajectory.time)
    assert run.trajectory.qpos[0] == pytest.approx(expected[0], abs=1e-12)
    assert np.abs(run.trajectory.qpos - expected).max() < 0.12
    # At rest in the recorded pose every force is zero: gear 3 counts threefold.
    at = round(0.5 / 0.002)
    target = [np.interp(0.501, TIMES, path(TIMES)[:, k]) for k in (1, 0)]
    assert run.trajectory.ctrl[at + 1] == pytest.approx([3 * target[0], target[1]], abs=1e-9)
    said = "servos follow the positions of walk.csv (1 s at 40 Hz: position of hip, knee)"
    assert f"1 s from the first pose of walk.csv; {said}" in run.ran


def test_a_recorded_run_is_followed(model, tmp_path):
    """The same controls by name from a table, as a Trajectory, and as rows of all coordinates."""
    record = sc.Sim(model).run(0.3, [[0.9, 0.4]] * 150, control_dt=0.002, record=("qpos", "ctrl"))
    record.save(tmp_path / "run.csv")
    record.save(tmp_path / "run.npz")
    found = []
    for follow in (record, tmp_path / "run.csv", tmp_path / "run.npz"):
        motion = sc.Motion(horizon=0.2, starts=2, follow=follow)
        schedule = scheduled(motion, model, 0.008)
        found.append(schedule.log.steps(0.0, 0.002, 100))
        assert schedule.starts[0].qpos == pytest.approx(record.qpos[0])
    np.testing.assert_array_equal(found[0], found[1])
    np.testing.assert_array_equal(found[0], found[2])


def test_one_pose_is_held(model):
    run = sc.run(model, follow={"hip": 0.1, "knee": 0.5}, horizon=2.0)
    assert run.sim.qpos == pytest.approx([0.1, 0.5], abs=1e-9)


def test_measurements_follow_and_their_commands_do(model, tmp_path, capsys, monkeypatch):
    monkeypatch.chdir(tmp_path)
    log(tmp_path)
    (tmp_path / "arm.xml").write_text(ARM)
    given = ["--follow", "walk.csv", "--horizon", "200ms", "--threads", "1"]
    assert main(["check", "arm.xml", *given]) == 0
    said = " ".join(capsys.readouterr().out.split())
    assert "stepcore predict arm.xml --horizon 0.2 --follow walk.csv" in said
    assert "--ctrl" not in said
    assert main(["run", "arm.xml", "--follow", "walk.csv", "--horizon", "100ms"]) == 0
    few = {"integrators": ["implicitfast"], "solvers": ["newton"], "precisions": ["f64"]}
    trade = sc.trade(
        model, follow="walk.csv", horizon=0.4, starts=2, by="flops", progress=False, **few
    )
    assert max(row.settings.dt for row in trade.rows) > 0.0039
    assert repr(sc.Motion(follow="walk.csv")) == "Motion(follow='walk.csv')"


@pytest.mark.parametrize(
    ("xml", "fields", "said"),
    [
        (ARM, {"follow": {"hop": 1.0}}, 'no joint is named "hop"; nearest: "hip"'),
        (ARM, {"follow": [[1.0, 2.0, 3.0]]}, r"has shape \(1, 3\): must be \(n, 2\)"),
        (ARM, {"follow": {"hip": 1.0}, "ctrl": [[0.0, 0.0]]}, "follow and ctrl are both given"),
        (
            ARM.partition("<actuator>")[0]
            + '<actuator><damper joint="hip" ctrlrange="0 1"/></actuator></mujoco>',
            {"follow": {"hip": 1.0}},
            "no actuator is a position servo or motor",
        ),
    ],
)
def test_what_cannot_be_followed_is_refused(xml, fields, said):
    with pytest.raises(ValueError, match=said):
        sc.run(sc.loads(xml), **fields)


def test_motors_follow_by_a_pd_controller_of_stepcore(tmp_path):
    """Under gravity, with the load of the first pose: within 0.12 rad of a path of 1.2 rad/s."""
    head = ARM.partition("<actuator>")[0].replace('gravity="0 0 0"', "")
    motors = '<motor name="a" joint="hip"/><motor name="b" joint="knee" gear="5"/>'
    model = sc.loads(f"{head}<actuator>{motors}</actuator></mujoco>").compile()
    run = sc.run(model, follow=log(tmp_path), horizon=1.0, record=("qpos",))
    assert np.abs(run.trajectory.qpos - path(run.trajectory.time)).max() < 0.12
    assert "motors follow the positions of walk.csv" in run.ran
    trade = sc.trade(model, follow=log(tmp_path), horizon=0.4, starts=2, by="flops", progress=False)
    assert trade.reference.error < 1e-4
