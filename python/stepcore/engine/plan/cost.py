"""The cost of a plan's entries: the difference between a step with and without the entry."""

from __future__ import annotations

from collections import Counter
from dataclasses import replace
from time import perf_counter
from typing import TYPE_CHECKING

import numpy as np

from stepcore import checks
from stepcore.engine.features import Removal, without
from stepcore.engine.plan.result import PlanEntry
from stepcore.engine.sim import Sim, unwatched

if TYPE_CHECKING:
    from stepcore.engine.model import Model

# Steps per timing, and timings per variant, interleaved with those of the complete model.
STEPS, ROUNDS = 20, 15


class StepCost:
    """The work of a step at a state, and the savings of removals. time: whether µs are measured."""

    def __init__(self, model: Model, sim: Sim | None, time: bool) -> None:
        checks.flag("plan", "time", time)
        self.model, self.time = model, time
        self.whole = unwatched(Sim(model))
        self.at = "the initial pose"
        if sim is not None:
            if not isinstance(sim, Sim) or sim.model.core is not model.core:
                raise checks.refuse("plan", "sim", sim, "a Sim of this model")
            self.whole = unwatched(Sim(model, sim.settings))
            self.at = f"t = {sim.time:g} s"
        elif model.keys:
            self.whole.reset(key=0)
            name = model.key_names[0]
            self.at = f"keyframe `{name}`" if name else "the first keyframe"
        self.state = self.whole.state() if sim is None else sim.state()
        self.settings = self.whole.settings
        self.whole.restore(self.state)
        self.flops = float(self.whole.count_flops())
        self.stages = {stage: float(n) for stage, n in self.whole.stage_flops().items()}
        self.micros = self._timed(self.whole)[0] if time else None

    def rows(self) -> Counter[str]:
        """Count the rows at the state by kind."""
        self.whole.restore(self.state)
        self.whole.forward()
        return Counter(str(kind) for kind in self.whole.rows["kind"])

    def priced(self, entry: PlanEntry, removal: Removal | None) -> PlanEntry:
        """Return the entry with its own work, or with the work that its removal saves."""
        if entry.stages:
            return replace(entry, flops=sum(self.stages[stage] for stage in entry.stages))
        if removal is None or not entry.used:
            return entry
        scene = self.model.scene.with_settings(self.settings)
        sim = unwatched(Sim(without(scene, [removal]).compile()))
        self._place(sim)
        flops = self.flops - sim.count_flops()
        micros = None
        if self.time:
            whole, reduced = self._timed(self.whole, sim)
            micros = whole - reduced
        return replace(entry, flops=flops, micros=micros)

    def _place(self, sim: Sim) -> None:
        """Put a variant, whose rows may differ, into the state."""
        self.whole.restore(self.state)
        for name in ("qpos", "qvel", "ctrl", "qfrc_applied", "xfrc_applied"):
            getattr(sim, name)[:] = getattr(self.whole, name)

    def _timed(self, *sims: Sim) -> list[float]:
        """Measure µs per step from the state, as the median of interleaved rounds."""
        spent: list[list[float]] = [[] for _ in sims]
        for _ in range(ROUNDS):
            for sim, times in zip(sims, spent, strict=True):
                self._place(sim)
                begin = perf_counter()
                sim.step(STEPS)
                times.append((perf_counter() - begin) / STEPS)
        self.whole.restore(self.state)
        return [1e6 * float(np.median(times)) for times in spent]
