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
residuals exceeds MuJoCo's. Below 1e-12 m/s both are at rounding and count as equal.
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


SMALL = {"pgs": 8.0, "newton": 8.0}
LARGE = {"pgs": 1.5, "newton": 1.0}
CASES = [
    Case("spring", scenes.spring(), aim=SMALL),
    Case("ball", scenes.ball(), aim=SMALL),
    Case("stack", scenes.stack(), aim=SMALL),
    *(
        Case(name, scenes.gym_path(name), True, 20, 2, 25, settle=300, aim=LARGE)
        for name in scenes.GYM
    ),
    Case("chain20", scenes.chain(), starts=4, hold=250, aim=LARGE),
    Case("capsules27", scenes.capsules(), starts=6, hold=25, settle=250, aim=LARGE),
]
# Of these also many worlds.
MANY = ("ball", "hopper", "half_cheetah", "ant")


def main() -> None:
    options = record.arguments(__doc__.splitlines()[0])
    report = record.Report("vs_mujoco", options, f"MuJoCo: {c_loop.how()}, timers off")
    c_loop.timers(False)
    report.say()
    report.say(
        f"{'model':25}{'integrator':13}{'solver':8}{'rows':>6}{'residual mean, worst [m/s]':>38}"
        f"{'µs a step':>18}{'ratio (quartiles)':>22}{'aim':>6}"
    )
    report.say(f"{'':52}{'stepcore':>19}{'MuJoCo':>19}{'stepcore':>9}{'MuJoCo':>9}")
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
    """Checks and times one model, with every integrator and solver that is asked for."""
    model, compiled = case.mujoco(), case.stepcore()
    integrators = dict.fromkeys(["euler", mujoco_side.shipped_integrator(model)])
    starts = 2 if options.quick and case.starts > 1 else case.starts
    motion = mujoco_side.record(model, starts, case.blocks, case.hold, case.settle)
    data = mujoco.MjData(model)
    for integrator in integrators:
        for solver in ("pgs", "newton"):
            line = f"{case.name:25}{integrator:13}{solver:8}"
            try:
                found = one(model, data, compiled, motion, integrator, solver, options)
            except ValueError as error:  # not built yet, or not the same physics
                report.say(f"{line} no ratio: {error}")
                report.add(case=case.name, integrator=integrator, solver=solver, refused=str(error))
                continue
            aim = (case.aim or {}).get(solver)
            report.say(line + describe(found, aim))
            record_of = {k: v for k, v in found.items() if k != "duel"} | found["duel"].record()
            report.add(case=case.name, integrator=integrator, solver=solver, aim=aim, **record_of)


def one(model, data, compiled, motion, integrator, solver, options) -> dict:
    """The check, the tolerance and the duel of one line."""
    # The plain method where it is enough, as MuJoCo's own is accelerated.
    mujoco_side.configure(model, integrator, solver)
    own = {"integrator": integrator, "solver": solver}
    apart = same_physics(model, data, compiled, motion, own)
    theirs, their_contacts = [], []
    for _ in mujoco_side.walk(model, data, motion):
        theirs.append((mujoco_side.residual(model, data), data.nefc))
        their_contacts.append(data.ncon)
    theirs = np.array(theirs)

    best = None
    for acceleration in ("none", "momentum") if solver == "pgs" else ("none",):
        try:
            settings = own | {"sweeps": 1000, "acceleration": acceleration}
            tolerance, ours = stepcore_side.as_exact(
                lambda tol, settings=settings: sc.Sim(compiled, **settings, tolerance=tol),
                motion,
                theirs[:, 0],
            )
        except ValueError:
            if acceleration == "none":
                raise
            continue
        if tolerance is None:
            worst = f"ours {ours.max():.1e}, MuJoCo's {theirs[:, 0].max():.1e} m/s"
            if acceleration == "none":
                continue
            raise ValueError(f"no tolerance gives an equal residual: worst {worst}")
        settings |= {"tolerance": tolerance}
        sim = sc.Sim(compiled, **settings)
        contacts = np.mean([len(sim.contacts) for _ in stepcore_side.walk(sim, motion)])
        expected = np.mean(their_contacts)
        if abs(contacts - expected) > SAME_CONTACTS * max(expected, contacts):
            raise ValueError(f"{contacts:.2f} contacts a step, MuJoCo {expected:.2f}")
        found = duel(
            Side("stepcore", stepcore_side.player(sim, motion), motion.steps),
            Side(
                "MuJoCo",
                c_loop.player(model, data, motion.states, motion.ctrl, motion.hold),
                motion.steps,
            ),
            options.pairs,
            options.sample,
        )
        if best is None or found.ratio > best["duel"].ratio:
            best = {
                "duel": found,
                "settings": settings | {"dt": model.opt.timestep},
                "mujoco": {"iterations": model.opt.iterations, "tolerance": model.opt.tolerance},
                "rows": float(theirs[:, 1].mean()),
                "contacts": [float(contacts), float(expected)],
                "residual": [ours.mean(), ours.max()],
                "mujoco_residual": [theirs[:, 0].mean(), theirs[:, 0].max()],
                "apart": apart,
                "steps": motion.steps,
            }
    if best is None:
        raise ValueError("no setting gives an equal residual")
    return best


def same_physics(model, data, compiled, motion, own) -> dict[str, float]:
    """How far apart the two are when solved to convergence; ValueError if too far."""
    kept = model.opt.solver, model.opt.tolerance, model.opt.iterations
    model.opt.solver, model.opt.tolerance, model.opt.iterations = 2, 0.0, 200
    try:
        sim = sc.Sim(compiled, **own, **EXACT)
        states = stepcore_side.snapshots(sim, motion)
        qacc, path = [], []
        for state, theirs, ctrl in zip(states, motion.states, motion.ctrl, strict=True):
            sim.restore(state)
            mujoco.mj_setState(model, data, theirs, c_loop.STATE)
            sim.ctrl[:], data.ctrl[:] = ctrl[0], ctrl[0]
            sim.forward()
            mujoco.mj_forward(model, data)
            scale = max(np.abs(data.qacc).max(), 1.0)
            qacc.append(np.abs(sim.qacc - data.qacc).max() / scale)
            sim.step(motion.hold)
            mujoco.mj_step(model, data, nstep=motion.hold)
            path.append(np.abs(sim.qpos - data.qpos).max())
    finally:
        model.opt.solver, model.opt.tolerance, model.opt.iterations = kept
    apart = {"qacc": max(qacc), "path_median": float(np.median(path)), "path_worst": max(path)}
    if not (apart["qacc"] <= SAME_QACC and apart["path_median"] <= SAME_PATH):
        raise ValueError(
            f"not the same physics: qacc {apart['qacc']:.1e} (relative), "
            f"path {apart['path_median']:.1e} (median)"
        )
    return apart


def describe(found: dict, aim: float | None) -> str:
    ours, theirs = found["residual"], found["mujoco_residual"]
    fight = found["duel"]
    low, high = fight.ratio_spread
    speeds = f"{np.median(fight.ours):9.3f}{np.median(fight.theirs):9.3f}"
    residuals = f"{ours[0]:10.1e}{ours[1]:9.1e}{theirs[0]:10.1e}{theirs[1]:9.1e}"
    ratio = f"{fight.ratio:8.2f} ({low:.2f}–{high:.2f})"
    return (
        f"{found['rows']:6.1f}{residuals}{speeds}{ratio:>22}{'' if aim is None else f'{aim:6.1f}'}"
    )


if __name__ == "__main__":
    main()
