"""Count the public files on which each kind of finding of `check` fires.

    python benches/findings.py [FOLDER ...] [--seconds 10]

The files are those of the wheels of gymnasium and dm_control, tests/threads, and the given folders.
A kind that fires on fewer than three files is a candidate for removal.
"""

from __future__ import annotations

import argparse
import warnings
from collections import defaultdict
from pathlib import Path

from robot_files import folder_of, wheels

import stepcore as sc
from stepcore.deadline import OutOfTime


def kinds_of(path: Path, seconds: float) -> set[str] | None:
    """Return the kinds of findings of a file; None if it does not load or is not checked."""
    try:
        result = sc.check(path, seconds=seconds, progress=False, threads=1)
    except (ValueError, OSError, OutOfTime, sc.SimulationError):
        return None
    return {finding.kind for finding in result.findings}


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("folders", nargs="*", type=Path)
    parser.add_argument("--seconds", type=float, default=10.0)
    options = parser.parse_args()
    threads = Path(__file__).parents[1] / "tests" / "threads"
    robots = wheels()
    for folder in (threads, *options.folders):
        robots += folder_of(folder.name, folder)
    # Collections share files.
    robots = list({robot.path.read_bytes(): robot for robot in robots}.values())
    warnings.simplefilter("ignore")
    files, checked = defaultdict[str, list[str]](list), 0
    for robot in robots:
        kinds = kinds_of(robot.path, options.seconds)
        checked += kinds is not None
        print(f"{robot.collection}/{robot.name}: {kinds}", flush=True)
        for kind in kinds or ():
            files[kind].append(f"{robot.collection}/{robot.name}")
    print(f"\n{checked} of {len(robots)} files were checked.\n")
    print("| kind | files | the first three |\n|---|---|---|")
    for kind, names in sorted(files.items(), key=lambda entry: len(entry[1])):
        print(f"| {kind} | {len(names)} | {', '.join(names[:3])} |")


if __name__ == "__main__":
    main()
