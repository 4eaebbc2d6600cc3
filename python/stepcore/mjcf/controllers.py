"""`<pid>` and `<dcmotor>`: the numbers of a controller.

With MuJoCo's rules for what an element or a class leaves out (MuJoCo documentation, XML reference,
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


def law(tag: str, base: Any, node: Node) -> dict[str, Any]:
    """The fields of `ActuatorGains` that an element or a class changes."""
    own = {"input": _input(node, base.input)}
    return own | (_pid(base, node) if tag == "pid" else _motor(base, node))


def first_of(gains: Any) -> str:
    """The first input of a controller, which its `Actuator` has."""
    words: str = gains.input
    return words.split()[0]


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
    more = {name: values.get(name, base.more.get(name, 0.0)) for name in ("ki", "imax", "slewmax")}
    if more["slewmax"] < 0:
        raise bad(node, "slewmax", more["slewmax"], ">= 0")
    if not (more["ki"] or more["slewmax"]):
        # What has no activation hands nothing of it down.
        more = {}
    law = {"gainprm": (kp,), "biasprm": (0.0, -kp, damping), "biastype": "affine"}
    return {**law, "more": more}


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
        known = values.get("resistance", resistance)
        by_nominal = _without_load(voltage, stall, free, known, base.damping)
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
    old = base.more
    kept = (0.0 - base.biasprm[1], old.get("ki", 0.0), 0.0 - base.biasprm[2])
    kept = (*kept, *(old.get(name, 0.0) for name in ("slewmax", "imax", "vmax")))
    kp, ki, kd, slewmax, imax, vmax = _filled(values.get("controller", ()), kept)
    if ki < 0:
        raise bad(node, "controller", values["controller"], "ki >= 0")
    bounds = {"slewmax": slewmax, "imax": imax, "vmax": vmax}
    more: dict[str, Any] = {"ki": ki} | {name: max(most, 0.0) for name, most in bounds.items()}
    rate = _filled(values.get("saturation", ()), (0.0, 0.0, old.get("current_rate", 0.0)))[2]
    more |= {"current_rate": max(rate, 0.0), "timeconst": _electrical(node, old, resistance)}
    for name, count in (("cogging", 3), ("lugre", 5)):
        more[name] = _filled(values.get(name, ()), old.get(name, (0.0,) * count))
    more["thermal"] = _thermal(node, old)
    fields: dict[str, Any] = {
        **{"motor": (constant, resistance), "biastype": "affine", "more": more},
        **{"gainprm": (0.0,), "biasprm": (0.0, 0.0 - kp, 0.0 - kd)},
    }
    if "saturation" in values:
        torque, current = (*values["saturation"], 0.0)[:2]
        fields["torque"] = torque if torque > 0 else max(constant * current, 0.0)
    return fields


def _without_load(
    voltage: float, stall: float, free: float, resistance: float, damping: float
) -> float:
    """The constant K of a motor that its own damping B lets turn at ω without a load.

    K (V - K ω)/R = B ω; without a resistance, K/R = stall/V. Where no K > 0 does it, MuJoCo takes
    the one without damping.
    """
    whole = voltage / free
    if damping <= 0:
        return whole
    if resistance > 0:
        square = voltage * voltage - 4.0 * resistance * damping * free * free
        return (voltage + math.sqrt(square)) / (2.0 * free) if square >= 0 else whole
    if stall <= damping * free:
        return whole
    return whole * (1.0 - damping * free / stall)


def _filled(given: Vec, kept: Vec) -> Vec:
    return (*given, *kept[len(given) :])


def _electrical(node: Node, old: dict[str, Any], resistance: float) -> float:
    """The time constant of the current [s], 0 without; of L and it, L counts."""
    if "inductance" not in node.values:
        kept: float = old.get("timeconst", 0.0)
        return kept
    given = node.values["inductance"]
    inductance, seconds = _filled(given, (0.0, old.get("timeconst", 0.0)))
    if min(inductance, seconds) < 0:
        raise bad(node, "inductance", given, ">= 0")
    return inductance / resistance if inductance > 0 else seconds


def _thermal(node: Node, old: dict[str, Any]) -> Vec | None:
    """Two of resistance, capacity and time constant give the third."""
    had: Vec | None = old.get("thermal")
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
