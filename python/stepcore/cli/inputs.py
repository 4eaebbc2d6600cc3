"""What drives the run of `stepcore run`: --ctrl, --control, --control-dt and --push."""

from __future__ import annotations

import argparse
import math

import numpy as np

from stepcore.checks import nearest
from stepcore.cli.motion import control_function, controls_of
from stepcore.cli.usage import Usage
from stepcore.engine.control import Control, control_name
from stepcore.engine.model import Model
from stepcore.engine.sim import Sim
from stepcore.engine.trajectory import whole_steps
from stepcore.experiment.motion_words import (
    actuators_in_words,
    held_in_words,
    scene_in_words,
    start_in_words,
)
from stepcore.experiment.schedule import smooth, undriven
from stepcore.experiment.single_run import Push
from stepcore.report.units import counted, seconds

# How long a push lasts where nobody says it [s].
PUSH = 0.1
# What --ctrl calls the controls of measurements.
SINES = "sines"
PUSH_FORM = "BODY:FX,FY,FZ@T or BODY:FX,FY,FZ@T+DURATION, in N and s"


def add_inputs(command: argparse.ArgumentParser) -> None:
    """The options that drive a run."""
    inputs = command.add_argument_group("inputs")
    inputs.add_argument(
        "--ctrl",
        metavar="VALUES",
        help='constant controls, "1,0,-1" or "hip=1,knee=-1"; a file (.npy or .csv) with one row '
        'for each control period; or "sines", the seeded sines that measurements run',
    )
    inputs.add_argument(
        "--control",
        metavar="FILE.py:FUNCTION",
        help="a function (time, sim) -> controls, in a file or a module",
    )
    inputs.add_argument(
        "--control-dt", type=float, metavar="S", help="control period [s] (default: every step)"
    )
    inputs.add_argument(
        "--push",
        action="append",
        default=[],
        metavar="BODY:F@T",
        help=f"a force on a body's centre of mass, {PUSH_FORM} (default: {PUSH:g} s), T counted "
        "from the beginning of the run; may be given several times",
    )


def control_of(args: argparse.Namespace, sim: Sim) -> Control | None:
    """Sets constant controls of a Sim, or returns the function that gives them."""
    model = sim.model
    if args.ctrl is not None and args.control is not None:
        raise Usage("--ctrl and --control are both given: a run has one of them")
    if args.control_dt is not None:
        whole_steps("--control-dt", args.control_dt, sim.settings.dt, least=1)
    if args.control is not None:
        return control_function(args.control)
    if args.ctrl is None:
        return None
    if args.ctrl == SINES:
        return _sines(args, sim)
    if args.ctrl.endswith((".npy", ".csv")):
        return _table(args.ctrl, args.control_dt, sim)
    for index, value in _values(args.ctrl, model).items():
        sim.ctrl[index] = value
    return None


def in_words(
    args: argparse.Namespace, sim: Sim, control: Control | None, key: str | int | None, time: float
) -> str:
    """What is run, in words, before it is run; key: the start, time: how long [s]."""
    model, period = sim.model, seconds(args.control_dt or sim.settings.dt)
    drive = held_in_words(model, sim.ctrl)
    if args.ctrl == SINES and model.nu:
        drive = f"{actuators_in_words(model)} follow seeded sines within 0.4 of their range"
        still = undriven(model, np.array(sim.ctrl))
        drive += f"; {', '.join(still)} without a range held at zero" if still else ""
    elif control is not None and model.nu:
        by = control_name(control) if args.control is not None else args.ctrl
        drive = f"{actuators_in_words(model)} driven by {by}, sampled every {period}"
    elif args.ctrl is not None and model.nu:
        drive = f"{actuators_in_words(model)} hold --ctrl {args.ctrl}"
    pushes = "".join(f"; push {text}" for text in args.push)
    begin = start_in_words(model, key)
    return f"{seconds(time)} from {begin}; {drive}{pushes}; {scene_in_words(model)}"


def _sines(args: argparse.Namespace, sim: Sim) -> Control:
    """What drives the actuators of a measurement: a few sines in the range of each, with seed 0."""
    period = args.control_dt or sim.settings.dt
    duration = 1.0 if args.duration is None else args.duration
    periods = math.ceil(duration / period) + 1
    held = np.array(sim.ctrl)
    return _held_rows(
        smooth(sim.model, held, periods, period, np.random.default_rng(0)), period, sim
    )


def _table(path: str, control_dt: float | None, sim: Sim) -> Control:
    """The rows of a file, one for each control period; the last is held."""
    rows = controls_of(path)
    if rows.ndim != 2 or rows.shape[1] != sim.model.nu:
        raise Usage(f"--ctrl {path}: has shape {rows.shape}; must be (n, {sim.model.nu})")
    if not np.isfinite(rows).all():
        raise Usage(f"--ctrl {path}: its numbers must be finite")
    return _held_rows(rows, control_dt or sim.settings.dt, sim)


def _held_rows(rows: np.ndarray, period: float, sim: Sim) -> Control:
    """A row each period [s], from now on; the last is held."""
    begin = sim.time

    def control(time: float, sim: Sim) -> np.ndarray:
        row: np.ndarray = rows[min(round((time - begin) / period), len(rows) - 1)]
        return row

    return control


def _values(text: str, model: Model) -> dict[int, float]:
    """Controls by the index of their actuator."""
    if not model.nu:
        raise Usage(f"--ctrl {text}: this model has no actuators")
    parts = [part.strip() for part in text.split(",")]
    every = counted(model.nu, "number")
    if not any("=" in part for part in parts):
        if len(parts) != model.nu:
            limit = f"must be {every}, one for each actuator; NAME=VALUE pairs; "
            raise Usage(f"--ctrl {text}: {limit}a .npy or .csv file; or {SINES!r}")
        return {k: _number("--ctrl", text, part) for k, part in enumerate(parts)}
    values = {}
    for part in parts:
        name, equals, value = (word.strip() for word in part.partition("="))
        if not equals:
            raise Usage(f"--ctrl {text}: '{part}' must be NAME=VALUE, as the others are")
        if not any(model.actuator_names):
            raise Usage(f"--ctrl {text}: no actuator of this model has a name: give {every}")
        if not name or name not in model.actuator_names:
            near = nearest(name, model.actuator_names)
            raise Usage(f"--ctrl {text}: no actuator is named '{name}'{near}")
        values[model.actuator_names.index(name)] = _number("--ctrl", text, value)
    return values


def pushes_of(args: argparse.Namespace, model: Model) -> list[Push]:
    """The pushes of --push."""
    return [_push(text, model) for text in args.push]


def _push(text: str, model: Model) -> Push:
    body, colon, rest = text.rpartition(":")
    force, at, when = rest.partition("@")
    parts = force.split(",")
    if not colon or not at or len(parts) != 3:
        raise Usage(f"--push {text}: must be {PUSH_FORM}")
    if not body or body not in model.body_names[1:]:
        near = nearest(body, model.body_names[1:])
        raise Usage(f"--push {text}: no body is named '{body}'{near}")
    # A sign may stand in an exponent: "1e+0".
    start, plus, duration = when.partition("+") if "e+" not in when else (when, "", "")
    x, y, z = (_number("--push", text, part) for part in parts)
    times = [_number("--push", text, start), _number("--push", text, duration) if plus else PUSH]
    if min(times) < 0:
        raise Usage(f"--push {text}: its times must be >= 0 s")
    return Push(model.body_names.index(body), (x, y, z), *times)


def _number(option: str, text: str, part: str) -> float:
    try:
        value = float(part)
    except ValueError:
        value = math.nan
    if not math.isfinite(value):
        raise Usage(f"{option} {text}: '{part}' must be a finite number")
    return value
