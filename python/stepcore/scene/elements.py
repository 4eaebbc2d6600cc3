"""The elements of a `Scene`: plain records that check every value they are given.

Units are SI, angles radians, quaternions w x y z (stored at unit length). A field can be read
and assigned; a value outside its limits, a wrong shape or a NaN is a `ValueError` that names the
element, the field, the value and the limit, and leaves the element as it was. Field names and
defaults are MuJoCo's. Elements compare by identity.
"""

from __future__ import annotations

import dataclasses
import typing
from dataclasses import dataclass
from typing import Annotated, ClassVar

from stepcore import checks
from stepcore.scene.frames import IDENTITY, ORIGIN, Vec

GRAVITY: Vec = (0.0, 0.0, -9.81)
SOLREF: Vec = (0.02, 1.0)
SOLIMP: Vec = (0.9, 0.95, 0.001, 0.5, 2.0)
JOINT_TYPES = ("free", "ball", "slide", "hinge")
FRICTION: Vec = (1.0, 0.005, 0.0001)
GEAR: Vec = (1.0, 0.0, 0.0, 0.0, 0.0, 0.0)
ACTUATOR_TYPES = ("motor", "position", "velocity", "general")
GEOM_TYPES = ("plane", "sphere", "capsule", "ellipsoid", "cylinder", "box")


# A field's type, with the check that every value for it goes through.
Text = Annotated[str, checks.text]
Flag = Annotated[bool, checks.flag]
Real = Annotated[float, checks.real()]
Gain = Annotated[float | None, checks.optional(checks.real())]
NonNegative = Annotated[float, checks.real(low=0)]
Mass = Annotated[float | None, checks.optional(checks.real(low=0))]
Int = Annotated[int, checks.whole(-(2**31), 2**31 - 1)]
Mask = Annotated[int, checks.whole(0, 2**32 - 1)]
Vec3 = Annotated[Vec, checks.vector(3)]
Axis = Annotated[Vec, checks.unit(3)]
Quat = Annotated[Vec, checks.unit(4)]
Size = Annotated[Vec, checks.vector(3, low=0, fill=(0.0, 0.0, 0.0))]
Friction = Annotated[Vec, checks.vector(3, low=0, fill=FRICTION)]
Gear = Annotated[Vec, checks.vector(6, fill=GEAR)]
Bias = Annotated[Vec | None, checks.optional(checks.vector(3, fill=ORIGIN))]
SolRef = Annotated[Vec, checks.solref]
SolImp = Annotated[Vec, checks.vector(5, fill=SOLIMP)]
Range = Annotated[tuple[float, float] | None, checks.optional(checks.interval)]
Numbers = Annotated[Vec | None, checks.optional(checks.numbers)]
Groups = Annotated[tuple[int, ...], checks.whole_pair]
Inertia = Annotated[Vec, checks.inertia]
ABody = Annotated["Body", checks.element("Body")]
AJoint = Annotated["Joint", checks.element("Joint")]


_CHECKS: dict[type, dict[str, checks.Check]] = {}


def _checks_of(kind: type[Element]) -> dict[str, checks.Check]:
    """The check of each field of an element, read once from its annotations."""
    if kind not in _CHECKS:
        hints = typing.get_type_hints(kind, include_extras=True)
        _CHECKS[kind] = {field: hints[field].__metadata__[0] for field in fields_of(kind)}
    return _CHECKS[kind]


class Element:
    """What all elements share: checked assignment, a label for messages, a short ``repr``."""

    # Where its file has it, "file:line"; set by the reader, and no field of the model.
    place: ClassVar[str] = ""

    def __setattr__(self, field: str, value: object) -> None:
        known = _checks_of(type(self))
        if field not in known:
            raise AttributeError(f'{self} has no field "{field}"{checks.nearest(field, known)}')
        object.__setattr__(self, field, known[field](self, field, value))

    def __str__(self) -> str:
        kind = type(self).__name__.lower()
        name = self.__dict__.get("name", "")
        if name:
            return f'{kind} "{name}"'
        body = self.__dict__.get("body")
        return f"unnamed {kind}" + (f" of {body}" if body is not None else "")

    def __repr__(self) -> str:
        parts = []
        for spec in dataclasses.fields(self):  # type: ignore[arg-type]
            value = self.__dict__.get(spec.name)
            if isinstance(value, Element):
                parts.append(f"{spec.name}=<{value}>")
            elif value != spec.default:
                parts.append(f"{spec.name}={value!r}")
        return f"{type(self).__name__}({', '.join(parts)})"


def fields_of(kind: type[Element]) -> list[str]:
    """The names of an element's fields, in order."""
    return [spec.name for spec in dataclasses.fields(kind)]  # type: ignore[arg-type]


@dataclass(eq=False, repr=False, kw_only=True)
class Body(Element):
    """A rigid body, placed in its parent's frame.

    parent: the Body that carries it (None for the world alone).
    pos: [m], shape (3,); quat: shape (4,).
    mass: [kg], >= 0, or None: mass, centre and inertia are taken from the body's geoms.
    ipos: centre of mass in the body's frame [m], shape (3,).
    inertia: about the centre of mass, in body axes [kg·m²], shape (6,): xx yy zz xy xz yz.
        Three numbers are taken as a diagonal.
    """

    name: Text = ""
    parent: Annotated[Body | None, checks.optional(checks.element("Body"))] = None
    pos: Vec3 = ORIGIN
    quat: Quat = IDENTITY
    mass: Mass = None
    ipos: Vec3 = ORIGIN
    inertia: Inertia = (0.0,) * 6


@dataclass(eq=False, repr=False, kw_only=True)
class Joint(Element):
    """A joint between a body and its parent; several on one body act in order.

    type: "hinge", "slide", "ball" or "free".
    pos: anchor in the body's frame [m]; axis: of a hinge or a slide, stored at unit length.
    range: (lower, upper) [rad or m], or None: no limit. A ball's lower is 0, its upper an angle.
    margin: distance at which a limit starts to act [rad or m].
    ref: the joint's coordinate in the pose in which the scene is described (hinge, slide).
    springref, stiffness, damping: a spring-damper [N·m/rad, N·m·s/rad; N/m, N·s/m].
    armature: inertia added to each of its dofs [kg·m² or kg], >= 0.
    frictionloss: dry friction [N·m or N], >= 0.
    solreflimit, solimplimit, solreffriction, solimpfriction: softness of its rows.
    """

    name: Text = ""
    body: ABody
    type: Annotated[str, checks.one_of(*JOINT_TYPES)] = "hinge"
    pos: Vec3 = ORIGIN
    axis: Axis = (0.0, 0.0, 1.0)
    range: Range = None
    margin: Real = 0.0
    ref: Real = 0.0
    springref: Real = 0.0
    stiffness: Real = 0.0
    damping: Real = 0.0
    armature: NonNegative = 0.0
    frictionloss: NonNegative = 0.0
    solreflimit: SolRef = SOLREF
    solimplimit: SolImp = SOLIMP
    solreffriction: SolRef = SOLREF
    solimpfriction: SolImp = SOLIMP


@dataclass(eq=False, repr=False, kw_only=True)
class Geom(Element):
    """A shape fixed to a body: what collides, and what gives a body its mass.

    type: "plane", "sphere", "capsule", "ellipsoid", "cylinder" or "box".
    size: [m], up to 3 numbers: sphere radius; capsule and cylinder radius, half length; box and
        ellipsoid half sizes; plane half sizes for drawing (0: endless) and grid spacing.
    pos: [m]; quat: in the body's frame.
    mass: [kg], >= 0, or None: density × volume. density: [kg/m³], with shellinertia [kg/m²].
    shellinertia: True puts the mass on the surface.
    contype, conaffinity: 32-bit masks; two geoms can touch if the contype of one and the
        conaffinity of the other share a bit.
    condim: 1 (frictionless), 3, 4 or 6. friction: sliding, torsional [m], rolling [m], >= 0.
    priority, solmix, solref, solimp: how two geoms' contact parameters are mixed, and which.
    margin: contacts act below this distance [m]; gap: and are listed this much further out [m].
    """

    name: Text = ""
    body: ABody
    type: Annotated[str, checks.one_of(*GEOM_TYPES)] = "sphere"
    size: Size = ORIGIN
    pos: Vec3 = ORIGIN
    quat: Quat = IDENTITY
    mass: Mass = None
    density: NonNegative = 1000.0
    shellinertia: Flag = False
    group: Int = 0
    contype: Mask = 1
    conaffinity: Mask = 1
    condim: Annotated[int, checks.one_of(1, 3, 4, 6)] = 3
    priority: Int = 0
    friction: Friction = FRICTION
    margin: Real = 0.0
    gap: NonNegative = 0.0
    solmix: NonNegative = 1.0
    solref: SolRef = SOLREF
    solimp: SolImp = SOLIMP


@dataclass(eq=False, repr=False, kw_only=True)
class Site(Element):
    """A named place on a body. pos: [m], shape (3,); quat: shape (4,)."""

    name: Text = ""
    body: ABody
    pos: Vec3 = ORIGIN
    quat: Quat = IDENTITY


@dataclass(eq=False, repr=False, kw_only=True)
class Actuator(Element):
    """A motor or a servo on one joint: the joint feels gear × force, and force is, by type,

    - "motor": the control;
    - "position": kp × (control − length) − kv × velocity, with kp 1, kv 0 where they are None;
      dampratio in place of kv stands for kv = 2 × dampratio × √(kp × m), m being the inertia
      that the actuator moves in the pose of the scene, and is worked out once, when the scene
      is compiled;
    - "velocity": kv × (control − velocity), kv 1 where it is None;
    - "general": gainprm × control + biasprm · (1, length, velocity), 1 and zeros where they are
      None. With gainprm = −biasprm[1] a biasprm[2] above 0 is a damping ratio, as in MuJoCo.

    length: gear × the joint's coordinate [rad or m], velocity: its rate. Servos act on hinges and
    slides; their work is no part of a Sim's `energy`. A field of another type is refused.

    gear: up to 6 numbers; a hinge or slide uses the first, a ball 3, a free joint 6.
    ctrlrange, forcerange: (lower, upper) to which control and force are clamped, or None.
    """

    name: Text = ""
    joint: AJoint
    type: Annotated[str, checks.one_of(*ACTUATOR_TYPES)] = "motor"
    gear: Gear = GEAR
    kp: Gain = None
    kv: Gain = None
    dampratio: Gain = None
    gainprm: Gain = None
    biasprm: Bias = None
    ctrlrange: Range = None
    forcerange: Range = None


@dataclass(eq=False, repr=False, kw_only=True)
class Equality(Element):
    """A constraint between two bodies. type "connect": they share one point.

    anchor: the point, in the frame of body1 in the pose of the scene [m], shape (3,).
    """

    name: Text = ""
    type: Annotated[str, checks.one_of("connect")] = "connect"
    body1: ABody
    body2: ABody
    anchor: Vec3 = ORIGIN
    active: Flag = True
    solref: SolRef = SOLREF
    solimp: SolImp = SOLIMP


@dataclass(eq=False, repr=False, kw_only=True)
class Key(Element):
    """A named state. qpos, qvel, ctrl: in the order of the compiled model; None: its default.

    time: [s].
    """

    name: Text = ""
    time: Real = 0.0
    qpos: Numbers = None
    qvel: Numbers = None
    ctrl: Numbers = None


@dataclass(eq=False, repr=False, kw_only=True)
class MassRules(Element):
    """How masses are made from geoms; the words are those of MJCF's ``<compiler>``.

    inertiafromgeom: True: always; False: never; None: where a body gives no mass itself.
    inertiagrouprange: geoms of these groups weigh, both ends included.
    boundmass [kg], boundinertia [kg·m²]: lower bounds. balanceinertia: repair A + B < C.
    settotalmass: scale all masses and inertias to this total [kg]; not positive: leave them.
    """

    inertiafromgeom: Annotated[bool | None, checks.one_of(None, True, False)] = None
    inertiagrouprange: Groups = (0, 5)
    boundmass: NonNegative = 0.0
    boundinertia: NonNegative = 0.0
    balanceinertia: Flag = False
    settotalmass: Real = -1.0

    def __str__(self) -> str:
        return "mass_rules"


@dataclass(eq=False, repr=False, kw_only=True)
class Features(Element):
    """What can be switched off in the model itself; every field is True or False.

    All but `coriolis` (Coriolis, centrifugal and gyroscopic forces) are MJCF's flags.
    """

    constraint: Flag = True
    equality: Flag = True
    frictionloss: Flag = True
    limit: Flag = True
    contact: Flag = True
    spring: Flag = True
    damper: Flag = True
    gravity: Flag = True
    clampctrl: Flag = True
    actuation: Flag = True
    filterparent: Flag = True
    eulerdamp: Flag = True
    coriolis: Flag = True

    def __str__(self) -> str:
        return "features"
