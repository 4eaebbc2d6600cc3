"""Gain and bias of an actuator from its fields kp, kv, dampratio, gainprm and biasprm.

Its force is gain × control + bias₀ + bias₁ × length + bias₂ × velocity, where length and
velocity are gear × those of the joint; the joint feels gear × force. The conventions are
MuJoCo's (documentation, XML reference, "actuator").
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Any, NamedTuple

from stepcore import checks
from stepcore.scene.elements import Actuator
from stepcore.scene.frames import ORIGIN, Vec

if TYPE_CHECKING:
    from stepcore.scene.contents import Contents

# The fields of each type of actuator; those of other types are refused.
WORDS = {
    "motor": (),
    "position": ("kp", "kv", "dampratio", "timeconst"),
    "velocity": ("kv",),
    "general": ("gainprm", "biasprm", "dyntype", "dynprm"),
}


class Gains(NamedTuple):
    """An actuator as the engine reads it.

    The engine replaces a dampratio other than 0 by bias₂ = −2 × dampratio × √(kp × m), where m is
    the inertia that the actuator moves in the pose of the scene.
    """

    gain: float = 1.0
    bias: Vec = ORIGIN
    dampratio: float = 0.0


def gains(actuator: Actuator) -> Gains:
    """Gain, bias and damping ratio, with defaults for fields that are None."""
    if actuator.type == "position":
        kp = _or(actuator.kp, 1.0)
        damping = _or(actuator.kv, 0.0)
        return Gains(kp, (0.0, -kp, -damping), _or(actuator.dampratio, 0.0))
    if actuator.type == "velocity":
        kv = _or(actuator.kv, 1.0)
        return Gains(kv, (0.0, 0.0, -kv))
    if actuator.type == "general":
        gain, bias = _or(actuator.gainprm, 1.0), actuator.biasprm or ORIGIN
        if gain == -bias[1] and bias[2] > 0:
            # A position servo whose damping is written as a ratio: MuJoCo's convention.
            return Gains(gain, (bias[0], bias[1], 0.0), bias[2])
        return Gains(gain, bias)
    return Gains()


def dynamics(actuator: Actuator) -> tuple[str, Vec]:
    """The type of its activation, "none" if it has none, and the parameters of that."""
    if actuator.type == "position":
        timeconst = _or(actuator.timeconst, 0.0)
        return ("filterexact" if timeconst > 0 else "none"), (timeconst, 0.0, 0.0)
    return actuator.dyntype or "none", actuator.dynprm or (1.0, 0.0, 0.0)


def na(scene: Contents) -> int:
    """The number of activations in a scene."""
    return sum(dynamics(actuator)[0] != "none" for actuator in scene.actuators)


def plain(actuator: Actuator) -> dict[str, Any]:
    """The gains and the dynamics as the engine's fields."""
    gain, bias, dampratio = gains(actuator)
    kind, parameters = dynamics(actuator)
    terms = {"gain": gain, "bias": list(bias), "dampratio": dampratio}
    return terms | {"dynamics": kind, "dynprm": list(parameters)}


def check(actuator: Actuator) -> None:
    """ValueError for fields that the type does not have, or that contradict each other."""
    own = WORDS[actuator.type]
    for word in sorted({word for words in WORDS.values() for word in words}):
        if getattr(actuator, word) is not None and word not in own:
            has = ", ".join(own) or "none of these"
            limit = f"None for type {actuator.type!r}, which has {has}"
            raise checks.refuse(actuator, word, getattr(actuator, word), limit)
    if actuator.type == "position":
        for word in ("kv", "dampratio", "timeconst"):
            if _or(getattr(actuator, word), 0.0) < 0:
                raise checks.refuse(actuator, word, getattr(actuator, word), ">= 0")
        if actuator.kv and actuator.dampratio:
            raise checks.ElementError(actuator, "kv and dampratio are both given")
    if dynamics(actuator)[0] == "none" and actuator.actrange is not None:
        raise checks.refuse(actuator, "actrange", actuator.actrange, "None without an activation")
    gain, bias, dampratio = gains(actuator)
    if dampratio and gain < 0:
        word = "kp" if actuator.type == "position" else "gainprm"
        raise checks.refuse(actuator, word, gain, ">= 0 with a damping ratio")
    kind = actuator.joint.type
    if (any(bias[1:]) or dampratio) and kind in ("ball", "free"):
        text = f"a servo on a {kind} joint is not built yet: hinges and slides have them"
        raise checks.ElementError(actuator, text)


def _or(value: float | None, default: float) -> float:
    return default if value is None else value
