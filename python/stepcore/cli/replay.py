"""Run a failed simulation again from its replay file, and show which elements injected energy in
the steps before the failure.

`stepcore run` writes such a file when a run fails; in Python it is the error's `replay`.

Example:
  stepcore replay ball-step1201.replay.json --plot energy.png
"""

from __future__ import annotations

import argparse

from stepcore.cli.output import add_output
from stepcore.engine.replay import replay
from stepcore.report.result import Result


def add(command: argparse.ArgumentParser) -> None:
    command.add_argument("file", metavar="FILE", help="a replay file (.replay.json)")
    add_output(command)


def call(args: argparse.Namespace) -> Result:
    return replay(args.file)
