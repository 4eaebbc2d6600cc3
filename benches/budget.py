"""What building and testing cost: processor seconds beside a fixed loop of work, and bytes of code.

    python benches/budget.py 'pip install ".[test]"' "pytest -n auto"    # what .ci/run runs
    python benches/budget.py --record …                                  # and keeps the figures

Where other programs run, processor seconds double; the loop, timed before and after, then takes
longer too. The code of the compiled module may not exceed TEXT: what raises it says why in the
same commit.
"""

from __future__ import annotations

import argparse
import resource
import subprocess
import sys
import time
from pathlib import Path
from types import SimpleNamespace

import record

# Bytes of machine code (`size`, section .text) of the module for AVX2 on Linux x86-64: 12.46e6
# since machine code of a step has left and lanes do without heaps and sleep (17.23e6 before), and a
# twentieth for other compilers. Forces and ranges of muscles by world took 8e3 of 13.094e6, and
# where edges of corners in one line cross 24e3. An allowance of evaluations for steps within an
# accuracy moved what is inlined, which took 30e3. Factors of round cones beside their axes took
# 157e3 (a step by sweeps of a robot on elliptic cones takes 0.7 to 0.85 of the time). Sides of
# cylinders took 8e3, and their use of gjk moved what is inlined elsewhere, which took 53e3. Since
# issue 85 every long loop checks for an interruption and can be unwound, and `discrete` and
# adhesion are as in MuJoCo, which took 120e3 together.
TEXT = 13_500_000
WHERE = "import pathlib, stepcore._core as core; print(core.VECTORS, core.__file__)"


def loop() -> float:
    """Processor seconds of a fixed loop of work."""
    started, total = time.process_time(), 0
    for number in range(20_000_000):
        total += number * number
    return time.process_time() - started


def run(command: str, report: record.Report) -> int:
    """Run a command in a shell; report its cost; return its exit status."""
    before, used, started = loop(), _used(), time.perf_counter()
    status = subprocess.run(["bash", "-euo", "pipefail", "-c", command]).returncode
    wall, used = time.perf_counter() - started, _used() - used
    beside = (before + loop()) / 2
    report.say(
        f"{command}: {used:.0f} s of processor time, {wall:.0f} s by the clock; "
        f"beside it a fixed loop took {beside:.2f} s"
    )
    report.add(command=command, processor=used, wall=wall, loop=beside, status=status)
    return status


def _used() -> float:
    usage = resource.getrusage(resource.RUSAGE_CHILDREN)
    return usage.ru_utime + usage.ru_stime


def code_bytes(report: record.Report) -> int:
    """Report the code of the installed module; return 1 if it is more than TEXT."""
    found = subprocess.run([sys.executable, "-c", WHERE], capture_output=True, text=True)
    vectors, path = found.stdout.split(maxsplit=1)
    sections = subprocess.run(["size", "-A", "-d", path.strip()], capture_output=True, text=True)
    lines = [line.split() for line in sections.stdout.splitlines()]
    text = next(int(line[1]) for line in lines if line and line[0] == ".text")
    name = Path(path).parent.name
    report.say(f"{name}, {vectors}: {text / 1e6:.2f} MB of code, at most {TEXT / 1e6:.2f}")
    report.add(vectors=vectors, text=text, limit=TEXT)
    return int(vectors == "avx2" and text > TEXT)


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--record", action="store_true", help="keep the figures in benches/results")
    parser.add_argument("build", help="the command that installs stepcore")
    parser.add_argument("tests", help="the command that tests it")
    options = parser.parse_args()
    keep = SimpleNamespace(pairs=0, sample=0.0, save=options.record)
    report = record.Report("budget", keep, "building and testing")
    status = run(options.build, report) or code_bytes(report) or run(options.tests, report)
    report.close()
    return status


if __name__ == "__main__":
    sys.exit(main())
