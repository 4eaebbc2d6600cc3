"""`Drives`: what each actuator of a model is, and what bounds its force."""

from __future__ import annotations

from functools import cached_property

import numpy as np

from stepcore.engine.model import Model
from stepcore.scene.layout import Layout

# Words for the types of actuators.
WORDS = {"motor": "motor", "muscle": "muscle", "damper": "damper", "cylinder": "cylinder"}
WORDS |= dict.fromkeys(("position", "velocity", "intvelocity"), "servo")
# Force laws under which a control sets a length, a velocity or a force.
SERVO, RATE, MOTOR, OTHER = "servo", "rate", "motor", "other"
# A control range within ±1 has no unit: it is an action, as of gymnasium and dm_control.
ACTION = 1.0


class Drives:
    """The actuators of a model by the quantity that their control sets.

    kinds: of each actuator: "servo" (its control is a length), "rate" (a velocity), "motor" (a
        force), or "other" (muscles, adhesion, controllers with further inputs).
    bounds: the largest |force| of each actuator, before the gear, inf without a bound, (nu,).
    """

    def __init__(self, model: Model) -> None:
        self.model, self.layout = model, Layout(model.scene)
        self.kinds = [self._kind(k) for k in range(model.nu)]
        self.bounds = np.array([self._bound(k) for k in range(model.nu)])
        # Target length or velocity per unit of control, of servos.
        bias = model.actuator_bias
        self.lengths = np.array([_over(model.actuator_gain[k], -bias[k, 1]) for k in self.all])
        self.speeds = np.array([_over(model.actuator_gain[k], -bias[k, 2]) for k in self.all])

    @property
    def all(self) -> range:
        return range(self.model.nu)

    def of(self, *kinds: str) -> list[int]:
        """Return the actuators of some kinds."""
        return [k for k in self.all if self.kinds[k] in kinds]

    def _kind(self, k: int) -> str:
        actuator, model = self.model.scene.actuators[k], self.model
        law, (_, length, speed) = actuator.law, model.actuator_bias[k].tolist()
        plain = law.gaintype == "fixed" and not law.is_muscle and law.controller is None
        if not plain or not model.actuator_gain[k] or actuator.target[0] == "body":
            return OTHER
        if actuator.feeds is not None or actuator.axis is not None:
            return OTHER
        if law.dyntype == "integrator":
            return RATE if length < 0 else OTHER
        if law.dyntype == "muscle":
            return OTHER
        if length < 0:
            return SERVO
        if length == 0 and speed < 0:
            return RATE
        if length == 0 and speed == 0:
            return MOTOR if self.joint(k) is not None else OTHER
        return OTHER

    def joint(self, k: int) -> int | None:
        """Return the hinge or slide that an actuator drives, or None."""
        joint, model = int(self.model.actuator_joint[k]), self.model
        drives = joint >= 0 and model.jnt_type[joint] in ("hinge", "slide")
        return joint if drives and model.actuator_gear[k, 0] else None

    def integrates(self, k: int) -> bool:
        """Whether the velocity that a control sets is that of a servo's target."""
        return self.model.scene.actuators[k].law.dyntype == "integrator"

    def _bound(self, k: int) -> float:
        """Return the largest force of an actuator, also within the range of its control."""
        model = self.model
        bound = float(np.abs(model.actuator_forcerange[k]).min())
        if self.kinds[k] == MOTOR and model.scene.features.clampctrl:
            ends = model.actuator_gain[k] * model.actuator_ctrlrange[k]
            bound = min(bound, float(np.abs(ends).max()))
        joint = self.joint(k)
        if joint is not None:
            whole = self.layout.joints[joint].actuatorfrcrange
            gear = abs(float(model.actuator_gear[k, 0]))
            if whole is not None:
                bound = min(bound, float(np.abs(whole).max()) / gear)
        return bound

    @cached_property
    def moves_about(self) -> bool:
        """Whether the actuators are on a body that nothing fixes: free, or on slides of its own."""
        model = self.model
        driven = {joint for k in self.all if (joint := self.joint(k)) is not None}
        trees = {model.root(int(model.jnt_body[joint])) for joint in driven}
        for joint, body in enumerate(model.jnt_body.tolist()):
            kind = model.jnt_type[joint]
            if body in trees and kind in ("free", "slide") and joint not in driven:
                return True
        return False

    @cached_property
    def takes_actions(self) -> bool:
        """Whether every control is an action within ±1, as of gymnasium's walkers."""
        low, high = self.model.actuator_ctrlrange.T
        return bool(self.model.nu and (np.maximum(-low, high) <= ACTION).all())


def _over(gain: float, stiffness: float) -> float:
    return float(gain / stiffness) if stiffness > 0 else 0.0


def actuators_in_words(model: Model) -> str:
    """Return the word for the actuators of a model, in the plural."""
    words = {WORDS.get(actuator.type, "actuator") for actuator in model.scene.actuators}
    return f"{words.pop()}s" if len(words) == 1 else "motors and servos"
