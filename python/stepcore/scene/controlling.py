"""Controllers: what of a `pid` or a `dcmotor` the engine does not have as gain and bias.

Several inputs, the integral of the error, a target that moves at a bounded rate, and a motor's
voltage, current, temperature, cogging and bristles (MuJoCo documentation, XML reference,
"actuator/pid" and "actuator/dcmotor").
"""

from __future__ import annotations

from typing import Any

from stepcore import checks
from stepcore.scene.elements import Actuator
from stepcore.scene.frames import ORIGIN

CONTROL = ("ki", "imax", "slewmax")
# A motor's numbers; the first two alone make no controller.
MOTOR = (
    *("motorconst", "resistance", "inductance", "vmax", "current_rate", "thermal", "cogging"),
    "lugre",
)


def inputs(actuator: Actuator) -> list[str]:
    """What the controls of a controller are, its own first."""
    return (actuator.input or "voltage").split()


def described(actuator: Actuator) -> dict[str, Any] | None:
    """The engine's controller; None where gain and bias are all of its law."""
    if actuator.type not in ("pid", "dcmotor"):
        return None
    given = {word: getattr(actuator, word) or 0.0 for word in (*CONTROL, *MOTOR)}
    more = ("ki", "slewmax", *MOTOR[2:])
    # What a ratio makes of kv is known to the engine, which is then the gain of a velocity too.
    by_ratio = inputs(actuator) == ["vel"] and bool(actuator.dampratio)
    stateless = not any(_any(given[word]) for word in more)
    if len(inputs(actuator)) == 1 and stateless and not by_ratio:
        return None
    own = {word: given[word] for word in CONTROL}
    if actuator.type == "pid":
        return {**own, "motor": None}
    rubs = actuator.lugre is not None and actuator.lugre[0] > 0
    motor = {
        **{word: given[word] for word in ("resistance", "inductance", "vmax", "current_rate")},
        "constant": given["motorconst"],
        "thermal": actuator.thermal and list(actuator.thermal),
        "cogging": list(actuator.cogging or ORIGIN),
        "lugre": list(actuator.lugre or ()) if rubs else None,
    }
    return {**own, "motor": motor}


def states(controller: dict[str, Any]) -> int:
    """The number of its activations."""
    motor = controller["motor"] or dict.fromkeys(("thermal", "lugre", "inductance"))
    kept = (controller["slewmax"], controller["ki"])
    return sum(map(bool, (*kept, motor["thermal"], motor["lugre"], motor["inductance"])))


def _any(value: Any) -> bool:
    return any(value) if isinstance(value, tuple) else bool(value)


def check(actuator: Actuator) -> None:
    """ValueError for numbers of a controller that do not go together."""
    words = inputs(actuator)
    if actuator.type == "dcmotor":
        _check_motor(actuator, words)
    elif actuator.input is None or "voltage" in words:
        raise checks.refuse(actuator, "input", actuator.input, "some of pos, vel, ff for a pid")
    if actuator.ki and "pos" not in words:
        raise checks.refuse(actuator, "ki", actuator.ki, "None without the input pos")
    first = words[0] == "pos" or (actuator.type == "dcmotor" and words[0] != "voltage")
    if actuator.slewmax and not first:
        what = "pos" if actuator.type == "pid" else "pos, vel or ff"
        raise checks.refuse(actuator, "slewmax", actuator.slewmax, f"None without the input {what}")
    _check_turns(actuator, words)


def _check_motor(actuator: Actuator, words: list[str]) -> None:
    for word in ("motorconst", "resistance"):
        if (getattr(actuator, word) or 0.0) <= 0:
            raise checks.refuse(actuator, word, getattr(actuator, word), "> 0")
    if words == ["voltage"]:
        for word in ("kp", "kv", *CONTROL, "vmax"):
            if getattr(actuator, word):
                limit = "None or 0 without an input pos, vel or ff"
                raise checks.refuse(actuator, word, getattr(actuator, word), limit)
    if (actuator.vmax or 0.0) < 0:
        raise checks.refuse(actuator, "vmax", actuator.vmax, ">= 0 for a dcmotor")
    if actuator.thermal and min(actuator.thermal[:2]) <= 0:
        limit = "resistance and capacity > 0"
        raise checks.refuse(actuator, "thermal", actuator.thermal, limit)


def _check_turns(actuator: Actuator, words: list[str]) -> None:
    """On a circle only a target without a state of its own is taken the shorter way."""
    if actuator.refsite is None and getattr(actuator.target[1], "type", "") != "ball":
        return
    turns = "pos" in words and actuator.type == "pid"
    if actuator.kp and not turns:
        limit = "0 on a ball or a refsite, but for a pid with the input pos"
        raise checks.refuse(actuator, "kp", actuator.kp, limit)
    for word in ("ki", "slewmax"):
        if getattr(actuator, word):
            raise checks.refuse(
                actuator, word, getattr(actuator, word), "None on a ball or a refsite"
            )
