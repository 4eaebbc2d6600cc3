"""Heaps against MuJoCo, one world: Newton and PGS at equal error of acceleration.

MuJoCo is stepped in a C loop with its timers off; stepcore from Python, as in `vs_mujoco.py`, whose
checks of equal physics this bench uses. MuJoCo keeps its shipped iterations and tolerance.
At every step of its motion its acceleration is compared with the converged one at the same state,
|a − a*| / max(|a*|, 1) in the largest entry; ours likewise along our motion. Our tolerance is then
the loosest at which neither the mean nor the worst of our errors is larger than MuJoCo's. Errors
below 1e-10 count as equal: both are then at what rounding leaves of a heap's acceleration. With
1000 boxes each of MuJoCo's solvers, CG too, meets the quickest of ours; the line says which. There
the tolerance is found by bisection, as errors fall with it: each try costs seconds.
"""

from __future__ import annotations

import c_loop
import mujoco
import mujoco_side
import numpy as np
import record
import scenes
import stepcore_side
from timing import Side, duel
from vs_mujoco import ACCELERATIONS, EXACT, SOLVERS, Case, Match

import stepcore as sc

ROUNDING = 1e-10
LADDER = tuple(10.0 ** (-e / 4) for e in range(12, 57))
CASES = [
    Case("capsules27", scenes.capsules(), starts=4, hold=10, settle=250, aim={"newton": 1.5}),
    Case("spheres100", scenes.spheres(100), starts=3, hold=10, settle=500, aim={"newton": 2.0}),
    Case(
        "spheres300",
        scenes.spheres(300),
        starts=3,
        hold=5,
        settle=500,
        aim={"newton": 2.0, "pgs": 5.0},
    ),
    Case(
        "boxstack10",
        scenes.box_stack(),
        starts=3,
        hold=10,
        settle=250,
        aim={"newton": 3.0, "pgs": 3.0},
    ),
    Case("boxes27", scenes.boxes(27), starts=3, hold=5, settle=500),
    Case("boxes100", scenes.boxes(100), starts=2, hold=3, settle=300),
    # The aim is against the MuJoCo solver with which it is hardest to meet.
    Case(
        "boxes1000",
        scenes.boxes(1000),
        starts=1,
        hold=3,
        settle=200,
        aim={"pgs": 10.0, "newton": 10.0, "cg": 10.0},
    ),
]
# Ours beside the solver of the same name, where all are tried.
ANY = (
    {"solver": "pgs", "acceleration": "none"},
    {"solver": "pgs", "acceleration": "momentum"},
    {"solver": "newton"},
)


def main() -> None:
    options = record.arguments(__doc__.splitlines()[0])
    report = record.Report("heaps", options, f"MuJoCo: {c_loop.how()}, timers off")
    c_loop.timers(False)
    report.say()
    report.say(
        f"{'heap':12}{'solver':8}{'contacts':>9}{'rows':>7}{'qacc apart':>11}"
        f"{'error: mean, worst':>21}{'MuJoCo: mean, worst':>21}"
        f"{'ours [µs]':>12}{'MuJoCo [µs]':>12}{'ratio (quartiles)':>21}{'aim':>6}"
    )
    for case in CASES:
        if options.only in case.name:
            compare(case, options, report)
    report.close()


def compare(case: Case, options, report: record.Report) -> None:
    """Checks and times one heap under each solver."""
    model, compiled = case.mujoco(), case.stepcore()
    starts = 1 if options.quick else case.starts
    motion = mujoco_side.record(model, starts, case.blocks, case.hold, case.settle)
    large = "cg" in (case.aim or {})
    for solver in (*SOLVERS, "cg") if large else SOLVERS:
        match = Heap(model, compiled, motion, "euler", solver)
        if large:
            match.try_any()
        aim = (case.aim or {}).get(solver)
        try:
            found = match.play(options)
        except ValueError as error:  # not the same physics, or not as exact
            report.say(f"{case.name:12}{solver:8} no ratio: {error}")
            report.add(case=case.name, solver=solver, refused=str(error))
            continue
        report.say(f"{case.name:12}{solver:8}" + describe(found, aim))
        record_ = found | {"duel": found["duel"].record()}
        report.add(case=case.name, solver=solver, aim=aim, **record_)


class Heap(Match):
    """One heap under one solver: the check, the tolerance, the duel."""

    def __init__(self, *args) -> None:
        super().__init__(*args)
        own = self.settings["solver"]
        ways = ACCELERATIONS if own == "pgs" else ("none",)
        self.ours = [{"solver": own, "acceleration": acceleration} for acceleration in ways]
        self.bisects = False

    def try_any(self) -> None:
        """Ours is the quickest of all solvers, whatever theirs; physics are compared by Newton."""
        self.ours, self.bisects = ANY, True
        self.settings["solver"] = "newton"

    def play(self, options) -> dict:
        model, motion, data = self.model, self.motion, self.data
        apart = self.same_physics()
        theirs, rows, contacts = self.their_errors()
        loop = c_loop.player(model, data, motion.states, motion.ctrl, motion.hold)
        found = []
        for ours in self.ours:
            settings = self.settings | {"sweeps": 1000} | ours
            tolerance, ours = self.as_exact(settings, theirs)
            if tolerance is None:
                continue
            sim = sc.Sim(self.compiled, **settings, tolerance=tolerance)
            sides = (
                Side("stepcore", stepcore_side.player(sim, motion), motion.steps),
                Side("MuJoCo", loop, motion.steps),
            )
            found.append(
                {
                    "duel": duel(*sides, options.pairs, options.sample),
                    "settings": settings | {"tolerance": tolerance, "dt": model.opt.timestep},
                    "error": [ours.mean(), ours.max()],
                    "contacts": self.same_contacts(sim, contacts.mean()),
                }
            )
        if not found:
            raise ValueError(f"no tolerance gives an error of {theirs.max():.1e}")
        return max(found, key=lambda one: one["duel"].ratio) | {
            "mujoco": {"iterations": model.opt.iterations, "tolerance": model.opt.tolerance},
            "mujoco_error": [theirs.mean(), theirs.max()],
            "rows": rows.mean(),
            "apart": apart,
        }

    def their_errors(self) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """MuJoCo's errors, rows and contacts, step by step."""
        model, data, seen = self.model, self.data, []
        exact, state = mujoco.MjData(model), np.empty(self.motion.states.shape[1])
        kept = model.opt.solver, model.opt.tolerance, model.opt.iterations
        newton = mujoco_side.SOLVERS["newton"]
        for start in self.motion.states:
            mujoco.mj_setState(model, data, start, c_loop.STATE)
            for _ in range(self.motion.hold):
                mujoco.mj_getState(model, data, state, c_loop.STATE)
                model.opt.solver, model.opt.tolerance, model.opt.iterations = newton, 0.0, 200
                mujoco.mj_setState(model, exact, state, c_loop.STATE)
                mujoco.mj_forward(model, exact)
                model.opt.solver, model.opt.tolerance, model.opt.iterations = kept
                mujoco.mj_step(model, data)
                seen.append((error(data.qacc, exact.qacc), data.nefc, data.ncon))
        theirs, rows, contacts = np.array(seen, dtype=float).T
        return theirs, rows, contacts

    def as_exact(self, settings: dict, theirs: np.ndarray):
        """Our loosest tolerance that is as exact, and our errors there."""
        mean, worst = max(theirs.mean(), ROUNDING), max(theirs.max(), ROUNDING)
        converged = sc.Sim(self.compiled, **self.settings | {"solver": "newton"}, **EXACT)

        def errors(tolerance: float) -> np.ndarray:
            sim = sc.Sim(self.compiled, **settings, tolerance=tolerance)
            ours = []
            for state in stepcore_side.snapshots(sim, self.motion):
                sim.restore(state)
                for _ in range(self.motion.hold):
                    converged.qpos[:], converged.qvel[:] = sim.qpos, sim.qvel
                    converged.forward()
                    sim.step(1)
                    ours.append(error(sim.qacc, converged.qacc))
            return np.array(ours)

        def enough(ours: np.ndarray) -> bool:
            return bool(np.mean(ours) <= mean and np.max(ours) <= worst)

        return first(errors, enough, self.bisects)


def first(errors, enough, bisects: bool) -> tuple[float | None, np.ndarray]:
    """The loosest tolerance of the ladder whose errors are small enough, and these."""
    if not bisects:
        for tolerance in LADDER:
            ours = errors(tolerance)
            if enough(ours):
                return tolerance, ours
        return None, ours
    low, high, ours = 0, len(LADDER) - 1, errors(LADDER[-1])
    if not enough(ours):
        return None, ours
    while low < high:
        middle = (low + high) // 2
        tried = errors(LADDER[middle])
        if enough(tried):
            high, ours = middle, tried
        else:
            low = middle + 1
    return LADDER[high], ours


def error(found: np.ndarray, exact: np.ndarray) -> float:
    """The largest difference of two accelerations, of the largest entry."""
    return float(np.abs(found - exact).max() / max(np.abs(exact).max(), 1.0))


def describe(found: dict, aim: float | None) -> str:
    """The numbers of a line; after our time + for momentum, n for Newton."""
    fight = found["duel"]
    low, high = fight.ratio_spread
    method = "+" if found["settings"].get("acceleration") == "momentum" else " "
    errors = "".join(f"{e:10.0e} {f:10.0e}" for e, f in (found["error"], found["mujoco_error"]))
    if found["settings"]["solver"] == "newton":
        method = "n"
    speeds = f"{np.median(fight.ours):11.1f}{method}{np.median(fight.theirs):12.1f}"
    ratio = f"{fight.ratio:.2f} ({low:.2f}–{high:.2f})"
    return (
        f"{found['contacts']:9.1f}{found['rows']:7.1f}{found['apart']['qacc']:11.0e}"
        f"{errors}{speeds}{ratio:>21}{'' if aim is None else f'{aim:6.1f}'}"
    )


if __name__ == "__main__":
    main()
