"""`<pid>` and `<dcmotor>`: the law of a controller without a state of its own.

A motor with the constant K and the resistance R pulls with K/R · (voltage − K · velocity); with an
input of its controller, with the torque that this asks for (MuJoCo documentation, XML reference,
"actuator/pid" and "actuator/dcmotor").
"""

from __future__ import annotations

import math
from typing import Any

from stepcore.mjcf.nodes import Node
from stepcore.mjcf.validation import bad
from stepcore.scene.frames import Vec

# What a class or an element of these kinds starts from, and the inputs that are built.
START: dict[str, dict[str, Any]] = {
    "pid": {"gainprm": (1.0,), "biasprm": (0.0, -1.0, 0.0), "input": "pos vel"},
    "dcmotor": {"gainprm": (0.0,), "biasprm": (0.0, 0.0, 0.0), "input": "voltage"},
}
INPUTS = {"pid": ("pos", "vel", "ff"), "dcmotor": ("pos", "vel", "ff", "voltage")}
# Attributes that add a state or another law where they are not 0.
UNBUILT = {
    "pid": {"ki": "the integral of a controller", "slewmax": "a bound of a setpoint's rate"},
    "dcmotor": {
        "inductance": "the inductance of a motor",
        "thermal": "the temperature of a motor",
        "cogging": "the cogging torque of a motor",
        "lugre": "the friction of bristles in a motor",
    },
}


def law(tag: str, base: Any, node: Node) -> dict[str, Any]:
    """The fields of `ActuatorGains` that an element or a class changes."""
    for attribute, what in UNBUILT[tag].items():
        value = node.values.get(attribute, 0.0)
        if _any(value):
            raise node.unbuilt(f"{what} ({attribute})", attribute)
    own = {"input": _input(node, base.input)}
    return own | (_pid(base, node) if tag == "pid" else _motor(base, node))


def first_of(gains: Any) -> str:
    """The first input of a controller, which its `Actuator` has."""
    words: str = gains.input
    return words.split()[0]


def others(gains: Any) -> dict[str, float]:
    """Its other inputs, and the force that one unit of each adds."""
    if gains.tag not in INPUTS:
        return {}
    constant, resistance = gains.motor
    unit = {"vel": -gains.biasprm[2], "ff": 1.0}
    if resistance > 0:
        unit["voltage"] = constant / resistance
    return {word: unit[word] for word in gains.input.split()[1:]}


def _any(value: float | Vec) -> bool:
    return any(value) if isinstance(value, tuple) else value != 0


def _input(node: Node, inherited: str) -> str:
    given: str = node.values.get("input", "") or inherited
    known = INPUTS[node.tag]
    words = given.split()
    if node.tag == "dcmotor" and words == ["none"]:
        return "none"
    if words != [word for word in known if word in words]:
        raise bad(node, "input", given, f"some of {', '.join(known)}, in this order")
    return " ".join(words)


def _pid(base: Any, node: Node) -> dict[str, Any]:
    values = node.values
    if values.get("kv", 0.0) < 0 or values.get("dampratio", 0.0) < 0:
        name = "kv" if values.get("kv", 0.0) < 0 else "dampratio"
        raise bad(node, name, values[name], ">= 0")
    if "kv" in values and "dampratio" in values:
        raise node.error("<pid> has both kv and dampratio")
    kp, damping = values.get("kp", -base.biasprm[1]), base.biasprm[2]
    if "kv" in values or "dampratio" in values:
        damping = values.get("dampratio", 0.0 - values.get("kv", 0.0))
    return {"gainprm": (kp,), "biasprm": (0.0, -kp, damping), "biastype": "affine"}


def _motor(base: Any, node: Node) -> dict[str, Any]:
    """MuJoCo's rules for what a datasheet leaves out: a constant by torque and one by voltage."""
    values = node.values
    kept, resistance = base.motor
    given = values.get("motorconst", (kept,))
    by_torque, by_voltage = (*given, 0.0)[:2]
    voltage, stall, free = (*values.get("nominal", ()), 0.0, 0.0, 0.0)[:3]
    if min(by_torque, by_voltage) < 0:
        raise bad(node, "motorconst", given, ">= 0")
    if "nominal" in values and free != 0:
        by_nominal = voltage / free
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
    old = (-base.biasprm[1], 0.0, -base.biasprm[2])
    controller: Vec = values.get("controller", ())
    filled = [*controller, *(*old, 0.0, 0.0, 0.0)[len(controller) :]]
    kp, ki, kd, slew, _, drive = filled
    for more, what in (
        (ki != 0, "the integral of a controller"),
        (slew > 0, "a bound of a setpoint's rate"),
        (drive > 0, "a bound of a controller's voltage"),
    ):
        if more:
            raise node.unbuilt(f"{what} (controller)", "controller")
    fields: dict[str, Any] = {
        **{"motor": (constant, resistance), "biastype": "affine"},
        **{"gainprm": (0.0,), "biasprm": (0.0, 0.0 - kp, 0.0 - kd)},
    }
    if "saturation" in values:
        torque, current = (*values["saturation"], 0.0)[:2]
        fields["torque"] = torque if torque > 0 else max(constant * current, 0.0)
    return fields
