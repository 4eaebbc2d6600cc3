"""What several commands take, and how their results leave: as text, data, a picture or a page."""

from __future__ import annotations

import argparse
import functools
import importlib
import os
import sys
import traceback
import warnings
from collections.abc import Callable
from pathlib import Path
from typing import Any

from stepcore._core import SimulationError
from stepcore.checks import nearest, one_line
from stepcore.report.result import Result


class Usage(ValueError):
    """What the user asked for cannot be done as asked."""


def add_file(command: argparse.ArgumentParser) -> None:
    """The model that a command works on, and the keyframe that it starts from."""
    command.add_argument("file", metavar="FILE", help="path, package:name or lesson:name")
    command.add_argument("--key", help="keyframe to start from")


def add_motion(command: argparse.ArgumentParser, *, several: bool = True) -> None:
    """The motion that is measured: how long, what drives it, from where; one start or several."""
    command.add_argument("--horizon", type=float, help="simulated time [s] (default: about 1)")
    command.add_argument("--ctrl", metavar="FILE", help="controls, .npy or .csv, one row a period")
    command.add_argument("--control", metavar="MODULE:FUNCTION", help="a function that controls")
    command.add_argument("--control-dt", type=float, help="control period [s]")
    if several:
        command.add_argument("--starts", type=int, default=8, help="seeded starts")
    command.add_argument("--seed", type=int, default=0)
    command.add_argument("--threads", type=int, help="runs at once (default: one a core)")


def motion_of(args: argparse.Namespace) -> dict[str, Any]:
    """What `add_motion` took, as arguments of `trade` and its like."""
    motion = {
        "horizon": args.horizon,
        "key": args.key,
        "ctrl": None if args.ctrl is None else _controls(args.ctrl),
        "control": None if args.control is None else _function(args.control),
        "control_dt": args.control_dt,
        "seed": args.seed,
        "threads": args.threads,
    }
    if "starts" in args:
        motion["starts"] = args.starts
    return motion


def add_output(command: argparse.ArgumentParser) -> None:
    """Where the result goes beside the screen."""
    command.add_argument("--plot", metavar="OUT", help="write the picture (.png, .svg, .pdf)")
    command.add_argument("--html", metavar="OUT", help="write a page that needs no other file")
    command.add_argument(
        "--json", nargs="?", const="-", metavar="OUT", help="print data, or write it to a file"
    )


def check_output(args: argparse.Namespace) -> None:
    """Before minutes of work: can everything be written at the end?"""
    for out in (args.plot, args.html, args.json if args.json != "-" else None):
        if out is not None:
            check_path(out)
    if args.plot is not None:
        _need_matplotlib("--plot", args.plot)
    if args.html is not None:
        _need_matplotlib("--html")


def check_path(out: str, option: str = "") -> None:
    """Whether a file can be written there, as far as folders tell."""
    path = Path(out).resolve()
    if not path.parent.is_dir() or path.is_dir():
        wrong = "a folder, not a file" if path.is_dir() else "no such folder"
        raise Usage(f"{option} {out}: {wrong}".lstrip())


def deliver(result: Result, args: argparse.Namespace, **text: Any) -> None:
    """Writes and prints a result as `add_output` was asked; text: arguments of its `text`."""
    if args.plot is not None:
        result.plot(args.plot)
    if args.html is not None:
        result.to_html(args.html)
    if args.json == "-":
        print(result.to_json())
        return
    if args.json is not None:
        Path(args.json).write_text(result.to_json() + "\n", encoding="utf-8")
    print(result.text(**text))


def _need_matplotlib(option: str, out: str | None = None) -> None:
    try:
        from matplotlib.figure import Figure
    except ImportError:
        raise Usage(f"{option} needs matplotlib: pip install 'stepcore[plot]'") from None
    known = Figure().canvas.get_supported_filetypes()
    if out is not None and Path(out).suffix.lstrip(".").lower() not in known:
        raise Usage(f"{option} {out}: the ending must be one of {', '.join(sorted(known))}")


def _controls(path: str) -> Any:
    import numpy as np

    if not os.path.isfile(path):
        raise Usage(f"--ctrl {path}: no such file")
    if not path.endswith((".npy", ".csv")):
        raise Usage(f"--ctrl {path}: must end in .npy or .csv")
    try:
        with warnings.catch_warnings():
            # An empty file is an error below, in one line.
            warnings.simplefilter("ignore")
            if path.endswith(".npy"):
                values = np.load(path, allow_pickle=False)
            else:
                values = np.loadtxt(path, delimiter=",", ndmin=2)
    except (ValueError, EOFError) as error:
        raise Usage(f"--ctrl {path}: {one_line(error)}") from None
    if values.size == 0:
        raise Usage(f"--ctrl {path}: it is empty; must hold one row of controls a period")
    return values


def _function(text: str) -> Callable[..., Any]:
    """The function that "module:function" names, found as `python -m` would from here."""
    module, colon, name = text.partition(":")
    if not colon or not module or not name:
        raise Usage(f"--control {text}: must be MODULE:FUNCTION")
    if "" not in sys.path and os.getcwd() not in sys.path:
        sys.path.insert(0, os.getcwd())
    try:
        found = importlib.import_module(module)
    except Exception as error:
        raise Usage(f"--control {text}: {_blame(error)}") from None
    function = getattr(found, name, None)
    if not callable(function):
        known = [key for key, value in vars(found).items() if callable(value)]
        raise Usage(f"--control {text}: {module} has no function '{name}'{nearest(name, known)}")

    @functools.wraps(function)
    def asked(*args: Any) -> Any:
        try:
            return function(*args)
        except SimulationError:
            raise
        except Exception as error:
            # No ValueError, which would be a failure of the setting that is tried.
            raise RuntimeError(f"--control {text}: {_blame(error)}") from error

    return asked


def _blame(error: Exception) -> str:
    """An error of the user's own code in one line: its type, its text and the line it is from."""
    last = traceback.extract_tb(error.__traceback__)[-1]
    return f"{type(error).__name__}: {one_line(error)} ({Path(last.filename).name}:{last.lineno})"
