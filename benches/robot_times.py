"""How long a step of a robot takes on both sides, with equal settings and as shipped."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import c_loop
import mujoco
import mujoco_side
import numpy as np
import stepcore_side
from timing import Side, duel

import stepcore as sc

STARTS, BLOCKS, HOLD, SETTLE = 6, 2, 25, 200
PAIRS, SAMPLE = 9, 0.02


@dataclass
class Times:
    """Medians [µs a step] and ratios (how many times faster stepcore is); 0: not known.

    why: what keeps a ratio from being known.
    """

    equal_us: tuple[float, float] = (0.0, 0.0)
    shipped_us: tuple[float, float] = (0.0, 0.0)
    equal: float = 0.0
    shipped: float = 0.0
    why: str = ""

    def cell(self) -> str:
        """A cell of the table."""

        def text(pair: tuple[float, float], ratio: float) -> str:
            return f"{pair[0]:.3g}, {pair[1]:.3g} (**{ratio:.2f}×**)" if ratio else "–"

        parts = [text(self.equal_us, self.equal), text(self.shipped_us, self.shipped)]
        return "; ".join(parts) + (f" {self.why}" if self.why else "")


def times(path: Path) -> Times:
    """Plays the same motion on both sides, in turn."""
    found = Times()
    c_loop.timers(False)
    theirs = mujoco.MjModel.from_xml_path(str(path))
    model = sc.load(path).compile()
    motion = mujoco_side.record(theirs, STARTS, BLOCKS, HOLD, SETTLE)
    if not np.isfinite(motion.states).all() or np.abs(motion.qvel).max() > 1e4:
        found.why = "MuJoCo's own motion explodes"
        return found
    try:
        found.shipped_us, found.shipped = _duel(model, theirs, motion, {})
        theirs.opt.solver = mujoco.mjtSolver.mjSOL_NEWTON
        # What MuJoCo's Newton stops at is rounding: so ours is told to.
        newton = {"solver": "newton", "sweeps": theirs.opt.iterations, "tolerance": 1e-9}
        found.equal_us, found.equal = _duel(model, theirs, motion, newton)
    except (ValueError, sc.SimulationError) as error:
        found.why = str(error).splitlines()[0]
    return found


def _duel(model, theirs, motion, settings) -> tuple[tuple[float, float], float]:
    data = mujoco.MjData(theirs)
    loop = c_loop.player(theirs, data, motion.states, motion.ctrl, motion.hold)
    ours = stepcore_side.player(sc.Sim(model, **settings), motion)
    fight = duel(
        Side("stepcore", ours, motion.steps), Side("MuJoCo", loop, motion.steps), PAIRS, SAMPLE
    )
    return (float(np.median(fight.ours)), float(np.median(fight.theirs))), fight.ratio
