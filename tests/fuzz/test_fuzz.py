"""Seeded fuzzing: no crash, no hang, no panic, and no exception but those that are promised.

A short part runs by default; the long part is `pytest -m long tests/fuzz`. Each case runs in a
process of its own; the fork is made in a fresh interpreter, which has no threads.
"""

import subprocess
import sys
from pathlib import Path

import pytest

HERE = Path(__file__).parent
RUN = """
import importlib, sys
sys.path[:0] = sys.argv[1:4]
import cases, isolation
(module, kind), first, count = sys.argv[4].split("."), int(sys.argv[5]), int(sys.argv[6])
case = getattr(importlib.import_module(module), kind)
cases.prepare()
print("\\n".join(isolation.defects(case, range(first, first + count), cases.PROMISED)))
"""
PATHS = (str(HERE), str(HERE.parent), str(HERE.parent / "parity"))
# With how many cases by default.
KINDS = {
    "cases.exploding_scene": 15,
    "cases.changed_attribute": 15,
    "cases.damaged_file": 15,
    "cases.bad_argument": 15,
    "cases.flipped_bit": 15,
    "random_scenes.random_scene": 15,
    "random_scenes.random_batch": 15,
    "forged.forged_snapshot": 15,
    "hostile.hostile_file": 15,
    "misuse.misuse": 10,
    "interrupts.interrupted": 15,
}


def defects(kind, first, count):
    """The lines of `isolation.defects`, of a fresh interpreter."""
    command = [sys.executable, "-c", RUN, *PATHS, kind, str(first), str(count)]
    done = subprocess.run(command, capture_output=True, text=True)
    assert done.returncode == 0, done.stderr
    return done.stdout.split("\n")[:-1] if done.stdout.strip() else []


@pytest.mark.parametrize("kind", KINDS)
def test_a_few_cases(kind):
    assert defects(kind, 0, KINDS[kind]) == []


@pytest.mark.long
@pytest.mark.parametrize("part", range(10))
@pytest.mark.parametrize("kind", KINDS)
def test_many_cases(kind, part):
    assert defects(kind, 1000 * part, 1000) == []


def test_a_crash_and_a_hang_are_told():
    """The harness itself: what it must catch, it catches."""
    script = RUN.replace("import cases, isolation", "import cases, isolation, os, time\n" + BREAKS)
    for kind, told in CAUGHT.items():
        command = [sys.executable, "-c", script, *PATHS, f"cases.{kind}", "0", "1"]
        done = subprocess.run(command, capture_output=True, text=True, check=True)
        assert told in done.stdout


BREAKS = """
isolation.SECONDS = 1
if sys.argv[-3] == "cases.hang":
    isolation.BY_THE_CLOCK = 3.0
def crash(seed): os.kill(os.getpid(), 11)
def hang(seed): time.sleep(60)
def busy(seed):
    while True: pass
def lost(seed): {}["x"]
def big(seed): bytearray(1 << 40)
cases.crash, cases.hang, cases.busy, cases.lost, cases.big = crash, hang, busy, lost, big
"""
CAUGHT = {
    "crash": "SIGSEGV",
    "hang": "no answer within 3 s",
    "busy": "no answer within",
    "lost": "KeyError: 'x'",
    "big": "MemoryError",
}
