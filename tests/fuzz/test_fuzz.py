"""Seeded fuzzing: no crash, no hang, no panic, and no exception but those that are promised.

A short part runs every day; the long part is `pytest -m long tests/fuzz`. Each case runs in a
process of its own; the fork is made in a fresh interpreter, which has no threads.
"""

import subprocess
import sys
from pathlib import Path

import pytest

HERE = Path(__file__).parent
RUN = """
import sys
sys.path[:0] = sys.argv[1:3]
import cases, isolation
kind, first, count = sys.argv[3], int(sys.argv[4]), int(sys.argv[5])
case = getattr(cases, kind)
cases.prepare()
print("\\n".join(isolation.defects(case, range(first, first + count), cases.PROMISED)))
"""
KINDS = ("exploding_scene", "changed_attribute", "damaged_file", "bad_argument", "flipped_bit")


def defects(kind, first, count):
    """The lines of `isolation.defects`, of a fresh interpreter."""
    paths = [str(HERE), str(HERE.parent)]
    command = [sys.executable, "-c", RUN, *paths, kind, str(first), str(count)]
    done = subprocess.run(command, capture_output=True, text=True)
    assert done.returncode == 0, done.stderr
    return done.stdout.split("\n")[:-1] if done.stdout.strip() else []


@pytest.mark.parametrize("kind", KINDS)
def test_a_few_cases(kind):
    assert defects(kind, 0, 150) == []


@pytest.mark.long
@pytest.mark.parametrize("part", range(10))
@pytest.mark.parametrize("kind", KINDS)
def test_many_cases(kind, part):
    assert defects(kind, 1000 + 1000 * part, 1000) == []


def test_a_crash_and_a_hang_are_told():
    """The harness itself: what it must catch, it catches."""
    script = RUN.replace("import cases, isolation", "import cases, isolation, os, time\n" + BREAKS)
    paths = [str(HERE), str(HERE.parent)]
    for kind, told in (("crash", "SIGSEGV"), ("hang", "no answer"), ("lost", "KeyError: 'x'")):
        command = [sys.executable, "-c", script, *paths, kind, "0", "1"]
        done = subprocess.run(command, capture_output=True, text=True, check=True)
        assert told in done.stdout


BREAKS = """
isolation.SECONDS = 0.5
def crash(seed): os.kill(os.getpid(), 11)
def hang(seed): time.sleep(60)
def lost(seed): {}["x"]
cases.crash, cases.hang, cases.lost = crash, hang, lost
"""
