"""The keyword fields of `Scene.add_joint` and its like, for type checkers and editors.

What each means stands in `stepcore.scene.elements`; a test compares the names.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING, Any, TypedDict

if TYPE_CHECKING:
    from numpy.typing import NDArray

    # What is checked when it is assigned: one number stands for a first entry where that is said.
    Vector = Sequence[float] | NDArray[Any]
    Numbers = float | Vector


class JointFields(TypedDict, total=False):
    """Fields of a `Joint` beside its body and type."""

    name: str
    pos: Vector
    axis: Vector
    range: Vector | None
    margin: float
    ref: float
    springref: float
    stiffness: float
    stiffnesspoly: Vector
    damping: float
    dampingpoly: Vector
    springdamper: Vector | None
    actuatorgravcomp: bool
    armature: float
    actuatorfrcrange: Vector | None
    frictionloss: float
    solreflimit: Vector
    solimplimit: Numbers
    solreffriction: Vector
    solimpfriction: Numbers


class GeomFields(TypedDict, total=False):
    """Fields of a `Geom` beside its body, type and size."""

    name: str
    pos: Vector
    quat: Vector
    fitscale: float
    mass: float | None
    density: float
    shellinertia: bool
    group: int
    hidden: bool
    contype: int
    conaffinity: int
    condim: int
    priority: int
    friction: Numbers
    margin: float
    gap: float
    surfacevel: Numbers
    adhesion: float
    solmix: float
    solref: Vector
    solimp: Numbers
    fluidshape: str
    fluidcoef: Numbers


class MeshFields(TypedDict, total=False):
    """Fields of a `Mesh` beside its name, vertices and faces."""

    scale: Vector
    refpos: Vector
    refquat: Vector
    inertia: str
    maxhullvert: int


class SiteFields(TypedDict, total=False):
    """Fields of a `Site` beside its body."""

    name: str
    pos: Vector
    quat: Vector
    type: str
    size: Numbers


class SensorFields(TypedDict, total=False):
    """Fields of a `Sensor` beside its type, object and reference."""

    name: str
    objtype: str
    reftype: str
    cutoff: float
    noise: float
    data: str | Sequence[str]
    reduce: str
    num: int


class TendonFields(TypedDict, total=False):
    """Fields of a `Tendon` beside its name and path."""

    range: Vector | None
    margin: float
    springlength: Numbers
    stiffness: float
    stiffnesspoly: Vector
    damping: float
    dampingpoly: Vector
    armature: float
    frictionloss: float
    actuatorfrcrange: Vector | None
    solreflimit: Vector
    solimplimit: Numbers
    solreffriction: Vector
    solimpfriction: Numbers


class ActuatorFields(TypedDict, total=False):
    """Fields of an `Actuator` beside its joint and type."""

    name: str
    cranklength: float
    gear: Numbers
    kp: float | None
    kv: float | None
    dampratio: float | None
    timeconst: Numbers | None
    input: str | None
    ki: float | None
    imax: float | None
    slewmax: float | None
    motorconst: float | None
    resistance: float | None
    inductance: float | None
    current_rate: float | None
    thermal: Numbers | None
    cogging: Numbers | None
    lugre: Numbers | None
    gain: float | None
    area: float | None
    bias: Numbers | None
    range: Vector | None
    force: float | None
    scale: float | None
    lmin: float | None
    lmax: float | None
    vmax: float | None
    fpmax: float | None
    fvmax: float | None
    tausmooth: float | None
    gaintype: str | None
    gainprm: Numbers | None
    biastype: str | None
    biasprm: Numbers | None
    dyntype: str | None
    dynprm: Numbers | None
    actrange: Vector | None
    actearly: bool
    lengthrange: Vector | None
    damping: float
    dampingpoly: Vector
    armature: float
    delay: float
    nsample: int
    interp: str
    enabled: bool
    ctrlrange: Vector | None
    forcerange: Vector | None


class EqualityFields(TypedDict, total=False):
    """Fields of an `Equality` beside its type, what it ties and its anchor."""

    name: str
    relpose: Vector | None
    torquescale: float
    polycoef: Numbers
    active: bool
    solref: Vector
    solimp: Numbers


class PairFields(TypedDict, total=False):
    """Fields of a `Pair` beside its geoms."""

    name: str
    condim: int
    friction: Numbers
    solref: Vector
    solimp: Numbers
    solreffriction: Vector | None
    margin: float
    gap: float
    adhesion: float


class KeyFields(TypedDict, total=False):
    """Fields of a `Key` beside its name."""

    time: float
    qpos: Vector | None
    qvel: Vector | None
    act: Vector | None
    ctrl: Vector | None
    mpos: Vector | None
    mquat: Vector | None
