"""`Actuator`: a motor, servo or muscle of a scene."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Annotated, Any

from stepcore import checks
from stepcore.scene.element import Element, FieldType, Places, place_of
from stepcore.scene.elements import field_types as of
from stepcore.scene.elements.actuator_laws import (
    ALL_LAW_FIELDS,
    CHARTS,
    CONTROL,
    FED,
    INPUTS,
    LAW_FIELDS,
    LAWS,
    Law,
    inputs,
)
from stepcore.scene.elements.body import SomeBody, SomeJoint, SomeSite
from stepcore.scene.elements.tendon import SomeTendon
from stepcore.scene.frames import ORIGIN, Vec

ACTUATOR_TYPES = tuple(LAWS)
DYNAMICS = ("none", "integrator", "filter", "filterexact", "muscle")
GAINS = ("fixed", "affine", "muscle")
BIASES = ("none", "affine", "muscle")
# Interpolation of past controls between samples.
INTERPS = ("zoh", "linear", "cubic")
# Transmission targets: an actuator has exactly one of these.
TARGETS = ("joint", "jointinparent", "tendon", "site", "cranksite", "body")
# Optional second fields, with the target that each field needs.
SECOND = {"refsite": "site", "slidersite": "cranksite"}
TARGET_FIELDS = (*TARGETS, *SECOND, "cranklength", "feeds")


def _one_or(count: int) -> checks.Check:

    def check(owner: Any, field: str, value: object) -> Any:
        if checks.as_list(value) is None:
            return checks.real()(owner, field, value)
        return checks.vector(count, fill=(0.0,) * count)(owner, field, value)

    return checks.optional(check)


def _inputs(owner: Any, field: str, value: object) -> Any:
    """Return inputs of a controller in their order, or the representation of an orientation."""
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
Thermal = Annotated[Vec | None, replace(of.optional(of.vector(5)), attribute="1-6")]
Cogging = Annotated[Vec | None, of.optional(of.vector(3, fill=ORIGIN))]
Lugre = Annotated[Vec | None, replace(of.optional(of.vector(5, low=0)), attribute="1-5")]
Samples = Annotated[int, replace(of.whole(0, 10**6), read=lambda value: max(value, 0))]


@dataclass(eq=False, repr=False, kw_only=True)
class Actuator(Element):
    """A motor, servo or muscle that applies gear × force to its transmission target.

    The force of each type is

    - "motor": control;
    - "position": kp × (control − length) − kv × velocity;
    - "velocity": kv × (control − velocity);
    - "intvelocity": kp × (w − length) − kv × velocity, where dw/dt = control;
    - "pid": kp × (p − length) + kv × (v − velocity) + ki × x + f, where dx/dt = p − length within
      ±imax. `input` lists which of p, v and f are controls; the others are 0;
    - "dcmotor": K/R × (voltage − K × velocity), with K = motorconst and the resistance R. With the
      inputs "pos", "vel" or "ff", a controller sets the voltage that gives the force of a pid;
    - "input": none; its control is another input of the actuator that it `feeds`;
    - "orientation", for a ball joint: a torque kp × r − kv × velocity about each axis of the body,
      where r is the rotation vector from the current orientation to the target orientation;
    - "damper": −kv × velocity × control;
    - "cylinder": area × w + bias · (1, length, velocity), where the pressure w follows the control
      with the time constant timeconst;
    - "adhesion": gain × control, a force that pulls the contacts of a body together;
    - "muscle": the force of MuJoCo's muscles at activation w (docs/method.md);
    - "general": gain × u + bias, where u is the control, or an activation w.

    Length and velocity are gear × the length and velocity of the target. A Sim's `energy` excludes
    energy that actuators store. Activations are a state of the simulation, `Sim.act`.

    name: unique among actuators, or "".
    joint: the target `Joint`. The length of a ball is the component of its rotation vector along
        gear; a servo on a ball takes the shorter way round. The length of a free joint is 0.
    jointinparent: in place of joint, a joint with its rotation axes in the parent frame.
    tendon: in place of joint, the target `Tendon`.
    site, refsite: in place of joint, a site at which force and torque act along gear, in the axes
        of the site. With a refsite, gear is in the axes of the refsite, and the length is the
        offset of the site from the refsite along gear.
    cranksite, slidersite, cranklength: in place of joint, a slider-crank: a rod of length
        cranklength [m] connects the cranksite to a slider, which moves along the z axis of the
        slidersite.
    body: in place of joint, a `Body`; the force acts along the normals of the body's contacts, in
        equal parts.
    type: one of the types above. A field that the type does not use is refused.
    gear: shape (6,). A hinge, slide, tendon or slider-crank uses the first number; a ball uses 3; a
        free joint and a site use 6, a force direction and a torque axis.
    kp: stiffness of a position or intvelocity servo, an orientation or a pid (None means 1), or of
        a dcmotor's controller (None means 0).
    kv: damping of the same types (None means 0), gain of a velocity servo or a damper (None means
        1).
    dampratio: damping ratio of a position or intvelocity servo, an orientation or a pid, in place
        of kv: kv = 2 × dampratio × √(kp × m), where m is the inertia that the actuator moves in the
        initial pose.
    timeconst: time constant [s] of a filter between control and target of a position servo (None
        means 0, no filter) or of a cylinder (None means 1); two time constants of a muscle, for
        activation and deactivation (None means 0.01 and 0.04).
    input: the meaning of the controls. For a pid: "pos", "vel" or "ff"; for a dcmotor also
        "voltage" (None). Several inputs are given in this order, such as "pos vel": the first is
        the control of the actuator itself, and each other input is the control of an actuator of
        type "input" with this `input`.
        For an orientation: "expmap" (None), a rotation vector [rad], or "quat", a quaternion of any
        length. The first component is the control of the orientation itself. The other components
        are the controls of actuators of type "input" with the inputs "y" and "z", or "x", "y" and
        "z"; these actuators apply the torque about the other axes. The forcerange (0, upper bound)
        of an orientation bounds the norm of the torque.
    feeds: for an "input", the pid, dcmotor or orientation that the control goes to.
    ki, imax: gain of the integral of the error, and bound of the integral, for a pid or a dcmotor's
        controller with the input "pos"; None means 0: no integral, no bound.
    slewmax: largest rate of change of the first target, for the same types [1/s]; None means 0: no
        bound.
    motorconst, resistance: of a dcmotor [N·m/A, Ω], > 0.
    inductance: of a dcmotor [H]; None means 0. With an inductance, the current is an activation.
    vmax, current_rate: bounds of the voltage of a dcmotor's controller [V] and of the rate of
        change of the current [A/s]; None means 0: no bound. The forcerange bounds the force of the
        current.
    thermal: thermal resistance [K/W], heat capacity [J/K], temperature coefficient of the
        electrical resistance [1/K], temperature at which `resistance` is valid and ambient
        temperature [°C] of a dcmotor. The temperature above ambient is then an activation.
    cogging: amplitude A, n and phase φ of the cogging force A sin(n × length + φ) of a dcmotor.
    lugre: LuGre friction of a dcmotor: stiffness and damping of the bristles, Coulomb and static
        friction, Stribeck velocity. The deflection of the bristles is then an activation. The order
        of activations is target, integral, temperature, bristles, current.
    gain: of an adhesion [N]; None means 1.
    area, bias: of a cylinder [m²]; None means 1 and zeros.
    range, force, scale, lmin, lmax, vmax, fpmax, fvmax, tausmooth: of a muscle, as in MJCF.
    gaintype, gainprm: of a general actuator. "fixed" (None): gain = gainprm (None means 1);
        "affine": gainprm · (1, length, velocity); "muscle": gainprm are range (2), force, scale,
        lmin, lmax, vmax, fpmax, fvmax.
    biastype, biasprm: "none", "affine" (None, if a biasprm is given) or "muscle". If
        gainprm = −biasprm[1], a positive biasprm[2] is a damping ratio, as in MuJoCo.
    dyntype: "none" (None); "integrator": dw/dt = control; "filter": dw/dt = (control −
        w)/dynprm[0]; "filterexact": the same with exact steps; "muscle".
    dynprm: of a general actuator; None means 1 [s].
    ctrlrange, actrange, forcerange: (lower, upper) bounds to which control, activation and force
        are clamped, or None.
    actearly: True computes the force from the activation at the end of the step.
    lengthrange: (least, greatest) length, which muscles refer to; None: found when the scene is
        compiled (`Scene.lengthrange`).
    damping, dampingpoly, armature: of the actuator itself; gear² times these values are added to
        the values of the target joint or tendon.
    delay: delay of the control [s]; 0: no delay. A delay counts in steps back from the present, and
        is at least one step.
    nsample: number of past controls that are kept (`Sim.ctrl_history`), at least 1 with a delay; a
        delay of more steps reads the oldest control.
    interp: interpolation between samples: "zoh" takes the earlier sample, "linear" a line, "cubic"
        a Catmull-Rom spline.
    enabled: False leaves the actuator out.
    """

    name: of.Text = ""
    joint: SomeJoint = None
    jointinparent: SomeJoint = None
    tendon: SomeTendon = None
    site: SomeSite = None
    refsite: SomeSite = None
    cranksite: SomeSite = None
    slidersite: SomeSite = None
    cranklength: Annotated[of.NonNegative, "m"] = 0.0
    body: SomeBody = None
    type: Annotated[str, of.words(*ACTUATOR_TYPES)] = "motor"
    gear: of.Gear = of.GEAR
    kp: of.Gain = None
    kv: of.Gain = None
    dampratio: of.Gain = None
    timeconst: Annotated[Times, "s"] = None
    input: Inputs = None
    feeds: Annotated[Actuator | None, of.optional(of.element("Actuator"))] = None
    ki: of.Limit = None
    imax: of.Limit = None
    slewmax: Annotated[of.Limit, "1/s"] = None
    motorconst: Annotated[of.Gain, "N·m/A"] = None
    resistance: Annotated[of.Gain, "Ω"] = None
    inductance: Annotated[of.Limit, "H"] = None
    current_rate: Annotated[of.Limit, "A/s"] = None
    thermal: Annotated[Thermal, "K/W, J/K, 1/K, °C and °C"] = None
    cogging: Cogging = None
    lugre: Lugre = None
    gain: Annotated[of.Gain, "N"] = None
    area: Annotated[of.Gain, "m²"] = None
    bias: of.Bias = None
    range: of.Range = None
    force: of.Gain = None
    scale: of.Gain = None
    lmin: of.Gain = None
    lmax: of.Gain = None
    vmax: of.Gain = None
    fpmax: of.Gain = None
    fvmax: of.Gain = None
    tausmooth: of.Gain = None
    gaintype: Annotated[str | None, of.optional(of.words(*GAINS))] = None
    gainprm: Terms = None
    biastype: Annotated[str | None, of.optional(of.words(*BIASES))] = None
    biasprm: Terms = None
    dyntype: Annotated[str | None, of.optional(of.words(*DYNAMICS))] = None
    dynprm: of.DynPrm = None
    ctrlrange: of.Range = None
    actrange: of.Range = None
    forcerange: of.Range = None
    actearly: of.Flag = False
    lengthrange: of.Lengths = None
    damping: of.Real = 0.0
    dampingpoly: of.Poly = (0.0, 0.0)
    armature: of.NonNegative = 0.0
    delay: Annotated[of.Delay, "s"] = 0.0
    nsample: Samples = 0
    interp: Annotated[str, of.words(*INTERPS)] = "zoh"
    enabled: of.OwnFlag = True

    @property
    def target(self) -> tuple[str, Any]:
        """The field of the transmission target, and its element; ("joint", None) if not given."""
        if self.feeds is not None:
            return self.feeds.target
        field = next((f for f in TARGETS if getattr(self, f) is not None), "joint")
        return field, getattr(self, field)

    def law_value(self, field: str) -> Any:
        """Return the value of a field of the law, with None replaced by the type's default.

        kp and kv of a general servo are those of its bias.
        """
        value, fields = getattr(self, field), LAW_FIELDS[self.type]
        if value is None and field in ("kp", "kv") and field not in fields:
            return self.servo_gains.get(field)
        return fields.get(field) if value is None else value

    @property
    def servo_gains(self) -> dict[str, float]:
        """kp and kv of a general position servo, or kv of a general velocity servo.

        The force is gain × control + bias₀ − kp × length − kv × velocity.
        """
        if self.type != "general" or (self.law.gaintype, self.law.biastype) != ("fixed", "affine"):
            return {}
        gains = {"kp": 0.0 - self.law.bias[1], "kv": 0.0 - self.law.bias[2]}
        return gains if gains["kp"] else {"kv": gains["kv"]} if gains["kv"] else {}

    def set_servo_gain(self, field: str, value: Any) -> None:
        """Assign kp or kv of a general servo; what the control asks for stays the same.

        The servo's main gain is kp, or kv without one: gain and bias₀ are scaled with it.
        """
        old, main = self.servo_gains[field], next(iter(self.servo_gains))
        # The field itself checks the value.
        setattr(self, field, value)
        new: float = getattr(self, field)
        setattr(self, field, None)
        law = self.law.general()
        (gain, *more), bias = law["gainprm"], [*law["biasprm"], *ORIGIN]
        if field == main:
            self.gainprm = (new if gain == old else gain * new / old, *more)
            bias[0] *= new / old
        bias[1 if field == "kp" else 2] = -new
        self.biasprm = tuple(bias[: max(3, len(law["biasprm"]))])

    @property
    def law(self) -> Law:
        """The force law of the actuator, with None replaced by the type's defaults."""
        if self.type == "input" and self.feeds is not None and self.axis is not None:
            return self.feeds.law
        return LAWS[self.type].to_law({f: self.law_value(f) for f in LAW_FIELDS[self.type]})

    @property
    def inputs(self) -> list[str]:
        """The meanings of the controls: first of its control, then of fed controls."""
        return inputs(self.type, self.input)

    @property
    def axis(self) -> int | None:
        """The index of the body axis of an orientation's torque; None for other types."""
        owner = self.feeds or self
        if owner.type != "orientation":
            return None
        words = owner.inputs
        at = words.index(self.input or "") if self.feeds and self.input in words else 0
        return at if at < 3 else None

    def plain(self, places: Places) -> dict[str, Any]:
        """Return the actuator as the engine reads it: law, transmission target and inputs."""
        law, owner, axis = self.law, self.feeds or self, self.axis
        gear = list(owner.gear)
        if axis is not None:
            gear = [float(k == axis) for k in range(3)] + list(ORIGIN)
        # A placeholder for muscles without a range: `length_ranges.fill_ranges` replaces it.
        lengthrange = self.lengthrange or (0.0, 1.0 if law.is_muscle else 0.0)
        bounds = owner if axis is not None else self
        field, element = self.target
        target: dict[str, Any] = {field: -1 if element is None else place_of(places, element)}
        if field == "site":
            target["refsite"] = owner.refsite and place_of(places, owner.refsite)
        if field == "cranksite" and owner.slidersite is not None:
            target["slidersite"] = place_of(places, owner.slidersite)
            target["cranklength"] = owner.cranklength
        return self.record("type", *ALL_LAW_FIELDS, *TARGET_FIELDS) | {
            "target": target,
            "feeds": None if self.feeds is None else place_of(places, self.feeds),
            "gain": list(law.gain),
            "bias": list(law.bias),
            "dampratio": law.dampratio,
            "controller": law.controller,
            "input": (self.input or "pos") if self.feeds else self.inputs[0],
            "gear": gear,
            "orientation": None if axis is None else {"axis": axis, "quat": owner.input == "quat"},
            "forcerange": bounds.forcerange and list(bounds.forcerange),
            "dynamics": law.dyntype,
            "dynprm": list(law.dynprm),
            "muscle_gain": _plain_muscle(law.muscle_gain),
            "muscle_bias": _plain_muscle(law.muscle_bias),
            "lengthrange": list(lengthrange),
        }

    def check(self, places: Places) -> None:
        """Raise ElementError for fields that the type does not use, or that are contradictory."""
        for field in TARGET_FIELDS:
            end = getattr(self, field)
            if isinstance(end, Element):
                places.needed(self, end)
        fields = LAW_FIELDS[self.type]
        for field in ALL_LAW_FIELDS:
            if getattr(self, field) is not None and field not in fields:
                has = ", ".join(fields) or "none of these"
                raise self._bad(field, f"None for type {self.type!r}, which has {has}")
        self._check_target()
        if self.delay > 0 and self.nsample == 0:
            raise self._bad("nsample", ">= 1 with a delay")
        two = isinstance(self.timeconst, tuple)
        if self.timeconst is not None and two != (self.type == "muscle"):
            raise self._bad("timeconst", "two numbers for a muscle, one for others")
        if self.type in ("pid", "dcmotor"):
            self._check_controller()
        if self.type == "orientation":
            self._check_orientation()
        if self.type == "input":
            if self.feeds is None:
                raise self._bad("feeds", "a pid, a dcmotor or an orientation for type 'input'")
            if self.input not in (*INPUTS, *CHARTS["quat"]):
                raise self._bad("input", f"one of {', '.join(INPUTS)}")
            if self.feeds.type not in FED or self.input not in self.feeds.inputs[1:]:
                raise self._bad("feeds", f"with {self.input!r} among its inputs, and not the first")
        if self.type in ("position", "intvelocity", "damper", "pid", "orientation"):
            for field in ("kv", "dampratio", "timeconst"):
                if (getattr(self, field) or 0.0) < 0:
                    raise self._bad(field, ">= 0")
            if self.kv and self.dampratio:
                raise checks.ElementError(self, "kv and dampratio are both given")
        if self.type in ("damper", "adhesion") and self.ctrlrange and self.ctrlrange[0] < 0:
            raise self._bad("ctrlrange", f">= 0 for type {self.type!r}")
        law = self.law
        if law.dyntype == "none" and self.actrange is not None:
            raise self._bad("actrange", "None without an activation")
        self._check_curves(law)
        if law.dampratio and law.gain[0] < 0:
            field = "gainprm" if self.type == "general" else "kp"
            raise checks.refuse(self, field, law.gain[0], ">= 0 with a damping ratio")

    def _bad(self, field: str, limit: str) -> checks.ElementError:
        return checks.refuse(self, field, getattr(self, field), limit)

    def _check_curves(self, law: Law) -> None:
        """Raise for muscle parameters outside MuJoCo's limits: its curves divide by them."""
        for field, numbers in (("gainprm", law.muscle_gain), ("biasprm", law.muscle_bias)):
            if numbers is None:
                continue
            low, high = numbers["range"]
            positive = ("scale", "vmax", "fpmax", "fvmax")
            limits = {
                "range": (low < high, "in ascending order"),
                **{name: (numbers[name] > 0, "> 0") for name in positive},
                "lmin": (numbers["lmin"] < 1, "below 1"),
                "lmax": (numbers["lmax"] > 1, "above 1"),
            }
            for name, (holds, limit) in limits.items():
                if not holds:
                    where = name if self.type == "muscle" else field
                    limit = f"{limit} ({name} of a muscle)"
                    raise checks.refuse(self, where, numbers[name], limit)

    def _check_target(self) -> None:
        if self.body is not None and self.law.servo:
            raise checks.ElementError(self, "a servo has no length at the contacts of a body")
        if self.type == "adhesion" and self.body is None:
            raise self._bad("body", "given for an adhesion")
        targets = [field for field in TARGETS if getattr(self, field) is not None]
        if self.type == "input":
            if targets:
                raise self._bad(targets[0], "None for type 'input', which pulls at nothing itself")
            return
        if len(targets) != 1:
            named_targets = " and ".join(targets) or "nothing"
            text = f"pulls at {named_targets}: it needs exactly one of {', '.join(TARGETS)}"
            raise checks.ElementError(self, text)
        target = targets[0]
        for second, first in SECOND.items():
            if getattr(self, second) is not None and target != first:
                raise self._bad(second, f"None without a {first}")
        if target == "cranksite":
            if self.slidersite is None:
                raise self._bad("slidersite", "given with a cranksite")
            if self.cranklength <= 0:
                raise self._bad("cranklength", "> 0")
        elif self.cranklength:
            raise self._bad("cranklength", "0 without a cranksite")
        if target not in ("joint", "jointinparent", "tendon"):
            for field in ("damping", "dampingpoly", "armature"):
                value = getattr(self, field)
                if any(value) if isinstance(value, tuple) else value:
                    raise self._bad(field, "0 unless it drives a joint or a tendon")

    def _check_controller(self) -> None:
        words, motor = self.inputs, self.type == "dcmotor"
        if motor:
            self._check_motor(words)
        elif self.input is None or not {*words} <= {*INPUTS[:3]}:
            raise self._bad("input", "some of pos, vel, ff for a pid")
        if self.ki and "pos" not in words:
            raise self._bad("ki", "None without the input pos")
        if self.slewmax and not (words[0] == "pos" or (motor and words[0] != "voltage")):
            allowed = "pos, vel or ff" if motor else "pos"
            raise self._bad("slewmax", f"None without the input {allowed}")
        if self.refsite is None and getattr(self.target[1], "type", "") != "ball":
            return
        # The shorter way round needs a position target without a state.
        if self.kp and (motor or "pos" not in words):
            raise self._bad("kp", "0 on a ball or a refsite, but for a pid with the input pos")
        for field in ("ki", "slewmax"):
            if getattr(self, field):
                raise self._bad(field, "None on a ball or a refsite")

    def _check_motor(self, words: list[str]) -> None:
        if not {*words} <= {*INPUTS}:
            raise self._bad("input", f"some of {', '.join(INPUTS)} for a dcmotor")
        for field in ("motorconst", "resistance"):
            if (getattr(self, field) or 0.0) <= 0:
                raise self._bad(field, "> 0")
        if words == ["voltage"]:
            for field in ("kp", "kv", *CONTROL, "vmax"):
                if getattr(self, field):
                    raise self._bad(field, "None or 0 without an input pos, vel or ff")
        if (self.vmax or 0.0) < 0:
            raise self._bad("vmax", ">= 0 for a dcmotor")
        if self.thermal and min(self.thermal[:2]) <= 0:
            raise self._bad("thermal", "resistance and capacity > 0")

    def _check_orientation(self) -> None:
        if self.input not in (None, *CHARTS):
            raise self._bad("input", f"one of {', '.join(CHARTS)}")
        if getattr(self.joint, "type", "") != "ball":
            raise self._bad("joint", "a ball joint for an orientation")
        if self.forcerange is not None and self.forcerange[0] != 0:
            raise self._bad("forcerange", "(0, most)")
        for field in ("damping", "armature"):
            if getattr(self, field):
                raise self._bad(field, "0 for an orientation")


def check_inputs(actuators: Sequence[Actuator]) -> None:
    """Raise ElementError unless every additional input has exactly one feeding actuator."""
    fed: dict[int, list[str]] = {}
    for actuator in actuators:
        if actuator.feeds is not None and actuator.input is not None:
            fed.setdefault(id(actuator.feeds), []).append(actuator.input)
    for actuator in actuators:
        for word in actuator.inputs[1:]:
            count = fed.get(id(actuator), []).count(word)
            if count != 1:
                limit = f"one actuator of type 'input' that feeds {word!r}, not {count}"
                raise checks.refuse(actuator, "input", actuator.input, limit)


def _plain_muscle(numbers: dict[str, Any] | None) -> dict[str, Any] | None:
    return numbers and {**numbers, "range": list(numbers["range"])}
