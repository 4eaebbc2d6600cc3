"""Arguments common to several commands: the model, the motion and its controls."""

from __future__ import annotations

import argparse
import importlib
import importlib.util
import inspect
import json
import math
import os
import re
import sys
import traceback
from collections.abc import Callable, Collection, Mapping
from contextlib import suppress
from pathlib import Path
from types import ModuleType
from typing import Any

from stepcore._core import Settings, SimulationError
from stepcore.checks import nearest, one_line
from stepcore.cli.terminal import Usage
from stepcore.engine.model import Model
from stepcore.experiment.control_table import PositionTable, control_table
from stepcore.experiment.default_motion import KINDS
from stepcore.experiment.log_files import ENDINGS, endings_for, is_file, parts_of
from stepcore.experiment.motion import INTERPOLATIONS, Motion
from stepcore.experiment.policy import ENDINGS as ENDINGS_OF_POLICIES
from stepcore.experiment.policy import Policy
from stepcore.loading import find_scene, load
from stepcore.report.units import counted, frequency_of, length_of, time_of

# A line of a docstring that begins the description of arguments: "dts [s], values: the axes".
ARGUMENT = re.compile(r"(\w+(?: \[\w+\])?(?:, \w+(?: \[\w+\])?)*): (.*)")


def documented(function: Callable[..., Any]) -> tuple[str, dict[str, str]]:
    """Return the description in a docstring of a function, and of each of its arguments."""
    said, arguments = list[str](), dict[str, str]()
    described = list[str]()
    for line in (inspect.getdoc(function) or "").splitlines():
        begins = ARGUMENT.match(line)
        if begins:
            described = re.sub(r" \[\w+\]", "", begins[1]).split(", ")
            arguments |= dict.fromkeys(described, begins[2])
        elif described and line.startswith("    "):
            for name in described:
                arguments[name] += " " + line.strip()
        elif arguments:
            break
        else:
            said.append(line)
    return "\n".join(said).strip(), arguments


def _read(parse: Callable[[str], float | None], limit: str) -> Callable[[str], float]:
    def read(text: str) -> float:
        value = parse(text)
        if value is None:
            raise argparse.ArgumentTypeError(f"'{text}' must be {limit}")
        return value

    return read


# A time [s], a length [m] and a frequency [Hz] on the command line.
time = _read(time_of, "a time: seconds, 1ms or 20us")
length = _read(length_of, "a length: metres, 1mm or 2cm")
frequency = _read(frequency_of, "a frequency: hertz, 8Hz or 1.2kHz")

TYPES = {"int": int, "float": float, "float | None": float}
LIST = "numbers a,b,c or FIRST:LAST:COUNT on a log scale"


def add_options(
    command: argparse.ArgumentParser,
    options: Mapping[str, Any],
    function: Callable[..., Any],
    excluding: Collection[str] = (),
) -> None:
    """Add options that are arguments of a function, with its words, types and defaults.

    options: for each argument, the metavar, the choices, or keywords for argparse; "flags" are the
        option's names if these differ. excluding: mutually exclusive options.
    """
    takes, (_, words) = inspect.signature(function).parameters, documented(function)
    alternatives = command.add_mutually_exclusive_group() if excluding else command
    for argument, option in options.items():
        if isinstance(option, str):
            option = {"metavar": option}
        elif isinstance(option, tuple):
            option = {"choices": option}
        own = {"help": words.get(argument, "").replace("%", "%%").rstrip("."), **option}
        flags = own.pop("flags", (f"--{argument.replace('_', '-')}",))
        parameter = takes.get(argument, inspect.Parameter(argument, inspect.Parameter.KEYWORD_ONLY))
        if parameter.annotation == "bool":
            own["action"] = "store_true"
        elif own.get("action") == "append":
            own["help"] += "; may be given several times"
        elif "action" not in own:
            known = parameter.default not in (None, parameter.empty)
            default = own.setdefault("default", parameter.default if known else None)
            if kind := TYPES.get(parameter.annotation):
                own.setdefault("type", kind)
            if known and "default" not in own["help"]:
                number = "g" if isinstance(default, float) else "s"
                own["help"] += f" (default: %(default){number})"
        if own.get("metavar") == "LIST":
            own["help"] += f" ({LIST})"
        if flags[0].startswith("-"):
            own["dest"] = argument
        (alternatives if argument in excluding else command).add_argument(*flags, **own)


# The description of each field of `Motion`: the first words of its docstring.
WORDS = {
    name: re.split(r"[;.] [Bb]y default|, or a text|\.(?: |$)", words)[0]
    for name, words in documented(Motion)[1].items()
}
# The options of a motion, by the field of `Motion` that each sets. "help" replaces the field's
# description; "usual" is the default.
OPTIONS: dict[str, dict[str, Any]] = {
    "horizon": {"type": time, "metavar": "S"},
    "starts": {"type": int, "metavar": "N"},
    "seed": {"type": int, "metavar": "N", "usual": "0"},
    "key": {"usual": "the first"},
    "control": {
        "metavar": "FILE.py:FUNCTION",
        "help": "a function (time, sim) -> controls, in a file or a module; or a policy (.onnx, or "
        ".pt of TorchScript) from qpos and qvel to controls",
    },
    "ctrl": {
        "metavar": "VALUES",
        "help": 'constant controls, "1,0,-1" or "hip=1,knee=-1"; or a file (.csv, .npz, .npy, '
        ".parquet, .mcap) with a row for each control period, or with a column for each actuator "
        "or joint by name and one of times; of an MCAP log with several topics, log.mcap:/TOPIC or "
        "log.mcap:/TOPIC.FIELD",
    },
    "control_dt": {
        "type": time,
        "metavar": "S",
        "usual": "the model's time step with --control or --ctrl, else chosen to fit",
    },
    "interpolation": {"choices": INTERPOLATIONS, "usual": "held"},
    "kind": {
        "flag": "--motion",
        "choices": KINDS,
        "help": "the motion without --ctrl and --control: move (point to point, within forces and "
        "limits), hold (the start), sines, random or fall",
        "usual": "chosen from the model",
    },
    "follow": {
        "metavar": "FILE",
        "help": "recorded positions of joints, by name, which servos and motors follow; a file as "
        "for --ctrl",
    },
}
# A motion has one of these.
DRIVES = ("control", "ctrl", "kind", "follow")


def add_file(command: argparse.ArgumentParser, *, optional: bool = False) -> None:
    """Add the argument FILE, the model of a command, and the options of loading."""
    count = "?" if optional else None
    help_words = "path, package:name or lesson:name"
    command.add_argument("file", nargs=count, metavar="FILE", help=help_words)
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
    command.add_argument(
        "--free", action="store_true", help="the base of a URDF gets a free joint: a legged robot"
    )
    command.add_argument(
        "--ground", action="store_true", help="a URDF gets a floor, which its lowest geom touches"
    )


def add_motion(group: Any, fields: Collection[str], **usual: Any) -> None:
    """Add the options of a motion; fields: of `Motion`. usual: the defaults of options."""
    drives = group.add_mutually_exclusive_group() if "ctrl" in fields else group
    for name, option in OPTIONS.items():
        if name in fields:
            own = {"help": WORDS[name], **option}
            flag = own.pop("flag", f"--{name.replace('_', '-')}")
            shown = usual.get(name) or own.get("usual")
            own.pop("usual", None)
            own["help"] += f" (default: {shown})" if shown else ""
            (drives if name in DRIVES else group).add_argument(flag, dest=name, **own)


def model_of(args: argparse.Namespace, warn: bool = True) -> Model:
    """Return the compiled model of FILE; warn: whether to warn of stiffness, as `load` does."""
    read = load if warn else find_scene
    options = {name: getattr(args, name) for name in ("without", "fuse", "free", "ground")}
    return read(args.file, **options).compile()


def is_whole(args: argparse.Namespace) -> bool:
    """Return whether no option of loading changes FILE."""
    return not (args.without or args.fuse is False or args.free or args.ground)


def key_of(args: argparse.Namespace, model: Model | None) -> str | int | None:
    """Return the keyframe of --key; a number is an index unless it names a keyframe."""
    key: str | None = args.key
    if key is None or (model is not None and key in model.key_names) or not key.isdecimal():
        return key
    return int(key)


def motion_of(args: argparse.Namespace, model: Model | None) -> dict[str, Any]:
    """Return the given options of a motion, and the threads, as arguments of a measurement."""
    given = {name: getattr(args, name, None) for name in (*OPTIONS, "threads")}
    given["key"] = key_of(args, model)
    if given["follow"] is not None:
        given["follow"] = _table("follow", given["follow"], PositionTable)
    if given["ctrl"] is not None:
        given["ctrl"] = controls_of(given["ctrl"], model)
    if given["control"] is not None:
        given["control"] = control_function(given["control"])
    return {name: value for name, value in given.items() if value is not None}


def controls_of(text: str, model: Model | None) -> Any:
    """Return the controls of --ctrl as an argument of `Motion`.

    model: None for a file that MuJoCo alone can load, whose controls come from a file.
    """
    if text in KINDS and (model is None or text not in model.actuator_names):
        raise Usage(f"--ctrl {text}: write --motion {text}")
    if is_file(text):
        return _table("ctrl", text, control_table)
    if os.path.exists(text):
        raise Usage(f"--ctrl {text}: must end in {endings_for(text)}")
    if model is None:
        raise Usage(f"--ctrl {text}: must be a file where stepcore cannot load the scene")
    if not model.nu:
        raise Usage(f"--ctrl {text}: this model has no actuators")
    return _constants(text, model.nu)


def _table(option: str, text: str, read: Callable[[str], Any]) -> Any:
    if not os.path.isfile(parts_of(text)[0]):
        raise Usage(f"--{option} {text}: no such file")
    try:
        return read(text)
    except (ValueError, OSError, ImportError) as error:
        raise Usage(f"--{option} {text}: {one_line(error)}") from None


def _constants(text: str, nu: int) -> list[list[float]] | dict[str, float]:
    """Return constant controls: a row for all actuators, or a dict by actuator or joint."""
    parts = [part.strip() for part in text.split(",")]
    if "=" in text:
        pairs = [[word.strip() for word in part.partition("=")] for part in parts]
        for part, (_, equals, _) in zip(parts, pairs, strict=True):
            if not equals:
                raise Usage(f"--ctrl {text}: '{part}' must be NAME=VALUE, as the others are")
        return {name: _number(text, value) for name, _, value in pairs}
    if len(parts) != nu or os.path.splitext(text)[1][1:].isalpha():
        limit = f"{counted(nu, 'number')}, one for each actuator; NAME=VALUE pairs"
        raise Usage(f"--ctrl {text}: must be {limit}; or a file that ends in {', '.join(ENDINGS)}")
    return [[_number(text, part) for part in parts]]


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
        policy = Policy(text)
        try:
            policy.network()
        except (ImportError, ValueError, OSError) as error:
            raise Usage(f"--control {text}: {one_line(error)}") from None
        return policy
    function = function_of("control", text)
    try:
        inspect.signature(function).bind("time", "sim")
    except TypeError:
        raise Usage(f"--control {text}: the control function must take (time, sim)") from None
    except ValueError:
        # Some C functions have no signature.
        pass
    return _NamedControl(text, function)


def function_of(option: str, text: str) -> Callable[..., Any]:
    """Import a function named by "file.py:function" or "module:function"; option: for errors."""
    module, colon, name = text.rpartition(":")
    try:
        if not colon or not module or not name:
            raise ValueError("must be FILE.py:FUNCTION or MODULE:FUNCTION")
        imported = _imported(module)
        function = getattr(imported, name, None)
        if not callable(function):
            known = [key for key, value in vars(imported).items() if callable(value)]
            raise ValueError(f"{module} has no function '{name}'{nearest(name, known)}")
    except (ImportError, ValueError, OSError) as error:
        raise Usage(f"--{option} {text}: {one_line(error)}") from None
    return function


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


def _imported(name: str) -> ModuleType:
    """Import a module, or a file as a module, even if another module has the same name."""
    file = Path(name).resolve()
    if not name.endswith(".py"):
        if "" not in sys.path and os.getcwd() not in sys.path:
            sys.path.insert(0, os.getcwd())
    elif not file.is_file():
        raise ValueError(f"{name}: no such file")
    elif str(file.parent) not in sys.path:
        # The file can import its neighbours, but Python's modules come first.
        sys.path.append(str(file.parent))
    try:
        if not name.endswith(".py"):
            return importlib.import_module(name)
        spec = importlib.util.spec_from_file_location(file.stem, file)
        assert spec is not None and spec.loader is not None
        module = importlib.util.module_from_spec(spec)
        # Pickling the module's functions requires the module to be importable by name.
        sys.modules.setdefault(file.stem, module)
        spec.loader.exec_module(module)
        return module
    except Exception as error:
        raise ValueError(_place(error)) from None


def _place(error: Exception) -> str:
    """Describe an error of the user's code in one line: type, text and line number."""
    last = traceback.extract_tb(error.__traceback__)[-1]
    return f"{type(error).__name__}: {one_line(error)} ({Path(last.filename).name}:{last.lineno})"


def setting(text: str) -> tuple[str, Any]:
    """Parse "name=value" as a field of Settings and its value: a number, true, false or a text."""
    name, equals, value = text.partition("=")
    if not equals:
        raise Usage(f"--set {text}: must be NAME=VALUE")
    fields = Settings().as_dict()
    if name not in fields:
        raise Usage(f"--set {text}: settings have no '{name}'{nearest(name, fields)}")
    if name in ("dt", "sleep_time"):
        return name, time_of(value) or value
    with suppress(ValueError):
        return name, json.loads(value.lower())
    return name, value
