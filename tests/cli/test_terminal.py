"""Output on terminals that cannot show every character, and Ctrl-C while MuJoCo is imported."""

import os
import subprocess
import sys

import pytest

from stepcore.measure.trade import mujoco as points


def output(*args, encoding="utf-8", columns=100, **more):
    environment = os.environ | {"PYTHONIOENCODING": encoding, "COLUMNS": str(columns)} | more
    command = [sys.executable, "-m", "stepcore", *args]
    return subprocess.run(command, env=environment, capture_output=True, timeout=60)


def test_a_result_is_printed_on_an_ascii_terminal():
    done = output("run", "lesson:stack", encoding="ascii")
    assert done.returncode == 0
    assert b" us a step" in done.stdout
    assert output("run", "lesson:stack", encoding="utf-8").stdout.decode().count("µs") == 1


def test_a_result_is_printed_where_the_locale_is_that_of_c():
    plain = {"LC_ALL": "C", "PYTHONUTF8": "0", "PYTHONCOERCECLOCALE": "0"}
    done = output("run", "lesson:stack", encoding="", **plain)
    assert (done.returncode, done.stderr) == (0, b"")
    assert b" us a step" in done.stdout


@pytest.mark.parametrize("command", ["run", "plan"])
def test_a_narrow_terminal_is_honoured(command):
    done = output(command, "lesson:drop", columns=40)
    assert done.returncode == 0
    words = done.stdout.decode().splitlines()
    # A single word, such as a list of numbers without spaces, may be longer.
    assert all(len(line) <= 40 or " " not in line.strip() for line in words)


def test_ctrl_c_while_mujoco_is_imported_is_no_missing_package(monkeypatch):
    class Interrupted:
        def find_spec(self, name, *_):
            if name == "mujoco":
                raise ImportError("KeyboardInterrupt: <EMPTY MESSAGE>")

    monkeypatch.delitem(sys.modules, "mujoco", raising=False)
    monkeypatch.setattr(sys, "meta_path", [Interrupted(), *sys.meta_path])
    with pytest.raises(KeyboardInterrupt):
        points.require()


def test_a_missing_mujoco_is_named(monkeypatch):
    monkeypatch.setitem(sys.modules, "mujoco", None)
    with pytest.raises(ImportError, match="pip install mujoco"):
        points.require()
