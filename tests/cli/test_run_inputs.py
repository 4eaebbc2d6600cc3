"""`stepcore run` under controls and pushes: velocities against momentum, F Δt = m Δv."""

import json
import sys

import numpy as np
import pytest

from stepcore.cli import main

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
        (["--ctrl", "c=1"], "no actuator is named 'c'"),
        (["--ctrl", "a=1,2"], "'2' must be NAME=VALUE"),
        (["--ctrl", "1,2", "--control", "m:f"], "both given"),
        (["--ctrl", "none.csv"], "no such file"),
        (["--control", "none.py:f"], "none.py: no such file"),
        (["--control", "none"], "FILE.py:FUNCTION"),
        (["--control-dt", "0.015"], "whole number of steps"),
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


def test_a_run_says_what_it_showed(capsys, carts):
    """A control of 30 in a range of ±10."""
    assert main(["run", carts, "--ctrl", "b=30"]) == 0
    said = capsys.readouterr().out
    assert "warning: The control of motor `b` is clamped for 100 % of the run" in said
    assert main(["run", carts, "--ctrl", "b=30", "--json"]) == 0
    (finding,) = json.loads(capsys.readouterr().out)["findings"]
    assert finding["kind"] == "clamped control" and finding["element"] == "motor `b`"
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
        (["--ctrl", "b=3"], "motors hold --ctrl b=3"),
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


def test_a_control_of_the_wrong_length_is_named(capsys, carts, tmp_path):
    file = tmp_path / "short.py"
    file.write_text("def short(time, sim):\n    return [time]\n")
    assert main(["run", carts, "--control", f"{file}:short"]) == 2
    assert "must return 2 finite numbers" in capsys.readouterr().err
