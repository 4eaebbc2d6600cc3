"""What all tests share."""

import math
import os
import signal
import sys

import pytest

# Before numpy is imported: each core has a worker, and the threads of BLAS spin while they wait.
os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")

from stepcore import deadline
from stepcore.report import progress


@pytest.fixture(autouse=True, scope="session")
def elsewhere(tmp_path_factory):
    """Tests run in a folder of their own: MuJoCo writes its warnings to the working directory."""
    before = os.getcwd()
    os.chdir(tmp_path_factory.mktemp("elsewhere"))
    yield
    os.chdir(before)


@pytest.fixture(autouse=True)
def import_path():
    """A command that loads a user's file adds its folder; processes started later inherit it."""
    before = sys.path[:]
    yield
    sys.path[:] = before


@pytest.fixture(autouse=True)
def without_time_limits(monkeypatch):
    """No answer of a command depends on how busy the machine is; tests/measure/test_seconds.py."""
    monkeypatch.setattr(progress, "LINES", math.inf)
    for command in deadline.SECONDS:
        monkeypatch.setitem(deadline.SECONDS, command, math.inf)


@pytest.fixture(autouse=True)
def interruptible():
    """Python's own handler of Ctrl-C: a process started in the background may ignore it."""
    before = signal.signal(signal.SIGINT, signal.default_int_handler)
    yield
    signal.signal(signal.SIGINT, before)
