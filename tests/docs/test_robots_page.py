"""docs/robots.md is true: every public robot is compared with MuJoCo again, at fewer states."""

import warnings

import menagerie
import pytest
import robot_files
import robots

STATES = 6
# At other states, and by other machines' MuJoCo, rounding is another.
SLACK, ROUNDING = 10, 1e-12


def every():
    found = robot_files.wheels()
    if menagerie.FOLDER.is_dir():
        found += robot_files.folder_of("menagerie", menagerie.FOLDER)
    return found


def written():
    """The cells of the page's tables, by collection and name."""
    rows, collection = {}, ""
    for line in robots.DOCS.read_text(encoding="utf-8").splitlines():
        if line.startswith("### "):
            collection = line[4:].split(":")[0]
        elif line.startswith("| ") and not line.startswith("| model"):
            cells = [cell.strip() for cell in line.strip("|").split("|")]
            rows[collection, cells[0]] = cells
    return rows


PAGE = written()


def figures(cell: str) -> list[float]:
    return [float(figure) for figure in cell.split(",") if figure.strip()]


def test_the_page_has_every_model_of_the_wheels():
    missing = {(robot.collection, robot.name) for robot in robot_files.wheels()} - PAGE.keys()
    assert not missing


@pytest.mark.parametrize("robot", every(), ids=lambda robot: f"{robot.collection}-{robot.name}")
def test_a_robot_is_as_near_mujoco_as_its_row_says(robot):
    said = PAGE[robot.collection, robot.name]
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        found = robots.cells(robots.examine(robot, STATES))
    assert found[:3] == said[:3]
    for own, page in zip(found[3:6], said[3:6], strict=True):
        # Of few states there may be none from which steps can be compared.
        for value, limit in zip(figures(own), figures(page) if own else [], strict=True):
            assert value <= SLACK * limit + ROUNDING
