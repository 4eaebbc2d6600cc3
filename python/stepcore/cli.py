"""The command line: `stepcore lesson`, `run`, `trade`, `info`; also `python -m stepcore`.

A FILE is the path of an MJCF file, "package:name" for a model among the files of an installed
package (as gymnasium:half_cheetah; the package is not imported), or "lesson:name" for a scene
of the lesson. Bad input is one line on the error stream: exit 2 for what was asked, 1 for what
went wrong on the way, 130 after Ctrl-C.
"""

from __future__ import annotations

import argparse
import functools
import importlib
import json
import os
import platform
import sys
import traceback
import warnings
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any, NoReturn

from stepcore._core import SimulationError
from stepcore.checks import nearest, one_line
from stepcore.table import Table, jsonable


class _Parser(argparse.ArgumentParser):
    """Errors in one line."""

    def error(self, message: str) -> NoReturn:
        self.exit(2, f"{self.prog}: {message}\n")


class _Version(argparse.Action):
    """Looks the version up only when it is asked for."""

    def __init__(self, option_strings: Sequence[str], dest: str, help: str) -> None:
        super().__init__(option_strings, dest, nargs=0, help=help)

    def __call__(self, parser: argparse.ArgumentParser, *_: Any) -> None:
        import stepcore

        print(f"stepcore {stepcore.__version__}")
        parser.exit()


class Usage(ValueError):
    """What the user asked for cannot be done as asked."""


def main(argv: Sequence[str] | None = None) -> int:
    """Runs one command; returns the exit status."""
    try:
        args = parser().parse_args(argv)
    except SystemExit as stop:
        return stop.code if isinstance(stop.code, int) else 2
    try:
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


def _say(text: str, status: int) -> int:
    print(f"stepcore: {text}", file=sys.stderr)
    return status


def parser() -> argparse.ArgumentParser:
    """What the commands take."""
    top = _Parser(prog="stepcore", description="Rigid-body physics that measures itself.")
    top.add_argument("--debug", action="store_true", help=argparse.SUPPRESS)
    top.add_argument("--version", action=_Version, help="print the version and exit")
    commands = top.add_subparsers(metavar="command", required=True, parser_class=_Parser)
    _add_lesson(commands)
    _add_run(commands)
    _add_trade(commands)
    info = commands.add_parser("info", help="versions and machine")
    info.add_argument("--json", action="store_true", help="print data instead of text")
    info.set_defaults(call=_info)
    return top


def _add_lesson(commands: Any) -> None:
    lesson = commands.add_parser("lesson", help="every figure of the lesson beside its reference")
    lesson.add_argument("--engine", choices=("rust", "numpy"), default="rust")
    lesson.add_argument(
        "--extremes", action="store_true", help="its scenes and two models at the extremes instead"
    )
    lesson.add_argument("--json", action="store_true", help="print data instead of text")
    lesson.set_defaults(call=_lesson)


def _add_run(commands: Any) -> None:
    run = commands.add_parser("run", help="simulate a model and print where it ends")
    run.add_argument("file", metavar="FILE", help="path, package:name or lesson:name")
    run.add_argument("--duration", type=float, help="simulated time [s] (default: 1)")
    run.add_argument("--dt", type=float, help="time step [s]")
    run.add_argument("--key", help="keyframe to start from")
    run.add_argument(
        "--set", action="append", default=[], metavar="NAME=VALUE", help="any field of Settings"
    )
    run.add_argument("--json", action="store_true", help="print data instead of text")
    run.set_defaults(call=_run)


def _add_trade(commands: Any) -> None:
    trade = commands.add_parser("trade", help="what speed costs in accuracy on a model")
    trade.add_argument("file", metavar="FILE", help="path, package:name or lesson:name")
    trade.add_argument("--horizon", type=float, help="simulated time [s] (default: about 1)")
    trade.add_argument("--key", help="keyframe to start from")
    trade.add_argument("--ctrl", metavar="FILE", help="controls, .npy or .csv, one row a period")
    trade.add_argument("--control", metavar="MODULE:FUNCTION", help="a function that controls")
    trade.add_argument("--control-dt", type=float, help="control period [s]")
    trade.add_argument("--starts", type=int, default=8, help="seeded starts")
    trade.add_argument("--seed", type=int, default=0)
    trade.add_argument("--threads", type=int, help="runs at once (default: one a core)")
    trade.add_argument("--plot", metavar="OUT", help="write the picture (.png, .svg, .pdf)")
    trade.add_argument(
        "--json", nargs="?", const="-", metavar="OUT", help="print data, or write it to a file"
    )
    trade.add_argument("--all", action="store_true", help="print every setting")
    trade.set_defaults(call=_trade)


def _lesson(args: argparse.Namespace) -> int:
    from stepcore import extremes, lesson

    if args.extremes and args.engine != "rust":
        raise Usage("--extremes: runs the Rust engine only")
    part = extremes if args.extremes else lesson
    rows = extremes.run() if args.extremes else lesson.run(args.engine)
    if args.json:
        print(json.dumps(jsonable([row.to_dict() for row in rows]), indent=2))
    else:
        print(part.report(rows))
    return 0 if all(row.ok for row in rows) else 1


def _run(args: argparse.Namespace) -> None:
    from time import perf_counter

    from stepcore.lookup import find_scene
    from stepcore.sim import Sim

    changes = dict(_setting(text) for text in args.set)
    if args.dt is not None:
        changes["dt"] = args.dt
    duration = 1.0 if args.duration is None else args.duration
    if not 0 <= duration < float("inf"):
        raise Usage(f"--duration {duration:g}: must be finite and >= 0 s")
    sim = Sim(find_scene(args.file).compile(), **changes)
    first = 0 if sim.model.keys else None
    sim.reset(key=first if args.key is None else args.key)
    dt = sim.settings.dt
    steps = round(duration / dt)
    notes = list(sim.model.scene.notes)
    if args.duration is not None and abs(steps * dt - duration) > 1e-6 * dt:
        notes.append(
            f"--duration {duration:g} s is no whole number of steps of {dt:g} s: "
            f"{steps * dt:g} s are run"
        )
    begin = perf_counter()
    sim.step(steps)
    spent = perf_counter() - begin
    kinetic, potential = (float(part) for part in sim.energy)
    result = {
        "settings": sim.settings.as_dict(),
        "steps": steps,
        "time": float(sim.time),
        "qpos": sim.qpos,
        "qvel": sim.qvel,
        "kinetic": kinetic,
        "potential": potential,
        "contacts": len(sim.contacts),
        "residual": float(sim.residual),
        "us_per_step": 1e6 * spent / steps if steps else None,
        "notes": notes,
    }
    if args.json:
        print(json.dumps(jsonable(result), indent=2))
        return
    print(f"{sim.model!r}\n{sim.settings!r}\n")
    print(f"time      {result['time']:g} s, {steps} steps")
    print(f"qpos      {_numbers(sim.qpos)}\nqvel      {_numbers(sim.qvel)}")
    print(f"energy    {kinetic:.6g} J kinetic, {potential:.6g} J potential")
    print(f"contacts  {len(sim.contacts)}, residual {float(sim.residual):.2g} m/s")
    if steps:
        print(f"computing {1e6 * spent / steps:.3g} us a step")
    for note in notes:
        print(f"note: {note}")


def _numbers(values: Any) -> str:
    return " ".join(f"{value:.6g}" for value in values)


def _setting(text: str) -> tuple[str, Any]:
    """ "name=value" as a field of Settings and its value."""
    name, equals, value = text.partition("=")
    if not equals:
        raise Usage(f"--set {text}: must be NAME=VALUE")
    from stepcore._core import Settings

    fields = Settings().as_dict()
    if name not in fields:
        raise Usage(f"--set {text}: settings have no '{name}'{nearest(name, fields)}")
    kind = type(fields[name])
    if kind is bool:
        if value.lower() not in ("true", "false"):
            raise Usage(f"--set {text}: must be true or false")
        return name, value.lower() == "true"
    try:
        return name, kind(value)
    except ValueError:
        raise Usage(f"--set {text}: '{value}' is not a number") from None


def _trade(args: argparse.Namespace) -> None:
    from stepcore.lookup import find_scene
    from stepcore.trade import trade

    for out in (args.plot, args.json if args.json != "-" else None):
        if out is not None and not Path(out).resolve().parent.is_dir():
            raise Usage(f"{out}: no such folder")
    if args.plot is not None:
        _need_matplotlib(args.plot)
    result = trade(
        find_scene(args.file),
        horizon=args.horizon,
        key=args.key,
        ctrl=None if args.ctrl is None else _controls(args.ctrl),
        control=None if args.control is None else _function(args.control),
        control_dt=args.control_dt,
        starts=args.starts,
        seed=args.seed,
        threads=args.threads,
    )
    if args.plot is not None:
        result.plot(args.plot)
    if args.json == "-":
        print(result.to_json())
        return
    if args.json is not None:
        Path(args.json).write_text(result.to_json() + "\n", encoding="utf-8")
    print(result.text(full=args.all))


def _need_matplotlib(out: str) -> None:
    """Before minutes of work: can the picture be drawn at the end?"""
    try:
        from matplotlib.figure import Figure
    except ImportError:
        raise Usage("--plot needs matplotlib: pip install 'stepcore[plot]'") from None
    known = Figure().canvas.get_supported_filetypes()
    if Path(out).suffix.lstrip(".").lower() not in known:
        raise Usage(f"--plot {out}: the ending must be one of {', '.join(sorted(known))}")


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


def _info(args: argparse.Namespace) -> None:
    from importlib import metadata

    def version(package: str) -> str | None:
        try:
            return metadata.version(package)
        except metadata.PackageNotFoundError:
            return None

    found = {name: version(name) for name in ("stepcore", "numpy", "matplotlib", "mujoco")}
    facts: dict[str, Any] = {
        **{name: text or "not installed" for name, text in found.items()},
        "python": platform.python_version(),
        "machine": f"{platform.system()} {platform.machine()}",
        "cores": os.cpu_count(),
    }
    if args.json:
        print(json.dumps(facts, indent=2))
    else:
        print(Table({"": name, " ": str(fact)} for name, fact in facts.items()))


if __name__ == "__main__":
    sys.exit(main())
