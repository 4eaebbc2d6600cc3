"""The commands `run`, which runs a model once, `replay` of a failed run, and `view`."""

from __future__ import annotations

import argparse
import sys
from typing import Any

import numpy as np

from stepcore._core import SimulationError
from stepcore.checks import one_line
from stepcore.cli.arguments import (
    OPTIONS,
    add_file,
    add_motion,
    add_options,
    controls_of,
    key_of,
    model_of,
    motion_of,
    setting,
    time,
)
from stepcore.cli.output import Writes, add_force, add_output, attempted, deliver
from stepcore.cli.terminal import INTERRUPTED, Usage, print_above, print_error, reason
from stepcore.engine.model import Model
from stepcore.engine.replay import replay
from stepcore.engine.sim import Sim
from stepcore.engine.trajectory import Trajectory
from stepcore.experiment.control_table import control_table
from stepcore.experiment.motion import Motion
from stepcore.experiment.schedule import HORIZON
from stepcore.experiment.single_run import PUSH, PUSH_FORM, Push
from stepcore.measure import run as runs
from stepcore.needs import need
from stepcore.report.outputs import is_replaceable
from stepcore.report.result import Result

# Extensions of --save, with the package that each needs; and the arrays saved without --record.
SAVED = {".npz": "", ".csv": "", ".mcap": "mcap", ".html": "trimesh"}
RECORD = ("qpos", "qvel", "ctrl", "energy", "overlap")
# The default horizon of the run on a page [s].
PAGE = 5.0
TEXTS = {
    "run": """\
Simulate a model and print its final state, energy and computing time, and what went
wrong on the way: contacts that creep, joints beyond their limits, servos that do not hold. A run
that fails writes a replay file, from which `stepcore replay` shows what failed.

Example:
  stepcore run gymnasium:half_cheetah --horizon 2 --ctrl bthigh=1,fthigh=-1 --push torso:50,0,0@1
""",
    "replay": """\
Run a failed simulation again from its replay file, and show which elements injected
energy in the steps before the failure.

`stepcore run` writes such a file when a run fails; in Python it is the error's `replay`.

Example:
  stepcore replay ball-step1201.replay.json --plot energy.png
""",
    "view": """\
Watch a model move, in a browser: paused, stepped, taken back in time, with sliders for its
controls, contact forces, energy and the residual. It prints the address of the page, which a
browser on another machine can open too (--host 0.0.0.0). With --html it runs the model and writes
a page that replays the run, which anybody opens without Python.

Example:
  stepcore view gymnasium:half_cheetah --ctrl bthigh=1,fthigh=-1 --html run.html
""",
}


OPTIONS_OF_RUN: dict[str, dict[str, Any]] = {
    "accuracy": {
        "metavar": "LENGTH",
        "help": "the requested error at the end of the run, such as 1mm: each time step is made of "
        "as many shorter ones as this takes (default: steps of --dt)",
    },
    "error_bar": {"action": argparse.BooleanOptionalAction},
    "set": {
        "action": "append",
        "default": [],
        "metavar": "NAME=VALUE",
        "help": "change a setting (any field of stepcore.Settings)",
    },
    "replay": {"metavar": "OUT", "help": "where to write the replay if the run fails"},
    "save": {
        "metavar": "OUT",
        "help": "write the run: .npz (arrays), .csv (columns by name), .mcap (a log for Foxglove) "
        "or .html (a page that replays it)",
    },
    "record": {
        "metavar": "NAMES",
        "default": None,
        "help": "what --plot, --html and --save have of every step, such as "
        "qpos,ctrl,actuator_force (default: energy,overlap; --save: qpos,qvel,ctrl too)",
    },
}


def text(name: str) -> str:
    """Return the description of a command and its example."""
    return TEXTS[name]


def add(command: argparse.ArgumentParser, name: str) -> None:
    """Add the options of a command."""
    if name == "replay":
        command.add_argument("file", metavar="FILE", help="a replay file (.replay.json)")
        add_output(command)
        return
    add_file(command)
    add_motion(command, ("key",))
    words = "time step [s] (default: the model's)"
    command.add_argument("--dt", type=time, metavar="S", help=words)
    if name == "view":
        _add_view(command)
    else:
        add_options(command, OPTIONS_OF_RUN, runs.run)
        _add_inputs(command, HORIZON)
        add_output(command, full="print the whole final state")


def _add_view(command: argparse.ArgumentParser) -> None:
    live = command.add_argument_group("live view")
    live.add_argument(
        "--host",
        default="localhost",
        help="where the page is served; 0.0.0.0 lets other machines open it (default: this machine "
        "alone)",
    )
    live.add_argument("--port", type=int, default=8080, help="of the page (default: 8080)")
    page = command.add_argument_group("page")
    page.add_argument("--html", dest="page", metavar="OUT", help="write a page that replays a run")
    add_force(page)
    _add_inputs(command, PAGE)


def _add_inputs(command: argparse.ArgumentParser, horizon: float) -> None:
    """Add the options of the inputs of a run, with its default horizon [s]."""
    inputs = command.add_argument_group("inputs")
    fields = OPTIONS.keys() - {"key", "starts"}
    held = "the keyframe's controls, held"
    add_motion(inputs, fields, horizon=f"{horizon:g}", kind=held, control_dt="every step")
    inputs.add_argument(
        "--push",
        action="append",
        default=[],
        metavar="BODY:F@T",
        help=f"a force on a body's centre of mass, {PUSH_FORM} (default: {PUSH:g} s), T counted "
        "from the beginning of the run; may be given several times",
    )


def call(args: argparse.Namespace, name: str) -> Result | int:
    """Run a command; return its result or its exit status."""
    if name == "replay":
        return replay(args.file)
    if args.horizon is not None and not 0 <= args.horizon < float("inf"):
        raise Usage(f"--horizon {args.horizon:g}: must be finite and >= 0 s")
    return _view(args) if name == "view" else _run(args)


def _run(args: argparse.Namespace) -> int:
    given = {"dt": args.dt, "accuracy": args.accuracy}
    changes = dict(map(setting, args.set))
    changes |= {name: value for name, value in given.items() if value is not None}
    model = model_of(args).with_settings(**changes)
    record = _recorded(args)
    motion, pushes = _inputs(args, model)
    model = motion.driven(model)
    horizon = max(HORIZON, motion.duration) if args.horizon is None else args.horizon
    # The ledger is needed to explain a failure in full, and costs only a few per cent.
    ledger = changes.get("ledger", True)
    sim = runs.sim_of(model, horizon, ledger=ledger, error_bar=args.error_bar)
    result = runs.simulated(sim, model.settings, motion, horizon, pushes, record, None, True)
    if result.error is not None:
        said = [f"{one_line(result.error)}.", *(finding.text for finding in result.findings)]
        # Printed first, because saving can fail too.
        print_error(" ".join(said), end=" ")
        _keep(result.error, args, result.trajectory)
        return 1
    unsaved = attempted(_saves(args, result.trajectory))
    deliver(result, args)
    for other in unsaved:
        raise other
    return INTERRUPTED if result.interrupted else 0


def _inputs(args: argparse.Namespace, model: Model) -> tuple[Motion, list[Push]]:
    """Return the motion and the pushes of a run."""
    motion = Motion(**(motion_of(args, model) | {"horizon": args.horizon or None}))
    try:
        pushes = [Push.of(text) for text in args.push]
        for push in pushes:
            push.body_index(model)
    except ValueError as error:
        raise Usage(f"--{one_line(error)}") from None
    return motion, pushes


def _recorded(args: argparse.Namespace) -> tuple[str, ...]:
    """Return the quantities to record at every step; report a missing package before the run."""
    if args.plot is None and args.save is None and args.html is None:
        if args.record is not None:
            raise Usage("--record is what --plot and --save have: give one of them")
        return ()
    if args.save is not None and not args.save.endswith(tuple(SAVED)):
        raise Usage(f"--save {args.save}: must end in {', '.join(SAVED)}")
    for ending, package in SAVED.items():
        if package and args.save is not None and args.save.endswith(ending):
            need(package, f"--save {args.save}", "mcap" if package == "mcap" else "view")
    if args.record is not None:
        return tuple(name.strip() for name in args.record.split(","))
    return ("qpos", "energy", "overlap") if args.save is None else RECORD


def _saves(args: argparse.Namespace, run: Trajectory | None) -> Writes:
    if run is None or args.save is None:
        return []
    others = {".mcap": run.save_mcap, ".html": run.save_html}
    save: Any = others.get(args.save[args.save.rindex(".") :], run.save)
    return [(args.save, lambda: save(args.save))]


def _keep(error: SimulationError, args: argparse.Namespace, run: Trajectory | None) -> None:
    """Save the replay of a failure, and the recorded run up to the failure."""
    name = "".join(c if c.isalnum() or c in "-_." else "-" for c in error.replay.name)
    path = args.replay or f"{name or 'run'}-step{error.step}.replay.json"
    while not args.replay and not is_replaceable(path):
        path = f"{path.removesuffix('.replay.json')}-new.replay.json"
    failed = attempted([(path, lambda: error.replay.save(path))])
    said = [f"To see what failed: stepcore replay {path}"]
    if failed:
        said = [f"The replay was not saved: {reason(failed[0])}."]
    saves = _saves(args, run)
    if run is not None and args.plot is not None:
        saves.append((args.plot, lambda: run.plot(args.plot)))
    said += [f"Not saved: {reason(other)}." for other in attempted(saves)]
    print_above(" ".join(said), stream=sys.stderr)


def _view(args: argparse.Namespace) -> int:
    """Show the model in a live view, or write the page of a run; return the exit status."""
    if args.page is not None:
        need("trimesh", f"--html {args.page}")
    elif args.horizon is not None:
        raise Usage("--horizon is of the run that --html writes; a live view has no end")
    horizon = args.horizon = PAGE if args.horizon is None else args.horizon
    model = model_of(args)
    sim = Sim(model, **({} if args.dt is None else {"dt": args.dt}))
    if args.page is None:
        _live(args, sim)
        return 0
    motion, pushes = _inputs(args, sim.model)
    run = runs.simulated(sim, sim.settings, motion, horizon, pushes, ("qpos",), None)
    if run.error is not None:
        print_error(one_line(run.error))
    # The page of a failed run shows the motion up to the failure.
    seen = run.trajectory
    if seen is not None:
        for unsaved in attempted([(args.page, lambda: seen.save_html(args.page))]):
            raise unsaved
        print_above(f"{args.page}: {seen.time[-1] - seen.time[0]:g} s of motion")
    return 0 if run.success else 1


def _live(args: Any, sim: Sim) -> None:
    others = ("control", "control_dt", "follow", "kind", "push")
    if any(getattr(args, name) for name in others):
        options = "--control, --control-dt, --follow, --motion and --push"
        raise Usage(f"{options} drive the run that --html writes")
    key = key_of(args, sim.model)
    sim.reset(key=0 if key is None and sim.model.keys else key)
    if args.ctrl is not None:
        table = control_table(controls_of(args.ctrl, sim.model))
        sim.ctrl = table.control_log(sim.model, np.array(sim.ctrl), sim.settings.dt).rows[0]
    sim.view(host=args.host, port=args.port, wait=True)
