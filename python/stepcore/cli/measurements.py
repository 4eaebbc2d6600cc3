"""The measuring commands, each of which calls the function of the same name."""

from __future__ import annotations

import argparse
import importlib
import inspect
import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any

from stepcore.cli.arguments import (
    OPTIONS,
    add_file,
    add_key,
    add_motion,
    add_seconds,
    key_of,
    length,
    model_of,
    motion_of,
    time,
)
from stepcore.cli.output import add_output
from stepcore.cli.terminal import Usage
from stepcore.deadline import SECONDS
from stepcore.engine.model import Model
from stepcore.engine.sim import Sim
from stepcore.experiment import schedule
from stepcore.report.result import Result

LIST = "numbers a,b,c or FIRST:LAST:COUNT on a log scale"
# Returns further arguments of the measuring function, from the command line and the model.
More = Callable[[argparse.Namespace, Model], Mapping[str, Any]]


@dataclass(frozen=True)
class Measurement:
    """A command that calls the measuring function of the same name.

    module: the module of the function. text: the help. options: the options by function argument;
    "flags" gives the option's name where it differs from the argument. excluding: mutually
    exclusive options. full: the description of --all in the help. warn: whether to warn of
    stiffness, as `stepcore.load` does; False if the result reports stiffness in detail. model: the
    settings of the argument FILE. motion: defaults shown in the help; None for a command without a
    motion. key: whether such a command has a keyframe. source: whether the function may read the
    file itself. more: further arguments of the function. done: what follows a call.
    """

    module: str
    text: str
    options: Mapping[str, Mapping[str, Any]]
    excluding: tuple[str, ...] = ()
    full: str = "print every row of the tables"
    warn: bool = True
    model: Mapping[str, Any] | None = None
    motion: Mapping[str, Any] | None = None
    key: bool = True
    source: bool = False
    more: More = lambda args, model: {}
    done: Callable[[Any, argparse.Namespace], None] = lambda result, args: None


def _function(name: str) -> Callable[..., Any]:
    """Return the function that a command calls."""
    module = importlib.import_module(MEASUREMENTS[name].module)
    function: Callable[..., Any] = getattr(module, name.replace("-", "_"))
    return function


def add(command: argparse.ArgumentParser, name: str) -> None:
    """Add the options of a command, with the defaults of its function."""
    measurement, function = MEASUREMENTS[name], _function(name)
    takes = inspect.signature(function).parameters
    add_file(command, **(measurement.model or {}))
    alternatives = command.add_mutually_exclusive_group() if measurement.excluding else command
    for argument, option in measurement.options.items():
        keywords = dict(option)
        flags = keywords.pop("flags", (f"--{argument}",))
        if argument in takes and "action" not in keywords:
            keywords.setdefault("default", takes[argument].default)
        if flags[0].startswith("-"):
            keywords["dest"] = argument
        to = alternatives if argument in measurement.excluding else command
        to.add_argument(*flags, **keywords)
    if measurement.motion is None:
        if measurement.key:
            add_key(command)
    else:
        module = importlib.import_module(measurement.module)
        shown = {field: getattr(module, field.upper(), None) for field in ("horizon", "starts")}
        shown["horizon"] = shown["horizon"] or schedule.HORIZON
        shown["starts"] = shown["starts"] or schedule.STARTS
        add_motion(command, takes, **(shown | dict(measurement.motion)))
    if name in SECONDS:
        add_seconds(command, SECONDS[name])
    add_output(command, full=measurement.full)


def call(args: argparse.Namespace, name: str) -> Result:
    """Run the measurement of a command."""
    measurement, function = MEASUREMENTS[name], _function(name)
    model = model_of(args, warn=measurement.warn)
    takes = inspect.signature(function).parameters
    given = {option: getattr(args, option) for option in measurement.options if option in takes}
    if measurement.motion is not None:
        given |= motion_of(args, model)
    if name in SECONDS:
        given["seconds"] = args.seconds
    given |= measurement.more(args, model)
    # The measurement can read the file itself, if it is taken as it is.
    whole = measurement.source and not args.without and args.fuse is not False
    result: Result = function(args.file if whole else model, **given)
    measurement.done(result, args)
    return result


def _checked(result: Any, args: argparse.Namespace) -> None:
    """Give the commands recommended by a check the same file and motion."""
    from stepcore.measure.check import file_in_words

    said = {name: getattr(args, name, None) for name in OPTIONS}
    result.file = file_in_words(args.file, args.without, args.fuse is not False)
    result.options = {name: str(value) for name, value in said.items() if value is not None}


def _ablated(result: Any, args: argparse.Namespace) -> None:
    if args.save is not None:
        result.smallest.save(args.save)


def _planned(args: argparse.Namespace, model: Model) -> Mapping[str, Any]:
    if args.key is None:
        return {}
    sim = Sim(model)
    sim.reset(key=key_of(args, model))
    return {"sim": sim}


def _lists(args: argparse.Namespace, model: Model) -> Mapping[str, Any]:
    return {
        "values": None if args.values is None else numbers("--values", args.values),
        "dts": None if args.dts is None else numbers("--dts", args.dts, time),
        "accuracies": (
            None if args.accuracies is None else numbers("--accuracies", args.accuracies, length)
        ),
    }


def numbers(option: str, text: str, read: Callable[[str], float] = float) -> list[float]:
    """Parse a list of numbers on the command line."""
    try:
        if ":" not in text:
            return [read(part) for part in text.split(",")]
        first, last, count = text.split(":")
        low, high, some = read(first), read(last), int(count)
    except (ValueError, argparse.ArgumentTypeError):
        raise Usage(f"{option} {text}: must be {LIST}") from None
    if not (0 < low < high < math.inf and 2 <= some <= 1000):
        limit = "0 < FIRST < LAST and a COUNT of 2 to 1000"
        raise Usage(f"{option} {text}: must have {limit}")
    ratio = (high / low) ** (1 / (some - 1))
    return [low * ratio**k for k in range(some)]


def _ranges(args: argparse.Namespace, model: Model) -> Mapping[str, Any]:
    """Return the logs and the ranges of the parameters of an identification."""
    ranges = {}
    for text in args.parameters:
        path, equals, span = text.rpartition("=")
        low, colon, high = span.partition(":")
        try:
            ranges[path] = float(low), float(high)
        except ValueError:
            equals = ""
        if not (equals and colon and path):
            raise Usage(f"--parameters {text}: must be PATH=LOW:HIGH")
    return {"parameters": ranges, "logs": [_log(text) for text in args.logs]}


def _log(text: str) -> Any:
    """Return a log on the command line: a file, or ARRAY=FILE with commas between several."""
    from stepcore.measure.identification.log import ARRAYS

    parts = [part.partition("=") for part in text.split(",")]
    apart = all(name in ARRAYS and file for name, _, file in parts)
    return {name: file for name, _, file in parts} if apart else text


def _identified(result: Any, args: argparse.Namespace) -> None:
    if args.save is not None:
        result.model.scene.save(args.save)


MEASUREMENTS = {
    "check": Measurement(
        "stepcore.measure.check",
        """\
Look for what makes a model misbehave, in seconds: overlaps, masses that no real thing
has, units that look like mm or degrees, states outside of limits, servos that are too weak, too
stiff or saturated, contacts that creep or sink in; then the element that limits the time step. Each
finding names its cure. The first command to run on a scene that misbehaves.

Example:
  stepcore check gymnasium:half_cheetah
""",
        {
            "depth": {
                "metavar": "LENGTH",
                "help": "name the solref with which contacts rest at this depth: metres, or "
                '"0.1mm"',
            }
        },
        warn=False,
        motion={},
        source=True,
        done=_checked,
    ),
    "trade": Measurement(
        "stepcore.measure.trade",
        """\
Run a model under many settings and compare each with a converged run: what speed costs in
accuracy. Given an error or a budget, recommend settings and confirm them on further starts.

Example:
  stepcore trade gymnasium:half_cheetah --error 1mm --plot trade.png
""",
        {
            "error": {
                "metavar": "LENGTH",
                "help": 'recommend the cheapest settings within this error: metres, "1mm" or '
                '"0.1%%" of the scene\'s size',
            },
            "budget": {
                "metavar": "COST",
                "help": 'recommend the most accurate settings within this cost: "20us/step", '
                '"5ms/s", or "100x" real time',
            },
            "further": {
                "type": int,
                "metavar": "N",
                "help": "number of further starts that must confirm a recommendation (default: "
                "%(default)s)",
            },
            "by": {
                "choices": ("time", "flops"),
                "help": "cost metric: wall time or floating-point operations (default: "
                "%(default)s)",
            },
            "grid": {
                "action": "store_true",
                "help": "try a full grid of settings instead of a search",
            },
            "effort": {
                "type": float,
                "metavar": "STEPS",
                "help": "the most that the converged motion may cost, in steps × (dofs + 2); a "
                "larger one knows errors better and judges shorter time steps (default: "
                "%(default)g)",
            },
            "mujoco": {"action": "store_true", "help": "run MuJoCo on the same motion too"},
        },
        excluding=("error", "budget"),
        full="print every setting",
        motion={},
        more=lambda args, model: {"search": "grid" if args.grid else None},
    ),
    "predict": Measurement(
        "stepcore.measure.predictability",
        """\
Measure how long a model's motion can be predicted: until runs that start a rounding error
apart are a thousand times as far apart. Beyond that time only statistics of the motion mean
anything, whatever the settings.

Example:
  stepcore predict gymnasium:ant --horizon 5 --plot growth.png
""",
        {},
        motion={},
    ),
    "diagnose": Measurement(
        "stepcore.measure.diagnosis",
        """\
Find the element that limits the time step under each integrator: a spring, damper, servo,
contact, limit or connect, with its frequency and damping. For a time step that is not stable,
list changes of the model or the settings that make it so.

Example:
  stepcore diagnose gymnasium:half_cheetah --dt 0.01
""",
        {
            "dt": {
                "type": time,
                "metavar": "S",
                "help": "time step that is wanted [s] (default: the model's)",
            }
        },
        full="print every element on its own, under every integrator",
        warn=False,
        motion={},
    ),
    "stability-map": Measurement(
        "stepcore.measure.stability",
        """\
Map the stability and accuracy of a model over the time step and one of its values (a
stiffness, a mass, a gain). There is one map for each integrator, with the stability limit from
theory.

Example:
  stepcore stability-map lesson:spring joint/spring/stiffness --values 10:1e4:16 --plot map.png
""",
        {
            "path": {
                "flags": ("path",),
                "metavar": "VALUE",
                "nargs": "?",
                "help": 'value to vary, such as "joint/knee/stiffness"',
            },
            "values": {"metavar": "LIST", "help": f"values to try: {LIST}"},
            "dts": {"metavar": "LIST", "help": f"time steps to try [s]: {LIST}"},
            "accuracies": {
                "metavar": "LIST",
                "help": f"accuracies that steps are to keep over the horizon [m]: {LIST}; the map "
                "shows the error delivered over the one asked for",
            },
            "integrators": {
                "flags": ("--integrator",),
                "action": "append",
                "metavar": "NAME",
                "help": "integrator to map; may be given several times",
            },
            "deviation": {
                "flags": ("--deviation", "--error"),
                "metavar": "E",
                "help": "deviation from the true motion above which a run is inaccurate: metres, "
                "1mm, or a percentage of the scene's size (default: 10%%)",
            },
            "size": {
                "type": length,
                "metavar": "M",
                "help": "length that deviations are relative to [m] (default: the scene's size)",
            },
        },
        model={
            "nargs": "?",
            "default": "lesson:spring",
            "words": " (default: lesson:spring; also lesson:stack)",
        },
        motion={"horizon": "1, or 25 times the largest time step if that is longer"},
        source=True,
        more=_lists,
    ),
    "converge": Measurement(
        "stepcore.measure.convergence",
        """\
Test whether the solver's sweeps converge the contact forces of a model. The report says
which contacts are furthest from converged, how fast the sweeps converge, and whether more sweeps or
smaller time steps reduce the error more for the same work.

Example:
  stepcore converge lesson:stack --plot residual.png
""",
        {
            "states": {
                "type": int,
                "metavar": "N",
                "help": "number of states at which sweeps are measured (default: %(default)s)",
            }
        },
        full="print every row, all runs of equal work, the residual by sweeps",
        motion={},
    ),
    "identify": Measurement(
        "stepcore.measure.identification",
        """\
Find values of a model in logs of its motion: masses, friction, damping, gains, the delay
of the controls. The answer has intervals, says which values the logs cannot tell apart, and how
much of the residual the time step makes.

Example:
  stepcore identify arm.xml log.csv --parameters joint/hinge/damping=0.01:2
""",
        {
            "logs": {
                "flags": ("logs",),
                "nargs": "+",
                "metavar": "LOG",
                "help": "a file (.csv, .npz, .parquet, .mcap) with times, and columns by joint, "
                "actuator or sensor; or of several sources "
                "qpos=log.mcap:/joint_states,ctrl=log.mcap:/commands",
            },
            "parameters": {
                "nargs": "+",
                "required": True,
                "default": None,
                "metavar": "PATH=LOW:HIGH",
                "help": "a value to find and its range, such as joint/knee/damping=0.01:2, or "
                "delay=0:0.05 [s] of the controls",
            },
            "most": {
                "type": int,
                "metavar": "N",
                "help": "largest number of iterations (default: %(default)s)",
            },
            "save": {"metavar": "OUT.xml", "help": "write the model with the values found as MJCF"},
        },
        key=False,
        more=_ranges,
        done=_identified,
    ),
    "tune": Measurement(
        "stepcore.measure.tune",
        """\
Find kp and kv of position servos for a wanted bandwidth, settling time or sag; or solref and
solimp of contacts for a wanted stiffness, depth, settling time or force noise. Every proposal is
run before it is printed, with the value that the run shows, as MJCF attributes to paste.

Example:
  stepcore tune arm.xml --bandwidth 5
""",
        {
            "bandwidth": {"type": float, "metavar": "HZ", "help": "of servos, -3 dB [Hz]"},
            "settling": {
                "type": time,
                "metavar": "S",
                "help": "time in which a step of the target (or of a contact's load) settles "
                "within 2 %% [s]",
            },
            "sag": {
                "type": float,
                "metavar": "X",
                "help": "of servos, distance from the target under the load of the pose [rad or m]",
            },
            "stiffness": {
                "type": float,
                "metavar": "N/M",
                "help": "of the contacts of a geom together [N/m]",
            },
            "depth": {"metavar": "LENGTH", "help": 'of contacts at rest: metres, or "0.1mm"'},
            "noise": {"type": float, "metavar": "N", "help": "of contact forces at rest, RMS [N]"},
            "servo": {
                "action": "append",
                "metavar": "NAME",
                "help": "a position servo; may be given several times (default: all)",
            },
            "geom": {
                "action": "append",
                "metavar": "NAME",
                "help": "a geom; may be given several times (default: those at rest after 2 s)",
            },
            "dt": {
                "type": time,
                "metavar": "S",
                "help": "time step that is wanted [s] (default: the model's)",
            },
        },
        excluding=("bandwidth", "settling", "sag", "stiffness", "depth", "noise"),
        warn=False,
        more=lambda args, model: {"key": key_of(args, model)},
    ),
    "plan": Measurement(
        "stepcore.measure.plan",
        """\
List what a step of a model computes and how many operations each entry costs, and what the
step leaves out and why.

Example:
  stepcore plan gymnasium:half_cheetah --time
""",
        {"time": {"action": "store_true", "help": "also measure times [µs]"}},
        full="print every entry, the names of all its elements",
        more=_planned,
    ),
    "ablate": Measurement(
        "stepcore.measure.ablation",
        """\
Remove each modelled feature in turn (friction, damping, limits, a geom, ...) and measure
how much work that saves and how much error it adds; then find the smallest model within an error.

Example:
  stepcore ablate gymnasium:half_cheetah --error 5mm --save small.xml
""",
        {
            "added": {
                "flags": ("--added", "--error"),
                "default": "1mm",
                "metavar": "LENGTH",
                "help": 'error that the smallest model may add: metres, "1mm" or "0.1%%" of the '
                "scene's size (default: %(default)s)",
            },
            "save": {"metavar": "OUT.xml", "help": "write the smallest model as MJCF"},
        },
        full="print every feature",
        motion={},
        done=_ablated,
    ),
}

TEXTS = {name: measurement.text for name, measurement in MEASUREMENTS.items()}
