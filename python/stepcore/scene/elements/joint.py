"""`Joint`: a joint between a body and its parent."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Annotated, Any

from stepcore.scene.element import Element
from stepcore.scene.elements import field_types as of
from stepcore.scene.elements.body import ABody
from stepcore.scene.frames import ORIGIN

JOINT_TYPES = ("free", "ball", "slide", "hinge")


@dataclass(eq=False, repr=False, kw_only=True)
class Joint(Element):
    """A joint between a body and its parent. Several joints of one body act in order.

    name: unique among joints, or "".
    body: the `Body` that the joint moves.
    type: "hinge", "slide", "ball" or "free".
    pos: anchor in the body's frame [m], shape (3,).
    axis: axis of a hinge or slide in the body's frame, shape (3,), stored at unit length.
    range: (lower, upper) limit [rad or m], or None for no limit; (0, largest angle) for a ball.
    margin: distance from a limit at which the limit starts to act [rad or m].
    ref: coordinate of a hinge or slide in the initial pose of the scene [rad or m].
    springref: coordinate at which the spring is relaxed [rad or m].
    stiffness: stiffness of the spring [N·m/rad or N/m].
    stiffnesspoly: b [.../rad or m] and c [.../rad² or m²] of a spring with the restoring force
        (stiffness + b x + c x²) x at a stretch x. For a ball, x is the norm of the stretch; for a
        free joint, translation and rotation have a norm each.
    damping: [N·m·s/rad or N·s/m].
    dampingpoly: b and c of a damper with the force (damping + b |v| + c v²) v.
    springdamper: time constant [s] and damping ratio, > 0, of spring and damper, for the inertia
        that the joint moves in the initial pose; None uses `stiffness` and `damping`.
    actuatorgravcomp: True counts the gravity compensation of bodies on this joint as a force of
        the joint's actuators.
    armature: inertia added to each dof of the joint [kg·m² or kg], >= 0.
    actuatorfrcrange: (lower, upper) bounds of the sum of all actuator forces on a hinge or slide
        [N·m or N], or None.
    frictionloss: dry friction [N·m or N], >= 0.
    solreflimit, solimplimit: softness of the limit.
    solreffriction, solimpfriction: softness of the dry friction.
    """

    name: of.Text = ""
    body: ABody
    type: Annotated[str, of.words(*JOINT_TYPES)] = "hinge"
    pos: Annotated[of.Vec3, "m"] = ORIGIN
    axis: of.Axis = (0.0, 0.0, 1.0)
    range: Annotated[of.Reach, "rad or m"] = None
    margin: Annotated[of.Real, "rad or m"] = 0.0
    ref: Annotated[of.Real, "rad or m"] = 0.0
    springref: Annotated[of.Real, "rad or m"] = 0.0
    stiffness: Annotated[of.Real, "N·m/rad or N/m"] = 0.0
    stiffnesspoly: of.Poly = (0.0, 0.0)
    damping: Annotated[of.Real, "N·m·s/rad or N·s/m"] = 0.0
    dampingpoly: of.Poly = (0.0, 0.0)
    springdamper: Annotated[of.SpringDamper, "s and 1"] = None
    actuatorgravcomp: of.Flag = False
    armature: Annotated[of.NonNegative, "kg·m² or kg"] = 0.0
    actuatorfrcrange: Annotated[of.Range, "N·m or N"] = None
    frictionloss: Annotated[of.NonNegative, "N·m or N"] = 0.0
    solreflimit: of.SolRef = of.SOLREF
    solimplimit: of.SolImp = of.SOLIMP
    solreffriction: of.SolRef = of.SOLREF
    solimpfriction: of.SolImp = of.SOLIMP

    @property
    def sprung(self) -> bool:
        """Whether the joint has a spring."""
        return self.springdamper is not None or any((self.stiffness, *self.stiffnesspoly))

    @property
    def damped(self) -> bool:
        """Whether the joint has a damper."""
        return self.springdamper is not None or any((self.damping, *self.dampingpoly))

    def record(self, *skip: str) -> dict[str, Any]:
        """Return the fields as the engine reads them; a missing springdamper becomes two zeros."""
        return super().record(*skip) | {"springdamper": list(self.springdamper or (0.0, 0.0))}


SomeJoint = Annotated[Joint | None, of.optional(of.element("Joint"))]
