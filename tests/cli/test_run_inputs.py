"""`stepcore run` under controls and pushes: velocities against momentum, F Δt = m Δv."""

import json
import sys

import numpy as np
import pytest

import stepcore as sc
from stepcore.cli import main
from stepcore.experiment.schedule import scheduled

# Two carts of 2 and 4 kg, each with a motor, nothing else: a step of semi-implicit Euler changes a
# velocity by F dt / m exactly, whatever the position.
CARTS = """<mujoco model="carts"><option timestep="0.01" gravity="0 0 0"/><worldbody>
<body name="light"><joint name="x" type="slide" axis="1 0 0"/><geom size=".1" mass="2"/></body>
<body name="heavy" pos="0 1 0"><joint name="y" type="slide" axis="1 0 0"/>
<geom size=".1" mass="4"/></body></worldbody>
<actuator><motor name="a" joint="x"/><motor name="b" joint="y" ctrlrange="-10 10"/></actuator>
</mujoco>"""


@pytest.fixture
def carts(tmp_path):
    file = tmp_path / "carts.xml"
    file.write_text(CARTS)
    return str(file)


def velocities(capsys, file, *args):
    status = main(["run", file, "--json", *map(str, args)])
    said = capsys.readouterr()
    assert status == 0, said.err
    return json.loads(said.out)["qvel"]


@pytest.mark.parametrize(("package", "ending"), [("mcap", ".mcap"), ("trimesh", ".html")])
def test_a_missing_extra_is_named_before_the_run(capsys, monkeypatch, tmp_path, package, ending):
    monkeypatch.setitem(sys.modules, package, None)
    out = str(tmp_path / f"run{ending}")
    commands = [["run", "lesson:drop", "--horizon", "1e9", "--save", out]]
    if ending == ".html":
        commands.append(["view", "lesson:drop", "--horizon", "1e9", "--html", out])
    for command in commands:
        assert main(command) == 1
        err = capsys.readouterr().err
        assert f"{out} needs {package}: pip install 'stepcore[" in err


@pytest.mark.parametrize("ctrl", ["3,-8", "b=-8,a=3", " a = 3 , b = -8"])
def test_constant_controls(capsys, carts, ctrl):
    assert velocities(capsys, carts, "--ctrl", ctrl) == pytest.approx([1.5, -2.0], abs=1e-12)


def test_an_actuator_that_is_not_named_keeps_its_control(capsys, carts):
    assert velocities(capsys, carts, "--ctrl", "b=4") == pytest.approx([0.0, 1.0], abs=1e-12)


def test_controls_of_a_file_are_held_for_their_period(capsys, carts, tmp_path):
    """0.3 s of 2 N, then 1 N to the end of 1 s: (0.6 + 0.7) N·s."""
    np.savetxt(tmp_path / "u.csv", [[2.0, 0.0], [1.0, 0.0]], delimiter=",")
    args = ["--ctrl", tmp_path / "u.csv", "--control-dt", 0.3]
    assert velocities(capsys, carts, *args) == pytest.approx([1.3 / 2, 0.0], abs=1e-12)


@pytest.mark.parametrize("joints", [False, True])
def test_a_log_with_names_and_times_drives_a_run_and_a_measurement(capsys, carts, tmp_path, joints):
    """0.3 s of 2 N from the log's first time on, then 1 N; in any order of columns."""
    names = "time,x" if joints else "t [s],a"
    (tmp_path / "log.csv").write_text(f"{names}\n5.0,2\n5.3,1\n")
    args = ["--ctrl", tmp_path / "log.csv"]
    assert velocities(capsys, carts, *args) == pytest.approx([1.3 / 2, 0.0], abs=1e-12)
    options = ["--horizon", "0.6", "--threads", "1", "--json"]
    assert main(["converge", carts, *map(str, args), *options]) == 0
    data = json.loads(capsys.readouterr().out)
    assert "motors driven by log.csv (300 ms at 3.333 Hz: control of a)" in data["ran"]


def test_a_measurement_takes_constant_controls_and_a_motion_by_name(capsys, carts):
    options = ["--horizon", "0.1", "--threads", "1", "--json"]
    said = {
        ("--ctrl", "b=4"): "motors hold b=4",
        ("--motion", "sines"): "test motion: random sines",
        ("--motion", "move"): "a PD controller drives the joints point to point",
        ("--motion", "hold"): "a PD controller holds the start",
        ("--motion", "random"): "motors get new random controls within their range every",
        ("--motion", "fall"): "motors are held at zero",
    }
    for given, words in said.items():
        assert main(["converge", carts, *given, *options]) == 0
        assert words in json.loads(capsys.readouterr().out)["ran"]
    assert main(["converge", carts, "--ctrl", "sines"]) == 2
    assert "--ctrl sines: write --motion sines" in capsys.readouterr().err
    assert main(["converge", carts, "--ctrl", "b=4", "--motion", "hold"]) == 2
    assert "argument --motion: not allowed with argument --ctrl" in capsys.readouterr().err


def test_a_column_without_an_actuator_names_the_nearest(capsys, tmp_path, carts):
    (tmp_path / "log.csv").write_text("time,lihgt\n0,1\n")
    assert main(["run", carts, "--ctrl", str(tmp_path / "log.csv")]) == 2
    assert 'no actuator is named "lihgt"' in capsys.readouterr().err


@pytest.mark.parametrize("period", [None, 0.05])
def test_a_function_in_a_file_is_called_every_period(capsys, carts, tmp_path, period):
    """F = t: the sum over the calls of t dt, with a file whose name a module of Python has."""
    (tmp_path / "json.py").write_text("def ramp(time, sim):\n    return [time, 0.0]\n")
    args = [] if period is None else ["--control-dt", period]
    dt = period or 0.01
    n = round(1 / dt)
    moved = velocities(capsys, carts, "--control", f"{tmp_path / 'json.py'}:ramp", *args)
    assert moved == pytest.approx([dt * dt * n * (n - 1) / 2 / 2, 0.0], abs=1e-12)
    assert sys.modules["json"] is json


def test_a_function_sees_the_state(capsys, carts, tmp_path):
    """v' = −(v − 1) c / m in steps: 1 − v falls by 1 − c dt/m a step."""
    code = "def cruise(time, sim):\n    return [10 * (1 - sim.qvel[0]), 0]\n"
    (tmp_path / "cruise.py").write_text(code)
    moved = velocities(capsys, carts, "--control", f"{tmp_path / 'cruise.py'}:cruise")
    assert moved[0] == pytest.approx(1 - (1 - 10 * 0.01 / 2) ** 100, abs=1e-12)


def test_pushes_are_impulses(capsys, carts):
    """6 N for 0.1 s (the default) on 2 kg, −8 N for 0.25 s on 4 kg, both after one another too."""
    one = ["--push", "light:6,0,0@0.5"]
    two = ["--push", "heavy:-8,100,0@0+0.25"]
    assert velocities(capsys, carts, *one) == pytest.approx([0.3, 0.0], abs=1e-12)
    assert velocities(capsys, carts, *one, *two) == pytest.approx([0.3, -0.5], abs=1e-12)
    again = ["--push", "light:1,0,0@0.55+0.2"]
    assert velocities(capsys, carts, *one, *again) == pytest.approx([0.4, 0.0], abs=1e-12)
    late = ["--push", "light:1,0,0@1.5"]
    assert velocities(capsys, carts, *late) == [0.0, 0.0]


def test_a_push_and_a_plot_leave_the_steps_as_they_are(capsys, carts, tmp_path):
    args = ["--ctrl", "3,-8", "--push", "light:6,0,0@0.305+0.111"]
    plain = velocities(capsys, carts, *args)
    assert velocities(capsys, carts, *args, "--plot", tmp_path / "p.png") == plain
    assert (tmp_path / "p.png").stat().st_size > 0


@pytest.mark.parametrize(
    ("args", "words"),
    [
        (["--ctrl", "1"], "must be 2 numbers, one for each actuator"),
        (["--ctrl", "1,x"], "'x' must be a finite number"),
        (["--ctrl", "1,inf"], "'inf' must be a finite number"),
        (["--ctrl", "c=1"], 'no actuator is named "c"'),
        (["--ctrl", "a=1,2"], "'2' must be NAME=VALUE"),
        (["--ctrl", "1,2", "--control", "m:f"], "not allowed with argument --ctrl"),
        (["--ctrl", "none.csv"], "no such file"),
        (["--control", "none.py:f"], "none.py: no such file"),
        (["--control", "none"], "FILE.py:FUNCTION"),
        (["--control-dt", "0.015"], "whole number of steps"),
        (["--save", "run.txt"], "must end in .npz, .csv, .mcap, .html"),
        (["--save", "no/such/run.npz"], "no such folder"),
        (["--record", "qpos"], "--record is what --plot and --save have"),
        (["--plot", "p.png", "--record", "qpso"], 'nearest: "qpos"'),
        (["--push", "light:1,2@0"], "BODY:FX,FY,FZ@T"),
        (["--push", "light:1,2,3"], "BODY:FX,FY,FZ@T"),
        (["--push", "world:1,2,3@0"], "no body is named 'world'"),
        (["--push", "lihgt:1,2,3@0"], 'nearest: "light"'),
        (["--push", "light:1,2,3@-1"], "times must be >= 0"),
        (["--push", "light:1,2,nan@0"], "'nan' must be a finite number"),
    ],
)
def test_a_bad_input_is_one_line(capsys, carts, args, words):
    assert main(["run", carts, *args]) == 2
    said = capsys.readouterr()
    assert words in said.err and said.err.count("\n") == 1 and not said.out


def test_a_run_says_what_it_showed(capsys, tmp_path, carts):
    """A servo of 4 N on a cart of 4 kg that is asked for 1 m is at its end all the time."""
    weak, motor = tmp_path / "weak.xml", '<motor name="b" joint="y" ctrlrange="-10 10"/>'
    servo = '<position name="b" joint="y" kp="100" kv="1" forcerange="-4 4"/>'
    weak.write_text(CARTS.replace(motor, servo))
    assert main(["run", str(weak), "--ctrl", "b=1"]) == 0
    said = " ".join(capsys.readouterr().out.split())
    assert "warning: Servo `b` is at the end of its forcerange (4 N) for 100 % of the run" in said
    assert main(["run", str(weak), "--ctrl", "b=1", "--json"]) == 0
    (finding,) = json.loads(capsys.readouterr().out)["findings"]
    assert finding["kind"] == "saturation" and finding["element"] == "servo `b`"
    assert main(["run", carts, "--ctrl", "b=3"]) == 0
    assert "warning" not in capsys.readouterr().out


def test_a_run_that_fails_says_how_it_began(capsys, tmp_path, monkeypatch):
    """Two balls in each other, under a penalty that is too stiff for the step."""
    monkeypatch.chdir(tmp_path)
    (tmp_path / "two.xml").write_text(
        """<mujoco><option timestep=".01" gravity="0 0 0"/><worldbody><body><freejoint/>
        <geom name="a" size=".1"/></body><body pos=".15 0 0"><freejoint/><geom name="b" size=".1"/>
        </body></worldbody></mujoco>"""
    )
    stiff = ["--set", "law=penalty", "--set", "penalty_stiffness=1e12"]
    status = main(["run", "two.xml", "--set", "integrator=explicit", *stiff])
    said = capsys.readouterr()
    assert status == 1 and said.err.count("\n") == 1
    assert "Geoms `a` and `b` overlap by 50 mm at the start" in said.err
    assert said.err.strip().endswith(".replay.json")


@pytest.mark.parametrize(
    ("args", "said"),
    [
        ([], "1 s from the pose of the scene; motors are held at zero; law solref"),
        (["--ctrl", "b=3"], "motors hold b=3"),
        (
            ["--control", "FILE:ramp"],
            "driven by the control function `ramp` of my_ramp.py, sampled every 10 ms",
        ),
        (["--push", "light:1,0,0@0.5"], "push light:1,0,0@0.5"),
    ],
)
def test_a_run_says_what_was_run(capsys, carts, tmp_path, args, said):
    file = tmp_path / "my_ramp.py"
    file.write_text("def ramp(time, sim):\n    return [time, 0.0]\n")
    assert main(["run", carts, *(arg.replace("FILE", str(file)) for arg in args)]) == 0
    assert said in " ".join(capsys.readouterr().out.split())


def test_sines_are_the_controls_of_a_measurement(capsys, carts, tmp_path):
    """Those that a measurement of one start with seed 0 and this period runs; 0 without a range."""
    model = sc.load(carts).compile()
    motion = sc.Motion(horizon=0.2, starts=1, kind="sines")
    (rows,) = scheduled(motion, model, 0.02).ctrl
    assert rows[:, 0] == pytest.approx(0) and np.ptp(rows[:, 1]) > 1
    # An impulse each period: m Δv = Σ F Δt.
    expected = 0.02 * rows.sum(axis=0) / (2, 4)
    options = ("--motion", "sines", "--control-dt", 0.02, "--horizon", 0.2)
    assert velocities(capsys, carts, *options) == pytest.approx(expected, abs=1e-12)
    assert main(["run", carts, "--motion", "sines"]) == 0
    said = " ".join(capsys.readouterr().out.split())
    assert (
        "random sines of 0.3 to 3 Hz, ±40 % of the control range, as policies look; a without"
        in said
    )


def test_a_run_is_saved(capsys, carts, tmp_path):
    run = tmp_path / "run.npz"
    assert main(["run", carts, "--horizon", "0.5", "--ctrl", "3,-8", "--save", str(run)]) == 0
    saved = sc.Trajectory.load(run)
    assert list(saved.data) == ["qpos", "qvel", "ctrl", "energy", "overlap"]
    assert saved.qvel[-1] == pytest.approx([0.75, -1.0], abs=1e-12) and len(saved) == 51
    assert saved.axes("ctrl")[0].entries == ("a", "b")
    options = ["--horizon", "0.1", "--record", "qpos, ctrl", "--save"]
    assert main(["run", carts, *options, str(run)]) == 0
    assert list(sc.Trajectory.load(run).data) == ["qpos", "ctrl"]
    for name in ("run.mcap", "run.html"):
        assert main(["run", carts, *options, str(tmp_path / name)]) == 0
        assert (tmp_path / name).stat().st_size > 1000
    capsys.readouterr()


def test_a_run_that_fails_is_saved_until_then(capsys, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    options = ["--horizon", "10000", "--dt", "0.205", "--set", "integrator=semi-implicit"]
    assert main(["run", "lesson:spring", *options, "--save", "run.npz"]) == 1
    assert "stepcore replay " in capsys.readouterr().err
    saved = sc.Trajectory.load("run.npz")
    assert 10 < len(saved) < 1000 and np.isfinite(saved.qpos).all()


def test_a_control_of_the_wrong_length_is_named(capsys, carts, tmp_path):
    file = tmp_path / "short.py"
    file.write_text("def short(time, sim):\n    return [time]\n")
    assert main(["run", carts, "--control", f"{file}:short"]) == 2
    assert "must return 2 finite numbers" in capsys.readouterr().err


def test_a_control_of_other_arguments_is_named(capsys, carts, tmp_path):
    file = tmp_path / "one.py"
    file.write_text("def one(sim):\n    return [0, 0]\n")
    for command in ("run", "diagnose"):
        assert main([command, carts, "--control", f"{file}:one"]) == 2
        assert "the control function must take (time, sim)" in capsys.readouterr().err


def test_an_actuator_without_a_name_has_that_of_its_joint(capsys):
    assert main(["run", "gymnasium:hopper", "--ctrl", "thigh_joint=1"]) == 0
    assert main(["run", "gymnasium:hopper", "--ctrl", "thigh=1"]) == 2
    assert 'no actuator is named "thigh"; nearest: "thigh_joint"' in capsys.readouterr().err


@pytest.mark.parametrize(
    ("motors", "ctrl", "text"),
    [
        (0, "1", "--ctrl 1: this model has no actuators"),
        (0, "a=1", "--ctrl a=1: this model has no actuators"),
        (1, "a=1", 'no actuator is named "a"'),
        (1, "1,2", "must be 1 number, one for each actuator"),
    ],
)
def test_controls_are_counted(motors, ctrl, text, capsys, tmp_path):
    file = tmp_path / "model.xml"
    file.write_text(
        f"""<mujoco><worldbody><body><joint name="j"/><geom size="1"/></body></worldbody>
        <actuator>{'<motor joint="j"/>' * motors}</actuator></mujoco>"""
    )
    assert main(["run", str(file), "--ctrl", ctrl]) == 2
    assert text in capsys.readouterr().err


def test_a_run_saved_as_a_table_is_played_again(capsys, carts, tmp_path):
    """Controls of each step, by actuator, to all digits; by `run`, by a Motion and by `check`."""
    (tmp_path / "wave.py").write_text(
        "import math\ndef wave(time, sim):\n    return [math.sin(9 * time), time]\n"
    )
    log, options = tmp_path / "log.csv", ["--horizon", "200ms"]
    given = ["--control", f"{tmp_path / 'wave.py'}:wave", *options]
    assert main(["run", carts, *given, "--save", str(log)]) == 0
    capsys.readouterr()
    expected = velocities(capsys, carts, *given)
    assert velocities(capsys, carts, "--ctrl", log, *options) == expected
    data = sc.run(carts, horizon="200ms", ctrl=log)
    assert (
        data.sim.qvel.tolist() == expected
        and "(200 ms at 100 Hz: position and velocity of x, y; control of a, b)" in data.ran
    )
    assert main(["check", carts, "--ctrl", str(log), *options, "--threads", "1"]) == 0


@pytest.mark.parametrize("way", ["held", "linear"])
def test_a_log_at_any_rate_drives_a_run(capsys, carts, tmp_path, way):
    """40 Hz at 10 ms: v = ∫u dt / m, whatever divides what."""
    times = np.arange(41) / 40
    rows = np.column_stack([times, np.cos(3 * times)])
    np.savetxt(tmp_path / "log.csv", rows, delimiter=",", header="time,a", comments="")
    moved = velocities(capsys, carts, "--ctrl", tmp_path / "log.csv", "--interpolation", way)
    held = rows[:-1, 1].sum() / 40
    lines = (rows[:-1, 1] + rows[1:, 1]).sum() / 80
    assert moved[0] == pytest.approx((held if way == "held" else lines) / 2, abs=1e-9)


def test_a_run_lasts_as_long_as_its_log(capsys, carts, tmp_path):
    (tmp_path / "log.csv").write_text("t,a\n3,1\n4.5,2\n")
    assert main(["run", carts, "--ctrl", str(tmp_path / "log.csv")]) == 0
    assert "1.5 s in 150 steps" in capsys.readouterr().out
    assert sc.run(carts, ctrl=tmp_path / "log.csv").steps == 150
