"""What the entries of a plan cost: a step with them, and one without."""

from __future__ import annotations

from collections import Counter
from dataclasses import replace
from time import perf_counter
from typing import Any

import numpy as np

from stepcore import checks
from stepcore.engine.model import Model
from stepcore.engine.sim import Sim
from stepcore.measure.ablation.changes import Change, made
from stepcore.measure.plan.result import Entry

# Steps of one timing, and timings of each variant, interleaved with those of the whole.
STEPS, ROUNDS = 20, 15


class Cost:
    """A model at a state: a whole step's work, and that of entries. time: in µs as well."""

    def __init__(self, model: Model, sim: Sim | None, time: bool) -> None:
        checks.flag("plan", "time", time)
        self.model, self.time = model, time
        self.whole = Sim(model)
        self.at = "the initial pose"
        if sim is not None:
            if not isinstance(sim, Sim) or sim.model.core is not model.core:
                raise checks.refuse("plan", "sim", sim, "a Sim of this model")
            self.whole = Sim(model, sim.settings)
            self.at = f"t = {sim.time:g} s"
        elif model.keys:
            self.whole.reset(key=0)
            self.at = f'key "{model.key_names[0]}"' if model.key_names[0] else "the first key"
        self.state = self.whole.state() if sim is None else sim.state()
        self.settings = self.whole.settings
        self.whole.restore(self.state)
        self.flops = _flops(self.whole)
        self.stages: dict[str, float] = {}
        if hasattr(self.whole, "stage_flops"):
            self.stages = dict(self.whole.stage_flops())
        self.micros = self._timed(self.whole, self.whole)[0] if time else None

    def rows(self) -> Counter[str]:
        """Rows of the state by kind."""
        self.whole.restore(self.state)
        self.whole.forward()
        return Counter(str(kind) for kind in self.whole.rows["kind"])

    def priced(self, entry: Entry, change: Change | None) -> Entry:
        """The entry with what leaving it out saves, if that can be measured."""
        if entry.parts and self.stages:
            return replace(entry, flops=float(sum(self.stages[part] for part in entry.parts)))
        if change is None or not entry.used or (self.flops is None and not self.time):
            return entry
        scene = self.model.scene.with_settings(self.settings)
        sim = Sim(made(scene, [change]).compile())
        self._place(sim)
        without = _flops(sim)
        flops = None if without is None or self.flops is None else self.flops - without
        micros = None
        if self.time:
            whole, less = self._timed(self.whole, sim)
            micros = whole - less
        return replace(entry, flops=flops, micros=micros)

    def _place(self, sim: Sim) -> None:
        """Puts a variant, whose rows may be others, at the state."""
        self.whole.restore(self.state)
        for name in ("qpos", "qvel", "ctrl", "qfrc_applied", "xfrc_applied"):
            getattr(sim, name)[:] = getattr(self.whole, name)

    def _timed(self, *sims: Sim) -> list[float]:
        """µs a step from the state, median of interleaved rounds."""
        spent: list[list[float]] = [[] for _ in sims]
        for _ in range(ROUNDS):
            for sim, times in zip(sims, spent, strict=True):
                self._place(sim)
                begin = perf_counter()
                sim.step(STEPS)
                times.append((perf_counter() - begin) / STEPS)
        self.whole.restore(self.state)
        return [1e6 * float(np.median(times)) for times in spent]


def _flops(sim: Any) -> float | None:
    return float(sim.count_flops(1)) if hasattr(sim, "count_flops") else None
