"""Find circulatory forces: forces of position that are the gradient of no energy.

The stiffness K of a force with a potential is symmetric. An antisymmetric part does work along a
closed path, and makes an oscillation grow (flutter): no dt and no integrator changes that. On a
ball joint, whose turns do not commute, the torque τ of a potential has K − Kᵀ = −[τ]×, in the
joint's own axes; only the rest is circulatory. Servos on the three axes of a ball joint are an
example: each pulls along a fixed axis, and the axes turn with the joint.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from stepcore.engine.arrays import Floats
from stepcore.engine.element import Element, ElementSlopes
from stepcore.engine.model import Model
from stepcore.measure.diagnosis.growth import eigenvalues
from stepcore.measure.diagnosis.isolated import joint_dofs
from stepcore.measure.diagnosis.limits import StepStability
from stepcore.measure.diagnosis.midpoint_map import cross_matrix

# The circulatory part of an element's stiffness, over its stiffness, that is more than rounding.
PART = 1e-6
# Without circulatory forces the growth must fall below this fraction.
LEFT = 0.5


@dataclass(frozen=True)
class Circulation:
    """Servos whose circulatory forces make a motion grow.

    elements: the servos.
    joint: the name of the joint that they drive; "" for several joints.
    growth: of the motion at a state [1/s].
    without: the growth at that state without the circulatory part of these forces [1/s].
    state: the index of the state.
    """

    elements: tuple[Element, ...]
    joint: str
    growth: float
    without: float
    state: int


def circulation(here: StepStability) -> Circulation | None:
    """Return the servos whose circulatory forces make the motion grow at the first state, or None.

    Growth counts from e-fold in the horizon.
    """
    if not any(kind in ("ball", "free") for kind in here.model.jnt_type):
        return None
    for k, state in enumerate(here.states):
        growth = float(here.rates[k].real.max(initial=0.0))
        motion = here.motion(state) if growth > 1 / here.horizon else None
        if motion is None:
            continue
        n, parts = len(motion.mass), {}
        for element, slopes in motion.elements.items():
            if element.kind == "actuator":
                part = circulatory(here.model, slopes)
                if np.abs(part).max() > PART * np.abs(slopes.stiffness).max():
                    parts[element] = part
        if not parts:
            continue
        rates = motion.rates.copy()
        rates[n:, :n] += np.linalg.solve(motion.mass, sum(parts.values(), np.zeros((n, n))))
        values = eigenvalues(rates)
        without = np.inf if values is None else max(float(values.real.max()), 0.0)
        if without < LEFT * growth:
            joints = {int(here.model.actuator_joint[element.index]) for element in parts}
            only = joints.pop() if len(joints) == 1 else -1
            name = here.model.element_name("joint", only) if only >= 0 else ""
            return Circulation(tuple(parts), name, growth, without, k)
    return None


def circulatory(model: Model, slopes: ElementSlopes) -> Floats:
    """Return the circulatory part of an element's stiffness, shape (nv, nv)."""
    part: Floats = (slopes.stiffness - slopes.stiffness.T) / 2
    for joint, kind in enumerate(model.jnt_type):
        if kind in ("ball", "free"):
            dofs = joint_dofs(model, joint)
            turns = slice(dofs.stop - 3, dofs.stop)
            part[turns, turns] += cross_matrix(slopes.force[turns]) / 2
    return part
