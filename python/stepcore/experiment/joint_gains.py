"""The stiffness and damping that springs, dampers and servos give their joints at rest."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

from stepcore.engine.linear_maps import DAMPING_IMPLICIT
from stepcore.engine.model import Model
from stepcore.scene.layout import DOFS, Layout


@dataclass(frozen=True)
class JointGain:
    """What one element gives each dof of its joint.

    kind: "spring", "damper" or "actuator"; index: of its joint or actuator. stiffness:
    [N·m/rad or N/m]; damping: [N·m·s/rad or N·s/m].
    """

    kind: str
    index: int
    joint: int
    stiffness: float
    damping: float


def joint_gains(model: Model) -> Iterator[JointGain]:
    """The gains of every spring and damper, then of every actuator, zeros among them.

    Polynomial springs and dampers count with their first coefficient, a servo with its feedback.
    """
    features = model.scene.features
    for j, joint in enumerate(Layout(model.scene).joints):
        record = joint.record()
        yield JointGain("spring", j, j, features.spring * float(record["stiffness"][0]), 0.0)
        yield JointGain("damper", j, j, 0.0, features.damper * float(record["damping"][0]))
    for i in range(model.nu if features.actuation else 0):
        square = float(model.actuator_gear[i, 0]) ** 2
        _, length, velocity = model.actuator_bias[i].tolist()
        joint_index = int(model.actuator_joint[i])
        if joint_index < 0 or model.jnt_type[joint_index] not in ("hinge", "slide"):
            continue
        yield JointGain("actuator", i, joint_index, -square * length, -square * velocity)


def joint_dofs(model: Model, joint: int) -> slice:
    """The dofs of a joint."""
    start = int(model.jnt_dofadr[joint])
    return slice(start, start + DOFS[model.jnt_type[joint]])


def implicit_kinds(model: Model, integrator: str) -> tuple[str, ...]:
    """The kinds of elements whose damping an integrator treats implicitly."""
    if integrator == "euler":
        return ("damper",) if model.scene.features.eulerdamp else ()
    if integrator not in DAMPING_IMPLICIT:
        return ()
    return ("damper", "tendon damper", "fluid", "actuator")
