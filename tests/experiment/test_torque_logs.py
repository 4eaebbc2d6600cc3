"""Logs of torques: motors are made where a model has none; if it has servos, the user chooses."""

from dataclasses import replace

import numpy as np
import pytest

import stepcore as sc
from stepcore.cli import main

URDF = """<robot name="arm"><link name="base"/><joint name="knee" type="revolute">
<parent link="base"/><child link="shin"/><axis xyz="0 1 0"/>
<limit effort="90" velocity="3" lower="-9" upper="9"/></joint>
<link name="shin"><inertial><origin xyz=".1 0 0"/><mass value="1"/>
<inertia ixx=".01" iyy=".01" izz=".01" ixy="0" ixz="0" iyz="0"/></inertial></link></robot>"""
SERVO = """<mujoco><worldbody><body><joint name="knee" axis="0 1 0" damping=".1"/>
<geom type="capsule" size=".03" fromto="0 0 0 .2 0 0" mass="1"/></body></worldbody>
<actuator><position name="drive" joint="knee" kp="50"/></actuator>
<keyframe><key qpos=".1" ctrl=".1"/></keyframe></mujoco>"""
TIMES = 0.004 * np.arange(100)
TORQUE = np.sin(9 * TIMES)


def test_motors_are_made_for_a_urdf_and_said():
    log = {"t": TIMES, "knee.position": 0 * TIMES, "knee.effort": TORQUE}
    run = sc.run(sc.loads(URDF), horizon=0.2, ctrl=log)
    assert "motors were made for the torques of ctrl: knee" in run.notes
    sim = sc.Sim(run.sim.model, run.settings)
    for k in range(100):
        sim.ctrl = TORQUE[k // 2]
        sim.step()
    assert run.sim.qpos == pytest.approx(sim.qpos, abs=1e-12)
    follow = sc.run(sc.loads(URDF), horizon=0.2, follow={"t": TIMES, "knee": 0.2 * TIMES})
    assert "motors were made for the positions of qpos: knee" in follow.notes
    assert follow.sim.qpos == pytest.approx([0.04], abs=5e-3)


def test_identify_finds_what_a_urdf_has_from_torques():
    pytest.importorskip("scipy")
    model = sc.Log({"t": TIMES, "knee.effort": TORQUE}).driven(sc.loads(URDF).compile())
    true = sc.Sim(model.with_values({"joint/knee/damping": 0.3}))
    run = true.run(0.4, lambda time, sim: np.sin(9 * time), record=("qpos", "ctrl"))
    torque = np.append(run.ctrl[1:, 0], 0.0)
    log = {"t": run.time, "knee.position": run.qpos[:, 0], "knee.torque": torque}
    found = sc.identify(sc.loads(URDF), log, {"joint/knee/damping": (0.01, 2)})
    assert found.values["joint/knee/damping"] == pytest.approx(0.3, rel=1e-6)
    assert any("400 ms at 500 Hz: position and torque of knee" in note for note in found.notes)


def test_torques_of_servos_are_a_choice(tmp_path, capsys):
    log = "\n".join(f"{t},0.1,{u}" for t, u in zip(TIMES.tolist(), TORQUE.tolist(), strict=True))
    (tmp_path / "log.csv").write_text(f"t,knee.position,knee.effort\n{log}\n")
    (tmp_path / "arm.xml").write_text(SERVO)
    file, path = str(tmp_path / "arm.xml"), str(tmp_path / "log.csv")
    said = rf"drive are no motors.*write {path}:effort .*--follow {path}"
    for question in (sc.run, sc.check):
        with pytest.raises(ValueError, match=said):
            question(file, ctrl=path)
    with pytest.raises(ValueError, match="drive are no motors") as refused:
        sc.identify(file, path, {"joint/knee/damping": (0.01, 2)})
    assert "follow" not in str(refused.value)
    assert main(["run", file, "--ctrl", f"{path}:effort", "--horizon", "0.2"]) == 0
    assert "motors driven by log.csv" in " ".join(capsys.readouterr().out.split())
    assert main(["run", file, "--follow", path, "--horizon", "0.2"]) == 0
    forced = sc.run(
        file, horizon=0.2, ctrl=sc.Log(path, controls="effort"), record=("actuator_force",)
    )
    assert forced.trajectory.actuator_force[1, 0] == pytest.approx(TORQUE[0], abs=1e-12)


@pytest.mark.parametrize(
    ("columns", "said"),
    [
        ({"knee.control": TORQUE}, 'no actuator is named "knee.control"'),
        ({"knee": TORQUE}, "has no controls: it has position of knee.*joint.effort.*--follow"),
        (
            {"knee.effort": TORQUE, "t": None},
            'has torque of knee, and no times: name a column "time"',
        ),
        ({"foot.effort": TORQUE}, 'no joint or actuator is named "foot.effort"'),
    ],
)
def test_controls_that_drive_nothing_are_an_error(columns, said):
    with pytest.raises(ValueError, match=said):
        log = {"t": TIMES, **columns}
        sc.run(sc.loads(URDF), ctrl={key: log[key] for key in log if log[key] is not None})


def test_velocities_of_free_and_ball_joints_need_not_be_logged():
    pytest.importorskip("scipy")
    model = sc.loads(
        '<mujoco><worldbody><body pos="0 0 3"><freejoint name="root"/><geom name="box" type="box"'
        ' size=".1 .2 .3" mass="2"/></body></worldbody></mujoco>'
    ).compile()
    true = sc.Sim(model.with_values({"gravity": [0.0, 0.0, -9.0]}))
    true.qvel[:] = 0.1, 0.2, 0.3, 1.0, 2.0, 0.5
    run = true.run(0.2, record=("qpos",))
    found = sc.identify(model, run, {"gravity[2]": (-20.0, -1.0)})
    assert found.values["gravity[2]"] == pytest.approx(-9.0, rel=1e-6)


def test_one_s_own_motion_is_not_advised_to_who_gave_one():
    """Uncertainty that cannot be reduced, for a motion by the user and for the default one."""
    log = {"t": TIMES, "drive": 0.1 + 0.1 * TIMES}
    few = {"horizon": 0.2, "starts": 1, "by": "flops", "progress": False, "solvers": ["newton"]}
    for motion, said in (
        ({"ctrl": log}, "a shorter piece of this motion"),
        ({}, "your own motion"),
    ):
        trade = sc.trade(sc.loads(SERVO), **few, **motion)
        trade.reference = replace(trade.reference, needs=np.inf)
        assert trade._surer() == f"Shorter steps do not make it surer: try {said}."
