"""Arguments common to several commands: the model, the motion and its controls."""

from __future__ import annotations

import argparse
import importlib
import importlib.util
import inspect
import math
import os
import re
import sys
import traceback
from collections.abc import Callable, Collection
from pathlib import Path
from types import ModuleType
from typing import Any

from stepcore._core import SimulationError
from stepcore.checks import nearest, one_line
from stepcore.cli.terminal import Usage
from stepcore.engine.model import Model
from stepcore.experiment.control_table import PositionTable, control_table
from stepcore.experiment.default_motion import KINDS
from stepcore.experiment.motion import INTERPOLATIONS
from stepcore.experiment.policy import ENDINGS as ENDINGS_OF_POLICIES
from stepcore.experiment.policy import Policy
from stepcore.experiment.user_table import ENDINGS, is_file
from stepcore.loading import find_scene, load
from stepcore.report.units import counted, length_of, time_of


def time(text: str) -> float:
    """Parse a time on the command line [s]."""
    value = time_of(text)
    if value is None:
        raise argparse.ArgumentTypeError(f"'{text}' must be a time: seconds, 1ms or 20us")
    return value


def limit(text: str) -> float:
    """Parse a time limit on the command line [s]."""
    return math.inf if text == "inf" else time(text)


def length(text: str) -> float:
    """Parse a length on the command line [m]."""
    value = length_of(text)
    if value is None:
        raise argparse.ArgumentTypeError(f"'{text}' must be a length: metres, 1mm or 2cm")
    return value


CTRL = (
    'constant controls, "1,0,-1" or "hip=1,knee=-1"; or a file (.csv, .npz, .npy, .parquet, .mcap) '
    "with a row for each control period, or with a column for each actuator or joint by name and "
    "one of times; of an MCAP log with several topics, log.mcap:/TOPIC or log.mcap:/TOPIC.FIELD"
)
# Options, by the field of `Motion` that the option sets.
OPTIONS: dict[str, dict[str, Any]] = {
    "horizon": {"type": time, "metavar": "S", "help": "simulated time [s]"},
    "starts": {
        "type": int,
        "metavar": "N",
        "help": "number of initial states: the keyframe and random ones near it",
    },
    "seed": {
        "type": int,
        "metavar": "N",
        "help": "random seed of the starts and of the default controls (default: 0)",
    },
    "key": {"help": "keyframe to start from, by name or index (default: the first)"},
    "control": {
        "metavar": "FILE.py:FUNCTION",
        "help": "a function (time, sim) -> controls, in a file or a module; or a policy (.onnx, or "
        ".pt of TorchScript) from qpos and qvel to controls",
    },
    "ctrl": {"metavar": "VALUES", "help": CTRL},
    "control_dt": {
        "type": time,
        "metavar": "S",
        "help": "control period [s] (default: the model's time step with --control or --ctrl, else "
        "chosen to fit)",
    },
    "interpolation": {
        "choices": INTERPOLATIONS,
        "help": "between the rows of a log with times (default: held)",
    },
    "kind": {
        "flag": "--motion",
        "choices": KINDS,
        "help": "the motion without --ctrl and --control: move (point to point, within forces and "
        "limits), hold (the start), sines, random or fall (default: chosen from the model)",
    },
    "follow": {
        "metavar": "FILE",
        "help": "recorded positions of joints, by name, which servos and motors follow; a file as "
        "for --ctrl",
    },
}


def add_file(command: argparse.ArgumentParser, **default: Any) -> None:
    """Add the argument FILE, the model of a command, and the options of loading."""
    words = "path, package:name or lesson:name"
    command.add_argument("file", metavar="FILE", help=words + default.pop("words", ""), **default)
    command.add_argument(
        "--without",
        action="append",
        default=[],
        metavar="KIND",
        help="a kind of thing that is left out of the file on purpose, such as flex, plugin, "
        "equality/weld or geom/surfacevel; may be given several times",
    )
    command.add_argument(
        "--no-fuse",
        dest="fuse",
        action="store_const",
        const=False,
        help="bodies that nothing moves against their parent, such as links of a URDF on fixed "
        "joints, stay bodies of their own",
    )


def add_key(command: argparse.ArgumentParser) -> None:
    """Add the option --key, the initial keyframe."""
    command.add_argument("--key", **OPTIONS["key"])


def add_horizon(command: Any, words: str) -> None:
    """Add the option --horizon of a single run; words: the help. --duration means the same."""
    command.add_argument("--horizon", type=time, metavar="S", help=words)
    command.add_argument("--duration", type=time, dest="horizon", help=argparse.SUPPRESS)


def add_seconds(command: argparse.ArgumentParser, default: float) -> None:
    """Add the option --seconds, the time limit of a measurement; default: [s]."""
    command.add_argument(
        "--seconds",
        type=limit,
        default=default,
        metavar="N",
        help="longest time of the measurement [s], or inf; the answer then says what was not done, "
        "as it does after Ctrl-C (default: %(default)g)",
    )


def flag_of(name: str) -> str:
    """Return the option that sets a field of `Motion`."""
    flag: str = OPTIONS[name].get("flag", f"--{name.replace('_', '-')}")
    return flag


def add_option(group: Any, name: str, **changed: Any) -> None:
    """Add the option of a field of `Motion`; changed: replaces what argparse is told of it."""
    option = {key: value for key, value in OPTIONS[name].items() if key != "flag"}
    group.add_argument(flag_of(name), dest=name, **(option | changed))


def add_motion(
    command: argparse.ArgumentParser, fields: Collection[str] = tuple(OPTIONS), **default: Any
) -> None:
    """Add the options of the motion, and the number of threads.

    fields: the fields of `Motion` that the measurement accepts. default: default values of these
        fields, which the help shows.
    """
    motion = command.add_argument_group("motion")
    for name, option in OPTIONS.items():
        if name in fields:
            words = option["help"]
            if default.get(name) is not None:
                words += f" (default: {default[name]})"
            add_option(motion, name, help=words)
    motion.add_argument(
        "--threads",
        type=int,
        metavar="N",
        help="number of runs at the same time (default: one per core)",
    )


def model_of(args: argparse.Namespace, warn: bool = True) -> Model:
    """Return the compiled model of FILE; warn: whether to warn of stiffness, as `stepcore.load`."""
    read = load if warn else find_scene
    return read(args.file, without=args.without, fuse=args.fuse).compile()


def key_of(args: argparse.Namespace, model: Model | None) -> str | int | None:
    """Return the keyframe of --key; a number is an index unless it names a keyframe."""
    key: str | None = args.key
    if key is None or (model is not None and key in model.key_names) or not key.isdecimal():
        return key
    return int(key)


def motion_of(args: argparse.Namespace, model: Model | None) -> dict[str, Any]:
    """Return the given options of `add_motion` as arguments of a measurement."""
    given = {name: getattr(args, name, None) for name in (*OPTIONS, "threads")}
    given["key"] = key_of(args, model)
    drives = [name for name in ("kind", "ctrl", "control", "follow") if given[name] is not None]
    if len(drives) > 1:
        first, second = map(flag_of, drives[:2])
        raise Usage(f"{first} and {second} are both given: a motion has one of them")
    if given["follow"] is not None:
        given["follow"] = _table("follow", given["follow"], PositionTable.of)
    if given["ctrl"] is not None:
        given["ctrl"] = controls_of(given["ctrl"], model)
    if given["control"] is not None:
        given["control"] = control_function(given["control"])
    return {name: value for name, value in given.items() if value is not None}


def controls_of(text: str, model: Model | None) -> Any:
    """Return the controls of --ctrl as an argument of `Motion`.

    model: None for a file that MuJoCo alone can load, where controls are those of a file.
    """
    if text in KINDS and (model is None or text not in model.actuator_names):
        raise Usage(f"--ctrl {text}: write --motion {text}")
    if is_file(text):
        return _table("ctrl", text, control_table)
    if os.path.exists(text):
        raise Usage(f"--ctrl {text}: must end in {', '.join(ENDINGS)}")
    if model is None:
        raise Usage(f"--ctrl {text}: must be a file where stepcore cannot load the scene")
    return _constants(text, model)


def _table(option: str, text: str, read: Callable[[str], Any]) -> Any:
    """Return the table of a file; option: "ctrl" or "follow"."""
    if not os.path.isfile(re.sub(r"(\.mcap):.*", r"\1", text)):
        raise Usage(f"--{option} {text}: no such file")
    try:
        return read(text)
    except (ValueError, OSError, ImportError) as error:
        raise Usage(f"--{option} {text}: {one_line(error)}") from None


def _constants(text: str, model: Model) -> list[list[float]] | dict[str, float]:
    """Return constant controls: a row for all actuators, or a dict by actuator name."""
    if not model.nu:
        raise Usage(f"--ctrl {text}: this model has no actuators")
    parts = [part.strip() for part in text.split(",")]
    every = counted(model.nu, "number")
    if not any("=" in part for part in parts):
        if len(parts) != model.nu or os.path.splitext(text)[1][1:].isalpha():
            limit = f"must be {every}, one for each actuator; NAME=VALUE pairs; "
            raise Usage(f"--ctrl {text}: {limit}or a file that ends in {', '.join(ENDINGS)}")
        return [[_number(text, part) for part in parts]]
    if not any(model.actuator_names):
        raise Usage(f"--ctrl {text}: no actuator of this model has a name: give {every}")
    values = {}
    for part in parts:
        name, equals, value = (word.strip() for word in part.partition("="))
        if not equals:
            raise Usage(f"--ctrl {text}: '{part}' must be NAME=VALUE, as the others are")
        if not name or name not in model.actuator_names:
            near = nearest(name, model.actuator_names)
            raise Usage(f"--ctrl {text}: no actuator is named '{name}'{near}")
        values[name] = _number(text, value)
    return values


def _number(text: str, part: str) -> float:
    try:
        value = float(part)
    except ValueError:
        value = math.nan
    if not math.isfinite(value):
        raise Usage(f"--ctrl {text}: '{part}' must be a finite number")
    return value


def control_function(text: str) -> Callable[..., Any]:
    """Import the control function named by "file.py:function" or "module:function".

    A module is found as by `python -m` in the working directory.
    """
    if text.endswith(ENDINGS_OF_POLICIES):
        try:
            control = Policy(text)
            control.network()
            return control
        except (ImportError, ValueError, OSError) as error:
            raise Usage(f"--control {text}: {one_line(error)}") from None
    module, colon, name = text.rpartition(":")
    if not colon or not module or not name:
        raise Usage(f"--control {text}: must be FILE.py:FUNCTION or MODULE:FUNCTION")
    if module.endswith(".py") and not os.path.isfile(module):
        raise Usage(f"--control {text}: {module}: no such file")
    try:
        imported = _file(module) if module.endswith(".py") else _module(module)
    except Exception as error:
        raise Usage(f"--control {text}: {_place(error)}") from None
    function = getattr(imported, name, None)
    if not callable(function):
        known = [key for key, value in vars(imported).items() if callable(value)]
        raise Usage(f"--control {text}: {module} has no function '{name}'{nearest(name, known)}")

    try:
        inspect.signature(function).bind("time", "sim")
    except TypeError:
        raise Usage(f"--control {text}: the control function must take (time, sim)") from None
    except ValueError:
        # Some C functions have no signature.
        pass
    return _NamedControl(text, function)


class _NamedControl:
    """A control function whose errors name the option; a copy contains a copy of the function."""

    def __init__(self, text: str, function: Callable[..., Any]) -> None:
        self.text, self.__wrapped__ = text, function

    def __call__(self, time: float, sim: Any) -> Any:
        try:
            return self.__wrapped__(time, sim)
        except SimulationError:
            raise
        except Exception as error:
            # A measurement would interpret a ValueError as a failure of the settings.
            raise RuntimeError(f"--control {self.text}: {_place(error)}") from error


def _module(name: str) -> ModuleType:
    if "" not in sys.path and os.getcwd() not in sys.path:
        sys.path.insert(0, os.getcwd())
    return importlib.import_module(name)


def _file(path: str) -> ModuleType:
    """Import a file as a module, even if another module has the same name.

    The file can import other files of its folder.
    """
    file = Path(path).resolve()
    if str(file.parent) not in sys.path:
        # Appended, so that files of this folder do not shadow standard modules.
        sys.path.append(str(file.parent))
    spec = importlib.util.spec_from_file_location(file.stem, file)
    if spec is None or spec.loader is None:
        raise ImportError(f"{path}: is no Python file")
    module = importlib.util.module_from_spec(spec)
    # Pickling the module's functions requires the module to be importable by name.
    sys.modules.setdefault(file.stem, module)
    spec.loader.exec_module(module)
    return module


def _place(error: Exception) -> str:
    """Describe an error of the user's code in one line: type, text and line number."""
    last = traceback.extract_tb(error.__traceback__)[-1]
    return f"{type(error).__name__}: {one_line(error)} ({Path(last.filename).name}:{last.lineno})"
