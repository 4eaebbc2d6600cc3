"""The command line, `stepcore COMMAND`; also `python -m stepcore`. A module here is a command.

A FILE is the path of an MJCF file, "package:name" for a model among the files of an installed
package (as gymnasium:half_cheetah; the package is not imported), or "lesson:name" for a scene
of the lesson. Bad input is one line on the error stream: exit 2 for what was asked, 1 for what
went wrong on the way, 130 after Ctrl-C.
"""

from __future__ import annotations

import argparse
import os
import sys
import warnings
from collections.abc import Sequence
from typing import Any, NoReturn, TextIO

from stepcore.checks import one_line
from stepcore.cli import (
    ablate,
    converge,
    diagnose,
    info,
    lesson,
    map,
    plan,
    predict,
    replay,
    run,
    trade,
)

# In the order of the help.
COMMANDS = (lesson, run, replay, trade, predict, diagnose, map, converge, plan, ablate, info)


class _Parser(argparse.ArgumentParser):
    """Errors in one line."""

    def error(self, message: str) -> NoReturn:
        self.exit(2, f"{self.prog}: {message}\n")


class _Version(argparse.Action):
    """Looks the version up only when it is asked for."""

    def __init__(self, option_strings: Sequence[str], dest: str, help: str) -> None:
        super().__init__(option_strings, dest, nargs=0, help=help)

    def __call__(self, parser: argparse.ArgumentParser, *_: Any) -> None:
        from importlib.metadata import version

        print(f"stepcore {version('stepcore')}")
        parser.exit()


def main(argv: Sequence[str] | None = None) -> int:
    """Runs one command; returns the exit status."""
    try:
        args = parser().parse_args(argv)
    except SystemExit as stop:
        return stop.code if isinstance(stop.code, int) else 2
    try:
        with warnings.catch_warnings():
            warnings.showwarning = _warned
            return int(args.call(args) or 0)
    except KeyboardInterrupt:
        return _say("stopped", 130)
    except BrokenPipeError:
        # The reader of a pipe has gone; nothing is left to say to it.
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
        return 1
    except (ValueError, OSError, TypeError) as error:
        if isinstance(error, TypeError) and args.debug:
            raise
        return _say(one_line(error), 2)
    except Exception as error:
        if args.debug:
            raise
        return _say(one_line(error), 1)


def _warned(
    message: Warning | str,
    category: type[Warning],
    filename: str,
    lineno: int,
    file: TextIO | None = None,
    line: str | None = None,
) -> None:
    """A warning in one line, without the place in the code that no user of commands knows."""
    _say(" ".join(str(message).split()), 0)


def _say(text: str, status: int) -> int:
    print(f"stepcore: {text}", file=sys.stderr)
    return status


def parser() -> argparse.ArgumentParser:
    """What the commands take."""
    top = _Parser(prog="stepcore", description="Rigid-body physics that measures itself.")
    top.add_argument("--debug", action="store_true", help=argparse.SUPPRESS)
    top.add_argument("--version", action=_Version, help="print the version and exit")
    commands = top.add_subparsers(metavar="command", required=True, parser_class=_Parser)
    for module in COMMANDS:
        module.add(commands)
    return top
