"""The commands `run`, which runs a model once, and `replay`, which repeats a failed run."""

from __future__ import annotations

import argparse
import sys
from collections.abc import Callable
from typing import Any

from stepcore._core import Settings, SimulationError
from stepcore.checks import nearest, one_line
from stepcore.cli.arguments import (
    OPTIONS,
    add_file,
    add_horizon,
    add_option,
    model_of,
    motion_of,
    time,
)
from stepcore.cli.output import Writes, add_output, attempted, deliver
from stepcore.cli.terminal import INTERRUPTED, Usage, put, reason, say
from stepcore.engine.model import Model
from stepcore.engine.replay import replay
from stepcore.engine.trajectory import RECORDED, Trajectory, whole_steps
from stepcore.experiment.motion import Motion
from stepcore.experiment.schedule import HORIZON
from stepcore.experiment.single_run import PUSH, PUSH_FORM, Push
from stepcore.measure.run import MOST_STEPS, sim_of, simulated
from stepcore.report.outputs import is_replaceable
from stepcore.report.result import Result
from stepcore.report.units import time_of
from stepcore.viewing.needs import need

# Extensions of --save, and the quantities that --save records without --record.
SAVED = (".npz", ".csv", ".mcap", ".html")
RECORD = ("qpos", "qvel", "ctrl", "energy", "overlap")
# Settings with the unit of time.
TIMES = ("dt", "sleep_time")
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
    command.add_argument("--key", **OPTIONS["key"])
    add_horizon(command, f"simulated time [s] (default: {HORIZON:g})")
    command.add_argument(
        "--dt", type=time, metavar="S", help="time step [s] (default: the model's)"
    )
    command.add_argument(
        "--accuracy",
        metavar="LENGTH",
        help="the error asked for at the end of the run, such as 1mm: each time step is made of as "
        "many shorter ones as this takes (default: steps of --dt)",
    )
    command.add_argument(
        "--error-bar",
        action=argparse.BooleanOptionalAction,
        help="estimate the error of the run from a finer run beside it (default: with --accuracy)",
    )
    command.add_argument(
        "--set",
        action="append",
        default=[],
        metavar="NAME=VALUE",
        help="change a setting (any field of stepcore.Settings); may be given several times",
    )
    command.add_argument(
        "--replay", metavar="OUT", help="where to write the replay if the run fails"
    )
    command.add_argument(
        "--save",
        metavar="OUT",
        help="write the run: .npz (arrays), .csv (columns by name), .mcap (a log for Foxglove) or "
        ".html (a page that replays it)",
    )
    command.add_argument(
        "--record",
        metavar="NAMES",
        help="what --plot, --html and --save have of every step, such as qpos,ctrl,actuator_force "
        "(default: energy,overlap; --save: qpos,qvel,ctrl too)",
    )
    add_inputs(command)
    add_output(command, full="print the whole final state")


def add_inputs(command: argparse.ArgumentParser) -> None:
    """Add the options of the inputs of a run."""
    inputs = command.add_argument_group("inputs")
    for name in ("ctrl", "interpolation", "follow", "control"):
        add_option(inputs, name)
    kind = OPTIONS["kind"]["help"].partition(" (default")[0]
    add_option(inputs, "kind", help=f"{kind} (default: the keyframe's controls, held)")
    add_option(inputs, "seed", help="random seed of --motion (default: 0)")
    inputs.add_argument(
        "--control-dt", type=time, metavar="S", help="control period [s] (default: every step)"
    )
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
    return replay(args.file) if name == "replay" else _run(args)


def _run(args: argparse.Namespace) -> int:
    changes = dict(_setting(text) for text in args.set)
    if args.dt is not None:
        changes["dt"] = args.dt
    if args.accuracy is not None:
        changes["accuracy"] = args.accuracy
    horizon = HORIZON if args.horizon is None else args.horizon
    if not 0 <= horizon < float("inf"):
        raise Usage(f"--horizon {horizon:g}: must be finite and >= 0 s")
    model = model_of(args).with_settings(**changes)
    dt = model.settings.dt
    if not horizon / dt < MOST_STEPS:
        limit = f"below {MOST_STEPS * dt:g} s at dt = {dt:g} s"
        raise Usage(f"--horizon {horizon:g} s: must be {limit} (2^64 steps)")
    record = _recorded(args)
    pushes, motion = pushes_of(args, model), motion_of_run(args, model)
    if args.horizon is None:
        horizon = max(horizon, motion.duration)
    # The ledger is needed to explain a failure in full, and costs only a few per cent.
    ledger = changes.get("ledger", True)
    sim = sim_of(model, horizon, ledger=ledger, error_bar=args.error_bar)
    result = simulated(sim, model.settings, motion, horizon, pushes, record, None, True)
    if result.error is not None:
        said = [f"{one_line(result.error)}.", *(finding.text for finding in result.findings)]
        # Printed first, because saving can fail too.
        say(" ".join(said), end=" ")
        _keep(result.error, args, result.trajectory)
        return 1
    unsaved = attempted(_saves(args, result.trajectory))
    deliver(result, args)
    for other in unsaved:
        raise other
    return INTERRUPTED if result.interrupted else 0


def motion_of_run(args: argparse.Namespace, model: Model) -> Motion:
    """Return the motion of --key, --ctrl, --control and --control-dt."""
    if args.control_dt is not None:
        whole_steps("--control-dt", args.control_dt, model.settings.dt, least=1)
    return Motion(**(motion_of(args, model) | {"horizon": args.horizon or None}))


def pushes_of(args: argparse.Namespace, model: Model) -> list[Push]:
    """Return the pushes of --push."""
    try:
        pushes = [Push.of(text) for text in args.push]
        for push in pushes:
            push.on(model)
    except ValueError as error:
        raise Usage(f"--{one_line(error)}") from None
    return pushes


def _recorded(args: argparse.Namespace) -> tuple[str, ...]:
    """Return the quantities to record at every step, after checking them."""
    if args.plot is None and args.save is None and args.html is None:
        if args.record is not None:
            raise Usage("--record is what --plot and --save have: give one of them")
        return ()
    if args.save is not None and not args.save.endswith(SAVED):
        raise Usage(f"--save {args.save}: must end in {', '.join(SAVED)}")
    # A missing package is reported before the run.
    if args.save is not None and args.save.endswith(".mcap"):
        need("mcap", f"--save {args.save}", "mcap")
    if args.save is not None and args.save.endswith(".html"):
        need("trimesh", f"--save {args.save}")
    if args.record is not None:
        names = tuple(name.strip() for name in args.record.split(","))
        for name in names:
            if name not in RECORDED:
                near = nearest(name, RECORDED)
                raise Usage(f"--record {args.record}: '{name}' cannot be recorded{near}")
        return names
    return ("energy", "overlap") if args.save is None else RECORD


def _saves(args: argparse.Namespace, run: Trajectory | None) -> Writes:
    saves: Writes = []
    if run is not None and args.save is not None:
        ending = SAVED.index(args.save[args.save.rindex(".") :])
        save = (run.save, run.save, run.save_mcap, run.save_html)[ending]
        saves.append((args.save, lambda: save(args.save)))
    return saves


def _keep(error: SimulationError, args: argparse.Namespace, run: Trajectory | None) -> None:
    """Save the replay of a failure, and the recorded run up to the failure."""
    path = args.replay or _replay_name(error)
    failed = attempted([(path, lambda: error.replay.save(path))])
    if failed:
        said = [f"The replay was not saved: {reason(failed[0])}."]
    else:
        said = [f"To see what failed: stepcore replay {path}"]
    saves = _saves(args, run)
    if run is not None and args.plot is not None:
        saves.append((args.plot, lambda: run.plot(args.plot)))
    said += [f"Not saved: {reason(other)}." for other in attempted(saves)]
    put(" ".join(said), stream=sys.stderr)


def _replay_name(error: SimulationError) -> str:
    """Return an unused file name for the replay of a failure."""
    name = "".join(c if c.isalnum() or c in "-_." else "-" for c in error.replay.name)
    path = f"{name or 'run'}-step{error.step}.replay.json"
    while not is_replaceable(path):
        path = f"{path.removesuffix('.replay.json')}-new.replay.json"
    return path


def _setting(text: str) -> tuple[str, Any]:
    """Parse "name=value" as a field of Settings and its value."""
    name, equals, value = text.partition("=")
    if not equals:
        raise Usage(f"--set {text}: must be NAME=VALUE")
    fields = Settings().as_dict()
    if name not in fields:
        raise Usage(f"--set {text}: settings have no '{name}'{nearest(name, fields)}")
    if (name, value) == ("sweeps", "auto"):
        return name, value
    if name == "accuracy":
        return name, value
    if name == "max_recovery_speed":
        return name, value if value in ("auto", "none") else _number(float, name, value)
    if name in TIMES:
        return name, _number(time_of, name, value)
    kind = type(fields[name])
    if kind is bool:
        if value.lower() not in ("true", "false"):
            raise Usage(f"--set {text}: must be true or false")
        return name, value.lower() == "true"
    return name, value if kind is str else _number(kind, name, value)


def _number(read: Callable[[str], Any], name: str, value: str) -> Any:
    try:
        number = read(value)
    except ValueError:
        number = None
    if number is None:
        raise Usage(f"--set {name}={value}: '{value}' is not a number")
    return number
