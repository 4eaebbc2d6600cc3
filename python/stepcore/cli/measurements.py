"""The measuring commands: each calls the function of its name, whose docstring is its help."""

from __future__ import annotations

import argparse
import importlib
import inspect
import math
import sys
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any

from stepcore.cli.arguments import (
    LIST,
    OPTIONS,
    WORDS,
    add_file,
    add_motion,
    add_options,
    control_function,
    documented,
    frequency,
    function_of,
    is_whole,
    key_of,
    model_of,
    motion_of,
    setting,
    time,
)
from stepcore.cli.gate import add_gate, finish
from stepcore.cli.output import add_output
from stepcore.cli.terminal import UNDECIDED, Usage
from stepcore.deadline import SECONDS
from stepcore.engine.model import Model
from stepcore.engine.sim import Sim
from stepcore.experiment import schedule
from stepcore.experiment.policy import ENDINGS as ENDINGS_OF_POLICIES
from stepcore.experiment.quantity import Quantity
from stepcore.loading import load
from stepcore.report.result import Result

# Returns further arguments of the measuring function, from the command line and the model.
More = Callable[[argparse.Namespace, Model], Mapping[str, Any]]


@dataclass(frozen=True)
class Measurement:
    """A command that calls the measuring function of the same name.

    module: of the function. example: the arguments of an example. options: see `add_options`.
    excluding: mutually exclusive options. full: the description of --all in the help. warn: whether
    to warn of stiffness, as `stepcore.load` does; False if the result reports stiffness in detail.
    horizon: the default horizon in words, if it is no constant. more: further arguments of the
    function. done: an action after a call. status: the exit status of a result without a test.
    """

    module: str
    example: str
    options: Mapping[str, Any]
    excluding: tuple[str, ...] = ()
    full: str = "print every row of the tables"
    warn: bool = True
    horizon: str = ""
    more: More = lambda args, model: {}
    done: Callable[[Any, argparse.Namespace], object] = lambda result, args: None
    status: Callable[[Any], int] = lambda result: 0


def _function(name: str) -> Callable[..., Any]:
    module = importlib.import_module(f"stepcore.measure.{MEASUREMENTS[name].module}")
    function: Callable[..., Any] = getattr(module, name.replace("-", "_"))
    return function


def text(name: str) -> str:
    """Return the description of a command and its example."""
    said, _ = documented(_function(name))
    return f"{said}\n\nExample:\n  stepcore {name} {MEASUREMENTS[name].example}"


def add(command: argparse.ArgumentParser, name: str) -> None:
    """Add the options of a command, with the words and defaults of its function."""
    measurement, function = MEASUREMENTS[name], _function(name)
    takes = inspect.signature(function).parameters
    add_file(command, optional="task" in measurement.options)
    add_options(command, measurement.options, function, measurement.excluding)
    if "key" in takes:
        module = sys.modules[function.__module__]
        usual = {
            name: getattr(module, name.upper(), None) or getattr(schedule, name.upper())
            for name in ("horizon", "starts")
        }
        usual["horizon"] = measurement.horizon or usual["horizon"]
        motion = command.add_argument_group("motion")
        add_motion(motion, takes, **usual)
        motion.add_argument(
            "--threads",
            type=int,
            metavar="N",
            help="number of runs at the same time (default: one per core)",
        )
    if name in SECONDS:
        command.add_argument(
            "--seconds",
            type=time,
            default=SECONDS[name],
            metavar="N",
            help="longest time of the measurement [s], or inf; the answer then says what was not "
            "done, as it does after Ctrl-C (default: %(default)g)",
        )
    add_output(command, full=measurement.full)
    add_gate(command, name)
    command.set_defaults(
        status=lambda result, args: finish(result, args) or measurement.status(result)
    )


def call(args: argparse.Namespace, name: str) -> Result:
    """Run the measurement of a command."""
    measurement, function = MEASUREMENTS[name], _function(name)
    if args.file is None and args.task is None:
        raise Usage(f"{name} needs FILE, or --task NAME")
    model: Any = None
    quantity = _return(args) if getattr(args, "task", None) else None
    try:
        model = quantity.model if quantity else model_of(args, warn=measurement.warn)
    except ValueError:
        # MuJoCo may run a file that stepcore cannot load.
        if getattr(args, "engine", "stepcore") == "stepcore" or not is_whole(args):
            raise
    takes = inspect.signature(function).parameters
    given = {option: getattr(args, option) for option in measurement.options if option in takes}
    if quantity is not None:
        given |= {"quantity": quantity, "starts": args.starts, "threads": args.threads}
    elif "key" in takes:
        given |= motion_of(args, model)
    if name in SECONDS:
        given["seconds"] = args.seconds
    if getattr(args, "max_error", None) is not None and given["budget"] is None:
        given["error"] = given["error"] or [args.max_error]
    for option in ("quantity", "error"):
        values = given.get(option)
        if isinstance(values, list) and len(values) == 1:
            given[option] = values[0]
    texts = given.get("quantity") if quantity is None else None
    if texts is not None:
        several = isinstance(texts, list)
        given["quantity"] = [_quantity(text) for text in texts] if several else _quantity(texts)
    given |= measurement.more(args, model)
    # MuJoCo reads the file itself, if no option of loading changes it.
    source = getattr(args, "engine", "") == "mujoco"
    whole = model is None or (source and is_whole(args))
    result: Result = function(args.file if whole else model, **given)
    measurement.done(result, args)
    return result


def _name_the_file(result: Any, args: argparse.Namespace) -> None:
    """Give the commands recommended by a check the same file and motion."""
    from stepcore.measure.check import file_in_words

    said = {name: getattr(args, name, None) for name in OPTIONS}
    flags = {"--no-fuse": args.fuse is False, "--free": args.free, "--ground": args.ground}
    result.file = file_in_words(args.file, args.without, [k for k, on in flags.items() if on])
    result.options = {name: str(value) for name, value in said.items() if value is not None}


def _save_smallest(result: Any, args: argparse.Namespace) -> None:
    if args.save is not None:
        if result.smallest is None:
            raise Usage(f"--save {args.save}: give MuJoCo the file with {result.in_file}")
        result.smallest.save(args.save)


def _other_model(args: argparse.Namespace, model: Model) -> Mapping[str, Any]:
    """Return the second model, loaded like the first, with its settings and engine."""
    other: Any = None
    if args.other is not None:
        other = load(args.other, without=args.without, fuse=args.fuse).compile()
    elif args.other_engine == "mujoco" and is_whole(args):
        other = args.file
    return {"other": other, "settings": dict(map(setting, args.set))}


def _sim_at_key(args: argparse.Namespace, model: Model) -> Mapping[str, Any]:
    if args.key is None:
        return {}
    sim = Sim(model)
    sim.reset(key=key_of(args, model))
    return {"sim": sim}


def _lists(args: argparse.Namespace, model: Model) -> Mapping[str, Any]:
    """Return the lists of values and time steps of a map."""
    read: dict[str, Callable[[str], float]] = {"values": float, "dts": time}
    given = {name: getattr(args, name) for name in read}
    return {
        name: words and numbers(f"--{name}", words, read[name]) for name, words in given.items()
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


def _logs_and_ranges(args: argparse.Namespace, model: Model) -> Mapping[str, Any]:
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


def _return(args: argparse.Namespace) -> Any:
    """Return the return of --task under the policy of --control."""
    from stepcore.gymnasium import Return

    if args.quantity not in (None, ["return"]):
        raise Usage(f"--quantity {args.quantity[0]}: must be return with --task")
    others = "file", "key", "ctrl", "control_dt", "kind", "follow"
    if name := next((name for name in others if getattr(args, name) is not None), None):
        shown = "FILE" if name == "file" else f"--{name.replace('_', '-')}"
        raise Usage(f"{shown} {getattr(args, name)}: must not be given with --task")
    if args.control is None:
        raise Usage(
            f"--task {args.task}: needs --control policy.onnx, or --control FILE.py:FUNCTION, a "
            "function of the observations of many worlds that returns their actions"
        )
    is_file = args.control.endswith(ENDINGS_OF_POLICIES)
    policy = control_function(args.control) if is_file else function_of("control", args.control)
    seed = 0 if args.seed is None else args.seed
    return Return(args.task, policy, horizon=args.horizon, seed=seed)


def _quantity(text: str) -> Any:
    """Return a quantity: its name; or a function in a file or module, or an entry of its dict."""
    module, _, name = text.rpartition(":")
    if not (module and name.isidentifier()):
        return text
    file, _, function = module.rpartition(":")
    if file and function.isidentifier():
        return Quantity(f"{function}:{name}", function_of("quantity", module), name)
    return function_of("quantity", text)


ENGINE = ("stepcore", "mujoco")
NAMES = {"action": "append", "metavar": "NAME"}
QUANTITY = (
    "the quantity whose error is measured, such as site/tip, joint/knee or max(contact/foot); or "
    "FILE.py:FUNCTION, a function of the runs (default: the motion of all bodies)"
)

MEASUREMENTS = {
    "check": Measurement(
        "check",
        "gymnasium:half_cheetah",
        {"depth": "LENGTH"},
        warn=False,
        done=_name_the_file,
    ),
    "trade": Measurement(
        "trade",
        "gymnasium:half_cheetah --error 1mm --plot trade.png",
        {
            **{
                "quantity": {**NAMES, "help": QUANTITY},
                "error": {"action": "append", "metavar": "AMOUNT"},
                "statistic": ("worst", "mean"),
                "task": {
                    "metavar": "NAME",
                    "help": "instead of FILE: a task of gymnasium, such as stepcore/Ant-v0, whose "
                    "return under the policy of --control is measured (a file, or a function of "
                    "the observations), from the task's resets",
                },
                "budget": "COST",
                "further": "N",
                "most": "N",
                "by": ("time", "flops"),
            },
            "grid": {
                "action": "store_true",
                "help": "try a full grid of settings instead of a search",
            },
            **{"effort": "OPERATIONS", "engine": ENGINE, "mujoco": {}},
        },
        excluding=("error", "budget"),
        full="print every setting",
        more=lambda args, model: {"search": "grid" if args.grid else None},
    ),
    "predict": Measurement(
        "predictability",
        "gymnasium:ant --horizon 5 --plot growth.png",
        {"quantity": {"metavar": "NAME", "help": QUANTITY}, "engine": ENGINE},
    ),
    "diagnose": Measurement(
        "diagnosis",
        "gymnasium:half_cheetah --dt 0.01",
        {"dt": "S", "integrators": {"flags": ("--integrator",), **NAMES}, "engine": ENGINE},
        full="print every element on its own",
        warn=False,
    ),
    "stability-map": Measurement(
        "stability",
        "lesson:spring joint/spring/stiffness --values 10:1e4:16 --plot map.png",
        {
            "path": {"flags": ("path",), "metavar": "PATH"},
            "values": "LIST",
            "dts": "LIST",
            "integrators": {"flags": ("--integrator",), **NAMES},
            "deviation": "E",
            "quantity": {"metavar": "NAME", "help": QUANTITY},
            "engine": ENGINE,
        },
        horizon="1, or 25 times the largest time step if that is longer",
        more=_lists,
    ),
    "converge": Measurement(
        "convergence",
        "lesson:stack --plot convergence.png",
        {"quantity": {"metavar": "NAME", "help": QUANTITY}, "engine": ENGINE},
    ),
    "identify": Measurement(
        "identification",
        "arm.xml log.csv --parameters joint/hinge/damping=0.01:2",
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
                "metavar": "PATH=LOW:HIGH",
                "help": "a value to find and its range, such as joint/knee/damping=0.01:2, or "
                "delay=0:0.05 [s] of the controls",
            },
            **{"pieces": "TIME", "interpolation": ("held", "linear"), "most": "N"},
            "threads": {"type": int, "metavar": "N"},
            "save": {"metavar": "OUT.xml", "help": "write the model with the values found as MJCF"},
        },
        more=_logs_and_ranges,
        done=lambda result, args: args.save and result.model.scene.save(args.save),
    ),
    "tune": Measurement(
        "tune",
        "arm.xml --bandwidth 5",
        {
            "bandwidth": {"type": frequency, "metavar": "HZ"},
            **{"settling": "S", "sag": "X", "depth": "LENGTH"},
            **{"servo": NAMES, "geom": NAMES, "dt": "S"},
        },
        excluding=("bandwidth", "settling", "sag", "depth"),
        warn=False,
    ),
    "plan": Measurement(
        "plan",
        "gymnasium:half_cheetah --time",
        {"time": {}, "key": {"help": f"{WORDS['key']} (default: the first)"}},
        full="print every entry, the names of all its elements",
        more=_sim_at_key,
    ),
    "compare": Measurement(
        "comparison",
        "robot.xml other.urdf --plot compare.png",
        {
            "other": {
                "flags": ("other",),
                "nargs": "?",
                "metavar": "OTHER",
                "help": "the second model: path, package:name or lesson:name; by default the first "
                "one, in another engine or with other settings",
            },
            "within": "LENGTH",
            "other_engine": ENGINE,
            "set": {
                "action": "append",
                "default": [],
                "metavar": "NAME=VALUE",
                "help": "a setting of the second model, such as dt=5ms",
            },
        },
        full="print every difference",
        more=_other_model,
        status=lambda result: UNDECIDED if result.unmapped else 0,
    ),
    "ablate": Measurement(
        "ablation",
        "gymnasium:half_cheetah --added 5mm --save small.xml",
        {
            "quantity": {"metavar": "NAME", "help": QUANTITY},
            "added": "AMOUNT",
            "further": "N",
            "engine": ENGINE,
            "save": {"metavar": "OUT.xml", "help": "write the smallest model as MJCF"},
        },
        full="print every feature",
        done=_save_smallest,
    ),
}
