"""Sensors of models that people use, against MuJoCo at states on the way of random falls."""

import menagerie
import mujoco
import peers
import pytest
import robot_files

import stepcore as sc

SENSING = ("unitree_go2/", "unitree_g1/", "anybotics_anymal_c/", "shadow_hand/", "agility_cassie/")


def robots():
    found = [robot for robot in robot_files.wheels() if "<sensor>" in robot.path.read_text()]
    if menagerie.FOLDER.is_dir():
        every = robot_files.folder_of("menagerie", menagerie.FOLDER)
        found += [robot for robot in every if robot.name.startswith(SENSING)]
    return found


@pytest.mark.parametrize("robot", robots(), ids=lambda robot: f"{robot.collection}-{robot.name}")
def test_public_robots(robot):
    """Models that people use: those of dm_control, and of a folder of robots where there is one."""
    ours = sc.load(robot.path).compile()
    theirs = peers.strict(mujoco.MjModel.from_xml_path(str(robot.path)))
    data, sim = mujoco.MjData(theirs), sc.Sim(ours, **peers.EXACT)
    geoms, alike = peers.kept_geoms(sim, theirs), 0
    for state in peers.fall_states(theirs, 12, seed=5):
        state.to_mujoco(theirs, data)
        state.to_stepcore(sim)
        mujoco.mj_forward(theirs, data)
        sim.forward()
        same = (
            peers.contacts_apart(sim, data, geoms) < 1e-9
            and peers.apart(sim.qacc, data.qacc) < 1e-9
        )
        if same:
            alike += 1
            assert peers.sensors_apart(sim, theirs, data) < 1e-6
    assert alike > 0
