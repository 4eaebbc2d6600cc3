"""`plan`: what a step of the compiled scene does, what it leaves out, and why.

What is left out was decided when the scene was compiled; the reasons come from the engine
(`model/plan.rs`). The work is counted on the step itself: an entry costs the operations that
removing it saves.
"""

from __future__ import annotations

import os

from stepcore.engine.model import Model
from stepcore.engine.sim import Sim
from stepcore.loading import find_model
from stepcore.measure.plan.cost import StepCost
from stepcore.measure.plan.entries import entries
from stepcore.measure.plan.result import Entry, Plan
from stepcore.scene.scene import Scene

__all__ = ["Entry", "Plan", "plan"]

STAGES = ("files", "place", "detect", "solve", "commit")


def plan(
    model: Model | Scene | str | os.PathLike[str], *, sim: Sim | None = None, time: bool = False
) -> Plan:
    """Lists what a step does (terms, pairs, kinds of rows, files) and what it leaves out, and why.

    model: a Model, a Scene, or the path of an MJCF file (or "package:name").
    sim: a Sim of this model, at whose state and settings the work of a step is counted; by default
        the first keyframe or the initial pose. time: measure in µs as well.

    Raises ValueError for a Sim of another model.

    >>> from stepcore import loads
    >>> scene = loads("<mujoco><worldbody><geom type='plane' size='1 1 1'/><body pos='0 0 1'>"
    ...     "<freejoint/><geom name='ball' size='.1'/></body></worldbody></mujoco>")
    >>> [entry.why for entry in plan(scene).left_out if entry.name.startswith("mass matrix")]
    ['isotropic: constant, and no gyroscopic term']
    """
    model = find_model(model)
    cost = StepCost(model, sim, time)
    listed = [cost.priced(*each) for each in entries(model, cost.settings, cost.rows())]
    return Plan(
        name=model.scene.name or "scene",
        settings=cost.settings,
        entries=sorted(listed, key=lambda entry: STAGES.index(entry.stage)),
        flops=cost.flops,
        stages=cost.stages,
        micros=cost.micros,
        at=cost.at,
    )
