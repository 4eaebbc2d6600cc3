"""The tutorials: every one runs, and every number in its text is one that it computes or sets.

A tutorial is a notebook as a Python script ("# %%" begins a cell); the site executes it. Numbers of
its text stand, with the same digits, in what it prints or in its code.
"""

import os
import re
import subprocess
import sys
from pathlib import Path

import pytest
from covering import first

ROOT = Path(__file__).parents[2]
TUTORIALS = sorted((ROOT / "docs" / "tutorials").glob("*.py"))
NUMBER = re.compile(r"(?<![\w.])\d[\d,]*(?:\.\d+)?(?:e[+-]?\d+)?")


def cells(path):
    """The kinds and texts of a notebook's cells."""
    for cell in re.split(r"^# %%", path.read_text(encoding="utf-8"), flags=re.MULTILINE)[1:]:
        head, _, body = cell.partition("\n")
        yield head.strip(" []"), body


def numbers(text):
    """The numbers of a text as they are written, without commas between thousands."""
    return {number.replace(",", "") for number in NUMBER.findall(text)}


def run(path, folder):
    environment = os.environ | {"MPLBACKEND": "Agg"}
    done = subprocess.run(
        [sys.executable, "-W", "error::UserWarning", str(path)],
        cwd=folder,
        env=environment,
        capture_output=True,
        text=True,
        check=False,
    )
    assert done.returncode == 0, done.stderr
    return done.stdout


# These compute for some seconds each; the build of the site runs them too.
LONG = ("find_friction", "own_steps", "twice_the_step")


@first(len(TUTORIALS) - len(LONG), path=sorted(TUTORIALS, key=lambda path: path.stem in LONG))
def test_a_tutorial_runs_and_computes_the_numbers_of_its_text(path, tmp_path):
    text = "".join(body for kind, body in cells(path) if kind == "markdown")
    code = "".join(body for kind, body in cells(path) if kind == "")
    computed = numbers(run(path, tmp_path)) | numbers(code)
    # Not those of a link's address.
    written = numbers(re.sub(r"\]\([^)]*\)", "]", text))
    assert written - computed == set()
    # The build runs it among the pages.
    assert not list(tmp_path.iterdir())


@pytest.mark.parametrize("path", TUTORIALS, ids=lambda path: path.stem)
def test_a_tutorial_begins_with_its_answer(path):
    kind, first = next(cells(path))
    title, empty, answer, *_ = first.split("\n")
    assert kind == "markdown" and title.startswith("# # ") and empty == "#"
    assert answer.startswith("# **")
