"""stepcore against MuJoCo, one world each: same model, states, controls, integrator and solver.

MuJoCo is stepped in a C loop with its timers off; stepcore from Python, `sim.step(n)` a block of
constant control, so what a call costs is in our numbers. Both restart from the same recorded
states again and again, close enough together that the two runs stay on one trajectory.

Before anything is timed, both must compute the same physics. With solvers run to convergence:
accelerations at every start equal to 1e-6 of the largest, and, over the first block, trajectories
whose distance (median over starts) is below 1e-6; and as the sides are timed, the mean number of
contacts within 3 %. Otherwise the line says why and holds no ratio.

Equal residual: MuJoCo keeps its shipped iterations and tolerance (100 and 1e-8 here). Its
residual is measured with our definition after every step (`mujoco_side.residual`), ours with
`Sim.residual`; our tolerance is then the loosest at which neither the mean nor the worst of our
residuals exceeds MuJoCo's. Below 1e-12 m/s both are at rounding and count as equal. PGS is tried
plain and accelerated (MuJoCo's always is); the faster one is printed, with a + if accelerated.
"""

from __future__ import annotations

from dataclasses import dataclass

import c_loop
import mujoco
import mujoco_side
import numpy as np
import record
import rollouts
import scenes
import stepcore_side
from timing import Side, duel

import stepcore as sc

SOLVERS = ("pgs", "newton")
ACCELERATIONS = ("none", "momentum")
EXACT = {"tolerance": 1e-13, "sweeps": 100_000}
SAME_QACC, SAME_PATH, SAME_CONTACTS = 1e-6, 1e-6, 0.03


@dataclass(frozen=True)
class Case:
    """A model, and the motion on which it is timed."""

    name: str
    xml: str
    is_file: bool = False
    starts: int = 1
    blocks: int = 1
    hold: int = 1000
    settle: int = 0
    aim: dict[str, float] | None = None

    def mujoco(self) -> mujoco.MjModel:
        load = mujoco.MjModel.from_xml_path if self.is_file else mujoco.MjModel.from_xml_string
        return load(self.xml)

    def stepcore(self) -> sc.Model:
        return (sc.load if self.is_file else sc.loads)(self.xml).compile()


LARGE = {"pgs": 1.5, "newton": 1.0}
CASES = [
    Case("spring", scenes.spring(), aim=dict.fromkeys(SOLVERS, 15.0)),
    Case("ball", scenes.ball(), aim=dict.fromkeys(SOLVERS, 12.0)),
    Case("free ball", scenes.free_ball(), aim=dict.fromkeys(SOLVERS, 10.0)),
    Case("stack", scenes.stack(), aim=dict.fromkeys(SOLVERS, 8.0)),
    *(
        Case(name, scenes.gym_path(name), True, 20, 2, 25, settle=300, aim=LARGE)
        for name in scenes.GYM
    ),
    Case("chain20", scenes.chain(), starts=4, hold=250),
    Case("capsules27", scenes.capsules(), starts=6, hold=25, settle=250),
]
# Of these also many worlds.
MANY = ("ball", "hopper", "half_cheetah", "ant")


def main() -> None:
    options = record.arguments(__doc__.splitlines()[0])
    report = record.Report("vs_mujoco", options, f"MuJoCo: {c_loop.how()}, timers off")
    c_loop.timers(False)
    report.say()
    report.say(
        f"{'':44}{'rows':>6}{'apart':>14}{'residual: mean, worst [m/s]':>36}{'µs a step':>20}"
    )
    report.say(
        f"{'model':25}{'integrator':11}{'solver':8}{'':6}{'qacc':>8}{'path':>8}"
        f"{'stepcore':>18}{'MuJoCo':>18}{'stepcore':>9}{'MuJoCo':>9}"
        f"{'ratio (quartiles)':>21}{'aim':>6}"
    )
    for case in CASES:
        if options.only in case.name:
            compare(case, options, report)
    report.say()
    report.say("many worlds, steps a second (thousands): stepcore, MuJoCo, ratio")
    for case in CASES:
        if options.only in case.name and case.name in MANY:
            rollouts.compare(case, options, report)
    report.close()


def compare(case: Case, options, report: record.Report) -> None:
    """Checks and times one model under each integrator and solver."""
    model, compiled = case.mujoco(), case.stepcore()
    starts = 2 if options.quick and case.starts > 1 else case.starts
    motion = mujoco_side.record(model, starts, case.blocks, case.hold, case.settle)
    for integrator in dict.fromkeys(["euler", mujoco_side.shipped_integrator(model)]):
        for solver in SOLVERS:
            line = f"{case.name:25}{integrator:11}{solver:8}"
            entry = {"case": case.name, "integrator": integrator, "solver": solver}
            match = Match(model, compiled, motion, integrator, solver)
            try:
                found = match.play(options)
            except ValueError as error:  # not the same physics, or not as exact
                report.say(f"{line} no ratio: {error}")
                report.add(**entry, refused=str(error))
                continue
            aim = (case.aim or {}).get(solver)
            report.say(line + describe(found, aim))
            report.add(**entry, aim=aim, **(found | {"duel": found["duel"].record()}))


class Match:
    """One model under one integrator and solver: the check, the tolerance, the duel."""

    def __init__(self, model, compiled, motion, integrator: str, solver: str) -> None:
        self.model, self.compiled, self.motion = model, compiled, motion
        self.data = mujoco.MjData(model)
        self.settings = {"integrator": integrator, "solver": solver}
        mujoco_side.configure(model, integrator, solver)

    def play(self, options) -> dict:
        """What the line of the table needs, under the faster of plain and accelerated PGS."""
        model, motion = self.model, self.motion
        apart = self.same_physics()
        data = self.data
        seen = [
            (mujoco_side.residual(model, data), data.nefc, data.ncon)
            for _ in mujoco_side.walk(model, data, motion)
        ]
        theirs, rows, contacts = np.array(seen, dtype=float).T
        loop = c_loop.player(model, data, motion.states, motion.ctrl, motion.hold)
        found = []
        for acceleration in ACCELERATIONS if self.settings["solver"] == "pgs" else ("none",):
            settings = self.settings | {"sweeps": 1000, "acceleration": acceleration}
            tolerance, ours = self.as_exact(settings, theirs)
            if tolerance is None:
                continue
            settings |= {"tolerance": tolerance}
            sim = sc.Sim(self.compiled, **settings)
            sides = (
                Side("stepcore", stepcore_side.player(sim, motion), motion.steps),
                Side("MuJoCo", loop, motion.steps),
            )
            found.append(
                {
                    "duel": duel(*sides, options.pairs, options.sample),
                    "settings": settings | {"dt": model.opt.timestep},
                    "residual": [ours.mean(), ours.max()],
                    "contacts": [self.same_contacts(sim, contacts.mean()), contacts.mean()],
                }
            )
        if not found:
            raise ValueError(f"no tolerance gives a residual of {theirs.max():.1e} m/s")
        # The plain method unless acceleration gains more than noise.
        plain = found[0]["duel"].ratio
        best = max(found, key=lambda one: one["duel"].ratio)
        return (best if best["duel"].ratio > 1.03 * plain else found[0]) | {
            "mujoco": {"iterations": model.opt.iterations, "tolerance": model.opt.tolerance},
            "mujoco_residual": [theirs.mean(), theirs.max()],
            "rows": rows.mean(),
            "apart": apart,
            "steps": motion.steps,
        }

    def as_exact(self, settings: dict, theirs: np.ndarray) -> tuple[float | None, np.ndarray]:
        """Our loosest tolerance that is as exact, and our residuals there."""

        def make(tolerance: float) -> sc.Sim:
            return sc.Sim(self.compiled, **settings, tolerance=tolerance)

        return stepcore_side.as_exact(make, self.motion, theirs)

    def same_contacts(self, sim: sc.Sim, expected: float) -> float:
        """Our mean number of contacts a step; ValueError if theirs is another."""
        ours = np.mean([len(sim.contacts) for _ in stepcore_side.walk(sim, self.motion)])
        if abs(ours - expected) > SAME_CONTACTS * max(ours, expected):
            raise ValueError(f"{ours:.2f} contacts a step, MuJoCo {expected:.2f}")
        return float(ours)

    def same_physics(self) -> dict[str, float]:
        """How far apart the two are when solved to convergence; ValueError if too far."""
        model, data, motion = self.model, self.data, self.motion
        kept = model.opt.solver, model.opt.tolerance, model.opt.iterations
        newton = mujoco_side.SOLVERS["newton"]
        model.opt.solver, model.opt.tolerance, model.opt.iterations = newton, 0.0, 200
        sim = sc.Sim(self.compiled, **self.settings, **EXACT)
        states = stepcore_side.snapshots(sim, motion)
        qacc, path = [], []
        for state, theirs, ctrl in zip(states, motion.states, motion.ctrl, strict=True):
            sim.restore(state)
            mujoco.mj_setState(model, data, theirs, c_loop.STATE)
            sim.ctrl[:], data.ctrl[:] = ctrl[0], ctrl[0]
            sim.forward()
            mujoco.mj_forward(model, data)
            scale = max(np.abs(data.qacc).max(initial=0.0), 1.0)
            qacc.append(np.abs(sim.qacc - data.qacc).max() / scale)
            sim.step(motion.hold)
            mujoco.mj_step(model, data, nstep=motion.hold)
            path.append(np.abs(sim.qpos - data.qpos).max())
        model.opt.solver, model.opt.tolerance, model.opt.iterations = kept
        apart = {"qacc": max(qacc), "path": float(np.median(path)), "worst_path": max(path)}
        if not (apart["qacc"] <= SAME_QACC and apart["path"] <= SAME_PATH):
            text = f"qacc {apart['qacc']:.1e} (relative), path {apart['path']:.1e} (median) apart"
            raise ValueError(f"not the same physics: {text}")
        return apart


def describe(found: dict, aim: float | None) -> str:
    """The numbers of a line."""
    fight, apart = found["duel"], found["apart"]
    low, high = fight.ratio_spread
    residuals = "".join(f"{r:9.0e}" for r in (*found["residual"], *found["mujoco_residual"]))
    method = "+" if found["settings"]["acceleration"] == "momentum" else " "
    speeds = f"{np.median(fight.ours):9.3f}{method}{np.median(fight.theirs):8.3f}"
    ratio = f"{fight.ratio:.2f} ({low:.2f}–{high:.2f})"
    return (
        f"{found['rows']:6.1f}{apart['qacc']:8.0e}{apart['path']:8.0e}"
        f"{residuals}{speeds}{ratio:>21}{'' if aim is None else f'{aim:6.1f}'}"
    )


if __name__ == "__main__":
    main()
