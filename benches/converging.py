"""How far motions are from converged ones, against how far they are told to be.

    python benches/converging.py [FILE …] [--starts 6] [--cap 1e10] [--seconds 60]

Each start climbs the ladders of implicitfast and rk4 until a run would take more operations than
`--cap`, or the scene's time is over. What a `Truth` would say after each rung (`_Start.unsure`) is
compared with the distance to the finest run of the *other* method, unless the finest runs of both
are further apart than half of that. The first line is of the scene with most misses, the last one
of all scenes.
"""

from __future__ import annotations

import argparse
import time
import warnings

import numpy as np

from stepcore.engine.norm import distances, rms
from stepcore.experiment import Motion, Study
from stepcore.experiment.truth import _Start

SCENES = [
    *("gymnasium:hopper", "gymnasium:walker2d", "gymnasium:humanoid", "gymnasium:ant"),
    *("dm_control:cheetah", "dm_control:hopper", "dm_control:walker"),
]
METHODS = ("implicitfast", "rk4")
# Rungs of a ladder, at most; from which on they are compared, and how many before the finest one
# are not, because they are near to the truth.
RUNGS, FIRST, LAST = 16, 3, 2


def shares(file: str, starts: int, cap: float, seconds: float) -> list[float]:
    """Return the distances to the converged motion over what is told of them."""
    study = Study(file, Motion(), starts=starts)
    study.allowed, ways = np.inf, study.engine.ways(study.schedule, 1e-3)
    truth, found = study.truth(1e-3), list[float]()
    for k, start in enumerate(truth.starts):
        end, scored = time.monotonic() + seconds / starts, truth.scored[k : k + 1]

        def far(a, b, scored=scored) -> float:
            return float(rms(distances(a, b, study.engine.matter), scored)[0])

        ladders = {}
        for way in (way for way in ways if way.name in METHODS):
            runs = ladders[way.name] = []
            for rung in range(RUNGS):
                if study.price(way.at(rung), 1) > cap or time.monotonic() > end:
                    break
                runs += [run for run in study.tracks([way.at(rung)], [start]) if not run.failure]
        if any(len(runs) <= FIRST + LAST for runs in ladders.values()):
            continue
        finest = {name: runs[-1] for name, runs in ladders.items()}
        gap = far(*finest.values())
        for name, other in zip(METHODS, METHODS[::-1], strict=True):
            runs = ladders[name]
            own = _Start(1, runs[1], runs[0], far(runs[0], runs[1]))
            for rung in range(2, len(runs) - LAST):
                now = runs[rung]
                own = own.finer(now, far(runs[rung - 1], now), far(runs[rung - 2], now))
                off = far(now, finest[other])
                if rung >= FIRST and off > 2 * gap and own.unsure > 0:
                    found.append(off / own.unsure)
    return found


def said(name: str, found: list[float]) -> str:
    off = np.array(found)
    over, twice = 100 * np.mean(off > 1), 100 * np.mean(off > 2)
    return (
        f"{name:24} {len(off):4} rungs; told {1 / np.median(off):.1f} times what it is (median); "
        f"too little in {over:.0f} %, by more than twice in {twice:.1f} %, worst {off.max():.1f}"
    )


def main() -> None:
    """Measure, and print a line for each scene."""
    parser = argparse.ArgumentParser(description=__doc__.partition("\n")[0])
    parser.add_argument("files", nargs="*", default=SCENES)
    parser.add_argument("--starts", type=int, default=6)
    parser.add_argument("--cap", type=float, default=1e10)
    parser.add_argument("--seconds", type=float, default=60)
    given = parser.parse_args()
    warnings.simplefilter("ignore")
    every = {f: shares(f, given.starts, given.cap, given.seconds) for f in given.files}
    every = {name: found for name, found in every.items() if found}
    for name in sorted(every, key=lambda name: -np.mean(np.array(every[name]) > 1)):
        print(said(name, every[name]))
    print(said("all", [share for found in every.values() for share in found]))


if __name__ == "__main__":
    main()
