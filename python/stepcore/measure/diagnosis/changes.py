"""Changes of elements that make a larger dt stable, and the new values that each puts in a scene.

A change has one number x: a gain is multiplied by x, an armature grows by x times the inertia that
the element moves, a damping grows by x times the critical damping, and a solref becomes slower by
1/x. Changes are made on a copy of the scene. New values are rounded to three digits, towards more
change.
"""

from __future__ import annotations

import copy
import dataclasses
import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from stepcore.engine.element import EQUALITIES, OVERRIDE, Element, Elements
from stepcore.engine.model import Model
from stepcore.measure.diagnosis.elements import solref_of
from stepcore.measure.diagnosis.isolated import ElementLimits
from stepcore.report.units import rounded, unit_of
from stepcore.scene.elements import Actuator, Joint
from stepcore.scene.frames import Vec
from stepcore.scene.layout import Layout
from stepcore.scene.scene import Scene

# The range of a gain's factor, down and up, and the range of added values, in octaves.
DOWN, UP, LEAST, MOST = 24, 8, -7, 14
# A gain of zero starts at this part of the critical damping.
FROM_NOTHING = 1 / 64
# The least damping ratio from which the size of added damping is measured.
UNDAMPED = 0.01
# Significant digits of a new value, and the most values written out in one text.
WRITTEN = 3


@dataclass(frozen=True)
class NewValue:
    """A value of the scene before and after a change.

    element: the element that has the value.
    owner: the element's name, such as "servo `elbow`".
    field: the name of the field, as in `Scene`.
    before, after: the numbers, in `unit`.
    unit: the unit, "" for none.
    size: |log| of the factor by which the change multiplies the gain, the inertia or the damping.
    gain: for a value that is a row of parameters, the name of the gain in it, and its value before
        and after.
    """

    element: Element = dataclasses.field(repr=False)
    field: str
    before: tuple[float, ...]
    after: tuple[float, ...]
    unit: str = ""
    size: float = 0.0
    gain: tuple[str, float, float] | None = None
    owner: str = dataclasses.field(init=False)

    def __post_init__(self) -> None:
        object.__setattr__(self, "owner", self.element.name)

    @property
    def way(self) -> str:
        """The old and the new numbers in words, with unit."""
        before, after = (self.before, self.after) if self.gain is None else self._gains
        old, new = (" ".join(f"{x:.6g}" for x in side) for side in (before, after))
        unit = f" {self.unit}" if self.unit else ""
        return f"from {old} to {new}{unit}"

    @property
    def _gains(self) -> tuple[tuple[float, ...], tuple[float, ...]]:
        assert self.gain is not None
        return (self.gain[1],), (self.gain[2],)

    @property
    def name(self) -> str:
        """The name of what changes: the field, or the gain in it."""
        return self.field if self.gain is None else self.gain[0]


def text_of(values: Sequence[NewValue]) -> str:
    """Return several changes in words; equal changes are merged, and at most three written out."""
    alike: dict[tuple[str, str], list[Element]] = {}
    for value in values:
        alike.setdefault((value.name, value.way), []).append(value.element)
    if len(alike) <= WRITTEN:
        texts = (f"change {f} of {Elements(owners).name} {w}" for (f, w), owners in alike.items())
        return ", ".join(texts)
    # Too many to write out: one field with a range of values.
    fields = " and ".join(dict.fromkeys(value.name for value in values))
    low, high = min(v.after[-1] for v in values), max(v.after[-1] for v in values)
    unit = f" {values[0].unit}" if values[0].unit else ""
    owners = Elements(dict.fromkeys(value.element for value in values)).name
    return f"change {fields} of {owners}, to {low:.3g} to {high:.3g}{unit}"


def ratio(before: float, after: float) -> float:
    """Return |log| of the factor between two numbers; 0 if either is zero."""
    if before == 0 or after == 0:
        return 0.0
    return abs(math.log(abs(after)) - math.log(abs(before)))


@dataclass(frozen=True)
class Change:
    """A way to change elements.

    what: the name of the change.
    xs: the values of x to try, from little change to large.
    adds: whether x is an added amount, of which 0 is no change, instead of a factor.
    """

    what: str
    xs: tuple[float, ...]
    adds: bool = False

    def before(self, x: float) -> float:
        """Return the value of x one octave nearer to no change."""
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


# Names of changes: a slower or faster response, more or less damping, and the standard form in
# place of the direct form.
SOLREF, ROW_DAMPING, STANDARD = "solref", "damping of solref", "standard form of solref"

GAINS, ARMATURE, DAMPING = _both("kp and kv"), _more("armature"), _more("more damping")
LESS = _less("setting")
CHAIN = _more("armature of the whole chain")
ROWS = (
    _both(SOLREF),
    _both(ROW_DAMPING),
    Change(STANDARD, (1.0,)),
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
    """Return a copy of the model's scene with `change` made to some elements, and its new values.

    model: the unchanged model.
    elements: the elements to change.
    change, x: the change and its number.
    dt: the step that must become stable [s].
    """
    scene = copy.deepcopy(model.scene)
    layout = Layout(scene)
    values: list[NewValue] = []
    done: set[int] = set()
    for element in elements:
        if change not in CHANGES.get(element.element.kind, ()):
            continue
        if change in ROWS:
            values += _solref(model, layout, element.element, change.what, x, 2 * dt)
        elif change in (ARMATURE, DAMPING, CHAIN):
            driven = _joint(layout, element)
            if driven is None:
                continue
            own = layout.joints.index(driven)
            joints = _chain(model, layout, own) if change is CHAIN else [own]
            # A joint that several elements share is changed once.
            fresh = [joint for joint in joints if joint not in done]
            done |= set(fresh)
            for joint in fresh:
                values += _added(model, layout, joint, change, x, element)
        else:
            for field in ("kp", "kv") if change is GAINS else (change.what,):
                values += _scaled(model, layout, element, field, x)
    if change is CHAIN and len(values) < 2:
        # A chain of one joint is the same change as ARMATURE.
        return scene, []
    return scene, values


def _scaled(
    model: Model, layout: Layout, limits: ElementLimits, name: str, x: float
) -> list[NewValue]:
    """Multiply a gain of the element by x, and return the new value.

    A kv of 0 becomes a part of the critical damping.
    """
    element, joint = limits.element, _joint(layout, limits)
    if element.kind == "actuator":
        servo = layout.scene.actuators[element.index]
        if servo.type == "general":
            turns = joint is not None and joint.type in ("hinge", "ball")
            return _general(servo, limits, name, x, unit_of(name, turns) if joint else "")
        if name == "kv" and servo.dampratio:
            name = "dampratio"
    field = next((field for field in element.fields(model) if field.name == name), None)
    if field is None:
        return []
    old = float(field.value)
    if old > 0:
        new = rounded(old * x, up=x > 1)
        size = ratio(old, new)
    elif old == 0 and name == "kv" and x > 1 and limits.omega > 0 and joint is not None:
        square = float(model.actuator_gear[element.index, 0]) ** 2
        critical = 2 * _mass(model, layout.joints.index(joint)) * limits.omega / square
        new = rounded(FROM_NOTHING * x * critical, up=True)
        size = _damped(FROM_NOTHING * x, limits)
    else:
        return []
    field.assign(layout, new)
    return [NewValue(element, name, (old,), (new,), field.unit, size)]


def _general(
    servo: Actuator, element: ElementLimits, field: str, x: float, unit: str
) -> list[NewValue]:
    """Scale the feedback of a general actuator, biasprm[1] with its gain or biasprm[2].

    Return the new value.
    """
    bias = servo.biasprm or (0.0, 0.0, 0.0)
    at = 1 if field == "kp" else 2
    if bias[at] == 0:
        return []
    new = math.copysign(rounded(abs(bias[at]) * x, up=x > 1), bias[at])
    if at == 1:
        factor = new / bias[1]
        if servo.gainprm is not None:
            servo.gainprm = np.multiply(servo.gainprm, factor).tolist()
        after = (bias[0] * factor, new, bias[2])
    else:
        after = (bias[0], bias[1], new)
    servo.biasprm = after
    gain = field, -bias[at], -new
    return [NewValue(element.element, "biasprm", bias, after, unit, ratio(bias[at], new), gain)]


def _added(
    model: Model, layout: Layout, index: int, change: Change, x: float, element: ElementLimits
) -> list[NewValue]:
    """Add armature or damping to a joint in proportion to its inertia, and return the new value."""
    joint, mass = layout.joints[index], _mass(model, index)
    field = "damping" if change is DAMPING else "armature"
    added = x * 2 * mass * element.omega if change is DAMPING else x * mass
    if added <= 0:
        return []
    old = getattr(joint, field)
    new = rounded(old + added, up=True)
    setattr(joint, field, new)
    owner, unit = Element.of(model, "joint", index), unit_of(field, joint.type in ("hinge", "ball"))
    size = _damped(x, element) if change is DAMPING else math.log1p(x)
    return [NewValue(owner, field, (old,), (new,), unit, size)]


def _damped(x: float, element: ElementLimits) -> float:
    """Return the size of a change that adds x times the critical damping to an element."""
    return math.log1p(x / max(element.ratio, UNDAMPED))


def _mass(model: Model, joint: int) -> float:
    """Return the inertia that a force on a joint moves [kg·m² or kg], the others free, or 0."""
    weight = float(model.dof_invweight0[model.jnt_dofadr[joint]])
    return 1 / weight if weight > 0 else 0.0


def _chain(model: Model, layout: Layout, joint: int) -> list[int]:
    """Return the hinges and slides of the kinematic tree that a joint belongs to."""
    roots = [model.root(int(body)) for body in model.jnt_body]
    return [
        j
        for j, other in enumerate(layout.joints)
        if roots[j] == roots[joint] and other.type in ("hinge", "slide")
    ]


def _solref(
    model: Model, layout: Layout, element: Element, what: str, x: float, softest: float
) -> list[NewValue]:
    """Change the solref of a row (see `new_solref`), and return the new value."""
    old = solref_of(model, element)
    new = new_solref(what, old, x, softest) if old is not None else None
    if old is None or new is None:
        return []
    fields = [field for field in element.fields(model) if field.name.startswith("solref")]
    for field in fields:
        field.assign(layout, new)
    first, owner = fields[0], element
    if first.kind == OVERRIDE:
        owner = Element(OVERRIDE, 0, -1, OVERRIDE)
    elif first.kind == "pair":
        name = str(layout.scene.pairs[first.index])
        owner = Element("pair", first.index, -1, name)
    elif element.kind == "contact":
        owner = dataclasses.replace(element, kind="geoms", name=f"both geoms of {element.name}")
    return [NewValue(owner, first.name, old, new, size=size_of(old, new))]


def new_solref(what: str, old: Vec, x: float, softest: float) -> Vec | None:
    """Return the solref after a change by x, or None if there is no such change.

    A solref of the standard form, (tc, ζ), has the stiffness 1/(tc ζ)² and the damping 2/tc of the
    direct form (−k, −b), both per inertia and for an impedance of 1. Sources: MuJoCo's
    documentation, "Solver parameters", and docs/method.md.

    what: the name of the change.
    old: the present solref.
    x: the factor.
    softest: the time constant [s] below which a row is unstable at the step that must become
        stable, or `refsafe` would silently soften it.
    """
    direct, up = old[0] <= 0, x > 1
    if what == SOLREF:
        if not direct:
            return rounded(old[0] / x, up=not up), old[1]
        return -rounded(-old[0] * x * x, up=up), -rounded(-old[1] * x, up=up)
    if what == ROW_DAMPING:
        if old[1] == 0:
            return None
        changed = math.copysign(rounded(abs(old[1]) * x, up=up), old[1])
        return old[0], changed
    if not direct or old[0] == 0:
        return None
    # Critically damped, and as stiff as the step allows.
    fastest = min(1 / math.sqrt(-old[0]), 2 / -old[1] if old[1] < 0 else math.inf)
    return rounded(max(fastest, softest), up=True), 1.0


def size_of(old: Vec, new: Vec) -> float:
    """Return |log| of the factor by which stiffness or damping changes, the larger of both."""
    (k, b), (stiffness, damping) = _direct(old), _direct(new)
    return max(ratio(k, stiffness), ratio(b, damping))


def softened_to(value: NewValue) -> str:
    """Return the stiffness of a row with a new solref, in words."""
    old, new = (_direct((side[0], side[1]))[0] for side in (value.before, value.after))
    return f" (stiffness {new:.3g}/s² times the inertia, in place of {old:.3g}/s²)"


def _direct(solref: Vec) -> tuple[float, float]:
    """Return the stiffness [1/s²] and damping [1/s] of a solref, per inertia."""
    first, second = solref[0], solref[1]
    if first <= 0:
        return -first, -second
    # Successive divisions avoid the overflow of a square.
    return 1 / first / first / second / second, 2 / first


def _joint(layout: Layout, limits: ElementLimits) -> Joint | None:
    """Return the joint that an element acts on, or None for an element that acts on several."""
    index = limits.element.index
    if limits.element.kind.startswith("tendon"):
        return None
    if limits.element.kind in ("actuator", "control"):
        actuator = layout.scene.actuators[index]
        return actuator.joint or actuator.jointinparent
    return layout.joints[index]
