"""Our side: the same motion from the same states, and the tolerance at which we are as exact."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from mujoco_side import Motion

# Residuals below this are rounding [m/s]: smaller is not better.
ROUNDING = 1e-12
# Tolerances that are tried [m/s], the loosest first.
LADDER = tuple(10.0 ** (-e / 4) for e in range(8, 57))


def snapshots(sim, motion: Motion) -> list:
    """Our state at every start, with the impulses of the step before to start the solver from."""
    kept = []
    for i in range(len(motion.states)):
        sim.reset()
        _set(sim, motion.before, i)
        sim.step(1)
        _set(sim, motion.starts, i)
        kept.append(sim.state())
    return kept


def _set(sim, starts: dict[str, np.ndarray], index: int) -> None:
    for name, values in starts.items():
        getattr(sim, name)[:] = values[index]


def player(sim, motion: Motion, chunk: int = 0) -> Callable[[], None]:
    """A call that plays the motion: `ctrl[:] = …; step(chunk)`, by default a block of constant
    control at once."""
    starts = list(zip(snapshots(sim, motion), motion.ctrl, strict=True))
    restore, step, ctrl = sim.restore, sim.step, sim.ctrl
    chunk = chunk or motion.hold
    calls = motion.hold // chunk

    def go() -> None:
        for state, blocks in starts:
            restore(state)
            for u in blocks:
                for _ in range(calls):
                    ctrl[:] = u
                    step(chunk)

    return go


def walk(sim, motion: Motion):
    """Steps the motion one step at a time; yields (start, step in it) after each."""
    for start, (state, blocks) in enumerate(zip(snapshots(sim, motion), motion.ctrl, strict=True)):
        sim.restore(state)
        for block, u in enumerate(blocks):
            sim.ctrl[:] = u
            for step in range(motion.hold):
                sim.step(1)
                yield start, block * motion.hold + step


def residuals(sim, motion: Motion) -> np.ndarray:
    """Residual of every step's solve [m/s]."""
    return np.array([sim.residual for _ in walk(sim, motion)])


def as_exact(make: Callable[[float], object], motion: Motion, theirs: np.ndarray):
    """The loosest tolerance at which we are as exact, and our residuals there.

    make: a Sim for a tolerance [m/s]. As exact: neither the mean nor the worst residual over the
    motion's steps is larger than theirs, where more than rounding. None if no tolerance does it.
    """
    mean, worst = max(theirs.mean(), ROUNDING), max(theirs.max(), ROUNDING)
    for tolerance in LADDER:
        # A solver that stops at the tolerance cannot be much better than it needs to be.
        if tolerance > 10 * worst:
            continue
        ours = residuals(make(tolerance), motion)
        if ours.mean() <= mean and ours.max() <= worst:
            return tolerance, ours
    return None, residuals(make(LADDER[-1]), motion)
