"""The force laws of actuators: one row for each type.

A force is gain × u + bias, where u is the control or the activation. Gain and bias are
(g₀, g₁, g₂) · (1, length, velocity) or the curves of a muscle. Length and velocity are gear × those
of the transmission target; the force on the target is gear × force. Conventions are MuJoCo's
(documentation, XML reference, "actuator"). MuJoCo's ``<general>`` can express every law without a
controller.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any, NamedTuple

from stepcore.scene.frames import ORIGIN, Vec

Values = Mapping[str, Any]

INPUTS = ("pos", "vel", "ff", "voltage")
# The components of an orientation, by representation.
CHARTS = {"expmap": ("x", "y", "z"), "quat": ("w", "x", "y", "z")}
# Types that accept controls of other actuators.
FED = ("pid", "dcmotor", "orientation")
# A muscle's parameters in the order of gainprm, with their defaults.
MUSCLE: dict[str, Any] = {
    "range": (0.75, 1.05),
    "force": -1.0,
    "scale": 200.0,
    "lmin": 0.5,
    "lmax": 1.6,
    "vmax": 1.5,
    "fpmax": 1.3,
    "fvmax": 1.2,
}
CONTROL = ("ki", "imax", "slewmax")


class Law(NamedTuple):
    """The force law of an actuator, with the fields of MuJoCo's ``<general>``.

    gaintype: "fixed", "affine" or "muscle".
    biastype: "none", "affine" or "muscle".
    dampratio: a value other than 0 replaces bias₂ by −2 × dampratio × √(kp × m), where m is the
        inertia that the actuator moves in the initial pose. MuJoCo writes it as a positive bias₂.
    controller: the parameters of a pid or a dcmotor that gain and bias cannot express, under the
        engine's names.
    """

    gaintype: str = "fixed"
    gainprm: Vec = (1.0,)
    biastype: str = "none"
    biasprm: Vec = ORIGIN
    dyntype: str = "none"
    dynprm: Vec = (1.0, 0.0, 0.0)
    dampratio: float = 0.0
    controller: dict[str, Any] | None = None

    @property
    def gain(self) -> Vec:
        """The factors of (1, length, velocity) in the gain."""
        numbers = (*self.gainprm, *ORIGIN)[:3]
        by_type = {"fixed": (numbers[0], 0.0, 0.0), "affine": numbers}
        return by_type.get(self.gaintype, ORIGIN)

    @property
    def bias(self) -> Vec:
        """The factors of (1, length, velocity) in the bias."""
        return (*self.biasprm, *ORIGIN)[:3] if self.biastype == "affine" else ORIGIN

    @property
    def muscle_gain(self) -> dict[str, Any] | None:
        """The parameters of a muscle's gain; None for other gains."""
        return _muscle(self.gainprm) if self.gaintype == "muscle" else None

    @property
    def muscle_bias(self) -> dict[str, Any] | None:
        """The parameters of a muscle's bias; None for other biases."""
        return _muscle(self.biasprm) if self.biastype == "muscle" else None

    @property
    def is_muscle(self) -> bool:
        return "muscle" in (self.gaintype, self.biastype)

    @property
    def holds_length(self) -> bool:
        """Whether MuJoCo takes this for a position servo: force kp × (control − length)."""
        fixed = self.gaintype == "fixed" and self.biastype == "affine"
        return fixed and self.gainprm[0] == -(*self.biasprm, *ORIGIN)[1]

    @property
    def servo(self) -> bool:
        """Whether the force depends on length or velocity."""
        motor = self.controller is not None and self.controller["motor"] is not None
        terms = (*self.gain[1:], *self.bias[1:], self.dampratio)
        return motor or self.is_muscle or any(terms)

    @property
    def states(self) -> int:
        """The number of activations of an actuator with this law."""
        if self.controller is None:
            return int(self.dyntype != "none")
        motor = self.controller["motor"] or dict.fromkeys(("thermal", "lugre", "inductance"))
        kept = (self.controller["slewmax"], self.controller["ki"])
        return sum(map(bool, (*kept, motor["thermal"], motor["lugre"], motor["inductance"])))

    def general(self) -> dict[str, Any]:
        """Return the fields of an actuator of type "general" with this law."""
        fields = dict(zip(GENERAL, self, strict=False))
        if self.dampratio:
            fields["biasprm"] = (*self.biasprm[:2], self.dampratio)
        return fields


GENERAL = Law._fields[:6]


def _muscle(numbers: Vec) -> dict[str, Any]:
    numbers = (*numbers, *(0.0,) * 9)[:9]
    return dict(zip(MUSCLE, (numbers[:2], *numbers[2:]), strict=True))


# From the fields of a type to its law, and back. Fields that are None have their defaults here.


def _general(values: Values) -> Law:
    def numbers(name: str) -> Vec:
        value = values[name]
        return value if isinstance(value, tuple) else (value,)

    fields = {name: values[name] for name in GENERAL}
    law = Law(**(fields | {name: numbers(name) for name in ("gainprm", "biasprm", "dynprm")}))
    if law.holds_length and (*law.biasprm, *ORIGIN)[2] > 0:
        bias = (*law.biasprm[:2], 0.0, *law.biasprm[3:])
        law = law._replace(biasprm=bias, dampratio=law.biasprm[2])
    return law


def _servo(values: Values) -> Law:
    kp, times = values["kp"], values.get("timeconst", 0.0)
    law = Law("fixed", (kp,), "affine", (0.0, -kp, 0.0 - values["kv"]))
    if times > 0:
        law = law._replace(dyntype="filterexact", dynprm=(times, 0.0, 0.0))
    return law._replace(dampratio=values["dampratio"])


def _from_servo(law: Law) -> dict[str, Any]:
    return {"kp": law.gainprm[0]} | damping(law.dampratio or (*law.biasprm, *ORIGIN)[2])


def damping(number: float) -> dict[str, Any]:
    """Return the field that MuJoCo's biasprm[2] means: a damping ratio above 0, otherwise −kv."""
    return {"dampratio": number} if number > 0 else {"kv": 0.0 - number}


def _velocity(values: Values) -> Law:
    return Law("fixed", (values["kv"],), "affine", (0.0, 0.0, -values["kv"]))


def _cylinder(values: Values) -> Law:
    times = (values["timeconst"], 0.0, 0.0)
    return Law("fixed", (values["area"],), "affine", values["bias"], "filter", times)


def _from_cylinder(law: Law) -> dict[str, Any]:
    bias = law.general()["biasprm"][:3]
    return {"area": law.gainprm[0], "bias": bias, "timeconst": law.dynprm[0]}


def _of_muscle(values: Values) -> Law:
    numbers = (*values["range"], *(values[field] for field in list(MUSCLE)[1:]))
    times = (*values["timeconst"], values["tausmooth"])
    return Law("muscle", numbers, "muscle", numbers, "muscle", times)


def _pid(values: Values) -> Law:
    words = inputs("pid", values["input"])
    # With a damping ratio the engine computes kv, which is also the gain of the velocity input.
    by_ratio = words == ["vel"] and bool(values["dampratio"])
    gains = {field: values[field] or 0.0 for field in CONTROL}
    kp, kv = values["kp"], values["kv"]
    law = Law("fixed", (kp,), "affine", (0.0, 0.0 - kp, 0.0 - kv), dampratio=values["dampratio"])
    if len(words) > 1 or gains["ki"] or gains["slewmax"] or by_ratio:
        gain = kp if "pos" in words else 0.0
        return law._replace(gainprm=(gain,), controller={**gains, "motor": None})
    return law._replace(gainprm=(_gains(kp, kv).get(words[0], 0.0),))


def _gains(kp: float, kv: float) -> dict[str, float]:
    return {"pos": kp, "vel": kv, "ff": 1.0}


def _dcmotor(values: Values) -> Law:
    words = inputs("dcmotor", values["input"])
    gains = {field: values[field] or 0.0 for field in CONTROL}
    kp, kv = values["kp"], values["kv"]
    law = Law("fixed", (0.0,), "affine", (0.0, 0.0 - kp, 0.0 - kv))
    lugre, cogging = values["lugre"], values["cogging"]
    numbers = {f: values[f] or 0.0 for f in ("resistance", "inductance", "vmax", "current_rate")}
    more = (gains["ki"], gains["slewmax"], *list(numbers.values())[1:], *cogging)
    if len(words) > 1 or any(more) or any(values["thermal"] or ()) or any(lugre or ()):
        motor = {
            **numbers,
            "constant": values["motorconst"],
            "thermal": values["thermal"] and list(values["thermal"]),
            "cogging": list(cogging),
            "lugre": list(lugre) if lugre is not None and lugre[0] > 0 else None,
        }
        return law._replace(controller={**gains, "motor": motor})
    if words == ["voltage"]:
        conducted = values["motorconst"] / values["resistance"]
        bias = (0.0, 0.0, 0.0 - conducted * values["motorconst"])
        return law._replace(gainprm=(conducted,), biasprm=bias)
    return law._replace(gainprm=(_gains(kp, kv).get(words[0], 0.0),))


@dataclass(frozen=True)
class LawType:
    """A type of actuator.

    fields: the fields of the type's law, with their defaults; other fields are refused.
    to_law: returns the law for values of these fields.
    from_law: returns the fields for a law that an MJCF default class gives as ``<general>``; None
        for a type that inherits no such law.
    """

    fields: dict[str, Any]
    to_law: Callable[[Values], Law] = lambda _: Law()
    from_law: Callable[[Law], dict[str, Any]] | None = None


_SERVO = {"kp": 1.0, "kv": 0.0, "dampratio": 0.0}
_CONTROL = dict.fromkeys(CONTROL, 0.0)
_MOTOR = {
    **{"motorconst": 0.0, "resistance": 1.0, "inductance": 0.0, "vmax": 0.0, "current_rate": 0.0},
    **{"thermal": None, "cogging": ORIGIN, "lugre": None},
}
LAWS = {
    "motor": LawType({}),
    "position": LawType(_SERVO | {"timeconst": 0.0}, _servo, _from_servo),
    "velocity": LawType({"kv": 1.0}, _velocity, lambda law: {"kv": law.gainprm[0]}),
    "intvelocity": LawType(
        _SERVO, lambda values: _servo(values)._replace(dyntype="integrator"), _from_servo
    ),
    "pid": LawType(_SERVO | {"input": None} | _CONTROL, _pid),
    "dcmotor": LawType({"kp": 0.0, "kv": 0.0, "input": "voltage"} | _CONTROL | _MOTOR, _dcmotor),
    # Without a force, except where it feeds an orientation (`Actuator.law`).
    "input": LawType({"input": None}, lambda _: Law(gainprm=(0.0,))),
    "orientation": LawType(_SERVO | {"input": "expmap"}, _servo),
    "damper": LawType(
        {"kv": 1.0},
        lambda values: Law("affine", (0.0, 0.0, 0.0 - values["kv"])),
        lambda _: {"kv": 0.0},
    ),
    "cylinder": LawType({"timeconst": 1.0, "area": 1.0, "bias": ORIGIN}, _cylinder, _from_cylinder),
    "adhesion": LawType(
        {"gain": 1.0},
        lambda values: Law(gainprm=(values["gain"],)),
        lambda law: {"gain": law.gainprm[0]},
    ),
    "muscle": LawType(
        MUSCLE | {"timeconst": (0.01, 0.04), "tausmooth": 0.0}, _of_muscle, lambda _: {}
    ),
    "general": LawType(
        dict(zip(GENERAL, Law(biastype="affine"), strict=False)) | {"gainprm": 1.0}, _general
    ),
}
LAW_FIELDS = {name: each.fields for name, each in LAWS.items()}
ALL_LAW_FIELDS = tuple(sorted({field for fields in LAW_FIELDS.values() for field in fields}))


def inputs(kind: str, words: str | None) -> list[str]:
    """Return the meanings of an actuator's controls, first that of its control input.

    given: the actuator's field `input`.
    """
    if kind == "orientation":
        return list(CHARTS[words or "expmap"])
    return (words or "voltage").split() if kind in FED else ["pos"]
