"""docs/robots.md is true: every public robot is compared with MuJoCo again, at fewer states."""

import warnings

import menagerie
import pytest
import record
import robot_files
import robot_times
import robots
from covering import first

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


# By default every third robot.
EVERY = sorted(every(), key=lambda robot: every().index(robot) % 3)


@first(len(EVERY) // 3, robot=EVERY)
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


def columns_of(page, mark, columns) -> list[tuple[str, ...]]:
    """The names and some columns of a table between marks."""
    text = page.read_text(encoding="utf-8").split(f"<!-- {mark} -->")[1]
    lines = text.split(f"<!-- end of {mark} -->")[0].splitlines()
    rows = [line.strip("| ").split(" | ") for line in lines if "/" in line and line[0] == "|"]
    return [(row[0], *(row[k].strip("*") for k in columns)) for row in rows]


def test_the_slowest_robot_leads_both_tables():
    every = columns_of(robots.DOCS, "times", (5, 7, 9))
    assert [float(row[1]) for row in every] == sorted(float(row[1]) for row in every)
    readme = columns_of(record.README, "slowest robots", (2, 3, 4))
    touching = [row for row in every if row in readme]
    assert readme and readme == touching and readme[0] == every[0]
    others = sum("other contacts" in row[3] for row in every)
    assert f"{others} of the {len(every)} robots" in record.README.read_text(encoding="utf-8")


def test_a_robot_is_timed_from_the_same_states_of_the_same_physics():
    """Law: at equal contacts the accelerations agree; both columns time the same steps."""
    hopper = next(robot for robot in robot_files.wheels() if robot.name == "hopper")
    found = robot_times.measure(hopper, pairs=1, sample=1e-3)
    assert found.touches and max(found.apart) < 1e-9 and not found.others
    assert found.ours.contacts == pytest.approx(found.theirs.contacts, abs=0.1)
    lines = robot_times.slowest([found]).splitlines()
    assert lines[2].startswith("| gymnasium/hopper |") and lines[3].startswith("| median of 1 |")
