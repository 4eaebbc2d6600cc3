"""The README and every page of the docs: their Python runs, their commands are ones we take.

The Python blocks of a page run in their order as one script. What `print(...)  # → text` prints is
that text, "..." standing for anything. A block that begins with "# name.py" is that file.
"""

import json
import re
import shlex
import subprocess
import sys
from pathlib import Path

import benchmarks
import commands as commands_on_pages
import pytest
import record
import vs_numpy

import stepcore as sc
from stepcore.cli import COMMANDS, parser

ROOT = Path(__file__).parents[2]
PAGES = [ROOT / "README.md", ROOT / "CONTRIBUTING.md", *sorted((ROOT / "docs").glob("**/*.md"))]
BLOCK = re.compile(r"^```(\w*)\n(.*?)^```", re.DOTALL | re.MULTILINE)
SCRIPTS = [page for page in PAGES if "```python" in page.read_text(encoding="utf-8")]

ROBOT = """
<mujoco model="robot">
  <worldbody>
    <geom type="plane" size="5 5 .1"/>
    <body pos="0 0 1">
      <joint name="knee" axis="0 1 0" damping=".1"/>
      <geom type="capsule" size=".05" fromto="0 0 0 .5 0 0"/>
    </body>
  </worldbody>
</mujoco>
"""


def blocks(page, *languages):
    found = BLOCK.findall(page.read_text(encoding="utf-8"))
    return [text for language, text in found if language in languages]


def test_no_text_installs_what_is_not_published():
    sources = [*(ROOT / "python").glob("**/*.py"), *(ROOT / "benches").glob("*.py")]
    for file in [*PAGES, *sources]:
        assert not re.search(r"pip install [\"']?stepcore|stepcore\[\w", file.read_text("utf-8")), (
            file
        )


@pytest.mark.parametrize("page", SCRIPTS, ids=lambda page: page.name)
def test_the_python_of_a_page_runs(page, tmp_path):
    (tmp_path / "docs").mkdir()
    for model in (ROOT / "docs").glob("*.xml"):
        (tmp_path / "docs" / model.name).write_bytes(model.read_bytes())
    (tmp_path / "robot.xml").write_text(ROBOT, encoding="utf-8")
    script = []
    for block in blocks(page, "python"):
        name = re.match(r"# (\w+\.py)\n", block)
        if name:
            (tmp_path / name[1]).write_text(block, encoding="utf-8")
        else:
            script.append(block)
    code = "\n".join(script)
    (tmp_path / "page.py").write_text(code, encoding="utf-8")
    done = subprocess.run(
        [sys.executable, "page.py"], cwd=tmp_path, capture_output=True, text=True, check=False
    )
    assert done.returncode == 0, done.stderr
    lines = iter(done.stdout.splitlines())
    for expected in re.findall(r"^ *print\(.*\)  # → (.*)$", code, re.MULTILINE):
        pattern = re.escape(expected).replace(re.escape("..."), ".*")
        assert any(re.fullmatch(pattern, line) for line in lines), (expected, done.stdout)
    for written in re.findall(r"(?:plot|save|to_html)\(\"([^\"]+)\"\)", code):
        assert (tmp_path / written).stat().st_size > 0


def commands():
    """Every `stepcore ...` of the pages, in blocks of commands and in the text."""
    for page in PAGES:
        lines = [line for block in blocks(page, "", "sh", "console") for line in block.splitlines()]
        lines += re.findall(r"`(stepcore [^`]*)`", BLOCK.sub("", page.read_text(encoding="utf-8")))
        for line in lines:
            for part in line.removeprefix("$ ").split("&&"):
                if part.strip().startswith("stepcore ") and "(" not in part:
                    yield page.name, part.strip()


@pytest.mark.parametrize(("page", "command"), sorted(set(commands())))
def test_a_command_of_a_page_is_one_we_take(page, command):
    argv = shlex.split(command, comments=True)[1:]
    assert argv[0] in COMMANDS
    if len(argv) > 1:
        parser(argv).parse_args(argv)


SHOWN = [
    # A whole trade beside MuJoCo takes longer than the other commands together.
    pytest.param(
        *(page.name, command, shown),
        marks=pytest.mark.long if command in commands_on_pages.TIMED else (),
    )
    for page in PAGES
    for command, shown in commands_on_pages.shown_in(page.read_text(encoding="utf-8"))
]


@pytest.mark.parametrize(("page", "command", "shown"), SHOWN)
def test_a_page_shows_what_its_command_prints(page, command, shown):
    """Where it no longer does: python docs_build/commands.py."""
    printed = commands_on_pages.printed(command, ROOT)
    if command in commands_on_pages.TIMED:
        # What costs least differs from run to run; the errors of the shipped settings do not.
        printed, shown = (lengths(text[text.index("As shipped") :]) for text in (printed, shown))
        assert len(shown) > 5 and printed[: len(shown)] == shown
    else:
        assert commands_on_pages.as_shown(printed, shown) == shown


def lengths(text):
    """Every length in a text, whose lines may be broken before its unit."""
    return re.findall(r"[\d.]+\s[mµn]?m\b", text.replace("\n", " "))


def test_the_log_beside_its_option_drives_the_robot(tmp_path):
    """A row holds until the next; what has no column keeps the control of the start, here 0."""
    (log,) = blocks(ROOT / "README.md", "csv")
    (tmp_path / "log.csv").write_text(log, encoding="utf-8")
    path = str(tmp_path / "log.csv")
    run = sc.run("gymnasium:half_cheetah", ctrl=path, horizon=0.04, record="ctrl").trajectory
    names = run.axes("ctrl")[0].entries
    played = {name: run["ctrl"][1:, k].tolist() for k, name in enumerate(names)}
    still = dict.fromkeys(names, [0.0] * 4)
    assert played == still | {"bthigh": [0.4, 0.4, 0.5, 0.5], "fthigh": [-0.2, -0.2, -0.1, -0.1]}


def test_the_numpy_table_is_of_the_last_kept_run():
    """Where it no longer is: python benches/vs_numpy.py."""
    kept = benchmarks.last_results(ROOT / "benches" / "results")["vs_numpy"]
    records = json.loads(kept.with_suffix(".json").read_text(encoding="utf-8"))["records"]
    shown = record.README.read_text(encoding="utf-8").split("<!-- numpy -->\n")[1]
    assert shown.split("<!-- end of numpy -->")[0] == vs_numpy.table(records)


def test_the_files_that_the_pages_name_are_there():
    text = "\n".join(page.read_text(encoding="utf-8") for page in PAGES)
    named = set(re.findall(r"\b(?:tests|benches|docs|crates|python)/[\w./-]*\w", text))
    # Those of docs/mujoco_models.md are MuJoCo's.
    own = {name for name in named if not name.startswith("python/mujoco/")}
    assert not [name for name in own if not (ROOT / name).exists()]
