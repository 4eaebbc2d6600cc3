"""`Actuator`."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Annotated, Any

from stepcore import checks
from stepcore.scene.element import Element, FieldType
from stepcore.scene.elements.body import Body
from stepcore.scene.elements.field_types import (
    GEAR,
    Bias,
    Delay,
    DynPrm,
    Flag,
    Gain,
    Gear,
    Lengths,
    Limit,
    NonNegative,
    OwnFlag,
    Poly,
    Range,
    Real,
    Text,
    element,
    optional,
    vector,
    whole,
    words,
)
from stepcore.scene.elements.joint import Joint
from stepcore.scene.elements.site import Site
from stepcore.scene.elements.tendon import Tendon
from stepcore.scene.frames import ORIGIN, Vec

_SERVOS = ("position", "velocity", "intvelocity")
ACTUATOR_TYPES = (
    *("motor", *_SERVOS, "pid", "dcmotor", "damper", "cylinder", "muscle", "adhesion"),
    *("orientation", "general", "input"),
)
INPUTS = ("pos", "vel", "ff", "voltage")
# The parts of an orientation, by how it is written.
CHARTS = {"expmap": ("x", "y", "z"), "quat": ("w", "x", "y", "z")}
DYNAMICS = ("none", "integrator", "filter", "filterexact", "muscle")
GAINS = ("fixed", "affine", "muscle")
BIASES = ("none", "affine", "muscle")
# What a control is between two samples of its past.
INTERPS = ("zoh", "linear", "cubic")
MOST_SAMPLES = 10**6
# A muscle's numbers in the order of gainprm, with their defaults.
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
_SERVO = {"kp": 1.0, "kv": 0.0, "dampratio": 0.0}
_CONTROL = dict.fromkeys(("ki", "imax", "slewmax"), 0.0)
_MOTOR = {
    **{"motorconst": 0.0, "resistance": 1.0, "inductance": 0.0, "vmax": 0.0, "current_rate": 0.0},
    **{"thermal": None, "cogging": ORIGIN, "lugre": None},
}
# By type: the fields of its law, each with the value that None stands for. A field of another type
# is refused.
LAW_FIELDS: dict[str, dict[str, Any]] = {
    "motor": {},
    "position": _SERVO | {"timeconst": 0.0},
    "velocity": {"kv": 1.0},
    "intvelocity": _SERVO,
    "pid": _SERVO | {"input": None} | _CONTROL,
    "dcmotor": {"kp": 0.0, "kv": 0.0, "input": "voltage"} | _CONTROL | _MOTOR,
    "input": {"input": None},
    "orientation": _SERVO | {"input": "expmap"},
    "damper": {"kv": 1.0},
    "cylinder": {"timeconst": 1.0, "area": 1.0, "bias": ORIGIN},
    "adhesion": {"gain": 1.0},
    "muscle": MUSCLE | {"timeconst": (0.01, 0.04), "tausmooth": 0.0},
    "general": {
        **{"gaintype": "fixed", "gainprm": 1.0, "biastype": "affine", "biasprm": ORIGIN},
        **{"dyntype": "none", "dynprm": (1.0, 0.0, 0.0)},
    },
}
# What an actuator can pull at: exactly one of these, and what else goes with it.
TARGETS = ("joint", "jointinparent", "tendon", "site", "cranksite", "body")
SECOND = {"refsite": "site", "slidersite": "cranksite"}


def _one_or(count: int) -> checks.Check:
    """A number, or up to `count` of them."""

    def check(owner: Any, field: str, value: object) -> Any:
        if checks.listed(value) is None:
            return checks.real()(owner, field, value)
        return checks.vector(count, fill=(0.0,) * count)(owner, field, value)

    return checks.optional(check)


def _inputs(owner: Any, field: str, value: object) -> Any:
    """Some of the inputs of a controller, in their order, or what an orientation is written as."""
    words = value.split() if isinstance(value, str) else []
    if value in (*CHARTS, *CHARTS["quat"]):
        return value
    if not words or words != [word for word in INPUTS if word in words]:
        limit = f"None or some of {', '.join(INPUTS)}, in this order"
        raise checks.refuse(owner, field, value, limit)
    return " ".join(words)


Terms = Annotated[Any, FieldType(_one_or(10), "Numbers | None", "*")]
Times = Annotated[Any, FieldType(_one_or(2), "Numbers | None", "1")]
Inputs = Annotated[str | None, FieldType(checks.optional(_inputs), "str | None", "")]
Thermal = Annotated[Vec | None, replace(optional(vector(5)), attribute="1-6")]
Cogging = Annotated[Vec | None, optional(vector(3, fill=ORIGIN))]
Lugre = Annotated[Vec | None, replace(optional(vector(5, low=0)), attribute="1-5")]
Samples = Annotated[int, replace(whole(0, MOST_SAMPLES), read=lambda value: max(value, 0))]
AnyJoint = Annotated[Joint | None, optional(element("Joint"))]
AnyTendon = Annotated[Tendon | None, optional(element("Tendon"))]
AnyBody = Annotated[Body | None, optional(element("Body"))]
AnySite = Annotated[Site | None, optional(element("Site"))]


@dataclass(eq=False, repr=False, kw_only=True)
class Actuator(Element):
    """A motor, servo or muscle. What it pulls at feels gear × force, where force is

    - for a "motor", the control;
    - for a "position" servo, kp × (control − length) − kv × velocity;
    - for a "velocity" servo, kv × (control − velocity);
    - for an "intvelocity" servo, kp × (w − length) − kv × velocity, where dw/dt = control;
    - for a "pid", kp × (p − length) + kv × (v − velocity) + ki × x + f, where its controls are
      those of p, v and f that its `input` names, the others are 0, and dx/dt = p − length within
      ±imax;
    - for a "dcmotor" of constant K = motorconst and resistance R, K/R × (voltage − K × velocity);
      with the inputs "pos", "vel" or "ff" its controller asks for the force of a pid, and gets it;
    - for an "input", none: its control is that of another input of the actuator that it `feeds`;
    - for an "orientation", of a ball joint, a torque kp × r − kv × velocity about each axis of its
      body, r being the rotation vector from its orientation to that of its controls;
    - for a "damper", −kv × velocity × control;
    - for a "cylinder", area × w + bias · (1, length, velocity), where w is the pressure, which
      follows the control with the time constant timeconst;
    - for an "adhesion", gain × control, with which the contacts of a body are pulled together;
    - for a "muscle", that of MuJoCo's muscles at activation w (docs/method.md);
    - for a "general" actuator, gain × u + bias: u is the control, or an activation w.

    Length and velocity are gear × those of what it pulls at. A Sim's `energy` does not include what
    actuators store. Activations are a state of the simulation, `Sim.act`.

    name: unique among actuators, or "".
    joint: the `Joint` that it drives. The length of a ball is the part of its rotation vector along
        gear, that of a free joint 0; a servo on a ball goes the shorter way round.
    jointinparent: in its place, a joint whose axes of rotation are those of the frame it stands in.
    tendon: in its place, the `Tendon` that it pulls.
    site, refsite: in its place, a site at which force and torque act along gear, in the axes of the
        site; with a refsite in the axes of that, and the length is that of the offset from it.
    cranksite, slidersite, cranklength: in its place, a slider-crank: a rod of this length [m] from
        the cranksite to the slidersite, which slides along its own z axis.
    body: in its place, a `Body` whose contacts are pulled at along their normals, each with the
        same part of the force.
    type: one of those above. A field of another type is refused.
    gear: shape (6,); a hinge, slide, tendon or slider-crank uses the first number, a ball 3, a free
        joint and a site 6: a direction and an axis.
    kp: stiffness of a position or intvelocity servo, an orientation or a pid; None means 1; of a
        dcmotor's controller, where None means 0.
    kv: damping of these (None means 0), gain of a velocity servo or a damper (None means 1).
    dampratio: damping ratio of a position or intvelocity servo or a pid, in place of kv:
        kv = 2 × dampratio × √(kp × m), where m is the inertia that it moves in the initial pose.
    timeconst: time constant [s] of a filter between control and target of a position servo (None
        means 0, no filter), of a cylinder (None means 1), and two of a muscle, of activation and
        deactivation (None means 0.01 and 0.04).
    input: what the control of a pid is, "pos", "vel" or "ff"; of a dcmotor also "voltage" (None).
        Several in this order, such as "pos vel": the first is its own control, and each of the
        others that of an actuator of the type "input", whose `input` it is.
        Of an orientation "expmap" (None), a rotation vector [rad], or "quat", a quaternion of any
        length: its own control is the first part, and those of actuators of the type "input" with
        the inputs "y" and "z", or "x", "y" and "z", the others. They pull about the other axes, and
        its forcerange (0, most) bounds the length of the torque.
    feeds: of an "input": the pid, dcmotor or orientation.
    ki, imax: of a pid and a dcmotor's controller with the input "pos": gain of the integral of the
        error, and its bound; None means 0, without.
    slewmax: of these: how fast the first target moves at most [1/s]; None means 0, at once.
    motorconst, resistance: of a dcmotor [N·m/A, Ω], > 0.
    inductance: of a dcmotor [H]; None means 0. Its current is then an activation.
    vmax, current_rate: bounds of the voltage of its controller [V], and of how fast its current
        changes [A/s]; None means 0, without. Its forcerange bounds what its current makes.
    thermal: its thermal resistance [K/W] and capacity [J/K], how much its resistance grows with
        each degree [1/K], and the temperatures of that resistance and of the surroundings [°C].
        The temperature above the surroundings is then an activation.
    cogging: amplitude A, n and phase φ of a force A sin(n × length + φ).
    lugre: LuGre friction: stiffness and damping of bristles, friction at speed and at rest, and the
        speed between these. The bristles' deflection is then an activation. Activations stand in
        the order target, integral, temperature, bristles, current.
    gain: of an adhesion [N]; None means 1.
    area, bias: of a cylinder [m²]; None means 1 and zeros.
    range, force, scale, lmin, lmax, vmax, fpmax, fvmax, tausmooth: of a muscle, as in MJCF.
    gaintype, gainprm: of a general actuator. "fixed" (None): gain = gainprm (None means 1);
        "affine": gainprm · (1, length, velocity); "muscle": gainprm are range (2), force, scale,
        lmin, lmax, vmax, fpmax, fvmax.
    biastype, biasprm: "none", "affine" (None, where there is a biasprm) or "muscle". If
        gainprm = −biasprm[1], a positive biasprm[2] is a damping ratio, as in MuJoCo.
    dyntype: "none" (None); "integrator": dw/dt = control; "filter": dw/dt = (control −
        w)/dynprm[0]; "filterexact": the same with exact steps; "muscle".
    dynprm: of a general actuator; None means 1 [s].
    ctrlrange, actrange, forcerange: (lower, upper) bounds to which control, activation and force
        are clamped, or None.
    actearly: True takes the force from the activation at the end of the step.
    lengthrange: least and greatest length, which muscles refer to; None: found when the scene is
        compiled (`Scene.lengthrange`).
    damping, dampingpoly, armature: of the actuator itself; gear² times these are added to those of
        the joint or tendon that it drives.
    delay: the control is that of so long ago [s]; 0: the present one. Steps are counted back from
        the present, and a delay shorter than a step is one step.
    nsample: how many past controls are kept (`Sim.ctrl_history`), at least 1 with a delay; a delay
        of more steps reads the oldest.
    interp: between samples, "zoh" takes the earlier one, "linear" a line, "cubic" a Catmull-Rom
        spline.
    enabled: False leaves it out.
    """

    name: Text = ""
    joint: AnyJoint = None
    jointinparent: AnyJoint = None
    tendon: AnyTendon = None
    site: AnySite = None
    refsite: AnySite = None
    cranksite: AnySite = None
    slidersite: AnySite = None
    cranklength: Annotated[NonNegative, "m"] = 0.0
    body: AnyBody = None
    type: Annotated[str, words(*ACTUATOR_TYPES)] = "motor"
    gear: Gear = GEAR
    kp: Gain = None
    kv: Gain = None
    dampratio: Gain = None
    timeconst: Annotated[Times, "s"] = None
    input: Inputs = None
    feeds: Annotated[Actuator | None, optional(element("Actuator"))] = None
    ki: Limit = None
    imax: Limit = None
    slewmax: Annotated[Limit, "1/s"] = None
    motorconst: Annotated[Gain, "N·m/A"] = None
    resistance: Annotated[Gain, "Ω"] = None
    inductance: Annotated[Limit, "H"] = None
    current_rate: Annotated[Limit, "A/s"] = None
    thermal: Annotated[Thermal, "K/W, J/K, 1/K, °C and °C"] = None
    cogging: Cogging = None
    lugre: Lugre = None
    gain: Annotated[Gain, "N"] = None
    area: Annotated[Gain, "m²"] = None
    bias: Bias = None
    range: Range = None
    force: Gain = None
    scale: Gain = None
    lmin: Gain = None
    lmax: Gain = None
    vmax: Gain = None
    fpmax: Gain = None
    fvmax: Gain = None
    tausmooth: Gain = None
    gaintype: Annotated[str | None, optional(words(*GAINS))] = None
    gainprm: Terms = None
    biastype: Annotated[str | None, optional(words(*BIASES))] = None
    biasprm: Terms = None
    dyntype: Annotated[str | None, optional(words(*DYNAMICS))] = None
    dynprm: DynPrm = None
    ctrlrange: Range = None
    actrange: Range = None
    forcerange: Range = None
    actearly: Flag = False
    lengthrange: Lengths = None
    damping: Real = 0.0
    dampingpoly: Poly = (0.0, 0.0)
    armature: NonNegative = 0.0
    delay: Annotated[Delay, "s"] = 0.0
    nsample: Samples = 0
    interp: Annotated[str, words(*INTERPS)] = "zoh"
    enabled: OwnFlag = True

    @property
    def target(self) -> tuple[str, Any]:
        """The field that says what it pulls at, and that element; ("joint", None) without one."""
        if self.feeds is not None:
            return self.feeds.target
        found = [field for field in TARGETS if getattr(self, field) is not None]
        field = found[0] if found else "joint"
        return field, getattr(self, field)

    def law_value(self, field: str) -> Any:
        """The value of a field of the law; where it is None, the default of the actuator's type."""
        value = getattr(self, field)
        return LAW_FIELDS[self.type].get(field) if value is None else value
