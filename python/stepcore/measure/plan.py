"""`plan`: the work of one step of a scene, and the work that the engine leaves out."""

from __future__ import annotations

import os

from stepcore.engine.model import Model
from stepcore.engine.plan import Plan, planned
from stepcore.engine.sim import Sim
from stepcore.loading import find_model
from stepcore.scene.scene import Scene


def plan(
    model: Model | Scene | str | os.PathLike[str], *, sim: Sim | None = None, time: bool = False
) -> Plan:
    """List the terms, pairs, kinds of rows and files of a step, and why others are left out.

    model: a Model, a Scene, or the path of an MJCF file (or "package:name").
    sim: a Sim of this model. The work of a step is counted at the state and settings of this Sim.
        By default the state is the first keyframe, or the initial pose.
    time: whether to measure computing times [µs] too.

    Raises ValueError for a Sim of another model.

    >>> from stepcore import loads
    >>> scene = loads("<mujoco><worldbody><geom type='plane' size='1 1 1'/><body pos='0 0 1'>"
    ...     "<freejoint/><geom name='ball' size='.1'/></body></worldbody></mujoco>")
    >>> [entry.why for entry in plan(scene).left_out if entry.name.startswith("mass matrix")]
    ['isotropic: constant, and no gyroscopic term']
    """
    return planned(find_model(model), sim, time)
