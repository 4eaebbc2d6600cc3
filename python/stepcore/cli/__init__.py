"""The command line: `stepcore COMMAND`, also `python -m stepcore`.

The module of a command has its help (`text`), adds the options (`add`) and runs the command
(`call`). Only the module of the requested command is imported.
"""

from __future__ import annotations

import argparse
import difflib
import importlib
import math
import os
import sys
import warnings
from collections.abc import Sequence
from typing import Any, NoReturn

from stepcore.cli.terminal import (
    INTERRUPTED,
    UNDECIDED,
    ends_early_on_ctrl_c,
    print_error,
    print_what_can_be_printed,
    reason,
    refusal,
    tells_so_far,
)
from stepcore.deadline import SECONDS, OutOfTime
from stepcore.escapes import printable
from stepcore.report.terminal import watched

COMMANDS = {
    "lesson": "check the engine on four small scenes whose results are known",
    "check": "look for what makes a model misbehave: the first command to run",
    "run": "simulate a model and print its final state",
    "view": "watch a model move, in a browser; or write a page that replays a run",
    "replay": "run a failed simulation again and show which elements injected its energy",
    "trade": "measure what speed costs in accuracy, and recommend settings",
    "predict": "measure how long a model's motion can be predicted",
    "diagnose": "find the element that limits the time step",
    "identify": "find masses, friction or gains in logs of a robot's motion",
    "tune": "find gains, or solref and solimp, for a wanted behaviour",
    "stability-map": "map stability and accuracy over the time step and one value of a model",
    "converge": "split the error into the parts of the time step and of the sweeps",
    "plan": "list what a step computes and what it leaves out",
    "ablate": "measure the cost and the effect of each modelled feature",
    "compare": "explain why two models behave differently",
    "info": "print versions and the machine",
}
# Commands that take no second.
QUICK = ("info", "lesson", "plan")
HELP = {"-h", "--help", "--version"}
DESCRIPTION = "Rigid-body physics that measures what speed costs in accuracy."
EPILOG = """\
examples:
  stepcore check gymnasium:half_cheetah             what is wrong with a model
  stepcore run gymnasium:hopper --plot run.png      simulate it
  stepcore trade robot.xml --error 1mm              the cheapest settings within 1 mm
  stepcore COMMAND --help                           what a command takes, with an example

FILE is the path of an MJCF or URDF file; or "package:name", a model among the files of an installed
package (gymnasium:half_cheetah; the package is not imported); or "lesson:name", one of four small
scenes that come with stepcore (spring, drop, stack, grasp).

exit status: 0 success, 1 run-time failure, or a test that failed (check --fail-on, diagnose,
trade --max-error, compare --max-difference), 2 usage or input error, 3 undecided in the time or
effort available, 130 interrupted
"""
# Modules of the commands; all other commands are in `measurements`.
MODULES = {
    **dict.fromkeys(("run", "replay", "view"), "run"),
    **dict.fromkeys(("lesson", "info"), "installation"),
}


class _Parser(argparse.ArgumentParser):
    """An argument parser that keeps line breaks in descriptions and prints one-line errors."""

    def __init__(self, **kwargs: Any) -> None:
        super().__init__(formatter_class=argparse.RawDescriptionHelpFormatter, **kwargs)

    def error(self, message: str) -> NoReturn:
        self.exit(2, f"{self.prog}: {message}\n")

    def _print_message(self, message: str, file: Any = None) -> None:
        super()._print_message(printable(message), file)

    def refuse(self, unknown: Sequence[str]) -> NoReturn:
        """Report the unknown arguments, and the option nearest to the first unknown option."""
        option = next((arg.partition("=")[0] for arg in unknown if arg.startswith("-")), None)
        if option is None:
            self.error(f"unexpected argument '{unknown[0]}'")
        known = {name.strip("-"): name for name in self._option_string_actions}
        near = difflib.get_close_matches(option.strip("-"), known, n=1, cutoff=0.5)
        better = f"nearest: {known[near[0]]}" if near else f"{self.prog} --help lists them"
        if option == "--timestep":
            better = f"it is {'--dt' if 'dt' in known else 'timestep of <option> in the file'}"
        self.error(f"no option {option}; {better}")


def main(argv: Sequence[str] | None = None) -> int:
    """Run one command; return the exit status."""
    debug, file = False, ""
    print_what_can_be_printed()
    try:
        args = _parsed(sys.argv[1:] if argv is None else list(argv))
        debug, file = args.debug, getattr(args, "file", "")
        return _run(args)
    except SystemExit as stop:
        return stop.code if isinstance(stop.code, int) else 2
    except KeyboardInterrupt as stop:
        done = ", ".join(getattr(stop, "__notes__", ()))
        print_error(f"interrupted after {done}" if done else "interrupted")
        return INTERRUPTED
    except BrokenPipeError:
        # The reader has closed the pipe.
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
        return 1
    except Exception as error:
        if debug:
            raise
        print_error(refusal(error, file) if file else reason(error))
        if isinstance(error, OutOfTime):
            return INTERRUPTED if error.interrupted else UNDECIDED
        return 2 if isinstance(error, (ValueError, OSError)) else 1


def _parsed(argv: Sequence[str]) -> argparse.Namespace:
    """Return the parsed arguments; report an unknown argument with the nearest option."""
    asked = _asked(argv)
    if watched():
        _say_what_it_does(argv)
    top = parser(argv)
    if not argv:
        top.print_help()
        top.exit(0)
    if asked is not None and asked not in COMMANDS:
        from stepcore.checks import nearest

        top.error(f"no command '{asked}'{nearest(asked, COMMANDS, limit=len(COMMANDS))}")
    args, unknown = top.parse_known_args(argv)
    if unknown:
        args.parser.refuse(unknown)
    return args


def _say_what_it_does(argv: Sequence[str]) -> None:
    """Describe a command and its duration on the error stream, before its module is imported."""
    name = _asked(argv)
    if name not in COMMANDS or name in QUICK or not HELP.isdisjoint(argv):
        return
    file = next((f" {word}" for word in argv[argv.index(name) + 1 :][:1] if word[:1] != "-"), "")
    limit, given = SECONDS.get(name, math.inf), any(word.startswith("--sec") for word in argv)
    most = f", at most {limit:g} s" if limit < math.inf and not given else ""
    print_error(f"{name}{file}{most}: {COMMANDS[name].partition(':')[0]}")


def _asked(argv: Sequence[str]) -> str | None:
    return next((arg for arg in argv if not arg.startswith("-")), None)


def _run(args: argparse.Namespace) -> int:
    from stepcore import files
    from stepcore.cli.output import check_output, deliver
    from stepcore.report.result import Result

    with warnings.catch_warnings():
        # In one line, without the source line that warned.
        warnings.showwarning = lambda message, *_, **__: print_error(" ".join(str(message).split()))
        check_output(args)
        try:
            with ends_early_on_ctrl_c(), tells_so_far(bool(getattr(args, "json", None))):
                result = args.call(args, args.command)
        finally:
            files.outputs.clear()
        if isinstance(result, Result):
            deliver(result, args)
            return INTERRUPTED if result.interrupted else args.status(result, args)
        return int(result or 0)


def parser(argv: Sequence[str]) -> argparse.ArgumentParser:
    """Create the parser of all commands, with the arguments of the command in `argv`."""
    top = _Parser(prog="stepcore", description=DESCRIPTION, epilog=EPILOG)
    top.add_argument("--debug", action="store_true", help="show the traceback of an error")
    version = ""
    if "--version" in argv:
        from importlib import metadata

        version = metadata.version("stepcore")
    words = "print the version and exit"
    top.add_argument("--version", action="version", version=f"stepcore {version}", help=words)
    commands = top.add_subparsers(metavar="COMMAND", required=True)
    asked = _asked(argv)
    for name, summary in COMMANDS.items():
        if name != asked:
            commands.add_parser(name, help=summary)
            continue
        module = importlib.import_module(f"stepcore.cli.{MODULES.get(name, 'measurements')}")
        text, _, example = module.text(name).partition("\n\nExample")
        command = commands.add_parser(
            name, help=summary, description=text, epilog=f"example{example}"
        )
        command.set_defaults(status=lambda result, args: 0)
        module.add(command, name)
        command.set_defaults(call=module.call, command=name, parser=command)
    return top
