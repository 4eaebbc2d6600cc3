"""Ways to change an element so that a larger dt is stable.

A change has one number x: a gain is multiplied by x, an armature grows by x times the inertia that
the element moves, a damping by x times the critical one, a solref becomes slower by 1/x. It is made
on a copy of the scene; values are rounded to three digits, towards more change.
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
    """A way to change elements. xs: the values of x to try, from little change to large."""

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
    "actuator": (_less("kp"), _less("kv"), GAINS, ARMATURE, DAMPING),
    "contact": (SOLREF,),
    "limit": (SOLREF,),
    "friction loss": (SOLREF,),
    "connect": (SOLREF,),
}


@dataclass(frozen=True)
class NewValue:
    """A value of the scene before and after a change.

    owner: the name of the element that has it, such as "servo `elbow`". field: which of its fields,
    as in `Scene`. before, after: the numbers, in `unit`.
    """

    owner: str
    field: str
    before: tuple[float, ...]
    after: tuple[float, ...]
    unit: str = ""

    @property
    def text(self) -> str:
        """The change in words."""
        old, new = (" ".join(f"{x:.6g}" for x in side) for side in (self.before, self.after))
        unit = f" {self.unit}" if self.unit else ""
        return f"change {self.field} of {self.owner} from {old} to {new}{unit}"


def changed(
    model: Model, elements: Sequence[ElementLimits], change: Change, x: float
) -> tuple[Scene, list[NewValue]]:
    """A copy of the model's scene with `change` made to some elements, and its new values."""
    scene = copy.deepcopy(model.scene)
    layout = Layout(scene)
    values: list[NewValue] = []
    for element in elements:
        if change not in CHANGES.get(element.element.kind, ()):
            continue
        if change is SOLREF:
            values += _softer(model, layout, element, x)
        elif change in (ARMATURE, DAMPING):
            values += _added(model, layout, element, change, x)
        else:
            for field in ("kp", "kv") if change is GAINS else (change.what,):
                values += _scaled(layout, element, field, x)
    return scene, values


def _scaled(layout: Layout, element: ElementLimits, field: str, x: float) -> list[NewValue]:
    """A gain of the element times x."""
    joint = _joint(layout, element)
    owner: Joint | Actuator = joint
    if element.element.kind == "actuator":
        owner = layout.scene.actuators[element.element.index]
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
    return [NewValue(element.name, field, (old,), (new,), _unit(field, joint))]


def _general(servo: Actuator, element: ElementLimits, field: str, x: float) -> list[NewValue]:
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
    return [NewValue(element.name, "biasprm", bias, after)]


def _added(
    model: Model, layout: Layout, element: ElementLimits, change: Change, x: float
) -> list[NewValue]:
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
    owner = model.element_name("joint", layout.joints.index(joint))
    return [NewValue(owner, field, (old,), (new,), _unit(field, joint))]


def _softer(model: Model, layout: Layout, element: ElementLimits, x: float) -> list[NewValue]:
    """A solref slower by 1/x: tc / x, or in direct form stiffness x² and damping x."""
    kind, index = element.element.kind, element.element.index
    old = solref_of(model, Layout(model.scene), element.element)
    if old is None:
        return []
    if old[0] > 0:
        new = (rounded(old[0] / x, up=True), old[1])
    else:
        new = (-rounded(-old[0] * x * x, up=False), -rounded(-old[1] * x, up=False))
    if kind == "contact":
        for geom in model.pair_geoms[index]:
            layout.geoms[geom].solref = new
        return [NewValue(f"both geoms of {element.name}", "solref", old, new)]
    if kind == "connect":
        layout.scene.equalities[index].solref = new
        return [NewValue(element.name, "solref", old, new)]
    field = "solreflimit" if kind == "limit" else "solreffriction"
    setattr(layout.joints[index], field, new)
    return [NewValue(element.name, field, old, new)]


def _joint(layout: Layout, element: ElementLimits) -> Joint:
    index = element.element.index
    if element.element.kind == "actuator":
        return layout.scene.actuators[index].joint
    return layout.joints[index]


def _unit(field: str, joint: Joint) -> str:
    return unit_of(field, joint.type in ("hinge", "ball"))


def rounded(value: float, *, up: bool) -> float:
    """A number >= 0 rounded to three digits, upwards or downwards.

    >>> rounded(1234.5, up=False), rounded(0.0012341, up=True)
    (1230.0, 0.00124)
    """
    if value <= 0:
        return 0.0
    place = math.floor(math.log10(value)) - DIGITS + 1
    count = value / 10.0**place
    # A number that has three digits already stays as it is.
    whole = round(count)
    if not math.isclose(count, whole, rel_tol=1e-9):
        whole = math.ceil(count) if up else math.floor(count)
    return float(f"{whole}e{place}")
