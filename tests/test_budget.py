"""No room outgrows its number in tests/budget.toml, and every feature has a user there."""

import ast
import inspect
import re
import tomllib
from pathlib import Path

import pytest

import stepcore
from stepcore.cli import COMMANDS

ROOT = Path(__file__).parents[1]
BUDGET = tomllib.loads((ROOT / "tests" / "budget.toml").read_text(encoding="utf-8"))


def files_of(room):
    """The Python files of a room: of a folder with all below it, or those that match a pattern."""
    return ROOT.glob(room if "*" in room else f"{room}/**/*.py")


def lines_of(file):
    return len(file.read_text(encoding="utf-8").splitlines())


def is_numeric(value):
    """Whether an expression is made of numbers alone."""
    match value:
        case ast.Constant():
            return type(value.value) in (int, float)
        case ast.UnaryOp():
            return is_numeric(value.operand)
        case ast.BinOp():
            return is_numeric(value.left) and is_numeric(value.right)
        case ast.Tuple() | ast.List():
            return bool(value.elts) and all(map(is_numeric, value.elts))
    return False


def assignments(body):
    """(target, value) of the assignments of a module, those of "A, B = 1, 2" one by one."""
    for node in body:
        if isinstance(node, ast.AnnAssign):
            yield node.target, node.value
        for target in node.targets if isinstance(node, ast.Assign) else ():
            if isinstance(target, ast.Tuple) and isinstance(node.value, ast.Tuple):
                yield from zip(target.elts, node.value.elts, strict=True)
            else:
                yield target, node.value


def constants_in(text):
    """The names of the numeric constants of a module."""
    return [
        target.id
        for target, value in assignments(ast.parse(text).body)
        if isinstance(target, ast.Name) and target.id.isupper() and is_numeric(value)
    ]


COUNTS = {
    "lines": lines_of,
    "constants": lambda file: len(constants_in(file.read_text(encoding="utf-8"))),
}


@pytest.mark.parametrize(
    ("unit", "room"), [(unit, room) for unit in COUNTS for room in BUDGET[unit]]
)
def test_no_room_outgrows_its_number(unit, room):
    used, most = sum(map(COUNTS[unit], files_of(room))), BUDGET[unit][room]
    assert 0 < used <= most, (
        f"{room} has {used} {unit}, and tests/budget.toml allows {most}: lower another room by as "
        "much in the same commit, or say in the table why this one grows"
    )


def test_every_file_is_in_a_room():
    """The rooms beside the whole are counted each: a new folder is a new line of the table."""
    package = set(files_of("python/stepcore"))
    rooms = [set(files_of(room)) for room in BUDGET["lines"] if room != "python/stepcore"]
    assert package - set().union(*rooms) == set()


def test_what_counts_as_a_constant():
    text = "A = 1\nB, C = 2.0, 'word'\nD: int = -3 * 4\nE = (1, 2)\nF = len('')\ng = 5\nH = True\n"
    assert constants_in(text) == ["A", "B", "D", "E"]


def test_every_feature_has_a_line_with_its_users():
    functions = {name for name in stepcore.__all__ if inspect.isroutine(getattr(stepcore, name))}
    commands = {name.replace("-", "_") for name in COMMANDS}
    assert set(BUDGET["features"]) == commands | functions


@pytest.mark.parametrize("feature", BUDGET["features"])
def test_the_files_that_use_a_feature_exist(feature):
    users = BUDGET["features"][feature]
    assert len(users.split()) > 2
    for file in re.findall(r"(?:docs|tests)/[\w/]+\.\w+", users):
        assert (ROOT / file).exists()
