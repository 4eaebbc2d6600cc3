"""Where the time of worlds in vector registers goes, by stage.

    RUSTFLAGS="-C target-feature=+avx2" cargo build --release -p stepcore-python
    cp target/release/lib_core.so python/stepcore/_core.abi3.so
    PYTHONPATH=python python benches/stages.py
    PYTHONPATH=python python benches/stages.py --only humanoid --no-save

Samples of processor time by Linux's `perf`, by the function that was running, while a batch repeats
a rollout of the models of `levels.py` (Newton, one thread, f64, each model's own integrator). The
module must have its symbols, which those of wheels do not have. What is not the engine's, Python
and the making of the model, is left out.
"""

from __future__ import annotations

import re
import subprocess
import sys
import tempfile
import time
from pathlib import Path

import levels
import mujoco_side
import numpy as np
import record

import stepcore as sc

WORLDS, STEPS, SECONDS = 512, 10, 3.0
# By the names of functions; the first that matches.
STAGES = {
    "few rows": r"stepcore::solve::few",
    "Newton": r"stepcore::solve::newton",
    "other solving": r"stepcore::solve::(pgs|solver|momentum|residual|alone|islands|limits)",
    "place": r"stepcore::place",
    "detect": r"stepcore::(detect|shapes)",
    "rows": r"stepcore::(elements|solve)",
    "commit": r"stepcore::(commit|step)\b",
    "functions": r"sin_cos|stepcore::real",
    "batch": r"stepcore::(batch|arrays|watch|sim|state)|_core::",
    "copies": r"^__?(mem|strided)|memmove|memset|memcpy",
}
LINE = re.compile(r"\s*([\d.]+)%\s+(\S+)\s+\[.\]\s+(.*)")


def main() -> None:
    options = record.arguments(__doc__.splitlines()[0])
    report = record.Report("stages", options, "share of processor time, worlds in lanes")
    report.say()
    report.say(f"{'model':14}" + "".join(f"{stage:>14}" for stage in [*STAGES, "else"]))
    for case in levels.CASES:
        if options.only in case.name:
            shares = sampled(case.name)
            report.say(f"{case.name:14}" + "".join(f"{share:13.0f}%" for share in shares.values()))
            report.add(case=case.name, percent=shares)
    report.close()


def sampled(name: str) -> dict[str, float]:
    """Percent of the engine's time, by stage."""
    with tempfile.TemporaryDirectory() as folder:
        data = str(Path(folder, "perf.data"))
        # Processor time, for machines that give away no counters.
        perf = ["perf", "record", "-q", "-o", data, "-e", "cpu-clock", "-F", "1999", "--"]
        subprocess.run([*perf, sys.executable, __file__, "run", name], check=True)
        shown = ["perf", "report", "-i", data, "--stdio", "--no-children", "--percent-limit", "0"]
        lines = subprocess.run([*shown, "--sort", "dso,symbol"], capture_output=True, text=True)
    found = dict.fromkeys([*STAGES, "else"], 0.0)
    for percent, library, function in LINE.findall(lines.stdout):
        if "_core" in library or ("libc" in library and re.search(STAGES["copies"], function)):
            found[stage(function)] += float(percent)
    whole = sum(found.values())
    return {name: 100 * part / whole for name, part in found.items()}


def stage(function: str) -> str:
    return next((name for name, own in STAGES.items() if re.search(own, function)), "else")


def run(name: str) -> None:
    """Repeats a rollout for some seconds."""
    case = next(case for case in levels.CASES if case.name == name)
    model = case.mujoco()
    integrator = mujoco_side.shipped_integrator(model)
    mujoco_side.configure(model, integrator, "newton")
    motion = mujoco_side.record(model, WORLDS, 1, 5, case.settle)
    ctrl = np.repeat(motion.ctrl, STEPS, axis=1)
    settings = {"solver": "newton", "integrator": integrator}
    batch = sc.Batch(case.stepcore(), WORLDS, threads=1, lanes=True, **settings)
    end = time.monotonic() + SECONDS
    while time.monotonic() < end:
        levels.run(batch, motion.starts["qpos"], motion.starts["qvel"], ctrl)


if __name__ == "__main__":
    run(sys.argv[2]) if sys.argv[1:2] == ["run"] else main()
