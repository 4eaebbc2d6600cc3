"""MuJoCo's own test models: each loads and is as near as docs/mujoco_models.md says.

The long part needs a clone of google-deepmind/mujoco: STEPCORE_MUJOCO names it, or a folder
`mujoco` lies beside the repository or above it.
"""

import json
import os
from pathlib import Path

import mujoco_causes
import mujoco_models
import pytest

_PLACES = [parent / "mujoco" for parent in Path(__file__).parents]
FOLDER = Path(
    os.environ.get("STEPCORE_MUJOCO")
    or next((place for place in _PLACES if (place / "test/engine/testdata").is_dir()), "nowhere")
).resolve()
KEPT = {row["name"]: row for row in json.loads(mujoco_models.RESULTS.read_text())["rows"]}
needed = pytest.mark.skipif(not FOLDER.is_dir(), reason="no clone of google-deepmind/mujoco")
# What may have become of a row since, as versions of MuJoCo and of stepcore change.
BETTER = ("equal",)


def test_the_page_shows_what_is_kept():
    rows = [mujoco_models.kept(row) for row in KEPT.values()]
    assert mujoco_models.table(rows) in mujoco_models.DOCS.read_text(encoding="utf-8")


def test_every_difference_has_a_cause():
    assert not [row["name"] for row in KEPT.values() if row["kind"] != "equal" and not row["cause"]]


@needed
@pytest.mark.long
@pytest.mark.parametrize("name", KEPT)
def test_a_file_is_as_the_page_says(name):
    robot = mujoco_models.robot_files.Robot("mujoco", name, FOLDER / name)
    row = mujoco_models.row_of(mujoco_models.alone(robot, 120.0))
    row.cause = mujoco_causes.cause(row, robot.path)
    assert row.kind in (KEPT[name]["kind"], *BETTER), row
    assert row.cause or row.kind == "equal", row
