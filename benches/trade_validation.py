"""Do recommendations hold? A plain loop of steps judges them, from starts that no search saw."""

from __future__ import annotations

import sys
from collections.abc import Iterator
from concurrent.futures import ProcessPoolExecutor

import numpy as np
import record
from trade_cases import CASES, Case

import stepcore as sc
from stepcore.experiment import Motion, Study
from stepcore.experiment.schedule import Schedule

NOTE = (
    "Each scene is traded for an error. The recommendation then runs from 32 starts that neither "
    "search nor proof has seen, in a plain loop of `Sim.step`, beside rk4 and Newton solved to "
    "rounding at a quarter of the finest step that the trade used. The distance is computed here: "
    "the RMS over samples and bodies of centre and arc. Samples after the time until which the "
    "trade says that the motion can be predicted do not count."
)
UNSEEN, SEED = 32, 987
# A recommendation holds if this share of the starts keeps to the error.
MOST = 0.9


def path(model: sc.Model, schedule: Schedule, start: int) -> tuple[np.ndarray, np.ndarray]:
    """Centres of mass and orientations of all bodies at the samples, in a plain loop."""
    sim, dt = sc.Sim(model), model.settings.dt
    schedule.starts[start].put(sim)
    rows, hold = schedule.rows([start], dt)
    every = schedule.every * schedule.steps(dt)
    com, quat = [], []
    for step in range(every * len(schedule.times)):
        if rows is not None:
            sim.ctrl[:] = rows[0, min(step // hold, rows.shape[1] - 1)]
        sim.step()
        if (step + 1) % every == 0:
            quat.append(np.array(sim.xquat))
            w, xyz, own = quat[-1][:, :1], quat[-1][:, 1:], np.asarray(model.body_ipos)
            com.append(sim.xpos + own + 2 * np.cross(xyz, np.cross(xyz, own) + w * own))
    return np.array(com), np.array(quat)


def apart(model: sc.Model, a: tuple, b: tuple, moving: list[int], samples: int) -> float:
    """RMS over samples and bodies of the distance of centres and the arc at radius of gyration."""
    inertia = np.trace(np.asarray(model.body_inertia), axis1=1, axis2=2)[moving]
    radius = np.sqrt(inertia / 2 / np.asarray(model.body_mass)[moving])
    away = np.linalg.norm(a[0] - b[0], axis=-1)[:samples, moving]
    cosine = np.abs((a[1] * b[1]).sum(axis=-1)).clip(0, 1)[:samples, moving]
    return float(np.sqrt(np.mean(away**2 + (2 * np.arccos(cosine) * radius) ** 2)))


def validate(case: Case) -> dict[str, object]:
    """One scene: how its recommendation does."""
    scene = case.make()
    result = sc.trade(
        scene, error=case.error, horizon=case.horizon, by="flops", threads=1, progress=False
    )
    row = result.recommended
    found: dict[str, object] = {
        "scene": case.name,
        "error_m": case.error,
        "runs": result.runs,
        "reference_m": result.reference.error,
        "recommended": None if row is None else row.change.words,
        "held": None,
    }
    if row is None:
        return found
    model, period = scene.compile(), result.schedule.period
    study = Study(model, Motion(horizon=case.horizon, seed=SEED), period=period, starts=UNSEEN)
    own = min(result.reference.settings.dt, row.settings.dt)
    fine = model.settings.replace(dt=own / 4, integrator="rk4", accuracy=None, precision="f64")
    convex = model.settings.law == "solref"
    exact = {"refsafe": False, "sleep": False, "sweeps": 200 if convex else 2000, "tolerance": 0.0}
    truth = model.with_settings(**fine.replace(**exact).as_dict())
    chosen, moving = row.change.of(model), study.engine.matter.moving
    samples = int(np.sum(study.schedule.times <= result.predictable))
    wrong = []
    for k in range(UNSEEN):
        try:
            both = [path(one, study.schedule, k) for one in (chosen, truth)]
            wrong.append(apart(model, *both, moving, max(1, samples)))
        except sc.SimulationError:
            wrong.append(np.inf)
    kept = float(np.mean(np.array(wrong) <= case.error))
    return found | {
        "kept": kept,
        "held": kept >= MOST,
        "median_m": float(np.median(wrong)),
        "worst_m": max(wrong),
        "cost": row.cost / result.shipped.cost,
        "missed_in_proof": None if result.proof is None else result.proof.missed,
    }


def _all(cases: list[Case]) -> Iterator[dict[str, object]]:
    """All scenes, one process a core."""
    with ProcessPoolExecutor() as pool:
        yield from pool.map(validate, cases)


def main() -> None:
    options = record.arguments(__doc__ or "")
    report = record.Report("trade_validation", options, NOTE)
    report.say()
    report.say(
        f"{'scene':26} {'error':>8} {'kept':>6} {'median':>8} {'worst':>8} {'cost':>6} proof"
    )
    chosen = [case for case in CASES if options.only in case.name]
    found = list(_all(chosen))
    for one in sorted(found, key=lambda one: one.get("kept", -1.0)):
        report.add(**one)
        head = f"{one['scene']:26} {one['error_m']:8.0e}"
        if one["held"] is None:
            report.say(f"{head} nothing recommended")
            continue
        report.say(
            f"{head} {one['kept']:6.0%} {one['median_m']:8.1e} {one['worst_m']:8.1e} "
            f"{one['cost']:6.2f} {one['missed_in_proof']} missed  {one['recommended']}"
        )
    ran = [one for one in found if one["held"] is not None]
    report.say()
    held = sum(bool(one["held"]) for one in ran)
    report.say(f"{held} of {len(found)} hold on at least {MOST:.0%} of unseen starts")
    if ran:
        mean = np.mean([one["kept"] for one in ran])
        report.say(f"{mean:.1%} of all unseen starts keep to the error")
    report.close()


if __name__ == "__main__":
    sys.exit(main())
