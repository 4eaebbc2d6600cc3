"""Which part of a robot's files the physics needs."""

from pathlib import Path

import menagerie
import pytest

import stepcore as sc


@menagerie.needed
def test_so101_needs_a_thirtieth_of_its_meshes():
    """Four files of 18, 0.59 MB of 17.4: what collides, and what has its mass from a mesh."""
    plan = sc.plan(menagerie.SO101)
    named = set(sc.load(menagerie.SO101)._source.unread)
    read = {Path(file).name for entry in plan.used for file in entry.names if file.endswith(".stl")}
    assert read == {
        "wrist_roll_follower_so101_camera_mount.stl",
        "wrist_roll_follower_so101_gripper_part0_v1.stl",
        "moving_jaw_so101_gripper_part0_v1.stl",
        "moving_jaw_so101_gripper_part1_v1.stl",
    }
    folder = menagerie.SO101.parent / "assets"
    size = {file: (folder / file).stat().st_size for file in read | named}
    assert plan.read_bytes == sum(size[file] for file in read)
    assert plan.asset_bytes == sum(size.values())
    assert plan.read_bytes == pytest.approx(0.6e6, rel=0.02)
    assert plan.asset_bytes == pytest.approx(17.4e6, rel=0.01)
    assert "it needs 0.59 MB." in str(plan)
