"""The command line: what it prints, its exit statuses, and errors of one line."""

import dataclasses
import json
import re
import signal
import subprocess
import sys
import threading

import numpy as np
import pytest

import stepcore as sc
from stepcore.cli import COMMANDS, main, parser
from stepcore.cli.arguments import OPTIONS
from stepcore.loading import find_asset

BALL = """<mujoco model="ball"><option timestep="0.004"/>
<worldbody><body pos="0 0 1"><freejoint/><geom size="0.1" mass="1"/></body></worldbody></mujoco>
"""


@pytest.fixture
def ball(tmp_path):
    file = tmp_path / "ball.xml"
    file.write_text(BALL)
    return str(file)


def call(capsys, *args):
    status = main([str(arg) for arg in args])
    said = capsys.readouterr()
    return status, said.out, said.err


def test_run_prints_the_final_state(capsys, ball):
    status, out, err = call(capsys, "run", ball, "--horizon", 0.4, "--json")
    assert status == 0 and not err
    data = json.loads(out)
    assert data["steps"] == 100 and data["time"] == pytest.approx(0.4)
    # v-first: 1 - g dt² n (n + 1) / 2
    assert data["qpos"][2] == pytest.approx(1 - 9.81 * 0.004**2 * 5050, abs=1e-12)
    status, out, err = call(
        capsys, "run", ball, "--horizon", "0.4", "--dt", "0.002", "--set", "integrator=rk4"
    )
    assert status == 0 and "200 steps" in out and "rk4" in out


def test_run_starts_at_the_first_key_though_it_has_no_name(capsys, tmp_path):
    file = tmp_path / "keys.xml"
    keys = '<keyframe><key qpos="0 0 5 1 0 0 0"/><key qpos="0 0 9 1 0 0 0"/></keyframe>'
    file.write_text(BALL.replace("</mujoco>", f"{keys}</mujoco>"))
    status, out, _ = call(capsys, "run", file, "--horizon", 0, "--json")
    assert status == 0 and json.loads(out)["qpos"][2] == 5


def test_run_of_a_scene_of_the_lesson_starts_at_its_key(capsys):
    status, out, _ = call(capsys, "run", "lesson:drop", "--horizon", 2, "--json")
    assert status == 0
    assert json.loads(out)["qpos"][0] == pytest.approx(-98.1e-6, abs=1e-12)


def test_trade_prints_and_writes(capsys, tmp_path, ball):
    out_json, ctrl = tmp_path / "trade.json", tmp_path / "ctrl.csv"
    ctrl.write_text("")
    options = ["--horizon", 0.1, "--starts", 1, "--threads", 1]
    status, out, err = call(capsys, "trade", ball, *options, "--json", out_json)
    assert status == 0 and not err
    assert "Errors are measured from" in out and "As shipped (euler, newton, dt 4 ms)" in out
    data = json.loads(out_json.read_text())
    assert data["model"] == "ball" and data["horizon"] == pytest.approx(0.096)
    status, out, _ = call(capsys, "trade", ball, *options, "--json")
    assert status == 0 and json.loads(out)["rows"]


def test_trade_with_a_control_function(capsys, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr(sys, "path", [*sys.path])
    (tmp_path / "my_control_of_a_grasp.py").write_text("def grip(time, sim):\n    return [3, 3]\n")
    options = ["--horizon", 0.016, "--starts", 1, "--control-dt", 0.008]
    control = ["--control", "my_control_of_a_grasp:grip"]
    status, out, err = call(capsys, "trade", "lesson:grasp", *options, *control)
    assert status == 0, err
    assert "grasp:" in out
    control = ["--control", "my_control_of_a_grasp:grab"]
    status, _, err = call(capsys, "trade", "lesson:grasp", *options, *control)
    assert status == 2 and "nearest" in err and "grip" in err


def test_a_model_of_an_installed_package(capsys):
    assert find_asset("gymnasium", "half_cheetah").name == "half_cheetah.xml"
    status, out, _ = call(capsys, "run", "gymnasium:half_cheetah", "--horizon", 0.1, "--json")
    assert status == 0 and len(json.loads(out)["qpos"]) == 9
    status, _, err = call(capsys, "run", "gymnasium:half_cheeta", "--horizon", 0.1)
    assert status == 2 and "half_cheetah" in err


def test_a_package_s_tests_come_last(tmp_path, monkeypatch):
    monkeypatch.setattr(sys, "path", [str(tmp_path), *sys.path])
    package = tmp_path / "a_package_of_models"
    for folder in ("suite", "testing/assets", "tests"):
        (package / folder).mkdir(parents=True)
        (package / folder / "cart.xml").touch()
    (package / "__init__.py").touch()
    (package / "tests" / "pole.xml").touch()
    assert find_asset(package.name, "cart") == package / "suite" / "cart.xml"
    assert find_asset(package.name, "tests/cart") == package / "tests" / "cart.xml"
    assert find_asset(package.name, "pole") == package / "tests" / "pole.xml"
    (package / "cart.xml").touch()
    with pytest.raises(ValueError, match="several files"):
        find_asset(package.name, "cart")


def test_info(capsys):
    status, out, _ = call(capsys, "info", "--json")
    assert status == 0
    assert {"stepcore", "numpy", "module", "python", "cores"} <= json.loads(out).keys()
    assert call(capsys, "info")[0] == 0


@pytest.mark.parametrize(
    ("args", "words"),
    [
        (["run", "no.xml", "--horizon", "1"], "no.xml: no such file"),
        (["run", "FOLDER"], "is a folder, not an MJCF or URDF file"),
        (["trade", "no.xml"], "no.xml: no such file"),
        (["replay", "no.json"], "no.json: no such file"),
        (["replay", "FOLDER"], "is a folder, not a replay file"),
        (["plan", "BALL", "--key", "1"], "key = 1"),
        (["run", "lesson:slide", "--horizon", "1"], "spring, drop, stack, grasp"),
        (["run", "no_such_package:x", "--horizon", "1"], "no package"),
        (["run", "a-b:x", "--horizon", "1"], "not the name of a package"),
        (["run", "BALL", "--horizon", "nan"], "--horizon"),
        (["run", "BALL", "--horizon", "-1"], "--horizon"),
        (["run", "BALL", "--horizon", "1 hour"], "'1 hour' must be a time: seconds, 1ms or 20us"),
        (["run", "BALL", "--horizon", "1e300"], "horizon = 1e+300: must be at most"),
        (["diagnose", "BALL", "--starts", "3"], "--starts"),
        (["run", "BALL", "--horizon", "1", "--dt", "0"], "dt"),
        (["run", "BALL", "--horizon", "1", "--key", "home"], "home"),
        (["run", "BALL", "--horizon", "1", "--set", "sweps=3"], "nearest"),
        (["run", "BALL", "--horizon", "1", "--set", "sweeps"], "NAME=VALUE"),
        (
            ["run", "BALL", "--horizon", "1", "--set", "sweeps=few"],
            "must be 'auto' or a whole",
        ),
        (["run", "BALL", "--horizon", "1", "--set", "refsafe=maybe"], "must be True or False"),
        (["run", "BROKEN", "--horizon", "1"], "broken.xml:1"),
        (["trade", "BALL", "--horizon", "-1"], "horizon"),
        (["trade", "BALL", "--starts", "none"], "--starts"),
        (["trade", "BALL", "--ctrl", "no.npy"], "no such file"),
        (["trade", "BALL", "--ctrl", "1,0"], "this model has no actuators"),
        (["trade", "BALL", "--budget", "20"], "must be > 0, with its unit: "),
        (["trade", "BALL", "--ctrl", "BALL"], "must end in .csv, .npz, .npy, .parquet, .mcap"),
        (["trade", "BALL", "--control", "json"], "FILE.py:FUNCTION or MODULE:FUNCTION"),
        (["trade", "BALL", "--control", "no_such_module:f"], "no_such_module"),
        (["trade", "BALL", "--json", "no/such/folder/x.json"], "no such folder"),
        (["trade", "BALL", "--html", "."], "a folder"),
        (["run", "BALL", "--replay", "."], "a folder"),
        (["ablate", "BALL", "--save", "."], "a folder"),
        (["diagnose", "BALL", "--seed", "-1"], "seed = -1"),
        (["diagnose", "BALL", "--control-dt", "-1"], "control_dt = -1"),
        (["lesson", "--engine", "abacus"], "abacus"),
        (["dance"], "dance"),
        (["tarde", "BALL"], "no command 'tarde'; nearest: \"trade\""),
        (["trade", "--errr", "1mm", "BALL"], "no option --errr; nearest: --error"),
        (["run", "BALL", "--horizn=3"], "no option --horizn; nearest: --horizon"),
        (["run", "BALL", "--xyzzy"], "no option --xyzzy; stepcore run --help"),
        (["run", "BALL", "BALL"], "unexpected argument"),
    ],
)
def test_bad_input_is_one_line_and_exit_2(capsys, tmp_path, ball, args, words):
    broken = tmp_path / "broken.xml"
    broken.write_text("<mujoco><wordbody/></mujoco>")
    named = {"BALL": ball, "BROKEN": str(broken), "FOLDER": str(tmp_path)}
    status, out, err = call(capsys, *(named.get(arg, arg) for arg in args))
    assert status == 2 and not out
    assert words in err and err.count("\n") == 1
    assert "Traceback" not in err and "Errno" not in err


def test_a_run_that_diverges_is_exit_1(capsys):
    args = ["--horizon", 1, "--set", "integrator=explicit", "--dt", 0.001]
    status, _, err = call(capsys, "run", "lesson:spring", *args)
    assert status == 0, "gains a tenth"
    args[1::4] = 100_000, 10
    status, _, err = call(capsys, "run", "lesson:spring", *args)
    assert status == 1 and "diverged" in err and err.count("\n") == 1


@pytest.mark.parametrize("error", [TypeError("no len()"), KeyError("qpos")])
def test_an_error_of_our_own_is_no_usage_error(capsys, monkeypatch, ball, error):
    def broken(*args, **kwargs):
        raise error

    monkeypatch.setattr("stepcore.engine.sim.Sim.balance", broken)
    status, out, err = call(capsys, "run", ball)
    assert status == 1 and not out and err.count("\n") == 1
    assert f"internal error ({type(error).__name__}: " in err and "--debug" in err
    with pytest.raises(type(error)):
        main(["--debug", "run", ball])


KEYS = """<keyframe><key name="1" qpos="0 0 5 1 0 0 0"/><key qpos="0 0 9 1 0 0 0"/>
<key name="low" qpos="0 0 1 1 0 0 0"/></keyframe></mujoco>"""


@pytest.mark.parametrize(("key", "height"), [("0", 5), ("1", 5), ("2", 1), ("low", 1)])
def test_a_key_is_a_name_or_an_index_where_no_key_has_that_name(capsys, tmp_path, key, height):
    file = tmp_path / "keys.xml"
    file.write_text(BALL.replace("</mujoco>", KEYS))
    status, out, err = call(capsys, "run", file, "--horizon", 0, "--json", "--key", key)
    assert status == 0 and json.loads(out)["qpos"][2] == height, err
    for command in ("plan", "predict"):
        status, _, err = call(capsys, command, file, "--key", key, *SHORT.get(command, ()))
        assert status == 0, err


SHORT = {"predict": ["--horizon", 0.1, "--starts", 1, "--threads", 1]}


@pytest.mark.parametrize("command", COMMANDS)
def test_the_help_of_a_command(capsys, command):
    status, out, err = call(capsys, command, "--help")
    assert status == 0 and not err
    assert out.startswith(f"usage: stepcore {command} ")
    assert f"example:\n  stepcore {command} " in out
    assert "None" not in out and "SUPPRESS" not in out
    choices = next(a.choices for a in parser([command])._actions if a.choices)
    assert all(re.match(r"[\w(\"=]", action.help) for action in choices[command]._actions)


@pytest.mark.parametrize("arguments", [[], ["--help"]])
def test_the_help_names_every_command_and_the_exit_statuses(capsys, arguments):
    status, out, _ = call(capsys, *arguments)
    assert status == 0 and all(command in out for command in COMMANDS)
    assert all(f"{code} " in out.split("exit status: ")[1] for code in (0, 1, 2, 3, 130))


def test_a_run_says_first_what_is_wrong(capsys, ball):
    status, out, _ = call(capsys, "run", ball, "--horizon", 0.2)
    assert status == 0 and out.startswith("ball: 200 ms in 50 steps of 4 ms; ")
    assert out.index("Nothing found: ") < out.index("The motion: ")
    assert "no step was made" in call(capsys, "run", ball, "--horizon", 0)[1]
    status, out, _ = call(capsys, "run", "gymnasium:half_cheetah")
    assert status == 0 and out.index("warning: Contact") < out.index("The motion: ")


def test_a_state_of_many_numbers_is_cut(capsys, tmp_path):
    hinge = '<body pos="0 0 -.1"><joint/><geom size=".01"/>'
    file = tmp_path / "chain.xml"
    file.write_text(f"<mujoco><worldbody>{hinge * 40}{'</body>' * 40}</worldbody></mujoco>")
    status, out, _ = call(capsys, "run", file, "--horizon", 0)
    assert status == 0 and "Not shown: 44 rows (--all" in " ".join(out.split())


def test_a_plot_of_a_run(capsys, tmp_path, ball):
    picture = tmp_path / "energy.svg"
    status, out, _ = call(capsys, "run", ball, "--horizon", 0.2, "--plot", picture)
    assert status == 0 and "50 steps" in out and "<svg" in picture.read_text()
    again = call(capsys, "run", ball, "--horizon", 0.2)[1]
    assert out.partition("\n")[2] == again.partition("\n")[2], "all but the time that it took"


def test_times_and_lengths_take_units(capsys, ball):
    """As --error does: 0.4 s in 2 ms are 200 steps."""
    run = call(capsys, "run", ball, "--horizon", "400ms", "--dt", "2ms", "--json")[1]
    assert json.loads(run)["steps"] == 200
    status, out, err = call(capsys, "run", ball, "--horizon", "8ms", "--set", "dt=4 ms", "--json")
    assert status == 0 and json.loads(out)["steps"] == 2, err
    plain = ["--dts", "0.001:0.01:3", "--deviation", "0.2", "--horizon", "0.1"]
    units = ["--dts", "1ms:10ms:3", "--deviation", "20cm", "--horizon", "100ms"]
    spring = ("lesson:spring", "joint/spring/stiffness", "--values", "10,20", "--threads", 1)
    first, second = (
        call(capsys, "stability-map", *spring, *way, "--json") for way in (plain, units)
    )
    assert first[0] == 0 and first == second


def test_ctrl_c_ends_a_run_and_keeps_what_it_showed(capsys, monkeypatch, ball, tmp_path):
    from stepcore.report.progress import Progress

    advance, calls, save = Progress.advance, [], str(tmp_path / "run.npz")

    def advanced(bar, count=1):
        advance(bar, count)
        calls.append(count)
        if len(calls) == 12:
            # In another thread, while the engine makes the next steps.
            threading.Thread(target=signal.raise_signal, args=(signal.SIGINT,)).start()

    monkeypatch.setattr(Progress, "advance", advanced)
    run = ["run", ball, "--horizon", 4e4, "--save", save, "--record", "qpos", "--json"]
    status, out, _ = call(capsys, *run)
    assert status == 130 and json.loads(out)["success"] is False
    kept, steps = sc.Trajectory.load(save), json.loads(out)["steps"]
    # Up to the last look at the run.
    assert 0.9 * steps < len(kept) <= steps + 1 and np.isfinite(kept["qpos"]).all()


def test_ctrl_c_is_exit_130(capsys, monkeypatch):
    def interrupted(*args, **kwargs):
        raise KeyboardInterrupt

    monkeypatch.setattr("stepcore.cli.arguments.load", interrupted)
    status, _, err = call(capsys, "run", "x", "--horizon", 1)
    assert status == 130 and err.count("\n") == 1


def test_ctrl_c_in_a_measurement_says_what_was_done(capsys, monkeypatch):
    from stepcore.report.progress import Progress

    advance, calls = Progress.advance, []

    def interrupted(bar, count=1):
        calls.append(count)
        advance(bar, count)
        if len(calls) == 2:
            raise KeyboardInterrupt

    monkeypatch.setattr(Progress, "advance", interrupted)
    status, out, err = call(capsys, "predict", "lesson:stack", "--horizon", 0.2, "--threads", 1)
    assert status == 130 and not out
    assert re.fullmatch(r"stepcore: interrupted after 2 of \d+ .*\n", err), err


def test_it_runs_as_a_module(ball):
    command = [sys.executable, "-m", "stepcore", "run", ball, "--horizon", "0.1"]
    done = subprocess.run(command, capture_output=True, text=True, check=False)
    assert done.returncode == 0 and "J kinetic" in done.stdout


def test_the_package_runs_as_a_module_and_tells_its_version():
    command = [sys.executable, "-m", "stepcore", "--version"]
    done = subprocess.run(command, capture_output=True, text=True, check=False)
    assert done.returncode == 0 and done.stdout.startswith("stepcore 0.") and not done.stderr


def test_a_run_is_one_second_by_default(capsys, ball):
    status, out, err = call(capsys, "run", ball, "--json")
    assert status == 0 and not err
    data = json.loads(out)
    assert data["steps"] == 250 and data["notes"] == []


def test_a_run_says_what_it_makes_of_a_duration_between_steps(capsys, ball):
    status, out, _ = call(capsys, "run", ball, "--horizon", 0.0149)
    assert status == 0 and "4 steps" in out
    assert "Note: 0.0149 s is not a whole number of steps of 0.004 s" in out
    assert "the run is 0.016 s long" in " ".join(out.split())
    assert "Note" not in call(capsys, "run", ball, "--horizon", 0.4)[1]


def test_a_run_tells_the_notes_of_its_file(capsys, tmp_path):
    file = tmp_path / "hinge.xml"
    joint = '<joint range="1 -1"/><geom size="1"/>'
    file.write_text(f"<mujoco><worldbody><body>{joint}</body></worldbody></mujoco>")
    status, out, _ = call(capsys, "run", file, "--horizon", 0)
    assert status == 0 and "Note:" in out
    assert "range = 1 -1 is empty: no limit" in " ".join(out.split())


@pytest.mark.parametrize(
    ("name", "content", "words"),
    [
        ("empty.csv", b"", "is empty"),
        ("words.csv", b"1,2\n3,x\n", "'x'"),
        ("ragged.csv", b"1,2\n3\n", "columns"),
        ("empty.npy", b"", ""),
        ("broken.npy", b"no array", ""),
    ],
)
def test_bad_controls_are_one_line_with_the_file(capsys, tmp_path, name, content, words):
    file = tmp_path / name
    file.write_bytes(content)
    status, _, err = call(capsys, "trade", "lesson:grasp", "--ctrl", file)
    assert status == 2 and err.count("\n") == 1
    assert f"{name}: " in err and words in err


def test_a_control_that_raises_is_named(capsys, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr(sys, "path", [*sys.path])
    source = "def grip(time, sim):\n    raise ValueError('boom')\ndef few(time):\n    return 0\n"
    (tmp_path / "my_broken_control.py").write_text(source)
    (tmp_path / "my_broken_module.py").write_text("1 / 0\n")
    args = ["trade", "lesson:grasp", "--horizon", 0.016, "--starts", 1, "--control"]
    status, _, err = call(capsys, *args, "my_broken_control:grip")
    assert status == 1 and err.count("\n") == 1
    assert "my_broken_control:grip: ValueError: boom (my_broken_control.py:2)" in err
    status, _, err = call(capsys, *args, "my_broken_control:few")
    assert (
        status == 2 and "my_broken_control:few: the control function must take (time, sim)" in err
    )
    status, _, err = call(capsys, *args, "my_broken_module:f")
    assert status == 2 and "my_broken_module:f: ZeroDivisionError" in err


def test_the_options_of_a_motion_are_its_fields():
    assert list(OPTIONS) == [field.name for field in dataclasses.fields(sc.Motion)]


@pytest.mark.parametrize(
    ("command", "words"),
    [
        ("predict", "[s] (default: 10.0)"),
        ("trade", "[s] (default: 1.0)"),
        ("converge", "(default: 3)"),
        ("ablate", "(default: 8)"),
    ],
)
def test_the_help_names_the_default_motion(capsys, monkeypatch, command, words):
    monkeypatch.setenv("COLUMNS", "200")
    assert words in call(capsys, command, "--help")[1]


def test_ctrl_c_while_a_command_is_imported_is_exit_130(capsys, monkeypatch):
    def interrupted(name):
        raise KeyboardInterrupt

    monkeypatch.setattr("stepcore.cli.importlib.import_module", interrupted)
    assert call(capsys, "run", "lesson:drop") == (130, "", "stepcore: interrupted\n")
