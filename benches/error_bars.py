"""Error bars: the estimated error of a run over its true one.

Each of the scenes of `trade_validation.py` starts at its first keyframe with its controls held, is
run with its own steps and within an accuracy of 1 mm, and is compared every 20 ms with a converged
run of fixed steps. `true/bar`: the largest true error of a body over the largest estimated one, up
to the end or to the time from which the run says that no error is known. The worst come first.
Lines whose truth is not known to a third of the error are left out and counted; so are runs that
diverge. `cost`: computing time with the bar over that without.
"""

from __future__ import annotations

import time
import warnings
from typing import Any

import numpy as np
import record
from trade_cases import CASES

import stepcore as sc
from stepcore.engine.norm import Matter, Tracks, distances

PERIOD, FINER = 0.02, 2048


def main() -> None:
    warnings.simplefilter("ignore")
    options = record.arguments(__doc__.splitlines()[0])
    report = record.Report("error_bars", options, f"compared every {PERIOD * 1e3:g} ms, one world")
    rows, unknown = [], 0
    for case in CASES:
        if options.only in case.name:
            model = case.make().compile()
            for row in measured(model, min(case.horizon, 0.2 if options.quick else 1e9)):
                rows.append({"name": case.name} | row)
                report.add(**rows[-1])
    known = [row for row in rows if row["true"] > 3 * row["truth"] and row["bar"] > 0]
    unknown = len(rows) - len(known)
    far = lambda row: abs(np.log(row["true"] / row["bar"]))  # noqa: E731
    report.say()
    report.say(f"{'scene':22}{'steps':14}{'true':>9}{'bar':>9}{'true/bar':>10}{'cost':>7}  until")
    for row in sorted(known, key=far, reverse=True):
        until = "" if np.isinf(row["until"]) else f"{row['until']:.2f} s"
        report.say(
            f"{row['name']:22}{row['steps']:14}{row['true']:9.1e}{row['bar']:9.1e}"
            f"{row['true'] / row['bar']:10.2f}{row['cost']:7.1f}  {until}"
        )
    good = sum(1 / 3 <= row["true"] / row["bar"] <= 3 for row in known)
    report.say(f"within a factor of 3: {good} of {len(known)}; truth not known: {unknown}")
    report.close()


def measured(model: sc.Model, horizon: float) -> list[dict[str, Any]]:
    """A row with the scene's own steps, and one within an accuracy; errors [m]."""
    own, rows = model.settings, []
    dt = PERIOD / max(1, round(PERIOD / own.dt))
    fine = {"solver": "newton", "sweeps": 200, "tolerance": 1e-12, "precision": "f64"}
    if own.law == "solref":
        fine["refsafe"] = False
    else:
        fine = {"precision": "f64"}
    pair = [poses(model, horizon, dt=dt / n, sleep=False, **fine)[0] for n in (FINER, FINER // 2)]
    ways: list[dict[str, Any]] = [{"dt": dt}]
    if own.law == "solref":
        ways.append({"dt": PERIOD, "accuracy": 1e-3})
    for way in ways:
        try:
            plain = poses(model, horizon, **way)[1]
        except sc.SimulationError:
            continue
        seen, cost, until, bar = poses(model, horizon, error_bar=True, **way)
        good = np.arange(1, len(bar) + 1) * PERIOD < until
        truth, true = (
            distances(one, pair[0], Matter.of(model))[0, good].max(initial=0.0)
            for one in (pair[1], seen)
        )
        steps = "own" if "accuracy" not in way else "accuracy 1 mm"
        row = {"steps": steps, "true": true, "bar": bar[good].max(initial=0.0), "truth": truth}
        rows.append(row | {"until": until, "cost": cost / plain})
    return rows


def poses(model: sc.Model, horizon: float, **fields: Any) -> tuple[Tracks, float, float, Any]:
    """Poses at every period, time [s], until when, and the bar [m]."""
    sim = sc.Sim(model, **fields)
    sim.reset(0 if model.keys else None)
    n, out, bar = round(PERIOD / sim.settings.dt), [], []
    began = time.process_time()
    for _ in range(round(horizon / PERIOD)):
        sim.step(n)
        out.append((sim.xpos, sim.xquat))
        if fields.get("error_bar"):
            bar.append(sim.error.largest)
    cost = time.process_time() - began
    until = sim.predictable_until if fields.get("error_bar") else np.inf
    xpos, xquat = (np.array(values)[None] for values in zip(*out, strict=True))
    return Matter.of(model).tracks(xpos, xquat), cost, until, np.array(bar)


if __name__ == "__main__":
    main()
