"""The elements of a `Scene`: records whose fields are checked whenever they are assigned.

Units are SI, angles are in radians, quaternions are w x y z and stored at unit length. A value
outside its limits, of the wrong shape or not finite raises a ValueError that names the element,
the field, the value and the limit, and leaves the element unchanged. Field names and defaults are
MuJoCo's. Elements compare by identity.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Annotated, Any

from stepcore import checks
from stepcore.scene.element import Element as Element
from stepcore.scene.element import fields_of as fields_of
from stepcore.scene.frames import IDENTITY, ORIGIN, Vec
from stepcore.scene.surfaces import HField as HField
from stepcore.scene.surfaces import Mesh as Mesh

GRAVITY: Vec = (0.0, 0.0, -9.81)
SOLREF: Vec = (0.02, 1.0)
SOLIMP: Vec = (0.9, 0.95, 0.001, 0.5, 2.0)
JOINT_TYPES = ("free", "ball", "slide", "hinge")
FRICTION: Vec = (1.0, 0.005, 0.0001)
PAIR_FRICTION: Vec = (1.0, 1.0, 0.005, 0.0001, 0.0001)
GEAR: Vec = (1.0, 0.0, 0.0, 0.0, 0.0, 0.0)
ACTUATOR_TYPES = ("motor", "position", "velocity", "general")
GEOM_TYPES = ("plane", "hfield", "sphere", "capsule", "ellipsoid", "cylinder", "box", "mesh")


# The type of a field, with the check that every assigned value passes.
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
PairFriction = Annotated[Vec, checks.vector(5, low=0, fill=PAIR_FRICTION)]
Gear = Annotated[Vec, checks.vector(6, fill=GEAR)]
Poly = Annotated[Vec, checks.vector(2, fill=(0.0, 0.0))]
Bias = Annotated[Vec | None, checks.optional(checks.vector(3, fill=ORIGIN))]
SolRef = Annotated[Vec, checks.solref]
SolRefFriction = Annotated[Vec | None, checks.optional(checks.solreffriction)]
SolImp = Annotated[Vec, checks.vector(5, fill=SOLIMP)]
Range = Annotated[tuple[float, float] | None, checks.optional(checks.interval)]
Numbers = Annotated[Vec | None, checks.optional(checks.numbers)]
Groups = Annotated[tuple[int, ...], checks.whole_pair]
Inertia = Annotated[Vec, checks.inertia]
AGeom = Annotated["Geom", checks.element("Geom")]
ABody = Annotated["Body", checks.element("Body")]
AJoint = Annotated["Joint", checks.element("Joint")]


@dataclass(eq=False, repr=False, kw_only=True)
class Body(Element):
    """A rigid body.

    name: unique among bodies, or "".
    parent: the `Body` that carries it; None for the world.
    pos: position in the parent's frame [m], shape (3,).
    quat: orientation in the parent's frame, shape (4,).
    mass: [kg], >= 0; None takes mass, centre of mass and inertia from the body's geoms.
    ipos: centre of mass in the body's frame [m], shape (3,).
    inertia: about the centre of mass, in body axes [kg·m²], shape (6,): xx yy zz xy xz yz. Three
        numbers give a diagonal.
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
    """A joint between a body and its parent. Several joints of one body act in order.

    name: unique among joints, or "".
    body: the `Body` that it moves.
    type: "hinge", "slide", "ball" or "free".
    pos: anchor in the body's frame [m], shape (3,).
    axis: of a hinge or slide, in the body's frame, shape (3,), stored at unit length.
    range: (lower, upper) limit [rad or m], or None for no limit; (0, largest angle) for a ball.
    margin: distance from a limit at which it starts to act [rad or m].
    ref: coordinate of a hinge or slide in the pose in which the scene is described [rad or m].
    springref: coordinate at which the spring is relaxed [rad or m].
    stiffness: of the spring [N·m/rad or N/m].
    stiffnesspoly: b [.../rad or m] and c [.../rad² or m²] of a spring that pulls back with
        (stiffness + b x + c x²) x at a stretch x; of a ball, and of a free joint's way and turn
        apart, x is the length of the stretch.
    damping: [N·m·s/rad or N·s/m].
    dampingpoly: b and c of a damper that pulls with (damping + b |v| + c v²) v.
    armature: inertia added to each of its dofs [kg·m² or kg], >= 0.
    frictionloss: dry friction [N·m or N], >= 0.
    solreflimit, solimplimit: softness of the limit.
    solreffriction, solimpfriction: softness of the dry friction.
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
    stiffnesspoly: Poly = (0.0, 0.0)
    damping: Real = 0.0
    dampingpoly: Poly = (0.0, 0.0)
    armature: NonNegative = 0.0
    frictionloss: NonNegative = 0.0
    solreflimit: SolRef = SOLREF
    solimplimit: SolImp = SOLIMP
    solreffriction: SolRef = SOLREF
    solimpfriction: SolImp = SOLIMP

    @property
    def sprung(self) -> bool:
        """Whether it has a spring."""
        return any(self.record()["stiffness"])

    @property
    def damped(self) -> bool:
        """Whether it has a damper."""
        return any(self.record()["damping"])

    def values(self) -> dict[str, Any]:
        """As for every element; coefficients of one polynomial stand together, if there are any."""
        values = super().values()
        for field in ("stiffness", "damping"):
            if any(poly := values.pop(field + "poly")):
                values[field] = (values[field], *poly)
        return values

    def record(self) -> dict[str, Any]:
        """As for every element; stiffness and damping are lists of all three coefficients."""
        coefficients = {
            "stiffness": [self.stiffness, *self.stiffnesspoly],
            "damping": [self.damping, *self.dampingpoly],
        }
        return super().record() | coefficients


@dataclass(eq=False, repr=False, kw_only=True)
class Geom(Element):
    """A shape fixed to a body: it collides, and it gives the body mass.

    name: unique among geoms, or "".
    body: the `Body` that it is fixed to.
    type: "plane", "hfield", "sphere", "capsule", "ellipsoid", "cylinder", "box" or "mesh".
    size: [m], shape (3,): radius of a sphere; radius and half length of a capsule or cylinder; half
        sizes of a box or ellipsoid; for a plane, half sizes and grid spacing for drawing (0 is
        infinite). Fewer numbers may be given.
    pos, quat: position [m], shape (3,), and orientation, shape (4,), in the body's frame. Those of
        a mesh are of the coordinates of its vertices; the compiled geom stands at its centre.
    mesh: the `Mesh` of a geom of type "mesh", or one that a primitive is fitted to: its size and
        pose are then found from the mesh (see `MassRules.fitaabb`). fitscale: times that size.
    hfield: the `HField` of a geom of type "hfield".
    mass: [kg], >= 0; None means density × volume.
    density: [kg/m³], or [kg/m²] with shellinertia; >= 0.
    shellinertia: True puts the mass on the surface.
    group: an integer that `MassRules.inertiagrouprange` refers to.
    contype, conaffinity: 32-bit masks; two geoms can collide if the contype of one and the
        conaffinity of the other share a bit.
    condim: dimension of the contact: 1 (frictionless), 3 (sliding), 4 (and torsion about the
        normal) or 6 (and rolling).
    friction: sliding, torsional [m] and rolling [m] coefficient, shape (3,), >= 0.
    solref, solimp: softness of its contacts.
    priority, solmix: which of two geoms decides their contact's parameters, and how they are mixed.
    margin: distance below which contacts act [m]. gap: contacts are listed from margin + gap [m].
    """

    name: Text = ""
    body: ABody
    type: Annotated[str, checks.one_of(*GEOM_TYPES)] = "sphere"
    size: Size = ORIGIN
    pos: Vec3 = ORIGIN
    quat: Quat = IDENTITY
    mesh: Annotated[Mesh | None, checks.optional(checks.element("Mesh"))] = None
    fitscale: Annotated[float, checks.real(above=0)] = 1.0
    hfield: Annotated[HField | None, checks.optional(checks.element("HField"))] = None
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
    """A named place on a body.

    pos, quat: position [m], shape (3,), and orientation, shape (4,), in the body's frame.
    """

    name: Text = ""
    body: ABody
    pos: Vec3 = ORIGIN
    quat: Quat = IDENTITY


@dataclass(eq=False, repr=False, kw_only=True)
class Actuator(Element):
    """A motor or servo on a joint. The force on the joint is gear × force, where force is

    - for a "motor", the control;
    - for a "position" servo, kp × (control − length) − kv × velocity;
    - for a "velocity" servo, kv × (control − velocity);
    - for a "general" actuator, gainprm × control + biasprm · (1, length, velocity).

    The length is gear × the joint's coordinate [rad or m], the velocity its rate. Servos act on
    hinges and slides, and a Sim's `energy` does not include their work.

    name: unique among actuators, or "".
    joint: the `Joint` that it drives.
    type: "motor", "position", "velocity" or "general". A field of another type is refused.
    gear: shape (6,); a hinge or slide uses the first number, a ball 3, a free joint 6.
    kp: stiffness of a position servo; None means 1.
    kv: damping of a position servo (None means 0), or gain of a velocity servo (None means 1).
    dampratio: damping ratio of a position servo, in place of kv: kv = 2 × dampratio × √(kp × m),
        where m is the inertia that it moves in the initial pose.
    gainprm, biasprm: of a general actuator; None means 1 and zeros. If gainprm = −biasprm[1], a
        positive biasprm[2] is a damping ratio, as in MuJoCo.
    ctrlrange, forcerange: (lower, upper) bounds to which control and force are clamped, or None.
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
    """A constraint between two bodies.

    name: unique among equalities, or "".
    type: "connect": the bodies share one point.
    body1, body2: the two `Body` objects.
    anchor: the point in the frame of body1, in the pose of the scene [m], shape (3,).
    active: False leaves the constraint out.
    solref, solimp: softness of the constraint.
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
class Pair(Element):
    """Two geoms that can collide, with contact parameters of their own.

    Neither the parameters of the geoms count, nor their masks, nor what is excluded: they collide
    even if one's body is the parent of the other's.

    name: unique among pairs, or "".
    geom1, geom2: the two `Geom` objects.
    condim: dimension of the contact: 1 (frictionless), 3 (sliding), 4 (and torsion about the
        normal) or 6 (and rolling).
    friction: sliding along both tangents [1], torsional [m], and rolling about both [m], shape
        (5,), >= 0. A pyramid or cone can be narrower along one tangent than along the other.
    solref, solimp: softness of its contacts.
    solreffriction: solref of the friction rows of an elliptic cone, where only the damping counts;
        None means that of the normal.
    margin: distance below which contacts act [m]. gap: contacts are listed from margin + gap [m].
    """

    name: Text = ""
    geom1: AGeom
    geom2: AGeom
    condim: Annotated[int, checks.one_of(1, 3, 4, 6)] = 3
    friction: PairFriction = PAIR_FRICTION
    solref: SolRef = SOLREF
    solimp: SolImp = SOLIMP
    solreffriction: SolRefFriction = None
    margin: Real = 0.0
    gap: NonNegative = 0.0


@dataclass(eq=False, repr=False, kw_only=True)
class ContactOverride(Element):
    """Contact parameters that replace those of every contact while `enable` is True.

    MJCF's ``o_margin``, ``o_solref``, ``o_solimp``, ``o_friction`` and the flag ``override``.

    margin: [m]. solref, solimp: softness. friction: as in `Pair`, shape (5,).
    """

    enable: Flag = False
    margin: Real = 0.0
    solref: SolRef = SOLREF
    solimp: SolImp = SOLIMP
    friction: PairFriction = PAIR_FRICTION

    def __str__(self) -> str:
        return "contact_override"


@dataclass(eq=False, repr=False, kw_only=True)
class Key(Element):
    """A keyframe: a named state.

    name: unique among keyframes, or "".
    time: [s].
    qpos, qvel, ctrl: in the order of the compiled model, shapes (nq,), (nv,) and (nu,); None means
        the pose of the scene, rest and zero.
    """

    name: Text = ""
    time: Real = 0.0
    qpos: Numbers = None
    qvel: Numbers = None
    ctrl: Numbers = None


@dataclass(eq=False, repr=False, kw_only=True)
class MassRules(Element):
    """How the masses of bodies are made, with the words of MJCF's ``<compiler>``.

    inertiafromgeom: True takes every body's mass from its geoms, False none, and None that of the
        bodies that have no mass of their own.
    inertiagrouprange: (first, last) group of the geoms that have mass.
    boundmass, boundinertia: lower bounds of a body's mass [kg] and principal inertias [kg·m²].
    balanceinertia: True repairs inertias that violate A + B >= C.
    settotalmass: total mass to which all masses and inertias are scaled [kg]; <= 0 scales nothing.
    fitaabb: True fits primitives to the bounding boxes of meshes, False to boxes of the same
        inertia.
    """

    inertiafromgeom: Annotated[bool | None, checks.one_of(None, True, False)] = None
    inertiagrouprange: Groups = (0, 5)
    boundmass: NonNegative = 0.0
    boundinertia: NonNegative = 0.0
    balanceinertia: Flag = False
    settotalmass: Real = -1.0
    fitaabb: Flag = False

    def __str__(self) -> str:
        return "mass_rules"


@dataclass(eq=False, repr=False, kw_only=True)
class Features(Element):
    """What a model takes into account. Each field is a flag; False leaves the feature out.

    The names are those of MJCF's flags, except `coriolis`: Coriolis, centrifugal and gyroscopic
    forces.
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
