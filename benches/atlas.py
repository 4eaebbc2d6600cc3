"""An atlas of public robots: stability limit, error, its cost and findings; docs/atlas.md.

    python benches/atlas.py [--folder NAME=DIR …] [--only TEXT] [--again] [--write]

`atlas.toml` lists the robots. Collections of installed packages are found by themselves; the folder
of another one is given by --folder, and its robots are left out without it. Each robot makes its
default test motion, and four questions are answered by stepcore's own commands:

- diagnose: the largest stable step under the file's integrator and under implicitfast, and the
  elements that limit it;
- trade: the error of the settings in the file over the motion, the cost of settings with at most
  half of it, and of those with at most 1 mm, relative to the settings in the file. Cost is counted
  work, so the numbers do not depend on the machine;
- predict's time, until which errors are measured;
- check: the findings.

Every row is kept in results/atlas.json as soon as it is complete, and an interrupted run continues
there; --again measures the rows anew. --write puts table and plot into docs/atlas.md.
"""

from __future__ import annotations

import argparse
import fnmatch
import importlib.util
import json
import math
import statistics
import time
import tomllib
import warnings
from concurrent.futures import ProcessPoolExecutor, as_completed
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import record

import stepcore as sc
from stepcore.experiment import Change, Study

HERE = Path(__file__).parent
KEPT = HERE / "results" / "atlas.json"
PAGE = HERE.parent / "docs" / "atlas.md"
# The operations of a trade, and the time of a diagnosis [s]: of a humanoid, about a quarter of
# the default effort; the whole atlas then takes two hours on two cores.
EFFORT, SECONDS = 3e10, 60.0


@dataclass(frozen=True)
class Robot:
    """A file of a collection, and where the collection is published."""

    collection: str
    name: str
    source: str
    path: Path

    @property
    def key(self) -> str:
        return f"{self.collection}/{self.name}"


def robots(folders: dict[str, Path]) -> list[Robot]:
    """List the robots of all collections that are installed or in a folder."""
    rows = []
    for collection, entry in tomllib.loads((HERE / "atlas.toml").read_text()).items():
        folder = folders.get(collection) or _installed(entry.get("package", ""))
        if folder is None:
            print(f"{collection}: left out; --folder {collection}=DIR names its folder")
            continue
        for path in sorted({path for glob in entry["models"] for path in folder.glob(glob)}):
            name = str(path.relative_to(folder).with_suffix(""))
            skipped = [f"{name}.xml", *name.split("/")]
            if any(fnmatch.fnmatch(skipped[0], glob) for glob in entry.get("except", ())):
                continue
            rows.append(Robot(collection, name.replace("/xmls", ""), entry["source"], path))
    return rows


def _installed(package: str) -> Path | None:
    name, _, inner = package.partition("/")
    spec = importlib.util.find_spec(name) if name else None
    if spec is None or not spec.submodule_search_locations:
        return None
    return Path(spec.submodule_search_locations[0]) / inner


def measure(robot: Robot) -> dict[str, Any]:
    """Answer the four questions about one robot."""
    warnings.simplefilter("ignore")
    row: dict[str, Any] = {"robot": robot.key, "source": robot.source, "version": sc.__version__}
    begun = time.process_time()
    try:
        scene = sc.load(robot.path)
        model = scene.compile()
    except ValueError as error:
        return row | {"refused": str(error).splitlines()[0].replace(str(robot.path), robot.name)}
    settings = model.settings
    row |= {"nv": model.nv, "nu": model.nu, "dt": settings.dt, "integrator": settings.integrator}
    for question in (limits, errors, findings):
        try:
            row |= question(scene)
        except ValueError as error:
            row.setdefault("not measured", []).append(str(error).splitlines()[0])
    return row | {"processor": time.process_time() - begun}


def limits(scene: sc.Scene) -> dict[str, Any]:
    integrator = scene.settings.integrator
    result = sc.diagnose(
        scene, integrators=["implicitfast"], seconds=SECONDS, threads=1, progress=False
    )
    row: dict[str, Any] = {"unfinished": bool(result.not_done)}
    for name in dict.fromkeys((integrator, "implicitfast")):
        row[f"limit {name}"], row[f"by {name}"] = result.limit(name), result.stiffest(name)
    return row


def errors(scene: sc.Scene) -> dict[str, Any]:
    """Measure the error of the file's settings, and trade for 1 mm and for half of that error."""

    def trade(error: float) -> Any:
        return sc.trade(scene, error=error, by="flops", effort=EFFORT, threads=1, progress=False)

    fine = trade(1e-3)
    # Without a request, the uncertainty is a hundredth of the error of the file's settings.
    (shipped,) = Study(scene, horizon=fine.horizon, effort=EFFORT).run([Change()])
    row = {
        "error": shipped.error,
        "uncertainty": float(max(shipped.unsure, default=math.nan)),
        "failure": shipped.failure,
        "predictable": fine.predictable,
        "horizon": fine.horizon,
        "1 mm": chosen(fine),
    }
    if 0 < shipped.error < math.inf:
        row["half"] = chosen(trade(shipped.error / 2))
    return row


def chosen(result: Any) -> dict[str, Any] | None:
    """Return a validated recommendation: its cost relative to the file's settings, and label."""
    best = result.recommended
    if best is None or best.failure:
        return None
    proof = result.proof
    validated = None if proof is None else proof.record()
    cost = best.cost / result.shipped.cost
    return {
        "cost": cost,
        "settings": result.label(best),
        "error": best.error,
        "validated": validated,
    }


def findings(scene: sc.Scene) -> dict[str, Any]:
    result = sc.check(scene, threads=1, progress=False)
    return {"findings": sorted({finding.kind for finding in result.findings})}


def main() -> None:
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("--folder", action="append", default=[], metavar="NAME=DIR")
    parser.add_argument("--only", default="", help="robots with this text in their name")
    parser.add_argument("--again", action="store_true", help="measure the rows anew")
    parser.add_argument("--jobs", type=int, default=2, help="processes")
    parser.add_argument("--write", action="store_true", help="put the table into docs/atlas.md")
    options = parser.parse_args()
    folders = {name: Path(path) for name, _, path in (f.partition("=") for f in options.folder)}
    kept = json.loads(KEPT.read_text()) if KEPT.exists() else {}
    todo = [
        robot
        for robot in robots(folders)
        if options.only in robot.key and (options.again or robot.key not in kept)
    ]
    with ProcessPoolExecutor(options.jobs, max_tasks_per_child=1) as pool:
        runs = {pool.submit(measure, robot): robot for robot in todo}
        for number, run in enumerate(as_completed(runs), 1):
            key = runs[run].key
            kept[key] = run.result()
            KEPT.write_text(json.dumps(dict(sorted(kept.items())), indent=1) + "\n")
            print(f"{number} of {len(todo)}: {key}, {kept[key].get('processor', 0):.0f} s")
    if options.write:
        record.put(PAGE, "atlas", table(kept))
        draw(kept)


def table(kept: dict[str, dict[str, Any]]) -> str:
    """Return the table of docs/atlas.md: robots whose runs fail, then the largest error first."""
    measured = [row for row in kept.values() if "error" in row]
    measured.sort(key=lambda row: (not row["failure"], -row["error"], row["robot"]))
    lines = [
        "| robot | dofs | settings | stable up to [ms] | limited by | implicitfast [ms] "
        "| error as shipped [mm] | half of it | 1 mm | findings |",
        "| --- | --- | --- | --- | --- | --- | --- | --- | --- | --- |",
        *(_cells(row) for row in measured),
    ]
    others = [row for row in kept.values() if "error" not in row]
    lines += ["", "Not measured:", ""]
    for row in sorted(others, key=lambda row: row["robot"]):
        why = row.get("refused") or "; ".join(dict.fromkeys(row.get("not measured", ())))
        lines.append(f"- {row['robot']}: {why}")
    return summary(measured) + "\n\n" + "\n".join(lines) + "\n"


def summary(measured: list[dict[str, Any]]) -> str:
    """State the medians over all robots, and how many can use a longer step as they are."""
    limits = [(row.get(f"limit {row['integrator']}", math.nan), row["dt"]) for row in measured]
    margins = [limit / dt for limit, dt in limits if not math.isnan(limit)]
    finite = [row["error"] for row in measured if not row["failure"]]
    halves = [row["half"]["cost"] for row in measured if row.get("half")]
    fine = [row["1 mm"]["cost"] for row in measured if row["1 mm"]]
    return (
        f"{len(measured)} robots. The median error of the settings in the files is "
        f"{1e3 * statistics.median(finite):.2g} mm, and half of it costs "
        f"{statistics.median(halves):.2g} times as much in the median. 1 mm is reached for "
        f"{len(fine)} robots, at {statistics.median(fine):.2g} times the cost in the median. "
        f"The largest stable step is {statistics.median(margins):.3g} times the file's in the "
        f"median of the {len(margins)} for which it was found, and shorter "
        f"than the file's for {sum(margin < 1 for margin in margins)} robots."
    )


def _cells(row: dict[str, Any]) -> str:
    def step(name: str) -> str:
        dt = row.get(f"limit {name}", math.nan)
        return "not found" if math.isnan(dt) else "any" if math.isinf(dt) else f"{1e3 * dt:.3g}"

    def cost(name: str) -> str:
        choice = row.get(name)
        return "–" if choice is None else f"{choice['cost']:.2g}×: {choice['settings']}"

    error = f"{1e3 * row['error']:.3g} ± {1e3 * row['uncertainty']:.1g}"
    if row["predictable"] < row["horizon"]:
        error += f" until {row['predictable']:.2g} s"
    integrator = row["integrator"]
    cells = [
        f"`{row['robot']}`",
        f"{row['nv']}",
        f"{integrator}, {1e3 * row['dt']:g} ms",
        step(integrator),
        row.get(f"by {integrator}", ""),
        step("implicitfast"),
        "fails" if row["failure"] else error,
        cost("half"),
        cost("1 mm"),
        ", ".join(row.get("findings", ())),
    ]
    return "| " + " | ".join(cells) + " |"


def draw(kept: dict[str, dict[str, Any]]) -> None:
    """Draw error against cost: as shipped, half of the error, and 1 mm, one line a robot."""
    import matplotlib

    matplotlib.use("svg")
    matplotlib.rcParams["svg.hashsalt"] = "atlas"
    from matplotlib import pyplot as plt

    figure, axes = plt.subplots(figsize=(7.5, 4.5))
    for row in kept.values():
        if "error" not in row or row["failure"]:
            continue
        points = [(1.0, row["error"])]
        points += [(c["cost"], c["error"]) for c in (row.get("half"), row["1 mm"]) if c]
        costs, errors = zip(*sorted(points), strict=True)
        axes.loglog(costs, [1e3 * e for e in errors], lw=0.6, color="0.6", zorder=1)
        axes.scatter([1.0], [1e3 * row["error"]], s=12, color="tab:red", zorder=2)
        axes.scatter(costs[1:], [1e3 * e for e in errors[1:]], s=6, color="tab:blue", zorder=2)
    axes.set_xlabel("cost relative to the settings in the file")
    axes.set_ylabel("RMS position error, worst start [mm]")
    axes.grid(alpha=0.3)
    figure.savefig(PAGE.with_suffix(".svg"), bbox_inches="tight", metadata={"Date": None})


if __name__ == "__main__":
    main()
