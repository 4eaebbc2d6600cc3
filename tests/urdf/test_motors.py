"""A URDF names no motors: measurements that move it make them of the efforts of its joints."""

import numpy as np
import pytest

import stepcore as sc
from stepcore.engine.actuator import actuators
from stepcore.experiment import Change, Study
from stepcore.experiment.change import Servo
from stepcore.measure.monitors import Finding, Next

LINK = """<link name="{0}"><inertial><origin xyz=".15 0 0"/><mass value="1"/>
<inertia ixx=".001" iyy=".01" izz=".01" ixy="0" ixz="0" iyz="0"/></inertial></link>"""
JOINT = """<joint name="{0}" type="revolute"><parent link="{1}"/><child link="{2}"/>
<origin xyz="{3} 0 0"/><axis xyz="0 1 0"/>
<limit effort="{4}" velocity="3" lower="-2" upper="2"/>{5}</joint>"""
MIMIC = '<mimic joint="elbow" multiplier="-1"/>'
ARM = "".join(
    [
        '<robot name="arm"><link name="base"/>',
        *(LINK.format(name) for name in ("upper", "lower", "finger", "flap")),
        JOINT.format("shoulder", "base", "upper", "0", "40", ""),
        JOINT.format("elbow", "upper", "lower", ".3", "20", ""),
        JOINT.format("grip", "lower", "finger", ".3", "5", MIMIC),
        JOINT.format("loose", "lower", "flap", ".2", "0", '<dynamics damping="1"/>').replace(
            "0 1 0", "0 0 1"
        ),
        "</robot>",
    ]
)


def test_joints_with_an_effort_get_motors_where_a_motion_moves_them():
    scene = sc.loads(ARM)
    model = Study(scene).model
    assert scene.compile().nu == 0
    assert model.actuator_names == ("shoulder", "elbow")
    said = "motors were made for the joints whose effort is bounded: shoulder, elbow"
    assert model.scene.notes[0] == said
    assert said not in scene.notes
    assert Study(scene, sc.Motion(kind="hold")).model.nu == 2
    for still in (sc.Motion(kind="fall"), sc.Motion(control=lambda time, sim: [])):
        assert Study(scene, still).model.nu == 0
    assert sc.run(scene, horizon=0.1).sim.model.nu == 0
    assert sc.run(scene, "move", horizon=0.1).sim.model.nu == 2


def test_where_no_effort_is_bounded_joints_with_a_range_get_motors_without_bounds():
    """Many files have effort="0", which bounds nothing; another model is left as it is."""
    text = ARM.replace('effort="40"', 'effort="0"').replace('effort="20"', 'effort="0"')
    scene = sc.loads(text.replace('effort="5"', 'effort="0"'))
    model = Study(scene).model
    assert model.actuator_names == ("shoulder", "elbow", "loose")
    assert "because the file bounds no effort: shoulder, elbow, loose" in model.scene.notes[0]
    assert np.isinf(np.abs(model.actuator_forcerange)).all()
    assert Study(sc.loads(scene.to_mjcf())).model.nu == 0


def test_a_limit_that_nobody_filled_in_does_not_let_the_arm_fall():
    """RM75's file has 0 for the effort and the velocity of six of its seven joints."""
    text = ARM.replace('effort="40" velocity="3"', 'effort="0" velocity="0"')
    driven = '<transmission name="t"><joint name="shoulder"/></transmission></robot>'
    text = text.replace("</robot>", driven)
    model = Study(sc.loads(text)).model
    assert model.actuator_names == ("shoulder", "elbow")
    assert [drive.bound for drive in actuators(model)] == [np.inf, 20]
    assert "bounded: elbow; for joints" in model.scene.notes[0]
    assert model.scene.notes[0].endswith("because the file bounds no effort of theirs: shoulder")


def test_check_runs_the_pose_that_motors_hold():
    """At zero torque an arm falls onto whatever is below it, and every finding is about that."""
    path = "/a/b.urdf"
    result = sc.check(sc.loads(ARM), progress=False)
    assert "a PD controller holds the start" in result.ran
    assert result.motion.kind is None
    result.file = path
    result.findings.append(Finding("creep", "warning", "", commands=(Next("run", "it"),)))
    said = [command for command, _ in result.commands]
    assert f"stepcore run {path} --motion hold" in said
    assert f"stepcore trade {path} --error 1mm" in said
    own = sc.loads(ARM)
    own.add_actuator("elbow")
    assert "motors are held at zero" in sc.check(own, progress=False).ran


def test_both_engines_say_how_wrong_the_moved_robot_is():
    pytest.importorskip("mujoco")
    errors = [
        Study(sc.loads(ARM), starts=2, engine=engine).run([Change(dt=0.004)])[0].error
        for engine in ("stepcore", "mujoco")
    ]
    assert 1e-5 < errors[0] < 1e-2
    assert errors[1] == pytest.approx(errors[0], rel=1e-3)


def test_a_file_is_read_by_stepcore_for_mujoco_too(tmp_path):
    """MuJoCo's own reader of URDF looks for the meshes of packages in the folder of the file."""
    mujoco = pytest.importorskip("mujoco")
    (tmp_path / "own" / "meshes").mkdir(parents=True)
    corners = np.array(np.meshgrid(*[[0, 0.1]] * 3)).reshape(3, -1).T
    lines = [f"v {x} {y} {z}" for x, y, z in corners]
    (tmp_path / "own" / "meshes" / "box.obj").write_text("\n".join(lines))
    shape = '<geometry><mesh filename="package://own/meshes/box.obj"/></geometry>'
    text = ARM.replace('<link name="flap">', f'<link name="flap"><collision>{shape}</collision>')
    (tmp_path / "own" / "urdf").mkdir()
    path = tmp_path / "own" / "urdf" / "arm.urdf"
    path.write_text(text)
    with pytest.raises(ValueError):
        mujoco.MjModel.from_xml_path(str(path))
    assert Study(path, engine="mujoco").engine.scene.nmesh == 1


def test_tuned_gains_are_those_of_a_controller_of_ones_own():
    """The gain of a PD controller that a user writes is 1/√2 at the bandwidth asked for."""
    scene = sc.loads(ARM).with_settings(dt=0.0005)
    tuning = sc.tune(scene, bandwidth=3.0)
    assert [tuned.name for tuned in tuning.found if tuned.reached] == ["shoulder", "elbow"]
    assert "forcerange" not in tuning.mjcf  # the joint has the bound
    model = scene.compile()
    driven = tuning.found[0].change.of(model)
    assert driven.actuator_names == ("shoulder", "elbow")
    kp, kv = driven.actuator_gain, -driven.actuator_bias[:, 2]
    dofs = [model.jnt_dofadr[model.index("joint", name)] for name in ("shoulder", "elbow")]
    for k, dof in enumerate(dofs):
        sim = sc.Sim(model)
        sim.forward()
        weight = np.array(sim.bias)[dofs]
        late = []
        for step in range(8000):
            target = np.zeros(2)
            target[k] = 0.01 * np.sin(2 * np.pi * 3 * step * sim.settings.dt)
            error = target - np.array(sim.qpos)[dofs]
            sim.qfrc_applied[dofs] = kp * error - kv * np.array(sim.qvel)[dofs] + weight
            sim.step()
            late.append(sim.qpos[dof])
        gain = np.ptp(late[4000:]) / 0.02
        assert gain == pytest.approx(np.sqrt(0.5), rel=0.05)


def test_a_servo_of_a_change_may_name_a_joint_without_a_motor():
    model = sc.loads(ARM).compile()
    change = Change(servos=[Servo("elbow", 30.0, 2.0)])
    assert change.of(model).actuator_names == ("elbow",)
    with pytest.raises(ValueError, match=r"elbw.*elbow"):
        Change(servos=[Servo("elbw", 30.0, 2.0)]).of(model)


BALL = '<collision><geometry><sphere radius="0.1"/></geometry></collision>'


def test_check_lists_the_pairs_of_a_urdf_to_leave_out(tmp_path):
    """Pasted where check says, its lines leave nothing of the finding."""
    path = tmp_path / "arm.urdf"
    text = ARM
    for name in ("upper", "finger", "flap"):
        text = text.replace(f'<link name="{name}">', f'<link name="{name}">{BALL}')
    # The shoulder's ball lies in the world's, and the flap's and the finger's in each other.
    path.write_text(text.replace('<link name="base"/>', f'<link name="base">{BALL}</link>'))
    found = sc.check(path, horizon=0.2, progress=False)
    assert "In a URDF, <exclude> stands in <mujoco><contact>" in found.text()
    (one,) = [finding for finding in found.findings if finding.lines]
    assert found.mjcf.splitlines() == list(one.lines)
    assert set(one.lines) == {
        '<exclude body1="world" body2="upper"/>',
        '<exclude body1="finger" body2="flap"/>',
    }
    assert all(f"  {line}" in found.text() for line in one.lines)
    pasted = f"<mujoco><contact>{found.mjcf}</contact></mujoco></robot>"
    path.write_text(path.read_text().replace("</robot>", pasted))
    after = sc.check(path, horizon=0.2, progress=False)
    assert not [finding for finding in after.findings if "exclude" in finding.text]
