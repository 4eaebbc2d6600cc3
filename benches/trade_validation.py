"""Do recommendations hold, and are they cheap? Against starts not seen, and against brute force."""

from __future__ import annotations

import math
import sys
from collections.abc import Iterator
from concurrent.futures import ProcessPoolExecutor

import numpy as np
import record
import trade_cases
from trade_cases import CASES, Judge

import stepcore as sc
from stepcore.experiment.cost import TimedRun, costs
from stepcore.report.progress import Progress

NOTE = (
    "Each scene is traded for an error; the recommendation then runs from 24 starts that neither "
    "search nor confirmation has seen, and against the cheapest of a full grid (steps by √2, "
    "integrators, PGS by sweeps cold and warm, Newton) that keeps to the error on 24 starts of its "
    "own, as many as the recommendation was held to. Prices are counted; times are interleaved."
)
UNSEEN, OWN = 24, 24
# Brute force is given this long a scene [s of processor time].
PATIENCE = 30.0
# A recommendation holds if this share of the starts keeps to the error.
MOST = 0.9


def validate(case: trade_cases.Case, brute: bool = True) -> dict[str, object]:
    """One scene: how the recommendation does, and what brute force finds."""
    scene = case.make()
    options = {"error": case.error, "horizon": case.horizon, "by": "flops", "progress": False}
    result = sc.trade(scene, threads=1, **options)
    row = result.recommended
    found: dict[str, object] = {
        "scene": case.name,
        "error_m": case.error,
        "screened": result.screened,
        "runs": result.runs,
        "reference_m": result.reference.high,
    }
    if row is None:
        return found | {"held": None, "recommended": None}
    finest = min(result.reference.settings.dt, row.settings.dt / 8)
    unseen = Judge(case, UNSEEN, 987, finest)
    wrong = np.array([unseen.wrong(row.settings, k) for k in range(UNSEEN)])
    found |= {
        "recommended": str(row.settings),
        "kept": float(np.mean(wrong <= case.error)),
        "held": bool(np.mean(wrong <= case.error) >= MOST),
        "median_m": float(np.median(wrong)),
        "worst_m": float(wrong.max()),
        "flops": unseen.price(row.settings),
        "confirmed": None if row.further is None else row.further.held,
    }
    if brute:
        judge = Judge(case, OWN, 654, finest)
        rows = max(path.rows for path in result.reference.runs)
        best = trade_cases.best(judge, case.error, rows, PATIENCE)
        if best is not None:
            price = judge.price(row.settings)
            timed = [TimedRun(judge.runner, settings) for settings in (row.settings, best[0])]
            with Progress("", 2, False) as bar:
                times = costs(timed, bar)
            found |= {"best": str(best[0]), "ratio": price / best[1], "times": times[0] / times[1]}
    return found


def _all(cases: list[trade_cases.Case]) -> Iterator[dict[str, object]]:
    """All scenes, one process a core; each times its own in turn."""
    with ProcessPoolExecutor() as pool:
        yield from pool.map(validate, cases)


def main() -> None:
    options = record.arguments(__doc__ or "")
    report = record.Report("trade_validation", options, NOTE)
    report.say()
    report.say(
        f"{'scene':26} {'error':>8} {'kept':>6} {'median':>8} {'worst':>8} {'flops':>6} time"
    )
    held, ratios, kept, count = 0, [], [], 0
    chosen = [case for case in CASES if options.only in case.name]
    for case, found in zip(chosen, _all(chosen), strict=True):
        report.add(**found)
        count += 1
        if found["held"] is None:
            report.say(f"{case.name:26} {case.error:8.0e} nothing recommended")
            continue
        held += bool(found["held"])
        kept.append(found["kept"])
        ratio, times = (float(found.get(name, math.nan)) for name in ("ratio", "times"))
        ratios += [ratio] if ratio == ratio else []
        report.say(
            f"{case.name:26} {case.error:8.0e} {found['kept']:6.0%} {found['median_m']:8.1e} "
            f"{found['worst_m']:8.1e} {ratio:6.2f} {times:4.2f}  {found['recommended']}"
        )
        report.say(f"{'':60} best: {found.get('best')}")
    report.say()
    report.say(f"{held} of {count} hold on at least {MOST:.0%} of unseen starts")
    cheap = sum(ratio <= 1.3 for ratio in ratios)
    report.say(
        f"{cheap} of {len(ratios)} within 1.3 times the best by brute force, where that ended "
        f"within {PATIENCE:.0f} s"
    )
    report.say(f"{np.mean(kept):.1%} of all unseen starts keep to the error")
    report.close()


if __name__ == "__main__":
    sys.exit(main())
