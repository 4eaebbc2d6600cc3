"""`Model.plan`: what a step of the compiled scene does, what it leaves out, and why.

What is left out was decided when the scene was compiled; the reasons are asked from the engine
(`model/plan.rs`), and the work is counted on the step itself: what an entry costs is the
operations that the step is rid of without it.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

from stepcore.measure.plan.cost import Cost
from stepcore.measure.plan.entries import entries
from stepcore.measure.plan.result import Entry, Plan

if TYPE_CHECKING:
    from stepcore.engine.model import Model
    from stepcore.engine.sim import Sim

__all__ = ["Entry", "Plan", "planned"]

STAGES = ("files", "place", "detect", "solve", "commit")


def planned(model: Model, sim: Sim | None, time: bool) -> Plan:
    """The plan of a model; see `Model.plan`."""
    cost = Cost(model, sim, time)
    found = entries(model, cost.settings, cost.rows())
    listed = [cost.priced(entry, change) for entry, change in found]
    return Plan(
        name=model.scene.name or "scene",
        settings=cost.settings,
        entries=sorted(listed, key=lambda entry: STAGES.index(entry.stage)),
        flops=cost.flops,
        stages=cost.stages,
        micros=cost.micros,
        at=cost.at,
    )
