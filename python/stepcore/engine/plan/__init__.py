"""The plan of a compiled scene: the work of a step, the omitted work, and the reasons.

Work is omitted when the scene is compiled; the reasons come from the engine (`model/plan.rs`).
Operations are counted in the step itself: the cost of an entry is the number of operations that
removing the entry saves.
"""

from __future__ import annotations

from collections import Counter
from typing import TYPE_CHECKING

from stepcore.engine.plan.cost import StepCost
from stepcore.engine.plan.entries import entries
from stepcore.engine.plan.result import Plan, PlanEntry

if TYPE_CHECKING:
    from stepcore.engine.model import Model
    from stepcore.engine.sim import Sim

__all__ = ["Plan", "PlanEntry", "makes_rows", "planned"]

STAGES = ("files", "place", "detect", "solve", "commit")


def planned(model: Model, sim: Sim | None, time: bool) -> Plan:
    """Create the plan of a model; see `stepcore.plan`."""
    cost = StepCost(model, sim, time)
    listed = [cost.priced(*each) for each in entries(model, cost.settings, cost.rows())]
    source = model.scene._source
    return Plan(
        name=model.scene.name or "scene",
        settings=cost.settings,
        entries=sorted(listed, key=lambda entry: STAGES.index(entry.stage)),
        flops=cost.flops,
        stages=cost.stages,
        micros=cost.micros,
        at=cost.at,
        read_bytes=source.read_bytes if source else 0,
        asset_bytes=source.asset_bytes if source else 0,
    )


def makes_rows(model: Model) -> bool:
    """Return whether the model can make rows: contacts, limits, friction or equalities."""
    listed = entries(model, model.settings, Counter())
    return any(entry.kind == "row" and entry.used for entry, _ in listed)
