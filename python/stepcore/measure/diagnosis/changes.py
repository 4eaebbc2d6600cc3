"""What can be changed of an element so that a larger dt is stable.

A change has one number x: a gain is multiplied by x, an armature grows by x times the inertia that
the element moves, a damping by x times its critical one, a solref becomes slower by 1/x. It is
made on a copy of the scene, with values rounded to three digits on the side of more change.
"""

from __future__ import annotations

import copy
import math
from collections.abc import Sequence
from dataclasses import dataclass

from stepcore.engine.model import Model
from stepcore.measure.diagnosis.element_limits import ElementLimits
from stepcore.measure.diagnosis.solref import solref_of
from stepcore.report.units import unit_of
from stepcore.scene.elements import Actuator, Joint
from stepcore.scene.layout import Layout
from stepcore.scene.scene import Scene

DIGITS = 3


@dataclass(frozen=True)
class Change:
    """A way to change elements. xs: the values of x to try, from little change to much."""

    what: str
    xs: tuple[float, ...]


def _less(what: str) -> Change:
    return Change(what, tuple(2.0**-k for k in range(1, 31)))


def _more(what: str) -> Change:
    return Change(what, tuple(2.0**k for k in range(-7, 15)))


GAINS = _less("kp and kv")
ARMATURE, DAMPING, SOLREF = _more("armature"), _more("more damping"), _less("solref")
CHANGES: dict[str, tuple[Change, ...]] = {
    "spring": (_less("stiffness"), ARMATURE, DAMPING),
    "damper": (_less("damping"), ARMATURE),
    "servo": (_less("kp"), _less("kv"), GAINS, ARMATURE, DAMPING),
    "contact": (SOLREF,),
    "limit": (SOLREF,),
    "friction loss": (SOLREF,),
    "connect": (SOLREF,),
}


@dataclass(frozen=True)
class Value:
    """What one field of one element is, and what it would be."""

    element: str
    field: str
    before: tuple[float, ...]
    after: tuple[float, ...]
    unit: str = ""

    @property
    def text(self) -> str:
        """As a report tells it."""
        old, new = (" ".join(f"{x:.6g}" for x in side) for side in (self.before, self.after))
        unit = f" {self.unit}" if self.unit else ""
        return f"{self.field} of {self.element} {old} → {new}{unit}"


def changed(
    model: Model, elements: Sequence[ElementLimits], change: Change, x: float
) -> tuple[Scene, list[Value]]:
    """A copy of the model's scene with `change` made to some elements, and what is new in it."""
    scene = copy.deepcopy(model.scene)
    layout = Layout(scene)
    values: list[Value] = []
    for element in elements:
        if change not in CHANGES.get(element.key.kind, ()):
            continue
        if change is SOLREF:
            values += _softer(model, layout, element, x)
        elif change in (ARMATURE, DAMPING):
            values += _added(model, layout, element, change, x)
        else:
            for field in ("kp", "kv") if change is GAINS else (change.what,):
                values += _scaled(layout, element, field, x)
    return scene, values


def _scaled(layout: Layout, element: ElementLimits, field: str, x: float) -> list[Value]:
    """A gain of the element times x."""
    joint = _joint(layout, element)
    owner: Joint | Actuator = joint
    if element.key.kind == "servo":
        owner = layout.scene.actuators[element.key.index[0]]
        if owner.type == "general":
            return _general(owner, element, field, x)
        if field == "kv" and owner.dampratio:
            field = "dampratio"
        elif field == "kp" and owner.type == "velocity":
            return []
    old = getattr(owner, field)
    if old is None:
        # The default of the gain that the actuator's type is named after.
        old = 1.0 if (field == "kp") == (getattr(owner, "type", "") == "position") else 0.0
    if old <= 0:
        return []
    new = rounded(old * x, up=False)
    setattr(owner, field, new)
    return [Value(element.key.label, field, (old,), (new,), _unit(field, joint))]


def _general(servo: Actuator, element: ElementLimits, field: str, x: float) -> list[Value]:
    """The feedback of a general actuator: biasprm[1], with its gain, or biasprm[2]."""
    bias = servo.biasprm or (0.0, 0.0, 0.0)
    at = 1 if field == "kp" else 2
    if bias[at] == 0:
        return []
    new = math.copysign(rounded(abs(bias[at]) * x, up=False), bias[at])
    if at == 1:
        factor = new / bias[1]
        if servo.gainprm is not None:
            servo.gainprm *= factor
        after = (bias[0] * factor, new, bias[2])
    else:
        after = (bias[0], bias[1], new)
    servo.biasprm = after
    return [Value(element.key.label, "biasprm", bias, after)]


def _added(
    model: Model, layout: Layout, element: ElementLimits, change: Change, x: float
) -> list[Value]:
    """Armature or damping on the element's joint, beside the mass that it moves."""
    joint = _joint(layout, element)
    if change is DAMPING and element.omega == 0:
        return []
    dof = model.jnt_dofadr[layout.joints.index(joint)]
    mass = 1 / float(model.dof_invweight0[dof])
    field = "armature" if change is ARMATURE else "damping"
    old = getattr(joint, field)
    more = x * mass if change is ARMATURE else x * 2 * mass * element.omega
    new = rounded(old + more, up=True)
    setattr(joint, field, new)
    name = joint.name or f"joint {layout.joints.index(joint)}"
    return [Value(f'joint "{name}"', field, (old,), (new,), _unit(field, joint))]


def _softer(model: Model, layout: Layout, element: ElementLimits, x: float) -> list[Value]:
    """A solref slower by 1/x: tc / x, or in direct form stiffness x² and damping x."""
    key, scene = element.key, layout.scene
    old = solref_of(model, Layout(model.scene), key)
    if old is None:
        return []
    if old[0] > 0:
        new = (rounded(old[0] / x, up=True), old[1])
    else:
        new = (-rounded(-old[0] * x * x, up=False), -rounded(-old[1] * x, up=False))
    if key.kind == "contact":
        for geom in key.index:
            layout.geoms[geom].solref = new
        return [Value("both geoms of " + key.label, "solref", old, new)]
    if key.kind == "connect":
        scene.equalities[key.index[0]].solref = new
        return [Value(key.label, "solref", old, new)]
    field = "solreflimit" if key.kind == "limit" else "solreffriction"
    setattr(layout.joints[key.index[0]], field, new)
    return [Value(key.label, field, old, new)]


def _joint(layout: Layout, element: ElementLimits) -> Joint:
    index = element.key.index[0]
    if element.key.kind == "servo":
        return layout.scene.actuators[index].joint
    return layout.joints[index]


def _unit(field: str, joint: Joint) -> str:
    return unit_of(field, joint.type in ("hinge", "ball"))


def rounded(value: float, *, up: bool) -> float:
    """A number >= 0 with three digits, not above (or below) the one given.

    >>> rounded(1234.5, up=False), rounded(0.0012341, up=True)
    (1230.0, 0.00124)
    """
    if value <= 0:
        return 0.0
    place = math.floor(math.log10(value)) - DIGITS + 1
    count = value / 10.0**place
    # What has three digits already stays as it is.
    whole = round(count)
    if not math.isclose(count, whole, rel_tol=1e-9):
        whole = math.ceil(count) if up else math.floor(count)
    return float(f"{whole}e{place}")
