"""Backlash that a user built and that does not act, because an equality holds its joint.

Backlash is a joint of small range in series with another: two joints of one body along one axis.
"""

from __future__ import annotations

from collections.abc import Iterator
from functools import partial

import numpy as np

from stepcore.engine.element import SceneField
from stepcore.engine.model import Model
from stepcore.engine.sim import Sim
from stepcore.measure.monitors.finding import Cure, Finding, Remedy, named
from stepcore.measure.monitors.joints import held_at, is_angular, length_of
from stepcore.measure.monitors.readings import REST
from stepcore.report.units import percent
from stepcore.scene.layout import Layout

# Cosine of the angle between two axes that are one.
PARALLEL = 1 - 1e-6
# A joint in free play falls onto an end of it. One that uses less than the first share of half its
# range is held; once it is free, it uses the second.
HELD, FREE = 0.9, 0.99


class PlayMonitor:
    """A record of the joints in series with another in one run."""

    def __init__(self, model: Model) -> None:
        self.model, self.held = model, held_at(model)
        limited = model.scene.features.limit and model.scene.features.constraint
        self.joints = [k for k in range(model.njnt) if limited and _in_series(model, k)]
        self.at = model.jnt_qposadr[self.joints] if self.joints else None
        self.places: list[np.ndarray] = []

    def look(self, sim: Sim) -> None:
        """Record the coordinates of the joints."""
        if self.at is not None:
            self.places.append(np.array(sim.qpos)[self.at])

    def used(self, joint: int) -> float:
        """Return the share of half its range that a joint uses at the end of the run."""
        low, high = (float(bound) for bound in self.model.jnt_range[joint])
        places = np.array(self.places)[-max(1, int(REST * len(self.places))) :]
        apart = places[:, self.joints.index(joint)] - (low + high) / 2
        return float(np.abs(apart).mean()) / ((high - low) / 2)

    def findings(self) -> Iterator[Finding]:
        """Yield the joints that an equality holds within their range."""
        model = self.model
        for joint in self.joints if self.places else ():
            aims = [
                (k, float(model.qpos0[model.jnt_qposadr[joint]]) + float(coefficients[0]))
                for k, other, coefficients in self.held.get(joint, ())
                if other is None
            ]
            low, high = (float(bound) for bound in model.jnt_range[joint])
            if not aims or not low < aims[0][1] < high or self.used(joint) > HELD:
                continue
            yield self._held(joint, *aims[0])

    def _held(self, joint: int, equality: int, aim: float) -> Finding:
        model, used = self.model, self.used(joint)
        low, high = (float(bound) for bound in model.jnt_range[joint])
        say = partial(length_of, model, joint)
        elements = (*named(model, "joint", [joint]), *named(model, "joint equality", [equality]))
        problem = (
            f"{elements[1].name} pulls {elements[0].name} to {say(aim)}, within its range of "
            f"{say(low)} to {say(high)}, so it is a spring and no backlash: {percent(used)} of the "
            "range is used"
        )
        active = SceneField.of(Layout(model.scene), "equality", equality, "active")
        remedy = Remedy(
            ((Cure("removing the equality", ((active, False),)),),),
            lambda m: 1 - m.play.used(joint),
            1 - FREE,
            lambda left: f"{percent(1 - left)} of it in use",
            now=1 - used,
            needed=True,
        )
        unit = "rad" if is_angular(model, joint) else "m"
        value = used * (high - low) / 2
        return Finding("backlash", "warning", problem, "", elements, value, unit, remedy=remedy)


def _in_series(model: Model, joint: int) -> bool:
    """Return whether a joint with a range has another joint of its body along the same axis."""
    kind, body, axis = model.jnt_type[joint], model.jnt_body[joint], model.jnt_axis[joint]
    if kind not in ("hinge", "slide") or not np.isfinite(model.jnt_range[joint]).all():
        return False
    return any(
        k != joint
        and model.jnt_body[k] == body
        and other == kind
        and abs(float(model.jnt_axis[k] @ axis)) > PARALLEL
        for k, other in enumerate(model.jnt_type)
    )
