"""`stepcore run`."""

from __future__ import annotations

import argparse
import json
from typing import Any

from stepcore._core import SimulationError
from stepcore.checks import nearest
from stepcore.cli.options import Usage, add_file, check_path
from stepcore.report.table import jsonable

# No counter of steps goes further.
MOST_STEPS = 2.0**64


def add(commands: Any) -> None:
    run = commands.add_parser("run", help="simulate a model and print where it ends")
    add_file(run)
    run.add_argument("--duration", type=float, help="simulated time [s] (default: 1)")
    run.add_argument("--dt", type=float, help="time step [s]")
    run.add_argument(
        "--set", action="append", default=[], metavar="NAME=VALUE", help="any field of Settings"
    )
    run.add_argument("--replay", metavar="OUT", help="where a failure is written, to be replayed")
    run.add_argument("--json", action="store_true", help="print data instead of text")
    run.set_defaults(call=call)


def call(args: argparse.Namespace) -> None:
    from time import perf_counter

    from stepcore.engine.sim import Sim
    from stepcore.reading import load

    if args.replay is not None:
        check_path(args.replay, "--replay")
    changes = dict(_setting(text) for text in args.set)
    if args.dt is not None:
        changes["dt"] = args.dt
    duration = 1.0 if args.duration is None else args.duration
    if not 0 <= duration < float("inf"):
        raise Usage(f"--duration {duration:g}: must be finite and >= 0 s")
    # A failure that is told in full costs a run a few percent.
    sim = Sim(load(args.file).compile(), **({"ledger": True} | changes))
    first = 0 if sim.model.keys else None
    sim.reset(key=first if args.key is None else args.key)
    dt = sim.settings.dt
    steps = _steps(duration, dt)
    notes = list(sim.model.scene.notes)
    if args.duration is not None and abs(steps * dt - duration) > 1e-6 * dt:
        notes.append(
            f"--duration {duration:g} s is no whole number of steps of {dt:g} s: "
            f"{steps * dt:g} s are run"
        )
    begin = perf_counter()
    try:
        sim.step(steps)
        sim.balance()
    except SimulationError as error:
        raise RuntimeError(f"{error}; stepcore replay {_written(error, args.replay)}") from None
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


def _steps(duration: float, dt: float) -> int:
    """Steps in a duration."""
    if not duration / dt < MOST_STEPS:
        limit = f"below {MOST_STEPS * dt:g} s at dt = {dt:g} s"
        raise Usage(f"--duration {duration:g} s: must be {limit} (2^64 steps)")
    return round(duration / dt)


def _written(error: SimulationError, path: str | None) -> str:
    """Writes the failure where it was asked for, or under a name of its own here."""
    if path is None:
        name = "".join(c if c.isalnum() or c in "-_." else "-" for c in error.replay.name)
        path = f"{name or 'run'}-step{error.step}.replay.json"
    error.replay.save(path)
    return path


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
    if (name, value) == ("sweeps", "auto"):
        return name, value
    kind = type(fields[name])
    if kind is bool:
        if value.lower() not in ("true", "false"):
            raise Usage(f"--set {text}: must be true or false")
        return name, value.lower() == "true"
    try:
        return name, kind(value)
    except ValueError:
        raise Usage(f"--set {text}: '{value}' is not a number") from None
