"""Commands on the pages: the build runs them, and shows what they print and draw.

`python docs_build/commands.py` writes what they print now into the pages.
"""

from __future__ import annotations

import os
import re
import shlex
import subprocess
import sys
import tempfile
from functools import cache
from pathlib import Path

from stepcore.cli.gate import TESTS
from stepcore.cli.measurements import SECONDS

ROOT = Path(__file__).parents[1]

# A block whose first line is a command; what follows is what it prints.
SHOWN = re.compile(r"^```\w*\n\$ (stepcore [^\n]*)\n(.*?)^```$", re.DOTALL | re.MULTILINE)
# Where a page shows the beginning of an output, its last line is this.
CUT = "…"
# Commands whose answer depends on times that they measure.
TIMED = {"stepcore trade gymnasium:half_cheetah --error 10mm --mujoco"}
# The time limit of measurements [s]: a slow machine shows the same answers as a fast one.
PATIENCE = 600
# The pictures of docs/ that commands draw, in about a minute. half_cheetah.png is drawn from
# measured times. Those of robots are photographs: see `photograph.py`.
DRAWN = {
    "arm.png": "stepcore diagnose docs/arm.xml",
    "half_cheetah.png": "stepcore trade gymnasium:half_cheetah --error 10mm --mujoco",
    "stability_spring.png": "stepcore stability-map lesson:spring joint/spring/stiffness "
    "--values 1:1e6:19 --horizon 2.5 --integrator explicit --integrator semi-implicit "
    "--integrator rk4",
}


@cache
def printed(command: str, root: Path) -> str:
    """What a command prints, in lines of 100 characters."""
    arguments = [sys.executable, "-m", *shlex.split(command)]
    if arguments[3] in SECONDS and "--seconds" not in arguments:
        arguments += ["--seconds", str(PATIENCE)]
    environment = os.environ | {"COLUMNS": "100", "MPLBACKEND": "Agg"}
    done = subprocess.run(
        arguments, cwd=root, env=environment, capture_output=True, text=True, check=False
    )
    # These exit with 1 if a test fails, and with 3 if it is undecided.
    if done.returncode not in ((0, 1, 3) if arguments[3] in TESTS else (0,)):
        raise RuntimeError(f"{command}: {done.stderr or done.stdout}")
    return done.stdout


def shown_in(page: str) -> list[tuple[str, str]]:
    """The commands of a page, each with what the page shows of its output."""
    return SHOWN.findall(page)


def as_shown(text: str, shown: str) -> str:
    """The part of an output that a page shows: as many lines, where its last one is the mark."""
    lines = shown.rstrip("\n").split("\n")
    if lines[-1] != CUT:
        return text
    return "\n".join(text.split("\n")[: len(lines) - 1]) + f"\n{CUT}\n"


def with_outputs(page: str, root: Path) -> str:
    """A page in which every block that begins with a command shows what that prints now."""

    def run(block: re.Match[str]) -> str:
        command, shown = block.groups()
        return f"```console\n$ {command}\n{as_shown(printed(command, root), shown)}```"

    return SHOWN.sub(run, page)


def picture(command: str, root: Path) -> bytes:
    """The picture that a command draws, as a PNG."""
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder, "picture.png")
        printed(f"{command} --plot {path}", root)
        return path.read_bytes()


def main() -> None:
    """Brings the pages' outputs up to date."""
    for path in [ROOT / "README.md", *sorted((ROOT / "docs").glob("**/*.md"))]:
        page = path.read_text(encoding="utf-8")
        path.write_text(with_outputs(page, ROOT), encoding="utf-8")


if __name__ == "__main__":
    main()
