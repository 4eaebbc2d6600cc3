"""Many worlds: `Batch.rollout` against `mujoco.rollout`, both from Python, as information.

Every world has its own start and its own controls; both sides keep every state. The solver is
Newton with each side's own default tolerance. Checked first: the worlds' paths over five steps.
"""

from __future__ import annotations

import mujoco
import mujoco_side
import numpy as np
import record
from mujoco import rollout
from timing import Side, duel

import stepcore as sc

STATE = mujoco.mjtState.mjSTATE_FULLPHYSICS
WORLDS, STEPS, SAME = 1024, 25, 1e-6


def compare(case, options, report: record.Report) -> None:
    """Lines for one model: one thread, and two."""
    model, compiled = case.mujoco(), case.stepcore()
    integrator = mujoco_side.shipped_integrator(model)
    mujoco_side.configure(model, integrator, "newton")
    worlds, steps = (64, 20) if options.quick else (WORLDS, STEPS)
    motion = mujoco_side.record(model, worlds, 1, 5, case.settle)
    ctrl = np.repeat(motion.ctrl, steps, axis=1)
    states = np.array([physics(model, state) for state in motion.states])
    kept = np.empty((worlds, steps, states.shape[1]))
    for threads in (1, 2):
        batch = sc.Batch(compiled, worlds, threads=threads, solver="newton", integrator=integrator)
        data = [mujoco.MjData(model) for _ in range(threads)]
        # Without threads of its own it runs in this one.
        pool = rollout.Rollout(nthread=threads if threads > 1 else 0)

        def ours(batch=batch) -> sc.batch.Rollout:
            batch.reset()
            batch.qpos[:], batch.qvel[:] = motion.starts["qpos"], motion.starts["qvel"]
            return batch.rollout(ctrl)

        def theirs(pool=pool, data=data) -> None:
            pool.rollout(model, data, states, ctrl, state=kept)

        theirs()
        qpos = kept[:, 4, 1 : 1 + model.nq]
        apart = float(np.median(np.abs(ours().qpos[:, 4] - qpos).max(axis=1)))
        line = (
            f"{case.name:25}{integrator:13}{worlds} worlds, {threads} thread{'s' * (threads > 1)}"
        )
        entry = {"case": case.name, "worlds": worlds, "threads": threads, "apart": apart}
        if not apart <= SAME:
            report.say(f"{line}  no ratio: paths {apart:.1e} apart after 5 steps (median)")
            report.add(**entry, refused="not the same physics")
            continue
        sides = (Side("stepcore", ours, worlds * steps), Side("MuJoCo", theirs, worlds * steps))
        found = duel(*sides, options.pairs, options.sample, wall=threads > 1)
        low, high = found.ratio_spread
        speeds = "".join(f"{1e3 / np.median(side):9.0f} k" for side in (found.ours, found.theirs))
        report.say(f"{line:62}{speeds}{found.ratio:8.2f} ({low:.2f}–{high:.2f})")
        report.add(**entry, integrator=integrator, solver="newton", **found.record())


def physics(model: mujoco.MjModel, state: np.ndarray) -> np.ndarray:
    """The part of an integration state that a rollout starts from."""
    out = np.empty(mujoco.mj_stateSize(model, STATE))
    mujoco.mj_extractState(model, state, mujoco.mjtState.mjSTATE_INTEGRATION, out, STATE)
    return out
