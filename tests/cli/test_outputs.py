"""Outputs of commands: they never replace an input, nor a file that stepcore did not write."""

import json
import os

import pytest
from small import ball

import stepcore as sc
from stepcore.cli import main
from stepcore.report.outputs import is_replaceable

MODEL = """<mujoco model="one"><include file="part.xml"/>
<asset><mesh name="m" file="m.obj"/></asset>
<worldbody><body pos="0 0 1"><joint type="slide" axis="0 0 1"/><geom type="mesh" mesh="m"/></body>
</worldbody></mujoco>"""
PART = "<mujoco><option timestep='0.01'/></mujoco>"
MESH = "v 0 0 0\nv 1 0 0\nv 0 1 0\nv 0 0 1\nf 1 3 2\nf 1 2 4\nf 1 4 3\nf 2 3 4\n"
FILES = {"model.xml": MODEL, "part.xml": PART, "m.obj": MESH, "notes.txt": "mine", "k.npy": "k"}
CONTROL = "def held(time, sim):\n    return []\n"
SHORT = ("--horizon", "0.05")


@pytest.fixture(autouse=True)
def folder(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    for name, text in FILES.items():
        (tmp_path / name).write_text(text)
    (tmp_path / "control.py").write_text(CONTROL)
    (tmp_path / "link.xml").symlink_to("model.xml")
    os.link(tmp_path / "model.xml", tmp_path / "hard.xml")
    return tmp_path


def kept(folder):
    assert all((folder / name).read_text() == text for name, text in FILES.items())
    assert (folder / "control.py").read_text() == CONTROL


@pytest.mark.parametrize("force", [(), ("--force",)])
@pytest.mark.parametrize(
    "command",
    [
        ["check", "model.xml", "--html", "model.xml"],
        ["check", "model.xml", "--html", "./link.xml"],
        ["check", "link.xml", "--json", "hard.xml"],
        ["check", "model.xml", "--html", "part.xml"],
        ["check", "model.xml", "--html", "m.obj"],
        ["trade", "model.xml", "--json", "model.xml"],
        ["ablate", "model.xml", "--save", "model.xml"],
        ["run", "model.xml", "--replay", "model.xml"],
        ["run", "model.xml", "--control", "control.py:held", "--replay", "control.py"],
        ["run", "model.xml", "--ctrl", "k.npy", "--replay", "k.npy"],
        ["identify", "model.xml", "k.npy", "--parameters", "a=1:2", "--save", "k.npy"],
        ["view", "model.xml", "--html", "model.xml"],
    ],
    ids=" ".join,
)
def test_an_input_is_never_replaced(folder, capsys, command, force):
    assert main([*command, *force]) == 2
    said = capsys.readouterr().err
    assert said.count("\n") == 1
    assert force == () or "read by this command" in said or "output of this command" in said
    kept(folder)


@pytest.mark.parametrize(
    "command",
    [
        ["check", "model.xml", "--html", "notes.txt"],
        ["check", "model.xml", "--json", "notes.txt"],
        ["run", "model.xml", "--replay", "notes.txt"],
        ["view", "model.xml", "--html", "notes.txt"],
    ],
    ids=" ".join,
)
def test_a_file_that_stepcore_did_not_write_is_kept(folder, capsys, command):
    assert main(command) == 2
    assert "is no earlier output of stepcore; --force replaces it" in capsys.readouterr().err
    kept(folder)


def test_force_replaces_it(folder):
    assert main(["check", "model.xml", "--html", "notes.txt", "--force"]) == 0
    assert (folder / "notes.txt").read_text().startswith("<!doctype html>")


@pytest.mark.parametrize(
    "command",
    [
        *(["check", "model.xml", "--plot", f"a.{ending}"] for ending in ("png", "svg", "pdf")),
        ["check", "model.xml", "--html", "a.html", "--json", "a.json"],
        ["run", "model.xml", *SHORT, "--save", "a.npz", "--plot", "a.png"],
        ["run", "model.xml", *SHORT, "--save", "a.mcap"],
        ["run", "model.xml", *SHORT, "--save", "a.html"],
        ["view", "model.xml", *SHORT, "--html", "a.html"],
    ],
    ids=" ".join,
)
def test_an_earlier_output_is_replaced(folder, command):
    assert main(command) == 0
    outputs = [name for name in os.listdir(folder) if name.startswith("a.")]
    assert outputs and all(is_replaceable(name) for name in outputs)
    assert main(command) == 0


@pytest.mark.parametrize("name", FILES)
def test_other_files_are_known_as_such(name):
    assert not is_replaceable(name)


def test_what_no_regular_file_is_can_be_written_to(capsys):
    assert main(["check", "model.xml", "--json", "/dev/null"]) == 0


def test_two_outputs_are_two_files(capsys):
    assert main(["check", "model.xml", "--html", "a.x", "--json", "./a.x"]) == 2
    assert "the same file" in capsys.readouterr().err


def test_a_replay_file_is_an_earlier_output_and_an_input(folder, capsys):
    sim = sc.Sim(ball(), ledger=True)
    sim.qfrc_applied[:] = 1e300
    with pytest.raises(sc.SimulationError) as caught:
        sim.step(50)
    caught.value.replay.save("b.json")
    assert is_replaceable("b.json")
    assert main(["replay", "b.json", "--json", "b.json"]) == 2
    assert "is read by this command" in capsys.readouterr().err
    assert json.loads((folder / "b.json").read_text())["kind"] == "stepcore replay"


def test_a_failure_finds_a_name_that_is_free(folder, capsys):
    (folder / "spring-step64.replay.json").write_text("mine")
    run = ["run", "lesson:spring", "--dt", "0.205", "--horizon", "100"]
    assert main([*run, "--set", "integrator=semi-implicit"]) == 1
    assert "stepcore replay spring-step64-new.replay.json" in capsys.readouterr().err
    assert (folder / "spring-step64.replay.json").read_text() == "mine"
