"""stepcore against numpy on the lesson's scenes: a mass on a spring, a ball drop, a stack.

One world, three opponents: `stepcore.lesson.loop` (the lesson's loop in plain numpy, on the same
Scene), and the scene by hand on small arrays with generic rows. Many worlds: the scene vectorised
by hand over 4096 worlds, which is numpy at its best, against `Batch` with as many.

First both sides take the same steps from the same start; the line gives how far apart their
positions end up at most; the bench fails if that is more than 1e-9 anywhere. A run that is kept
writes the table of README, the worst row first.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np
import numpy_side
import record
from timing import Duel, Side, duel

import stepcore as sc
from stepcore import lesson
from stepcore.lesson.loop import Loop

SAME = 1e-9
HEAD = ("scene", "numpy", "numpy takes", "stepcore takes", "times as fast")
AIM = 100.0  # times plain numpy
WORLDS = 4096
CHECKED, STEPS = 300, 400  # one world: steps that are compared, and that are timed


@dataclass(frozen=True)
class Case:
    """A scene, its hand-written opponents, and the starts of many worlds."""

    name: str
    scene: sc.Scene
    plain: Callable[[np.ndarray], object]
    many: Callable[[np.ndarray], object]
    spread: float

    @property
    def start(self) -> np.ndarray:
        return np.array(self.scene.key("start").qpos, dtype=float)

    def starts(self, worlds: int) -> np.ndarray:
        """Different in every world, shape (worlds, nq)."""
        lifted = self.spread * np.random.default_rng(5).uniform(size=(worlds, 1))
        return self.start + lifted * np.arange(1, len(self.start) + 1)


SWEEPS = numpy_side.SWEEPS
CASES = [
    Case(
        "spring",
        lesson.spring(),
        numpy_side.PlainSpring,
        numpy_side.ManySprings,
        spread=1.0,
    ),
    Case(
        "ball drop",
        lesson.drop(),
        lambda start: numpy_side.PlainTower(start, 1, relaxed=False),
        numpy_side.ManyDrops,
        spread=0.1,
    ),
    Case(
        f"stack, {SWEEPS} sweeps",
        lesson.stack(SWEEPS),
        lambda start: numpy_side.PlainTower(start, SWEEPS, relaxed=True),
        numpy_side.ManyStacks,
        spread=1e-5,
    ),
]


def main() -> None:
    options = record.arguments(__doc__.splitlines()[0])
    note = "the lesson's settings: semi-implicit, PGS from zero, tolerance 0 (every sweep runs)"
    report = record.Report("vs_numpy", options, note)
    report.say()
    report.say(
        f"{'scene':18}{'opponent':34}{'apart':>9}{'stepcore':>12}{'numpy':>12}"
        f"{'ratio (quartiles)':>24}{'aim':>6}   per world-step"
    )
    for case in CASES:
        if options.only in case.name:
            one_world(case, options, report)
            many_worlds(case, options, report)
    report.close()
    others = [entry for entry in report.records if "refused" in entry]
    if others:
        raise SystemExit(f"{len(others)} of {len(report.records)} have other physics")
    if options.save:
        record.put(record.README, "numpy", table(report.records))


def table(records: list[dict[str, Any]]) -> str:
    """The table of README: numpy at its best and as one writes it, on one thread, worst first."""
    rows = []
    for entry in records:
        plain = entry["opponent"].startswith("plain")
        if "ratio" in entry and (plain or ", 1 thread " in entry["opponent"]):
            many = entry["opponent"].split(" by hand")[0] + ", vectorised by hand"
            times = (_time(entry[side]["median"]) for side in ("theirs_us", "ours_us"))
            cells = (entry["case"], "one world" if plain else many, *times)
            digits = 1 if entry["ratio"] < 10 else 0
            rows.append((entry["ratio"], (*cells, f"{entry['ratio']:.{digits}f}")))
    return record.markdown(HEAD, [row for _, row in sorted(rows)])


def one_world(case: Case, options, report: record.Report) -> None:
    plain = case.plain(case.start)
    against(case, "plain numpy, generic rows", plain, plain.reset, options, report)
    page = Loop(case.scene)
    against(case, "stepcore.lesson.loop", page, page.reset, options, report)


def against(case: Case, name: str, theirs, restart, options, report: record.Report) -> None:
    """One world of ours and of an opponent, step by step, then timed."""
    sim = sc.Sim(case.scene.compile())
    sim.reset(key="start")
    start = sim.state()
    restart()
    apart = 0.0
    for _ in range(CHECKED):
        sim.step(1)
        theirs.step(1)
        apart = max(apart, float(np.abs(sim.qpos - theirs.qpos).max()))

    def ours_play() -> None:
        sim.restore(start)
        sim.step(STEPS)

    def their_play() -> None:
        restart()
        theirs.step(STEPS)

    sides = (Side("stepcore", ours_play, STEPS), Side("numpy", their_play, STEPS))
    judge(case, name, apart, *sides, options, report)


def many_worlds(case: Case, options, report: record.Report) -> None:
    worlds = 512 if options.quick else WORLDS
    steps = 100
    starts = case.starts(worlds)
    theirs = case.many(starts)
    for threads in (1, 2):
        batch = sc.Batch(case.scene.compile(), worlds, threads=threads)

        def ours_play(batch=batch) -> None:
            batch.reset()
            batch.qpos[:] = starts
            batch.step(steps)

        def their_play() -> None:
            theirs.reset()
            theirs.step(steps)

        apart = 0.0
        for take in (1, 10, 100):
            batch.reset()
            batch.qpos[:] = starts
            batch.step(take)
            theirs.reset()
            theirs.step(take)
            apart = max(apart, float(np.abs(batch.qpos - theirs.qpos).max()))
        name = f"{worlds} worlds by hand, {threads} thread{'s' * (threads > 1)} of ours"
        ours = Side("stepcore", ours_play, steps * worlds)
        other = Side("numpy", their_play, steps * worlds)
        judge(case, name, apart, ours, other, options, report, threads)


def judge(
    case: Case,
    opponent: str,
    apart: float,
    ours: Side,
    theirs: Side,
    options,
    report: record.Report,
    threads: int = 1,
) -> None:
    """One line: a ratio if both sides compute the same, else why not."""
    line = f"{case.name:18}{opponent:34}{apart:9.1e}"
    entry = {"case": case.name, "opponent": opponent, "apart": apart}
    if not apart <= SAME:
        report.say(f"{line}  no ratio: not the same physics")
        report.add(**entry, refused="not the same physics")
        return
    found = duel(ours, theirs, options.pairs, options.sample, wall=threads > 1)
    aim = AIM if opponent.startswith("plain") else None
    report.say(line + speeds(found, aim))
    report.add(**entry, aim=aim, settings=case.scene.options, **found.record())


def speeds(found: Duel, aim: float | None) -> str:
    low, high = found.ratio_spread
    times = "".join(f"{_time(np.median(side)):>12}" for side in (found.ours, found.theirs))
    ratio = f"{found.ratio:.1f} ({low:.1f}–{high:.1f})"
    return f"{times}{ratio:>24}{'' if aim is None else f'{aim:6.0f}'}"


def _time(us: float) -> str:
    return f"{us:.2f} µs" if us >= 1 else f"{us * 1e3:.1f} ns"


if __name__ == "__main__":
    main()
