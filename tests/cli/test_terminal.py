"""Output on terminals: characters that cannot be shown, what goes on, Ctrl-C."""

import contextlib
import json
import os
import signal
import subprocess
import sys

import pytest

from stepcore.experiment import mujoco_engine


def output(*args, encoding="utf-8", columns=100, **more):
    environment = os.environ | {"PYTHONIOENCODING": encoding, "COLUMNS": str(columns)} | more
    command = [sys.executable, "-m", "stepcore", *args]
    return subprocess.run(command, env=environment, capture_output=True, timeout=600)


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
        mujoco_engine.mujoco()


def test_a_missing_mujoco_is_named(monkeypatch):
    monkeypatch.setitem(sys.modules, "mujoco", None)
    with pytest.raises(ImportError, match="pip install mujoco"):
        mujoco_engine.mujoco()


START = "import signal, sys; signal.signal(signal.SIGINT, signal.default_int_handler)\n"
# What is known so far is told at once, however quick the machine is.
MAIN = """from stepcore.cli import main, terminal
terminal.OFTEN = (0.0, 0.0)
sys.exit(main(sys.argv[1:]))"""


def on_a_terminal(*args, before="", until=None):
    """Run a command whose error stream alone is a terminal.

    until: text on the terminal at which Ctrl-C is pressed.

    Returns the exit status, standard output, and the lines that the terminal then shows.
    """
    pty = pytest.importorskip("pty")
    controller, terminal = pty.openpty()
    command = [sys.executable, "-c", START + before + MAIN, *args]
    environment = os.environ | {"COLUMNS": "100"}
    shown = b""
    with subprocess.Popen(command, stdout=-1, stderr=terminal, env=environment) as process:
        os.close(terminal)
        # A terminal whose last program has ended raises OSError on Linux.
        with contextlib.suppress(OSError):
            while more := os.read(controller, 4096):
                shown += more
                if until is not None and until in shown:
                    process.send_signal(signal.SIGINT)
                    until = None
        os.close(controller)
        out = process.stdout.read().decode()
    return process.returncode, out, drawn(shown.decode())


def drawn(text):
    """Return the lines on a terminal after a text, in which a carriage return goes back."""
    lines = []
    for line in text.replace("\r\n", "\n").split("\n"):
        seen = ""
        for part in line.split("\r"):
            seen = part + seen[len(part) :]
        lines.append(seen.rstrip())
    return lines


TRADE = ("trade", "lesson:spring", "--horizon", "0.2", "--starts", "3", "--further", "0", "--json")


def test_a_command_says_at_once_what_it_does_and_then_what_it_knows_so_far():
    status, out, lines = on_a_terminal(*TRADE, "--error", "1mm")
    assert (status, lines.pop()) == (0, "")
    assert lines[0] == (
        "stepcore: trade lesson:spring, at most 60 s: "
        "measure what speed costs in accuracy, and recommend settings"
    )
    # The bars between them are erased.
    assert len(lines) > 2 and all(line.startswith("stepcore: so far: ") for line in lines[1:])
    assert "as shipped" in lines[1] and "±" in lines[1] and "best" not in lines[1]
    assert "; best " in lines[-1]
    assert json.loads(out)["kind"] == "trade"


def test_what_a_command_does_is_said_before_its_module_is_imported():
    broken = "sys.modules['stepcore.cli.measurements'] = None\n"
    status, _, lines = on_a_terminal("check", "x.xml", "--seconds", "5", before=broken)
    assert status != 0
    assert lines[0] == "stepcore: check x.xml: look for what makes a model misbehave"


def test_a_pipe_gets_the_answer_alone():
    done = output(*TRADE)
    assert (done.returncode, done.stderr) == (0, b"") and json.loads(done.stdout)


@pytest.mark.parametrize("args", [("info",), ("trade", "--help"), ()])
def test_nothing_is_said_of_what_takes_no_time(args):
    assert on_a_terminal(*args)[2] == [""]


def test_ctrl_c_leaves_no_bar():
    long = ("predict", "gymnasium:ant", "--horizon", "100", "--seconds", "inf")
    status, _, lines = on_a_terminal(*long, until=b" 0/8")
    assert (status, lines.pop()) == (130, "")
    assert all(line.startswith("stepcore: ") for line in lines)
    assert lines[1].startswith("stepcore: interrupted; what is known follows")
