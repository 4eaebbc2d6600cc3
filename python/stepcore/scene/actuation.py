"""The force law of an actuator from the fields of its type.

Its force is gain × u + bias, where u is its control or its activation; gain and bias are
(g₀, g₁, g₂) · (1, length, velocity) or those of a muscle, and length and velocity are gear × those
of what it pulls at, which feels gear × force. The conventions are MuJoCo's (documentation, XML
reference, "actuator").
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Any, NamedTuple

from stepcore import checks
from stepcore.scene import controlling, orienting
from stepcore.scene.element import Places, place_of
from stepcore.scene.elements import Actuator
from stepcore.scene.elements.actuator import LAW_FIELDS, MUSCLE, SECOND, TARGETS
from stepcore.scene.frames import ORIGIN, Vec

if TYPE_CHECKING:
    from stepcore.scene.holdings import Holdings

NO_DYNAMICS = ("none", (1.0, 0.0, 0.0))
# Fields that reach the engine as its law, and as its target.
LAW = tuple(sorted({field for fields in LAW_FIELDS.values() for field in fields}))
TARGET = (*TARGETS, *SECOND, "cranklength", "feeds")


class Law(NamedTuple):
    """An actuator as the engine reads it.

    The engine replaces a dampratio other than 0 by bias₂ = −2 × dampratio × √(kp × m), where m is
    the inertia that the actuator moves in the pose of the scene.
    """

    gain: Vec = (1.0, 0.0, 0.0)
    bias: Vec = ORIGIN
    dampratio: float = 0.0
    controller: dict[str, Any] | None = None
    dynamics: tuple[str, Vec] = NO_DYNAMICS
    muscle_gain: dict[str, Any] | None = None
    muscle_bias: dict[str, Any] | None = None

    @property
    def servo(self) -> bool:
        """Whether its force depends on length or velocity."""
        muscle = self.muscle_gain is not None or self.muscle_bias is not None
        motor = self.controller is not None and self.controller["motor"] is not None
        return motor or muscle or any(self.gain[1:]) or any(self.bias[1:]) or self.dampratio != 0


def law(actuator: Actuator) -> Law:
    """Its law, with defaults for fields that are None."""
    kind, value = actuator.type, actuator.law_value
    if kind in ("position", "intvelocity"):
        kp, timeconst = value("kp"), value("timeconst") or 0.0
        dynamics = ("filterexact", (timeconst, 0.0, 0.0)) if timeconst > 0 else NO_DYNAMICS
        if kind == "intvelocity":
            dynamics = ("integrator", (1.0, 0.0, 0.0))
        bias = (0.0, -kp, 0.0 - value("kv"))
        return Law((kp, 0.0, 0.0), bias, value("dampratio"), dynamics=dynamics)
    if kind in ("pid", "dcmotor"):
        return _controlled(actuator)
    if kind == "velocity":
        kv = value("kv")
        return Law((kv, 0.0, 0.0), (0.0, 0.0, -kv))
    if kind == "damper":
        return Law((0.0, 0.0, 0.0 - value("kv")))
    if kind == "adhesion":
        return Law((value("gain"), 0.0, 0.0))
    if kind == "cylinder":
        dynamics = ("filter", (value("timeconst"), 0.0, 0.0))
        return Law((value("area"), 0.0, 0.0), value("bias"), dynamics=dynamics)
    if kind == "muscle":
        words = {field: value(field) for field in MUSCLE}
        parameters = (*value("timeconst"), value("tausmooth"))
        return Law(ORIGIN, dynamics=("muscle", parameters), muscle_gain=words, muscle_bias=words)
    if kind == "orientation":
        kp, kv = value("kp"), value("kv")
        return Law((kp, 0.0, 0.0), (0.0, 0.0 - kp, 0.0 - kv), value("dampratio"))
    if kind == "input":
        owner = actuator.feeds
        turns = owner is not None and orienting.axis(actuator) is not None
        return law(owner) if owner is not None and turns else Law(ORIGIN)
    return _general(actuator) if kind == "general" else Law()


def _controlled(actuator: Actuator) -> Law:
    """A voltage, or a setpoint or a force of a controller."""
    value = actuator.law_value
    kp, kv, own = value("kp"), value("kv"), value("input") or "voltage"
    dampratio = value("dampratio") or 0.0
    if (controller := controlling.described(actuator)) is not None:
        turns = actuator.type == "pid" and "pos" in own.split()
        bias = (0.0, 0.0 - kp, 0.0 - kv)
        return Law((kp if turns else 0.0, 0.0, 0.0), bias, dampratio, controller)
    if own == "voltage":
        constant, resistance = value("motorconst") or 0.0, value("resistance") or 1.0
        conducted = constant / resistance
        return Law((conducted, 0.0, 0.0), (0.0, 0.0, 0.0 - conducted * constant))
    gain = {"pos": kp, "vel": kv, "ff": 1.0}[own]
    return Law((gain, 0.0, 0.0), (0.0, 0.0 - kp, 0.0 - kv), dampratio)


def _general(actuator: Actuator) -> Law:
    given = actuator.gainprm if actuator.gainprm is not None else 1.0
    gainprm = given if isinstance(given, tuple) else (given,)
    bias = actuator.biasprm if actuator.biasprm is not None else ORIGIN
    bias = bias if isinstance(bias, tuple) else (bias,)
    gain, bias = (*gainprm, *ORIGIN)[:3], (*bias, *ORIGIN)
    dynamics = (actuator.dyntype or "none", actuator.dynprm or (1.0, 0.0, 0.0))
    result = Law((gain[0], 0.0, 0.0), dynamics=dynamics)
    if actuator.gaintype == "affine":
        result = result._replace(gain=gain)
    if actuator.gaintype == "muscle":
        result = result._replace(gain=ORIGIN, muscle_gain=_muscle(gainprm))
    if actuator.biastype == "muscle":
        result = result._replace(muscle_bias=_muscle(bias))
    elif actuator.biastype != "none":
        result = result._replace(bias=bias[:3])
        if actuator.gaintype in (None, "fixed") and gain[0] == -bias[1] and bias[2] > 0:
            # A position servo whose damping is written as a ratio: MuJoCo's convention.
            result = result._replace(bias=(bias[0], bias[1], 0.0), dampratio=bias[2])
    return result


def _muscle(parameters: Vec) -> dict[str, Any]:
    numbers = (*parameters, *(0.0,) * 9)[:9]
    return dict(zip(MUSCLE, (numbers[:2], *numbers[2:]), strict=True))


def na(scene: Holdings) -> int:
    """The number of activations in a scene."""
    return sum(states(law(actuator)) for actuator in scene.actuators)


def states(own: Law) -> int:
    """The number of activations of an actuator with this law."""
    if own.controller is not None:
        return controlling.states(own.controller)
    return int(own.dynamics[0] != "none")


def plain(actuator: Actuator, places: Places) -> dict[str, Any]:
    """The actuator as the engine reads it."""
    own = law(actuator)
    kind, parameters = own.dynamics
    # What a muscle leaves to be found stands in its place: `length_ranges.fill`.
    muscle = own.muscle_gain is not None or own.muscle_bias is not None
    lengthrange = actuator.lengthrange or (0.0, 1.0 if muscle else 0.0)
    feeds = None if actuator.feeds is None else place_of(places, actuator.feeds)
    return actuator.record("type", *LAW, *TARGET) | {
        "target": _target(actuator, places),
        "feeds": feeds,
        "gain": list(own.gain),
        "bias": list(own.bias),
        "dampratio": own.dampratio,
        "controller": own.controller,
        **orienting.plain(actuator),
        "dynamics": kind,
        "dynprm": list(parameters),
        "muscle_gain": _listed(own.muscle_gain),
        "muscle_bias": _listed(own.muscle_bias),
        "lengthrange": list(lengthrange),
    }


def _listed(words: dict[str, Any] | None) -> dict[str, Any] | None:
    return words and {**words, "range": list(words["range"])}


def _target(actuator: Actuator, places: Places) -> dict[str, Any]:
    """What it pulls at as the engine reads it."""
    field, element = actuator.target
    own: dict[str, Any] = {field: -1 if element is None else place_of(places, element)}
    actuator = actuator.feeds or actuator
    if field == "site":
        reference = actuator.refsite
        own["refsite"] = None if reference is None else place_of(places, reference)
    if field == "cranksite" and actuator.slidersite is not None:
        own["slidersite"] = place_of(places, actuator.slidersite)
        own["cranklength"] = actuator.cranklength
    return own


def check(actuator: Actuator) -> None:
    """ValueError for fields that the type does not have, or that contradict each other."""
    own = LAW_FIELDS[actuator.type]
    for word in LAW:
        if getattr(actuator, word) is not None and word not in own:
            has = ", ".join(own) or "none of these"
            limit = f"None for type {actuator.type!r}, which has {has}"
            raise checks.refuse(actuator, word, getattr(actuator, word), limit)
    _check_target(actuator)
    if actuator.delay > 0 and actuator.nsample == 0:
        raise checks.refuse(actuator, "nsample", 0, ">= 1 with a delay")
    pair, timeconst = isinstance(actuator.timeconst, tuple), actuator.timeconst
    if timeconst is not None and pair != (actuator.type == "muscle"):
        limit = "two numbers for a muscle, one for others"
        raise checks.refuse(actuator, "timeconst", timeconst, limit)
    if actuator.type in ("pid", "dcmotor"):
        controlling.check(actuator)
    if actuator.type in ("orientation", "input"):
        orienting.check(actuator)
    if actuator.type in ("position", "intvelocity", "damper", "pid", "orientation"):
        for word in ("kv", "dampratio", "timeconst"):
            if (getattr(actuator, word) or 0.0) < 0:
                raise checks.refuse(actuator, word, getattr(actuator, word), ">= 0")
        if actuator.kv and actuator.dampratio:
            raise checks.ElementError(actuator, "kv and dampratio are both given")
    lowest = -1.0 if actuator.ctrlrange is None else actuator.ctrlrange[0]
    if actuator.type in ("damper", "adhesion") and lowest < 0:
        limit = f">= 0 for type {actuator.type!r}"
        raise checks.refuse(actuator, "ctrlrange", actuator.ctrlrange, limit)
    own_law = law(actuator)
    if own_law.dynamics[0] == "none" and actuator.actrange is not None:
        raise checks.refuse(actuator, "actrange", actuator.actrange, "None without an activation")
    _check_curves(actuator, own_law)
    if own_law.dampratio and own_law.gain[0] < 0:
        word = "gainprm" if actuator.type == "general" else "kp"
        raise checks.refuse(actuator, word, own_law.gain[0], ">= 0 with a damping ratio")


def _check_curves(actuator: Actuator, own: Law) -> None:
    """A muscle's curves divide by these; MuJoCo's limits."""
    named = (("gainprm", own.muscle_gain), ("biasprm", own.muscle_bias))
    for field, words in named:
        if words is None:
            continue
        low, high = words["range"]
        limits = {
            "range": (low < high, "in ascending order"),
            **{word: (words[word] > 0, "> 0") for word in ("scale", "vmax", "fpmax", "fvmax")},
            "lmin": (words["lmin"] < 1, "below 1"),
            "lmax": (words["lmax"] > 1, "above 1"),
        }
        for word, (holds, limit) in limits.items():
            if not holds:
                where = word if actuator.type == "muscle" else field
                raise checks.refuse(actuator, where, words[word], f"{limit} ({word} of a muscle)")


def _check_target(actuator: Actuator) -> None:
    if actuator.body is not None and law(actuator).servo:
        raise checks.ElementError(actuator, "a servo has no length at the contacts of a body")
    if actuator.type == "adhesion" and actuator.body is None:
        raise checks.refuse(actuator, "body", None, "given for an adhesion")
    found = [field for field in TARGETS if getattr(actuator, field) is not None]
    if actuator.type == "input":
        if found:
            limit = "None for type 'input', which pulls at nothing itself"
            raise checks.refuse(actuator, found[0], getattr(actuator, found[0]), limit)
        return
    if len(found) != 1:
        what = " and ".join(found) or "nothing"
        text = f"pulls at {what}: it needs exactly one of {', '.join(TARGETS)}"
        raise checks.ElementError(actuator, text)
    for second, first in SECOND.items():
        if getattr(actuator, second) is not None and found[0] != first:
            raise checks.refuse(
                actuator, second, getattr(actuator, second), f"None without a {first}"
            )
    if found[0] == "cranksite":
        if actuator.slidersite is None:
            raise checks.refuse(actuator, "slidersite", None, "given with a cranksite")
        if actuator.cranklength <= 0:
            raise checks.refuse(actuator, "cranklength", actuator.cranklength, "> 0")
    elif actuator.cranklength:
        raise checks.refuse(actuator, "cranklength", actuator.cranklength, "0 without a cranksite")
    if found[0] not in ("joint", "jointinparent", "tendon"):
        for field in ("damping", "dampingpoly", "armature"):
            value = getattr(actuator, field)
            if any(value) if isinstance(value, tuple) else value:
                raise checks.refuse(
                    actuator, field, value, "0 unless it drives a joint or a tendon"
                )
