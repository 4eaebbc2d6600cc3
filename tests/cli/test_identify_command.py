"""stepcore identify: values in files, from the command line."""

import json

import numpy as np
import pytest

import stepcore as sc
from stepcore.cli import main

pytest.importorskip("scipy")
SWING = """<mujoco model="swing"><option timestep="0.005"/><worldbody>
<body name="bob"><joint name="hinge" axis="0 1 0" damping="{}"/>
<geom type="capsule" size=".02" fromto="0 0 0 .3 0 0" mass="1"/></body></worldbody>
<actuator><motor name="drive" joint="hinge"/></actuator></mujoco>"""
WANTED = "joint/hinge/damping=0.01:2"


@pytest.fixture(autouse=True)
def folder(tmp_path, monkeypatch):
    """The model, and a log of one with another damping."""
    monkeypatch.chdir(tmp_path)
    (tmp_path / "swing.xml").write_text(SWING.format(0.1))
    ctrl = 0.5 * np.sin(np.arange(200) / 20)[:, None]
    sim = sc.Sim(sc.loads(SWING.format(0.3)))
    sim.run(1.0, control=ctrl, record=("qpos", "qvel", "ctrl")).save("log.csv")
    return tmp_path


def test_values_and_the_model_with_them(capsys):
    command = ["identify", "swing.xml", "log.csv", "--parameters", WANTED]
    assert main([*command, "--save", "found.xml", "--json"]) == 0
    said = json.loads(capsys.readouterr().out)
    assert said["kind"] == "identification"
    assert said["values"]["joint/hinge/damping"] == pytest.approx(0.3, rel=1e-9)
    assert sc.load("found.xml").joint("hinge").damping == pytest.approx(0.3, rel=1e-9)
    assert main(command) == 0
    out = capsys.readouterr().out
    fit = "The model explains the log to within its noise."
    assert out.startswith(f"swing: 1 value from 1 log\n\n{fit}\njoint/hinge/damping = 0.3 (95 %: ")


def test_several_logs_parameters_and_sources(capsys):
    apart = "qpos=log.csv,ctrl=log.csv"
    parameters = [WANTED, "body/bob/mass=0.2:5", "delay=0:0.05"]
    command = ["identify", "swing.xml", "log.csv", apart, "--parameters", *parameters]
    more = ["--pieces", "0.5s", "--threads", "1", "--seconds", "inf"]
    assert main([*command, *more, "--json", "--plot", "found.svg"]) == 0
    said = json.loads(capsys.readouterr().out)
    assert said["values"]["body/bob/mass"] == pytest.approx(1.0, rel=1e-6)
    assert said["values"]["delay"] == pytest.approx(0.0, abs=1e-9)


@pytest.mark.parametrize(
    "arguments, said",
    [
        (["log.csv"], "the following arguments are required: --parameters"),
        (["log.csv", "--parameters", "joint/hinge/damping"], "must be PATH=LOW:HIGH"),
        (["log.csv", "--parameters", "joint/hinge/damping=1"], "must be PATH=LOW:HIGH"),
        (["log.csv", "--parameters", "joint/hing/damping=.01:1"], 'no joint is named "hing"'),
        (["none.csv", "--parameters", WANTED], "none.csv"),
        (["swing.xml", "--parameters", WANTED], "must end in .csv"),
    ],
)
def test_what_cannot_be_read_is_a_usage_error(capsys, arguments, said):
    assert main(["identify", "swing.xml", *arguments]) == 2
    err = capsys.readouterr().err
    assert said in err and err.count("\n") == 1
