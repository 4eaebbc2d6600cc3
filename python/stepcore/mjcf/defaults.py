"""The sections `<compiler>` and `<default>`, which complete the attributes of elements.

The law of an actuator follows from its element and its default classes by MuJoCo's rules:
MuJoCo's rules: `<general>` inherits from its class. A shortcut (`<position>`, `<velocity>`, …)
inherits from the innermost class whose actuator was last written as the same shortcut or as
`<general>`. If no class matches, the shortcut has its own defaults. Controllers (`<pid>`,
`<dcmotor>`) and `<orientation>` inherit only from classes of the same element.
"""

from __future__ import annotations

import math
import os
from collections.abc import Callable, Iterable
from dataclasses import dataclass, field, replace
from typing import Any

from stepcore.checks import nearest
from stepcore.mjcf.nodes import Node
from stepcore.mjcf.schema import ACTUATORS, ORIENTATION, TAKEN_BACK, class_fields
from stepcore.mjcf.validation import bad
from stepcore.scene import frames
from stepcore.scene.elements import LengthRange, MassRules
from stepcore.scene.elements.actuator_laws import (
    CHARTS,
    CONTROL,
    GENERAL,
    INPUTS,
    LAWS,
    MUSCLE,
    Law,
    damping,
    inputs,
)
from stepcore.scene.frames import ORIGIN, Vec

Values = dict[str, Any]
# The default values of controllers and orientations.
START: dict[str, dict[str, Any]] = {
    "pid": {"kp": 1.0, "kv": 0.0, "input": "pos vel"},
    "dcmotor": {
        **{"motorconst": 0.0, "resistance": 0.0, "input": "voltage", "kp": 0.0, "kv": 0.0},
        **dict.fromkeys((*CONTROL, "vmax", "current_rate", "timeconst"), 0.0),
        **{"cogging": ORIGIN, "lugre": (0.0,) * 5, "thermal": None},
    },
    "orientation": {"kp": 1.0, "kv": 0.0, "input": "expmap"},
}
CONTROLLERS = {"pid": INPUTS[:3], "dcmotor": INPUTS}


class Compiler:
    """The compiler settings of a file; a later section overrides an earlier one.

    directory: the folder of the model's main file, or None for a text without a folder.
    file: the name of the main file; elements of included files have another name.
    """

    def __init__(
        self, sections: Iterable[Node], directory: str | None = None, file: str = ""
    ) -> None:
        self.directory = directory
        self.file = file
        self.values: dict[str, Any] = {}
        self.ranges: dict[str, Any] = {}
        for node in sections:
            self.values |= node.values
            if node.values.get("coordinate") == "global":
                limit = "local: MuJoCo dropped global coordinates"
                raise bad(node, "coordinate", "global", limit)
            sequence = node.values.get("eulerseq", "xyz")
            if len(sequence) != 3 or sequence.lower().strip("xyz"):
                raise bad(node, "eulerseq", sequence, "three letters of x, y, z, X, Y, Z")
            for child in node.children:
                self.ranges |= child.values
        self.degrees = self.values.get("angle", "degree") == "degree"
        self.autolimits: bool = self.values.get("autolimits", True)
        self.eulerseq: str = self.values.get("eulerseq", "xyz")

    def path(self, node: Node, name: str, folder: str = "") -> str:
        """Return the path of the file that an element names.

        As in MuJoCo, the file is searched in `folder`, relative to the main file. For an element of
        an included file, the search continues in the included file's relative folder within
        `folder`, and then in the included file's own folder.
        """
        home = os.path.join(self.directory or "", folder)
        places = [os.path.join(home, name)]
        if node.file != self.file:
            beside = os.path.abspath(os.path.dirname(node.file))
            within = os.path.relpath(beside, self.directory)
            places += [os.path.join(home, within, name), os.path.join(beside, name)]
        return next((place for place in places if os.path.isfile(place)), places[0])

    def asset(self, node: Node, name: str, folder: str = "meshdir") -> str | None:
        """Return the path of the file that an asset names; None in a text without a folder.

        folder: the attribute that gives the folder of such files.
        """
        name = name.replace("\\", "/")
        within = self.values.get(folder, self.values.get("assetdir", ""))
        stripped = bool(self.values.get("strippath"))
        if stripped:
            name = name.rpartition("/")[2]
        if self.directory is None and not os.path.isabs(os.path.join(within, name)):
            return None
        # With strippath, the folder of an included file is not searched either.
        path = os.path.join(self.directory or "", within, name)
        return os.path.normpath(path if stripped else self.path(node, name, within))

    def mass_rules(self) -> MassRules:
        return MassRules(**class_fields(MassRules, self.values))

    def lengthrange(self) -> LengthRange:
        return LengthRange(**self.ranges)

    def radians(self, angle: float) -> float:
        return angle * (math.pi / 180) if self.degrees else angle

    def orientation(self, node: Node, values: dict[str, Any]) -> Vec:
        """Return the unit quaternion of an element's orientation attribute, by default identity."""
        orientations = [name for name in ORIENTATION if name in values]
        if len(orientations) > 1:
            raise node.error(
                f"<{node.tag}> has two orientations: {orientations[0]} and {orientations[1]}"
            )
        if not orientations:
            return frames.IDENTITY
        numbers = values[orientations[0]]
        try:
            if orientations[0] == "axisangle":
                return frames.from_axis_angle(numbers[:3], self.radians(numbers[3]))
            if orientations[0] == "xyaxes":
                return frames.from_xy_axes(numbers[:3], numbers[3:])
            if orientations[0] == "zaxis":
                return frames.from_z_axis(numbers)
            if orientations[0] == "euler":
                return frames.from_euler([self.radians(a) for a in numbers], self.eulerseq)
            # A unit quaternion is not normalised again, so that writing and reading is exact.
            if abs(math.hypot(*numbers) - 1.0) <= 1e-15:
                return tuple(numbers)
            return frames.normalised(numbers, "the quaternion")
        except ValueError as error:
            raise bad(node, orientations[0], numbers, f"a direction: {error}") from None


MAIN = "main"


def overlay(under: Values, over: Values) -> Values:
    """Return the values of `under`, overridden by the values of `over`.

    A shorter vector replaces only its own entries. An orientation attribute replaces any other.
    An empty material or mesh is none.
    """
    result = dict(under)
    if any(name in over for name in ORIENTATION):
        for name in ORIENTATION:
            result.pop(name, None)
    for name, value in over.items():
        old = result.get(name)
        if isinstance(value, tuple) and isinstance(old, tuple) and len(old) > len(value):
            value = value + old[len(value) :]
        result[name] = value
    for name in TAKEN_BACK:
        if name in result and not result[name].strip():
            del result[name]
    return result


class Defaults:
    """The default classes of a model; `of` completes an element's attributes."""

    def __init__(self, sections: Iterable[Node]) -> None:
        self.classes: dict[str, dict[str, Values]] = {MAIN: {}}
        # The actuator gains of each class and the classes around it, the outermost first.
        self.chains: dict[str, Chain] = {MAIN: (ActuatorGains(),)}
        for section in sections:
            if section.attrs.get("class", MAIN) != MAIN:
                raise section.error('the outermost <default> has the class "main" and no other')
            self._read(section)

    def _read(self, section: Node) -> None:
        # A class's own elements are read before its nested classes, in any document order.
        pending = [(section, MAIN)]
        while pending:
            node, name = pending.pop()
            elements = self.classes[name]
            for child in node.children:
                if child.tag != "default":
                    tag = "actuator" if child.tag in ACTUATORS else child.tag
                    elements[tag] = overlay(elements.get(tag, {}), child.values)
                    if tag == "actuator":
                        elements[tag] = without_range(elements[tag], child)
                        chain = self.chains[name]
                        gains = inherited(chain, child)
                        self.chains[name] = (*chain[:-1], gains)
                        elements[tag] = saturated_motor(elements[tag], gains, child)
            inner = [child for child in node.children if child.tag == "default"]
            for child in inner:
                inner_name = child.attrs.get("class", "")
                if not inner_name:
                    raise child.error('a nested <default> needs class="…"')
                if inner_name in self.classes:
                    raise child.error(f'the default class "{inner_name}" is defined twice')
                self.classes[inner_name] = dict(elements)
                self.chains[inner_name] = (*self.chains[name], self.chains[name][-1])
            pending += [(child, child.attrs["class"]) for child in reversed(inner)]

    def known(self, node: Node, attribute: str) -> str | None:
        """Return the class that an attribute of a node names; None without the attribute."""
        name = node.attrs.get(attribute)
        if name is not None and name not in self.classes:
            raise node.error(f'unknown default class "{name}"{nearest(name, self.classes)}')
        return name

    def of(self, node: Node, childclass: str | None = None, kind: str = "") -> Values:
        """Return a node's values, completed from its class, else from `childclass`, else from main.

        kind: the tag in the default class if it differs from the node's tag: "actuator",
        "equality" or "tendon".
        """
        name = self.known(node, "class") or childclass or MAIN
        attributes = {key: value for key, value in node.values.items() if key != "class"}
        return overlay(self.classes[name].get(kind or node.tag, {}), attributes)

    def gains(self, node: Node) -> ActuatorGains:
        return inherited(self.chains[self.known(node, "class") or MAIN], node)


@dataclass(frozen=True)
class Model:
    """A validated file without anything that MuJoCo has to expand.

    files: the files that it was read from.
    """

    root: Node
    compiler: Compiler
    defaults: Defaults
    files: tuple[str, ...]


@dataclass(frozen=True)
class ActuatorGains:
    """The force law of an actuator or a default class.

    tag: the element that defines the law.
    values: the fields of the law. Those of a `<general>` are in MJCF notation. A `<dcmotor>` has
        the electrical time constant [s] in place of the inductance.
    inheritrange: the scale of an inherited range, or 0.
    torque: the torque limit of a motor [N·m]; 0: unlimited, None: not given.
    damping: the first coefficient of the actuator's own damping.
    """

    tag: str = "general"
    values: Values = field(default_factory=lambda: dict(zip(GENERAL, Law(), strict=False)))
    inheritrange: float = 0.0
    torque: float | None = None
    damping: float = 0.0

    @property
    def law(self) -> Law:
        row = LAWS[self.tag]
        return row.to_law(row.fields | (self.values if self.tag == "general" else self.fields))

    @property
    def is_position(self) -> bool:
        """Whether the control is a length, and so can inherit the range of the joint."""
        if "input" in self.values:
            return self.tag == "pid" and self.inputs[:1] == ["pos"]
        return self.law.holds_length

    @property
    def inputs(self) -> list[str]:
        return inputs(self.tag, self.values.get("input"))

    @property
    def activates(self) -> str:
        """The type of the activation dynamics, or "none"."""
        return "none" if self.tag in START else self.law.dyntype

    @property
    def fields(self) -> Values:
        """The law, as fields of `Actuator`."""
        values = dict(self.values)
        if self.tag == "dcmotor":
            values["inductance"] = values.pop("timeconst") * values["resistance"]
            if values["input"] == "voltage":
                del values["kp"], values["kv"]
        if self.tag != "general":
            return values
        affine = values["biastype"] == "affine"
        fields: Values = {
            "gainprm": values["gainprm"][0],
            "biasprm": values["biasprm"][:3] if affine else None,
        }
        if values["gaintype"] != "fixed":
            fields |= {"gaintype": values["gaintype"], "gainprm": values["gainprm"][:10]}
        if values["biastype"] == "muscle":
            fields |= {"biastype": "muscle", "biasprm": values["biasprm"][:10]}
        if values["dyntype"] != "none":
            fields |= {"dyntype": values["dyntype"], "dynprm": values["dynprm"][:3]}
        return fields


Chain = tuple[ActuatorGains, ...]


def inherited(chain: Chain, node: Node) -> ActuatorGains:
    """Return the law of an actuator or default. chain: the laws of its classes, outermost first."""
    last, tag = chain[-1], node.tag
    drag = (*node.values.get("damping", ()), last.damping)[0]
    if tag == "general":
        return replace(_general(last, node), damping=drag)
    if tag in START:
        explicit = next((gains for gains in reversed(chain) if gains.tag == tag), None)
        base = replace(explicit or ActuatorGains(tag, START[tag]), damping=drag)
        scale = _inheritrange(base, node) if tag == "pid" else 0.0
        return replace(_SHORTCUTS[tag](base, node), inheritrange=scale, damping=drag)
    if tag not in _SHORTCUTS:
        # A <motor>, which has no law, or an actuator that is not supported. Only a <general>
        # inherits the range from a class.
        scale = last.inheritrange if tag in LAWS else 0.0
        return ActuatorGains(tag, {}, scale, damping=drag)
    handed = next((g for g in reversed(chain) if g.tag in (tag, "general")), ActuatorGains())
    if handed.tag == "general" and (from_law := LAWS[tag].from_law):
        handed = replace(handed, tag=tag, values=from_law(handed.law))
    actuator_gains = _SHORTCUTS[tag](handed, node)
    position = tag in ("position", "intvelocity")
    scale = _inheritrange(handed, node) if position else last.inheritrange
    return replace(actuator_gains, inheritrange=scale, damping=drag)


def _own(node: Node, *names: str) -> Values:
    return {name: node.values[name] for name in names if name in node.values}


def _not_negative(node: Node, values: Values, *names: str) -> None:
    for name in names:
        if values.get(name, 0.0) < 0:
            raise bad(node, name, values[name], ">= 0")


def _plain(base: ActuatorGains, node: Node) -> ActuatorGains:
    """Return the law of a velocity servo, damper, cylinder or adhesion: its own attributes."""
    values = base.values | _own(node, *LAWS[node.tag].fields)
    if node.tag in ("damper", "adhesion"):
        _not_negative(node, values, "kv", "gain")
    diameter = node.values.get("diameter", -1.0)
    if node.tag == "cylinder" and diameter >= 0:
        # Unlike a power, a product overflows to inf, which the element's own check reports.
        values["area"] = math.pi / 4 * diameter * diameter
    return ActuatorGains(node.tag, values)


def _muscle(base: ActuatorGains, node: Node) -> ActuatorGains:
    """Return the law of a muscle; a negative number keeps the inherited value.

    As in MuJoCo, the default values of `<general>` count as not given.
    """
    values, had = node.values, base.values
    low, high = had.get("range", MUSCLE["range"])
    bounds = (
        MUSCLE["range"][0] if low == 1.0 else low,
        MUSCLE["range"][1] if high == 0.0 else high,
    )
    rise, fall = had.get("timeconst", LAWS["muscle"].fields["timeconst"])
    times = (0.01 if rise == 1 else rise, 0.04 if fall == 0 else fall)
    gains: Values = {
        name: tuple(b if a < 0 else a for a, b in zip(values.get(name, old), old, strict=True))
        for name, old in (("range", bounds), ("timeconst", times))
    }
    gains["tausmooth"] = values.get("tausmooth", had.get("tausmooth", 0.0))
    for name, default in list(MUSCLE.items())[1:]:
        kept = had.get(name, default) or default
        gains[name] = values[name] if values.get(name, -1.0) >= 0 else kept
    _not_negative(node, gains, "tausmooth")
    return ActuatorGains("muscle", gains)


def _servo(base: ActuatorGains, node: Node) -> ActuatorGains:
    _not_negative(node, node.values, "kv", "dampratio", "timeconst")
    values = _damped(base.values, node) | _own(node, "kp")
    if node.values.get("timeconst", 0.0) > 0:
        values["timeconst"] = node.values["timeconst"]
    elif "timeconst" in node.values:
        values.pop("timeconst", None)
    return ActuatorGains(node.tag, values)


def _damped(values: Values, node: Node) -> Values:
    """Return the fields with the element's damping, given as kv or as dampratio."""
    if "kv" in node.values and "dampratio" in node.values:
        raise node.error(f"<{node.tag}> has both kv and dampratio")
    if "kv" not in node.values and "dampratio" not in node.values:
        return dict(values)
    kept = {name: value for name, value in values.items() if name not in ("kv", "dampratio")}
    return kept | damping(node.values.get("dampratio", 0.0 - node.values.get("kv", 0.0)))


def _orientation(base: ActuatorGains, node: Node) -> ActuatorGains:
    chart = node.values.get("input", "") or base.values["input"]
    if chart not in CHARTS:
        raise bad(node, "input", chart, " or ".join(CHARTS))
    return ActuatorGains("orientation", _servo(base, node).values | {"input": chart})


def _input(node: Node, handed_down: str) -> str:
    words_given: str = node.values.get("input", "") or handed_down
    controllers, words = CONTROLLERS[node.tag], words_given.split()
    if node.tag == "dcmotor" and words == ["none"]:
        return "none"
    if words != [word for word in controllers if word in words]:
        raise bad(node, "input", words_given, f"some of {', '.join(controllers)}, in this order")
    return " ".join(words)


def _pid(base: ActuatorGains, node: Node) -> ActuatorGains:
    input_words = _input(node, base.values["input"])
    _not_negative(node, node.values, "kv", "dampratio")
    values = _damped(base.values, node) | {"input": input_words} | _own(node, "kp", *CONTROL)
    _not_negative(node, values, "slewmax")
    if values.get("ki") or values.get("slewmax"):
        values |= {name: values.get(name, 0.0) for name in CONTROL}
    else:
        # The class of a controller without activation passes none of these on.
        values = {name: value for name, value in values.items() if name not in CONTROL}
    return ActuatorGains("pid", values)


def _dcmotor(base: ActuatorGains, node: Node) -> ActuatorGains:
    """Return the law of a DC motor by MuJoCo's rules for datasheet values.

    The motor constant follows from torque, voltage or the nominal point.
    """
    values, old = node.values, base.values
    gains: Values = {"input": _input(node, old["input"])}
    resistance: float = old["resistance"]
    constants = values.get("motorconst", (old["motorconst"],))
    by_torque, by_voltage = (*constants, 0.0)[:2]
    voltage, stall, free = (*values.get("nominal", ()), 0.0, 0.0, 0.0)[:3]
    if min(by_torque, by_voltage) < 0:
        raise bad(node, "motorconst", constants, ">= 0")
    if "nominal" in values and free != 0:
        measured = values.get("resistance", resistance)
        by_nominal = _without_load(voltage, stall, free, measured, base.damping)
        by_torque, by_voltage = by_torque or by_nominal, by_voltage or by_nominal
    both = by_torque > 0 and by_voltage > 0
    constant = math.sqrt(by_torque * by_voltage) if both else max(by_torque, by_voltage)
    if "resistance" in values:
        resistance = values["resistance"]
    elif resistance == 0 and stall > 0:
        resistance = constant * voltage / stall
    if constant <= 0:
        raise node.error(
            "<dcmotor> needs a motorconst or a nominal point: its constant must be > 0"
        )
    if resistance <= 0:
        raise node.error("<dcmotor> needs a resistance or a nominal point: it must be > 0")
    gains |= {"motorconst": constant, "resistance": resistance}
    names = ("kp", "ki", "kv", "slewmax", "imax", "vmax")
    controller = _filled(values.get("controller", ()), tuple(old[name] for name in names))
    gains |= dict(zip(names, controller, strict=False))
    if gains["ki"] < 0:
        raise bad(node, "controller", values["controller"], "ki >= 0")
    rate = _filled(values.get("saturation", ()), (0.0, 0.0, old["current_rate"]))[2]
    gains |= {name: max(gains[name], 0.0) for name in ("slewmax", "imax", "vmax")}
    gains |= {"current_rate": max(rate, 0.0), "timeconst": old["timeconst"]}
    if "inductance" in values:
        # A given inductance takes precedence over the electrical time constant [s].
        inductance, seconds = _filled(values["inductance"], (0.0, old["timeconst"]))
        if min(inductance, seconds) < 0:
            raise bad(node, "inductance", values["inductance"], ">= 0")
        gains["timeconst"] = inductance / resistance if inductance > 0 else seconds
    gains |= {name: _filled(values.get(name, ()), old[name]) for name in ("cogging", "lugre")}
    gains["thermal"] = _thermal(node, old["thermal"])
    torque = base.torque
    if "saturation" in values:
        most, current = (*values["saturation"], 0.0)[:2]
        torque = most if most > 0 else max(constant * current, 0.0)
    return ActuatorGains("dcmotor", gains, torque=torque)


def _without_load(
    voltage: float, stall: float, free: float, resistance: float, drag: float
) -> float:
    """Return the motor constant K from the no-load speed ω and the motor's own damping B.

    K solves K (V - K ω)/R = B ω; without a resistance, K/R = stall/V. If no K > 0 solves the
    equation, K is V/ω, the value without damping, as in MuJoCo.
    """
    total = voltage / free
    if drag <= 0:
        return total
    if resistance > 0:
        square = voltage * voltage - 4.0 * resistance * drag * free * free
        return (voltage + math.sqrt(square)) / (2.0 * free) if square >= 0 else total
    if stall <= drag * free:
        return total
    return total * (1.0 - drag * free / stall)


def _filled(front: Vec, kept: Vec) -> Vec:
    return (*front, *kept[len(front) :])


def _thermal(node: Node, had: Vec | None) -> Vec | None:
    """Return the thermal parameters; two of resistance, capacity and time constant suffice."""
    if "thermal" not in node.values:
        return had
    kept = (*had[:2], 0.0, *had[2:]) if had else (0.0,) * 6
    path, capacity, seconds, *rest = _filled(node.values["thermal"], kept)
    if not (path or capacity or seconds):
        return None
    if path > 0 and seconds > 0:
        capacity = seconds / path
    elif capacity > 0 and seconds > 0:
        path = seconds / capacity
    if path <= 0 or capacity <= 0:
        limit = "two of resistance, capacity and time constant > 0"
        raise bad(node, "thermal", node.values["thermal"], limit)
    return (path, capacity, *rest)


_SHORTCUTS: dict[str, Callable[[ActuatorGains, Node], ActuatorGains]] = {
    "position": _servo,
    "intvelocity": _servo,
    **dict.fromkeys(("velocity", "damper", "cylinder", "adhesion"), _plain),
    "muscle": _muscle,
    "pid": _pid,
    "dcmotor": _dcmotor,
    "orientation": _orientation,
}


def _general(base: ActuatorGains, node: Node) -> ActuatorGains:
    if base.tag not in LAWS or base.tag in CONTROLLERS:
        raise node.unbuilt(f"<general> in a class whose default is <{base.tag}>")
    values = base.values if base.tag == "general" else base.law.general()
    merged: Values = {
        name: (*node.values[name], *values[name][len(node.values[name]) :])
        for name in ("gainprm", "biasprm", "dynprm")
        if node.values.get(name)
    }
    merged |= _own(node, "dyntype", "gaintype", "biastype")
    gains = ActuatorGains("general", values | merged, _inheritrange(base, node))
    if gains.values["gaintype"] in _CANONICAL:
        return _canonical(gains, node)
    return replace(gains, torque=base.torque)


# MuJoCo's canonical notation writes controllers and orientations as `<general>`, with their
# parameters by position (MuJoCo documentation, XML reference, "actuator/general").


def _canonical(gains: ActuatorGains, node: Node) -> ActuatorGains:
    values, kind = gains.values, gains.values["gaintype"]
    bias, dynamics, read = _CANONICAL[kind]
    if values["biastype"] != bias or values["dyntype"] not in dynamics:
        types = f'biastype="{values["biastype"]}" and dyntype="{values["dyntype"]}"'
        raise node.unbuilt(f'<general> gaintype="{kind}" with {types}')
    early = node.values.get("actearly", kind == "dcmotor")
    if early != (kind == "dcmotor") or node.values.get("actrange"):
        name = "actrange" if node.values.get("actrange") else "actearly"
        raise node.unbuilt(f'<general> gaintype="{kind}" with {name}', name)
    tag = "orientation" if kind == "so3" else kind
    return replace(gains, tag=tag, values=read(values, node))


def _ten(prm: Vec) -> Vec:
    return (*prm, *(0.0,) * 10)[:10]


def _canonical_pid(values: Values, node: Node) -> Values:
    gain, bias = values["gainprm"], values["biasprm"]
    constant, stiffness, drag = _ten(bias)[:3]
    if constant != 0:
        raise bad(node, "biasprm", bias, "0 first, for a pid")
    pid: Values = {"kp": 0.0 - stiffness, "input": node.values.get("input", "") or "pos vel"}
    if values["dyntype"] == "none":
        if gain[0] != 0:
            limit = '0 (the gain of the integral) without dyntype="pid"'
            raise bad(node, "gainprm", gain, limit)
    else:
        pid |= dict(zip(CONTROL, (gain[0], *_ten(values["dynprm"])[:2]), strict=True))
        if min(pid[name] for name in CONTROL) < 0:
            raise bad(node, "dynprm", values["dynprm"], "gains and limits >= 0")
    return pid | damping(drag)


def _canonical_motor(values: Values, node: Node) -> Values:
    gain, bias, dynamics = (_ten(values[name]) for name in ("gainprm", "biasprm", "dynprm"))
    resistance, constant, more_by_degree, reference, kp, ki, kd, vmax = gain[:8]
    if values["dyntype"] == "none":
        dynamics = (0.0,) * 10
    timeconst, rate, path, capacity, ambient, stiffness, drag, slewmax, imax = dynamics[:9]
    if resistance <= 0 or constant <= 0:
        limit = "a resistance and a constant > 0 for a dcmotor"
        raise bad(node, "gainprm", values["gainprm"], limit)
    heats = path > 0 and capacity > 0
    return {
        **{"motorconst": constant, "resistance": resistance, "kp": kp, "kv": kd, "ki": ki},
        **{"slewmax": max(slewmax, 0.0), "imax": max(imax, 0.0), "vmax": max(vmax, 0.0)},
        **{"current_rate": max(rate, 0.0), "timeconst": max(timeconst, 0.0)},
        "input": node.values.get("input", "") or "voltage",
        "cogging": bias[:3],
        "lugre": (stiffness, drag, *bias[3:6]),
        "thermal": (path, capacity, more_by_degree, reference, ambient) if heats else None,
    }


def _canonical_orientation(values: Values, node: Node) -> Values:
    chart = node.values.get("input", "") or "expmap"
    if chart not in CHARTS:
        raise bad(node, "input", chart, " or ".join(CHARTS))
    kp, bias = values["gainprm"][0], _ten(values["biasprm"])[:3]
    if bias[:2] != (0.0, 0.0 - kp):
        raise bad(node, "biasprm", values["biasprm"], "0 -kp -kv for an orientation")
    return {"kp": kp, "input": chart} | damping(bias[2])


# For each gaintype: the required biastype, the allowed dyntypes, and the parameter reader.
_CANONICAL: dict[str, tuple[str, tuple[str, ...], Callable[[Values, Node], Values]]] = {
    "pid": ("affine", ("none", "pid"), _canonical_pid),
    "dcmotor": ("dcmotor", ("none", "dcmotor"), _canonical_motor),
    "so3": ("so3", ("none",), _canonical_orientation),
}


def _inheritrange(base: ActuatorGains, node: Node) -> float:
    """Return the scale from the joint's range to the control range; 0 if the latter is given."""
    share: float = node.values.get("inheritrange", base.inheritrange)
    attribute = {"intvelocity": "actrange", "pid": "posrange"}.get(node.tag, "ctrlrange")
    if attribute not in node.values:
        return share
    if node.values.get("inheritrange", 0.0) > 0:
        raise node.error(f"<{node.tag}> has both {attribute} and inheritrange")
    return 0.0


def saturated_motor(values: Values, gains: ActuatorGains, node: Node) -> Values:
    """Return the values of a motor or its class, with the force range from its saturation."""
    if gains.torque is None or "saturation" not in node.values:
        return values
    rest = {name: v for name, v in values.items() if name not in ("forcerange", "forcelimited")}
    return rest | ({"forcerange": (-gains.torque, gains.torque)} if gains.torque > 0 else {})


def without_range(values: Values, node: Node) -> Values:
    """Return the values of a class, without ctrlrange if `node` inherits the joint's range."""
    takes_over = node.values.get("inheritrange", 0.0) > 0
    return {name: v for name, v in values.items() if name != "ctrlrange" or not takes_over}
