"""Servos that turn a ball to an orientation, and the inputs that an actuator has beside its own.

A servo of orientations is three actuators, one for each axis of the body, and a fourth without a
force where its controls are a quaternion; the first has the numbers, and the others feed it
(MuJoCo documentation, XML reference, "actuator/orientation").
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

from stepcore import checks
from stepcore.scene import controlling
from stepcore.scene.elements import Actuator
from stepcore.scene.elements.actuator import CHARTS, INPUTS
from stepcore.scene.frames import ORIGIN

# What other actuators can feed.
FED = ("pid", "dcmotor", "orientation")


def parts(actuator: Actuator) -> list[str]:
    """What the controls of an actuator are, its own first."""
    if actuator.type == "orientation":
        return list(CHARTS[actuator.input or "expmap"])
    return controlling.inputs(actuator) if actuator.type in FED else ["pos"]


def axis(actuator: Actuator) -> int | None:
    """The axis about which it turns a ball; None: it is none of those."""
    owner = actuator.feeds or actuator
    if owner.type != "orientation":
        return None
    words = parts(owner)
    at = words.index(actuator.input or "") if actuator.feeds and actuator.input in words else 0
    return at if at < 3 else None


def plain(actuator: Actuator) -> dict[str, Any]:
    """The engine's fields of an orientation, and what its control is."""
    owner, at = actuator.feeds or actuator, axis(actuator)
    gear = list(owner.gear)
    if at is not None:
        gear = [float(k == at) for k in range(3)] + list(ORIGIN)
    bounds = {} if at is None else {"forcerange": owner.forcerange and list(owner.forcerange)}
    return {
        "input": (actuator.input or "pos") if actuator.feeds else parts(actuator)[0],
        "gear": gear,
        "orientation": None if at is None else {"axis": at, "quat": owner.input == "quat"},
        **bounds,
    }


def check(actuator: Actuator) -> None:
    """ValueError for an orientation or an input that does not fit."""
    if actuator.type == "orientation":
        _check_turn(actuator)
    else:
        _check_input(actuator)


def _check_turn(actuator: Actuator) -> None:
    if actuator.input not in (None, *CHARTS):
        raise checks.refuse(actuator, "input", actuator.input, f"one of {', '.join(CHARTS)}")
    if getattr(actuator.joint, "type", "") != "ball":
        raise checks.refuse(actuator, "joint", actuator.joint, "a ball joint for an orientation")
    if actuator.forcerange is not None and actuator.forcerange[0] != 0:
        raise checks.refuse(actuator, "forcerange", actuator.forcerange, "(0, most)")
    for field in ("damping", "armature"):
        if getattr(actuator, field):
            value = getattr(actuator, field)
            raise checks.refuse(actuator, field, value, "0 for an orientation")


def _check_input(actuator: Actuator) -> None:
    owner = actuator.feeds
    if owner is None:
        limit = "a pid, a dcmotor or an orientation for type 'input'"
        raise checks.refuse(actuator, "feeds", None, limit)
    if actuator.input not in (*INPUTS, *CHARTS["quat"]):
        raise checks.refuse(actuator, "input", actuator.input, f"one of {', '.join(INPUTS)}")
    if owner.type not in FED or actuator.input not in parts(owner)[1:]:
        limit = f"with {actuator.input!r} among its inputs, and not the first"
        raise checks.refuse(actuator, "feeds", owner, limit)


def check_inputs(actuators: Sequence[Actuator]) -> None:
    """ValueError where an input of an actuator has no control, or has two."""
    fed: dict[int, list[str]] = {}
    for actuator in actuators:
        if actuator.feeds is not None and actuator.input is not None:
            fed.setdefault(id(actuator.feeds), []).append(actuator.input)
    for actuator in actuators:
        found = fed.get(id(actuator), [])
        for word in parts(actuator)[1:]:
            if found.count(word) != 1:
                limit = f"one actuator of type 'input' that feeds {word!r}, not {found.count(word)}"
                raise checks.refuse(actuator, "input", actuator.input, limit)
