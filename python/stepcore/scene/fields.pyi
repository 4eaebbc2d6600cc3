"""The keyword fields of `Scene.add_joint` and its like: python benches/keyword_types.py.

What each means stands in `stepcore.scene.elements`.
"""

from collections.abc import Sequence
from typing import Any, TypedDict

from numpy.typing import NDArray

from stepcore.scene.elements import Actuator, Body, Joint, Site, Tendon

# What is checked when it is assigned: one number stands for a first entry where that is said.
Vector = Sequence[float] | NDArray[Any]
Numbers = float | Vector

class BodyFields(TypedDict, total=False):
    mass: float | None
    ipos: Vector
    inertia: Vector
    iquat: Vector | None
    gravcomp: float
    mocap: bool
    sleep: str

class JointFields(TypedDict, total=False):
    name: str
    pos: Vector
    axis: Vector
    range: Vector | None
    margin: float
    ref: float
    springref: float
    stiffness: float
    stiffnesspoly: Numbers
    damping: float
    dampingpoly: Numbers
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
    scale: Vector
    refpos: Vector
    refquat: Vector
    inertia: str
    maxhullvert: int

class SiteFields(TypedDict, total=False):
    name: str
    pos: Vector
    quat: Vector
    type: str
    size: Numbers

class SensorFields(TypedDict, total=False):
    name: str
    objtype: str
    reftype: str
    cutoff: float
    noise: float
    data: str | Sequence[str]
    reduce: str
    num: int

class TendonFields(TypedDict, total=False):
    range: Vector | None
    margin: float
    springlength: Numbers
    stiffness: float
    stiffnesspoly: Numbers
    damping: float
    dampingpoly: Numbers
    armature: float
    frictionloss: float
    actuatorfrcrange: Vector | None
    solreflimit: Vector
    solimplimit: Numbers
    solreffriction: Vector
    solimpfriction: Numbers

class ActuatorFields(TypedDict, total=False):
    name: str
    jointinparent: str | Joint | None
    tendon: str | Tendon | None
    site: str | Site | None
    refsite: str | Site | None
    cranksite: str | Site | None
    slidersite: str | Site | None
    cranklength: float
    body: str | Body | None
    gear: Numbers
    kp: float | None
    kv: float | None
    dampratio: float | None
    timeconst: Numbers | None
    input: str | None
    feeds: str | Actuator | None
    ki: float | None
    imax: float | None
    slewmax: float | None
    motorconst: float | None
    resistance: float | None
    inductance: float | None
    current_rate: float | None
    thermal: Vector | None
    cogging: Numbers | None
    lugre: Vector | None
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
    ctrlrange: Vector | None
    actrange: Vector | None
    forcerange: Vector | None
    actearly: bool
    lengthrange: Vector | None
    damping: float
    dampingpoly: Numbers
    armature: float
    delay: float
    nsample: int
    interp: str
    enabled: bool

class EqualityFields(TypedDict, total=False):
    name: str
    site1: str | Site | None
    site2: str | Site | None
    joint1: str | Joint | None
    joint2: str | Joint | None
    tendon1: str | Tendon | None
    tendon2: str | Tendon | None
    relpose: Vector | None
    torquescale: float
    polycoef: Numbers
    active: bool
    solref: Vector
    solimp: Numbers

class PairFields(TypedDict, total=False):
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
    time: float
    qpos: Vector | None
    qvel: Vector | None
    act: Vector | None
    ctrl: Vector | None
    mpos: Vector | None
    mquat: Vector | None
