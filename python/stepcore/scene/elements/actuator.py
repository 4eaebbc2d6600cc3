"""`Actuator`."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Annotated

from stepcore import checks
from stepcore.scene.element import Element
from stepcore.scene.elements.field_types import GEAR, Bias, DynPrm, Flag, Gain, Gear, Range, Text
from stepcore.scene.elements.joint import AJoint

ACTUATOR_TYPES = ("motor", "position", "velocity", "general")
DYNAMICS = ("none", "integrator", "filter", "filterexact")
DynType = Annotated[str | None, checks.optional(checks.one_of(*DYNAMICS))]


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
    timeconst: of a position servo: time constant of a filter between its control and its target
        [s]; None means 0, no filter.
    dyntype: of a general actuator: what stands in for the control is an activation w, a state of
        the simulation, with dw/dt = control ("integrator") or (control − w)/dynprm[0] ("filter", and
        "filterexact", whose steps are exact); None means "none".
    dynprm: of a general actuator; None means 1 [s].
    ctrlrange, actrange, forcerange: (lower, upper) bounds to which control, activation and force
        are clamped, or None.
    actearly: True takes the force from the activation at the end of the step.
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
    timeconst: Gain = None
    dyntype: DynType = None
    dynprm: DynPrm = None
    ctrlrange: Range = None
    actrange: Range = None
    forcerange: Range = None
    actearly: Flag = False
