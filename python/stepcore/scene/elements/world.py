"""`Key`, `MassRules`, `LengthRange` and `Features`: records about the whole scene."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Annotated

from stepcore import checks
from stepcore.scene.element import Element, FieldType
from stepcore.scene.elements import field_types as of


@dataclass(eq=False, repr=False, kw_only=True)
class Key(Element):
    """A keyframe: a named state.

    name: unique among keyframes, or "".
    time: [s].
    qpos, qvel, act, ctrl: in the order of the compiled model, shapes (nq,), (nv,), (na,) and (nu,).
        None means the pose of the scene for qpos, and zeros for the others.
    mpos, mquat: positions [m], shape (3 n,), and quaternions, shape (4 n,), of the n mocap bodies;
        None means the pose of the scene.
    """

    name: of.Text = ""
    time: Annotated[of.Real, "s"] = 0.0
    qpos: of.Numbers = None
    qvel: of.Numbers = None
    act: of.Numbers = None
    ctrl: of.Numbers = None
    mpos: of.Numbers = None
    mquat: of.Numbers = None


FromGeoms = Annotated[
    bool | None,
    FieldType(
        checks.one_of(None, True, False),
        "bool | None",
        of.AUTO,
        read=lambda value: None if value == "auto" else value,
    ),
]


@dataclass(eq=False, repr=False, kw_only=True)
class MassRules(Element):
    """Rules for the masses of bodies, named as in MJCF's ``<compiler>``.

    inertiafromgeom: True takes the mass of every body from its geoms, False of no body, and None
        of the bodies without an explicit mass.
    inertiagrouprange: (first, last) group of the geoms that have mass.
    boundmass, boundinertia: lower bounds of a body's mass [kg] and principal inertias [kg·m²].
    balanceinertia: True repairs inertias that violate A + B >= C.
    settotalmass: total mass to which all masses and inertias are scaled [kg]; <= 0 scales nothing.
    fitaabb: True fits primitives to the bounding boxes of meshes, False to boxes of the same
        inertia.
    """

    inertiafromgeom: FromGeoms = None
    inertiagrouprange: of.Groups = (0, 5)
    boundmass: Annotated[of.NonNegative, "kg"] = 0.0
    boundinertia: Annotated[of.NonNegative, "kg·m²"] = 0.0
    balanceinertia: of.Flag = False
    settotalmass: Annotated[of.Real, "kg"] = -1.0
    fitaabb: of.Flag = False

    def __str__(self) -> str:
        return "mass_rules"


@dataclass(eq=False, repr=False, kw_only=True)
class LengthRange(Element):
    """Settings of the simulation that finds the length range of muscles, as in MuJoCo.

    The simulation concerns muscles that give no range. It runs when the scene is compiled. It pulls
    the actuator both ways from the initial pose, without gravity, contacts, friction, passive
    forces and other actuators, until limits or geometry stop the motion.

    mode: "none" refuses muscles without a range. All other modes find the ranges of muscles;
        MuJoCo distinguishes these modes.
    useexisting: False finds the ranges of all muscles.
    uselimit: True takes the range of the joint or tendon if the joint or tendon has a range.
    accel: norm of the acceleration of all dofs under the pull [m/s² and rad/s²].
    maxforce: upper bound of the norm of the pull [N or N·m]; 0: no bound.
    timeconst: time constant of the decay of velocities [s].
    timestep: time step of the simulation [s]; 0: the scene's time step.
    inttotal: duration of the pull [s].
    interval: final part of the pull, in which the length must settle [s].
    tolrange: largest change of length in the interval, as a fraction of the range.
    """

    mode: Annotated[str, of.words("none", "muscle", "muscleuser", "all")] = "muscle"
    useexisting: of.Flag = True
    uselimit: of.Flag = False
    accel: Annotated[of.NonNegative, "rad/s² or m/s²"] = 20.0
    maxforce: Annotated[of.NonNegative, "N·m or N"] = 0.0
    timeconst: Annotated[of.NonNegative, "s"] = 1.0
    timestep: Annotated[of.NonNegative, "s"] = 0.01
    inttotal: Annotated[of.NonNegative, "s"] = 10.0
    interval: Annotated[of.NonNegative, "s"] = 2.0
    tolrange: of.NonNegative = 0.05

    def __str__(self) -> str:
        return "lengthrange"


@dataclass(eq=False, repr=False, kw_only=True)
class Features(Element):
    """Flags of the physical effects that a model includes; False leaves an effect out.

    The names are those of MJCF's flags, except `coriolis`: Coriolis, centrifugal and gyroscopic
    forces.
    """

    constraint: of.Flag = True
    equality: of.Flag = True
    frictionloss: of.Flag = True
    limit: of.Flag = True
    contact: of.Flag = True
    spring: of.Flag = True
    damper: of.Flag = True
    gravity: of.Flag = True
    clampctrl: of.Flag = True
    actuation: of.Flag = True
    filterparent: of.Flag = True
    eulerdamp: of.Flag = True
    sensor: of.Flag = True
    coriolis: of.Flag = True

    def __str__(self) -> str:
        return "features"
