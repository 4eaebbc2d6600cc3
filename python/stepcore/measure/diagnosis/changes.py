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
from stepcore.measure.diagnosis.closed_form_bound import root_of
from stepcore.measure.diagnosis.element_id import EQUALITIES
from stepcore.measure.diagnosis.element_limits import ElementLimits
from stepcore.measure.diagnosis.new_value import NewValue, ratio, rounded
from stepcore.measure.diagnosis.solref import solref_of
from stepcore.measure.diagnosis.solref_changes import (
    ROW_DAMPING,
    SOLREF,
    STANDARD,
    new_solref,
    size_of,
)
from stepcore.report.units import unit_of
from stepcore.scene.elements import Actuator, Joint
from stepcore.scene.elements.actuator import LAW_FIELDS
from stepcore.scene.layout import Layout
from stepcore.scene.scene import Scene

# How far a gain is changed in both directions, and how far something is added, in octaves.
DOWN, UP, LEAST, MOST = 24, 8, -7, 14
# A gain of zero grows from this part of the critical damping.
FROM_NOTHING = 1 / 64
# A smaller damping ratio counts as this one where damping is added to it.
UNDAMPED = 0.01


@dataclass(frozen=True)
class Change:
    """A way to change elements. xs: the values of x to try, from little change to large.

    adds: x = 0 is no change, and not x = 1.
    """

    what: str
    xs: tuple[float, ...]
    adds: bool = False

    def before(self, x: float) -> float:
        """The value an octave nearer to no change."""
        if x == 1.0 and not self.adds:
            return 1.0
        return 2 * x if x < 1 and not self.adds else x / 2


def _less(what: str) -> Change:
    return Change(what, tuple(2.0**-k for k in range(1, DOWN + 1)))


def _both(what: str) -> Change:
    octaves = [k for n in range(1, DOWN + 1) for k in ((-n, n) if n <= UP else (-n,))]
    return Change(what, tuple(2.0**k for k in octaves))


def _more(what: str) -> Change:
    return Change(what, tuple(2.0**k for k in range(LEAST, MOST + 1)), adds=True)


GAINS, ARMATURE, DAMPING = _both("kp and kv"), _more("armature"), _more("more damping")
LESS = _less("setting")
CHAIN = _more("armature of the whole chain")
ROWS = (
    _both(SOLREF),
    _both(ROW_DAMPING),
    # At x = 1 another form of the same stiffness.
    Change(STANDARD, (1.0, *_less(STANDARD).xs)),
)
CHANGES: dict[str, tuple[Change, ...]] = {
    "spring": (_less("stiffness"), ARMATURE, CHAIN, DAMPING),
    "damper": (_both("damping"), ARMATURE, CHAIN),
    "actuator": (_both("kp"), _both("kv"), GAINS, ARMATURE, CHAIN, DAMPING),
    "control": (ARMATURE, CHAIN, DAMPING),
    "contact": ROWS,
    "tendon spring": (_less("stiffness"),),
    "tendon damper": (_both("damping"),),
    "limit": ROWS,
    "tendon limit": ROWS,
    "tendon friction loss": ROWS,
    "friction loss": ROWS,
    **dict.fromkeys(EQUALITIES, ROWS),
}


def changed(
    model: Model, elements: Sequence[ElementLimits], change: Change, x: float, dt: float
) -> tuple[Scene, list[NewValue]]:
    """A copy of the model's scene with `change` made to some elements, and its new values.

    dt [s]: the step that is to be stable.
    """
    scene = copy.deepcopy(model.scene)
    layout = Layout(scene)
    values: list[NewValue] = []
    done: set[int] = set()
    for element in elements:
        if change not in CHANGES.get(element.element.kind, ()):
            continue
        if change in ROWS:
            softest = 2 * dt if model.settings.refsafe else 0.0
            values += _solref(model, layout, element, change.what, x, softest)
        elif change in (ARMATURE, DAMPING, CHAIN):
            driven = _joint(layout, element)
            if driven is None:
                continue
            own = layout.joints.index(driven)
            joints = _chain(model, layout, own) if change is CHAIN else [own]
            # A joint with a spring and a servo, or of a chain, is changed once.
            fresh = [joint for joint in joints if joint not in done]
            done |= set(fresh)
            for joint in fresh:
                values += _added(model, layout, joint, change, x, element)
        else:
            for field in ("kp", "kv") if change is GAINS else (change.what,):
                values += _scaled(model, layout, element, field, x)
    if change is CHAIN and len(values) < 2:
        # One joint: that is the change of its armature.
        return scene, []
    return scene, values


def _scaled(
    model: Model, layout: Layout, element: ElementLimits, field: str, x: float
) -> list[NewValue]:
    """A gain of the element times x."""
    if element.element.kind.startswith("tendon"):
        tendon = layout.scene.tendons[element.element.index]
        old = getattr(tendon, field)
        if old <= 0:
            return []
        new = rounded(old * x, up=x > 1)
        setattr(tendon, field, new)
        return [NewValue(element.name, field, (old,), (new,), size=ratio(old, new))]
    joint = _joint(layout, element)
    owner: Joint | Actuator | None = joint
    if element.element.kind == "actuator":
        owner = layout.scene.actuators[element.element.index]
        if owner.type == "general":
            return _general(owner, element, field, x)
        if field not in LAW_FIELDS[owner.type]:
            return []
        if field == "kv" and owner.dampratio:
            field = "dampratio"
        old = owner.law_value(field)
    else:
        old = getattr(joint, field)
    if old == 0 and field == "kv" and x > 1 and element.omega > 0 and joint is not None:
        square = float(model.actuator_gear[element.element.index, 0]) ** 2
        critical = 2 * _mass(model, layout.joints.index(joint)) * element.omega / square
        new = rounded(FROM_NOTHING * x * critical, up=True)
        size = _damped(FROM_NOTHING * x, element)
    elif old <= 0:
        return []
    else:
        new = rounded(old * x, up=x > 1)
        size = ratio(old, new)
    setattr(owner, field, new)
    return [NewValue(element.name, field, (old,), (new,), _unit(field, joint), size)]


def _general(servo: Actuator, element: ElementLimits, field: str, x: float) -> list[NewValue]:
    """The feedback of a general actuator: biasprm[1], with its gain, or biasprm[2]."""
    bias = servo.biasprm or (0.0, 0.0, 0.0)
    at = 1 if field == "kp" else 2
    if bias[at] == 0:
        return []
    new = math.copysign(rounded(abs(bias[at]) * x, up=x > 1), bias[at])
    if at == 1:
        factor = new / bias[1]
        if servo.gainprm is not None:
            servo.gainprm *= factor
        after = (bias[0] * factor, new, bias[2])
    else:
        after = (bias[0], bias[1], new)
    servo.biasprm = after
    return [NewValue(element.name, "biasprm", bias, after, size=ratio(bias[at], new))]


def _added(
    model: Model, layout: Layout, index: int, change: Change, x: float, element: ElementLimits
) -> list[NewValue]:
    """Armature or damping on a joint, beside the mass that it moves."""
    joint, mass = layout.joints[index], _mass(model, index)
    field = "damping" if change is DAMPING else "armature"
    added = x * 2 * mass * element.omega if change is DAMPING else x * mass
    if added <= 0:
        return []
    old = getattr(joint, field)
    new = rounded(old + added, up=True)
    setattr(joint, field, new)
    owner = model.element_name("joint", index)
    size = _damped(x, element) if change is DAMPING else math.log1p(x)
    return [NewValue(owner, field, (old,), (new,), _unit(field, joint), size)]


def _damped(x: float, element: ElementLimits) -> float:
    """The size of a change that adds x times the critical damping to what an element has."""
    return math.log1p(x / max(element.ratio, UNDAMPED))


def _mass(model: Model, joint: int) -> float:
    """The inertia that a torque on a joint moves, the others free [kg·m² or kg]; 0 if none."""
    weight = float(model.dof_invweight0[model.jnt_dofadr[joint]])
    return 1 / weight if weight > 0 else 0.0


def _chain(model: Model, layout: Layout, joint: int) -> list[int]:
    """The hinges and slides of the tree that a joint belongs to."""
    roots = [root_of(model, int(body)) for body in model.jnt_body]
    return [
        j
        for j, other in enumerate(layout.joints)
        if roots[j] == roots[joint] and other.type in ("hinge", "slide")
    ]


def _solref(
    model: Model, layout: Layout, element: ElementLimits, what: str, x: float, softest: float
) -> list[NewValue]:
    """Another solref of a row; see `new_solref`."""
    kind, index = element.element.kind, element.element.index
    old = solref_of(model, Layout(model.scene), element.element)
    new = new_solref(what, old, x, softest) if old is not None else None
    if old is None or new is None:
        return []
    size = size_of(old, new)
    if kind == "contact":
        override = layout.scene.contact_override
        if override.enable:
            override.solref = new
            return [NewValue("contact_override", "solref", old, new, size=size)]
        both = {id(layout.geoms[geom]) for geom in model.contact_pair(index).geoms}
        explicit = [p for p in layout.scene.pairs if {id(p.geom1), id(p.geom2)} == both]
        for pair in explicit:
            pair.solref = new
        if explicit:
            return [NewValue(str(explicit[0]), "solref", old, new, size=size)]
        for geom in model.contact_pair(index).geoms:
            layout.geoms[geom].solref = new
        return [NewValue(f"both geoms of {element.name}", "solref", old, new, size=size)]
    if kind in EQUALITIES:
        layout.scene.equalities[index].solref = new
        return [NewValue(element.name, "solref", old, new, size=size)]
    field = "solreflimit" if kind.endswith("limit") else "solreffriction"
    owner = layout.scene.tendons[index] if kind.startswith("tendon") else layout.joints[index]
    setattr(owner, field, new)
    return [NewValue(element.name, field, old, new, size=size)]


def _joint(layout: Layout, element: ElementLimits) -> Joint | None:
    """The joint that an element acts on; None for one that acts on several."""
    index = element.element.index
    if element.element.kind in ("actuator", "control"):
        actuator = layout.scene.actuators[index]
        return actuator.joint or actuator.jointinparent
    return layout.joints[index]


def _unit(field: str, joint: Joint | None) -> str:
    return unit_of(field, joint is not None and joint.type in ("hinge", "ball"))
