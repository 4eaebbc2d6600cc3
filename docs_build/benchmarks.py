"""The page of benchmarks, from the results that the benches keep."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

# Benches in the order of the page, and what each asks.
BENCHES = {
    "vs_mujoco": "Small scenes and gymnasium's models against MuJoCo",
    "heaps": "Heaps against MuJoCo, at equal error",
    "robots": "Public robots against MuJoCo",
    "vs_rapier": "A ball and piles of spheres against Rapier",
    "vs_numpy": "The lesson's scenes against numpy",
    "heap_scale": "What a heap costs as it grows",
    "heap_threads": "One heap, stepped by several threads",
    "levels": "Batches against mujoco.rollout, by vector instructions",
    "batch_threads": "Batches, stepped by several threads",
    "vector_envs": "Environments against gymnasium's and EnvPool",
    "peak": "What share of the processor's peak a step reaches",
    "executors": "Runs in threads, processes and a Dask cluster",
    "trade_validation": "Do the trade's recommendations hold?",
}
INTRODUCTION = """# Benchmarks

Every figure here was measured, checked to be of the same physics on both sides, and kept in
`benches/results`, from which this page is made. Ratios above 1 mean that stepcore is faster.
[What makes the numbers fair](../benches/README.md), and how to run each bench, stands beside them.
"""


def page(benches: Path) -> str:
    """The page: of every bench the last kept result.

    Raises ValueError for a result whose bench has no place on the page.
    """
    latest = last_results(benches / "results")
    if unknown := latest.keys() - BENCHES.keys():
        raise ValueError(f"results without a place on the page: {sorted(unknown)}")
    parts = [INTRODUCTION]
    for bench, title in BENCHES.items():
        if bench in latest:
            parts.append(f"## {title}\n\n{_section(bench, latest[bench])}")
    return "\n\n".join(parts) + "\n"


def last_results(folder: Path) -> dict[str, Path]:
    """The newest kept text of each bench; names are bench-date-processor."""
    return {path.name.split("-")[0]: path for path in sorted(folder.glob("*.txt"))}


def _section(bench: str, text: Path) -> str:
    """The ratios as a table, where there are such, and the whole output as it was printed."""
    output = text.read_text(encoding="utf-8").rstrip("\n")
    kept = f"""??? note "The whole output of `{bench}.py`, {_date(text)}"\n\n"""
    kept += "\n".join(f"    {line}" for line in f"```text\n{output}\n```".split("\n"))
    data = json.loads(text.with_suffix(".json").read_text(encoding="utf-8"))
    return "\n\n".join(filter(None, (_machine(data), _ratios(data["records"]), kept)))


def _date(text: Path) -> str:
    """The date in the name of a result."""
    return "-".join(text.name.split("-")[1:4])


def _machine(data: dict[str, Any]) -> str:
    """Where, when and with which versions a result was measured, in a line."""
    machine, versions = data["machine"], data["versions"]
    packages = ", ".join(f"{name} {version}" for name, version in versions.items())
    return (
        f"{data['date']}, {machine['cpu']}, {machine['cores']} cores, {machine['vectors']}, "
        f"load {machine['load'][0]:.1f}; {packages}."
    )


def _ratios(records: list[dict[str, Any]]) -> str:
    """Cases by integrator and solver, each with its median ratio; "" without such records."""
    duels = [record for record in records if "duel" in record and "solver" in record]
    columns = list(dict.fromkeys(_setting(record) for record in duels))
    cells = {(record["case"], _setting(record)): record["duel"]["ratio"] for record in duels}
    rows = [
        [case, *(_ratio(cells.get((case, column))) for column in columns)]
        for case in dict.fromkeys(record["case"] for record in duels)
    ]
    return _table(["", *columns], rows) if rows else ""


def _setting(record: dict[str, Any]) -> str:
    return ", ".join(filter(None, (record.get("integrator"), record["solver"])))


def _ratio(ratio: float | None) -> str:
    """A ratio with two digits; bold where the other side is faster."""
    if ratio is None:
        return ""
    return f"{ratio:.2f}" if ratio >= 1 else f"**{ratio:.2f}**"


def _table(head: list[str], rows: list[list[str]]) -> str:
    lines = [head, ["---"] * len(head), *rows]
    return "\n".join(f"| {' | '.join(line)} |" for line in lines)
