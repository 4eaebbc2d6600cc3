"""Simulate a model and print its final state, energy and computing time, and what went wrong on
the way: contacts that creep, joints beyond their limits, servos that do not hold. A run that fails
writes a replay file, from which `stepcore replay` shows what failed.

Example:
  stepcore run gymnasium:half_cheetah --duration 2 --ctrl bthigh=1,fthigh=-1 --push torso:50,0,0@1
"""

from __future__ import annotations

import argparse
import sys
from typing import Any

from stepcore._core import Settings, SimulationError
from stepcore.checks import nearest, one_line
from stepcore.cli.inputs import add_inputs, control_of, in_words, pushes_of
from stepcore.cli.motion import add_file, add_key, key_of, model_of
from stepcore.cli.output import Writes, add_force, add_json, attempted, print_json
from stepcore.cli.terminal import put, reason, say
from stepcore.cli.usage import Usage
from stepcore.engine.sim import Sim
from stepcore.engine.trajectory import RECORDED, Trajectory
from stepcore.experiment.pace import Pace
from stepcore.experiment.single_run import LOOKS, SingleRun
from stepcore.measure.monitors import Finding, Monitor
from stepcore.report.outputs import is_replaceable
from stepcore.report.report import NARROWEST, wrapped
from stepcore.report.table import window
from stepcore.report.units import computing, counted, seconds, times
from stepcore.viewing.needs import need

# The counter of steps has 64 bits.
MOST_STEPS = 2.0**64
DURATION = 1.0
# Endings of --save, and what it has of every step where --record does not say.
SAVED = (".npz", ".mcap", ".html")
RECORD = ("qpos", "qvel", "ctrl", "energy", "overlap")
# Where the values of the report begin.
LABEL = 11
# Of a state so many numbers are printed.
NUMBERS = 36


def add(command: argparse.ArgumentParser) -> None:
    add_file(command)
    add_key(command)
    command.add_argument(
        "--duration", type=float, metavar="S", help=f"simulated time [s] (default: {DURATION:g})"
    )
    command.add_argument(
        "--dt", type=float, metavar="S", help="time step [s] (default: the model's)"
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
        "--plot",
        metavar="OUT",
        help="write the plot of energy and overlap, or of --record",
    )
    command.add_argument(
        "--save",
        metavar="OUT",
        help="write the run: .npz (arrays), .mcap (a log for Foxglove) or .html (a page that "
        "replays it)",
    )
    command.add_argument(
        "--record",
        metavar="NAMES",
        help="what --plot and --save have of every step, such as qpos,ctrl,actuator_force "
        "(default: energy,overlap; --save: qpos,qvel,ctrl too)",
    )
    add_inputs(command)
    add_force(command)
    add_json(command)


def call(args: argparse.Namespace) -> int:
    changes = dict(_setting(text) for text in args.set)
    if args.dt is not None:
        changes["dt"] = args.dt
    duration = DURATION if args.duration is None else args.duration
    if not 0 <= duration < float("inf"):
        raise Usage(f"--duration {duration:g}: must be finite and >= 0 s")
    model = model_of(args)
    # The ledger explains a failure in full, and costs a few percent.
    sim = Sim(model, **({"ledger": True} | changes))
    # Those that were asked for.
    shown = Settings(**(sim.settings.as_dict() | {"ledger": changes.get("ledger", False)}))
    key = key_of(args, model)
    sim.reset(key=0 if key is None and model.keys else key)
    steps = _steps(duration, sim.settings.dt)
    notes = list(model.scene.notes)
    run = steps * sim.settings.dt
    if args.duration is not None and abs(run - duration) > 1e-6 * sim.settings.dt:
        notes.append(
            f"--duration {duration:g} s is not a whole number of steps of "
            f"{sim.settings.dt:g} s: the run is {run:g} s long"
        )
    record = _recorded(args)
    monitor, control = Monitor(sim.model), control_of(args, sim)
    pace = Pace(min(steps, LOOKS))
    ran = in_words(args, sim, control, key, run)
    single = SingleRun(
        sim,
        control=control,
        control_dt=args.control_dt,
        pushes=pushes_of(args, model),
        probes=[monitor, pace] if steps else [],
        record=record,
        progress=None,
    )
    try:
        single.run(steps)
        sim.balance()
    except SimulationError as error:
        said = [f"{one_line(error)}."]
        said += [finding.text for finding in monitor.findings(failed=True)]
        # The failure is known before anything else can go wrong.
        say(" ".join(said), end=" ")
        _keep(error, args, single.trajectory)
        return 1
    unsaved = attempted(_saves(args, single.trajectory))
    found = monitor.findings() if steps else []
    step = pace.seconds(Sim(model, sim.settings)) if steps else 0.0
    _report(sim, shown, ran, steps, step, notes, found, args.json)
    for other in unsaved:
        raise other
    return 0


def _recorded(args: argparse.Namespace) -> tuple[str, ...]:
    """What is recorded of every step, checked before the run."""
    if args.plot is None and args.save is None:
        if args.record is not None:
            raise Usage("--record is what --plot and --save have: give one of them")
        return ()
    if args.save is not None and not args.save.endswith(SAVED):
        raise Usage(f"--save {args.save}: must end in {', '.join(SAVED)}")
    # What is missing is said before the run.
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
    """What writes the plot and the run itself; of a run that fails, what it did until then."""
    saves: Writes = []
    if run is not None and args.plot is not None:
        saves.append((args.plot, lambda: run.plot(args.plot)))
    if run is not None and args.save is not None:
        ending = SAVED.index(args.save[args.save.rindex(".") :])
        save = (run.save, run.save_mcap, run.save_html)[ending]
        saves.append((args.save, lambda: save(args.save)))
    return saves


def _keep(error: SimulationError, args: argparse.Namespace, run: Trajectory | None) -> None:
    """Saves the replay of a failure, which was said, and what the run did until then."""
    path = args.replay or _replay_name(error)
    failed = attempted([(path, lambda: error.replay.save(path))])
    if failed:
        said = [f"The replay was not saved: {reason(failed[0])}."]
    else:
        said = [f"To see what failed: stepcore replay {path}"]
    said += [f"Not saved: {reason(other)}." for other in attempted(_saves(args, run))]
    put(" ".join(said), stream=sys.stderr)


def _report(
    sim: Sim,
    shown: Settings,
    ran: str,
    steps: int,
    step: float,
    notes: list[str],
    found: list[Finding],
    as_json: bool,
) -> None:
    """Prints the final state and what the run showed.

    shown: the settings that were asked for. ran: the motion, in words. step: computing time
    of a step [s].
    """
    kinetic, potential = (float(part) for part in sim.energy)
    cost = 1e6 * step or None
    if as_json:
        data = {
            "settings": sim.settings,
            "ran": ran,
            "steps": steps,
            "time": sim.time,
            "qpos": sim.qpos,
            "qvel": sim.qvel,
            "kinetic": kinetic,
            "potential": potential,
            "contacts": len(sim.contacts),
            "residual": sim.residual,
            "us_per_step": cost,
            "notes": notes,
            "findings": [finding.record() for finding in found],
        }
        print_json(data)
        return
    model = sim.model
    name = model.scene.name or "scene"
    if not steps:
        _say(f"{name}: no step was made.")
    else:
        dt = sim.settings.dt
        took = f"{seconds(steps * dt)} in {counted(steps, 'step')} of {seconds(dt)}"
        pace = cost and f"; {computing(cost)} a step, {times(1e6 * dt / cost)} real time"
        _say(f"{name}: {took}{pace or ''}.")
    for finding in found:
        _say(f"{finding.severity}: {finding.text}")
    if steps and not found:
        _say("Nothing found: no contact creeps or sinks in, and limits and servos hold.")
    _say(f"The motion: {ran}.")
    _say(f"{shown!r}")
    put("")
    _say(f"time       {sim.time:g} s", LABEL)
    _say(f"qpos       {_numbers(sim.qpos)}", LABEL)
    _say(f"qvel       {_numbers(sim.qvel)}", LABEL)
    _say(f"energy     {kinetic:.6g} J kinetic, {potential:.6g} J potential", LABEL)
    _say(f"contacts   {len(sim.contacts)}, residual {sim.residual:.2g} m/s", LABEL)
    for note in notes:
        _say(f"note: {note}")


def _say(text: str, indent: int = 2) -> None:
    """Prints a text in lines that fit the terminal; those after the first are indented."""
    put("\n".join(wrapped(text, max(NARROWEST, window()), hanging=indent, whole=True)))


def _steps(duration: float, dt: float) -> int:
    """Steps in a duration."""
    if not duration / dt < MOST_STEPS:
        limit = f"below {MOST_STEPS * dt:g} s at dt = {dt:g} s"
        raise Usage(f"--duration {duration:g} s: must be {limit} (2^64 steps)")
    return round(duration / dt)


def _replay_name(error: SimulationError) -> str:
    """Under which name the replay of a failure is saved in this folder."""
    name = "".join(c if c.isalnum() or c in "-_." else "-" for c in error.replay.name)
    path = f"{name or 'run'}-step{error.step}.replay.json"
    while not is_replaceable(path):
        path = f"{path.removesuffix('.replay.json')}-new.replay.json"
    return path


def _numbers(values: Any) -> str:
    more = f" … and {len(values) - NUMBERS} more (--json)" if len(values) > NUMBERS else ""
    return " ".join(f"{value:.6g}" for value in values[:NUMBERS]) + more


def _setting(text: str) -> tuple[str, Any]:
    """ "name=value" as a field of Settings and its value."""
    name, equals, value = text.partition("=")
    if not equals:
        raise Usage(f"--set {text}: must be NAME=VALUE")
    fields = Settings().as_dict()
    if name not in fields:
        raise Usage(f"--set {text}: settings have no '{name}'{nearest(name, fields)}")
    if (name, value) == ("sweeps", "auto"):
        return name, value
    if name == "max_recovery_speed":
        return name, value if value in ("auto", "none") else _number(float, name, value)
    kind = type(fields[name])
    if kind is bool:
        if value.lower() not in ("true", "false"):
            raise Usage(f"--set {text}: must be true or false")
        return name, value.lower() == "true"
    return name, value if kind is str else _number(kind, name, value)


def _number(kind: type, name: str, value: str) -> Any:
    try:
        return kind(value)
    except ValueError:
        raise Usage(f"--set {name}={value}: '{value}' is not a number") from None
