"""Replay files: any scene bit for bit; a changed byte is refused; saving never hides a failure."""

import json
import warnings
from pathlib import Path

import numpy as np
import pytest
from zoo import ZOO

import stepcore as sc
from stepcore.cli import main
from stepcore.engine import replay as files

# An inline mesh, a height field, a texture, a keyframe, a mocap body, an actuator with a delay.
EVERYTHING = """<mujoco model="all"><option timestep="0.05"/>
<asset><mesh name="m" vertex="0 0 0 .2 0 0 0 .2 0 0 0 .2" scale="1 1 -1"/>
<hfield name="h" nrow="3" ncol="2" size="1 1 .2 .1" elevation="0 .1 .2 .3 .4 .5"/>
<texture name="t" type="2d" builtin="checker" width="8" height="8"/>
<material name="c" texture="t" rgba="1 0 0 1"/></asset>
<worldbody><geom type="hfield" hfield="h" material="c"/>
<body name="ghost" mocap="true" pos="2 0 0"><geom size=".1"/></body>
<body pos="0 0 1"><joint name="j" stiffness="1e7"/><geom type="mesh" mesh="m"/></body>
<body pos="0 0 2"><freejoint/><geom size=".1" material="c"/></body></worldbody>
<actuator><motor name="a" joint="j" delay="0.1" nsample="4"/></actuator>
<keyframe><key qvel="1 0 0 0 0 0 0"/></keyframe>
<custom><text name="stepcore" data="integrator=explicit"/></custom></mujoco>"""


pytestmark = pytest.mark.filterwarnings("ignore::stepcore.StiffnessWarning")


def failure(sim, most=1000):
    with warnings.catch_warnings(), pytest.raises(sc.SimulationError) as caught:
        warnings.simplefilter("ignore")
        sim.step(most)
    return caught.value


def read_back(error, path):
    """The failure from its file, which must be the same scene, state and failure in every bit."""
    error.replay.save(path)
    loaded = sc.Replay.load(path)
    assert loaded == error.replay
    assert loaded.to_json() == error.replay.to_json()
    again, other = sc.replay(path), error.replay.run()
    assert again.same and other.same
    assert again.energy.tobytes() == other.energy.tobytes()
    return loaded


def test_a_scene_with_everything_is_read_back(tmp_path):
    sim = sc.Sim(sc.loads(EVERYTHING), ledger=True)
    sim.reset(0)
    sim.ctrl[:] = 0.5
    loaded = read_back(failure(sim), tmp_path / "all.json")
    mine, its = (s["meshes"][0]["vertices"] for s in (sim.model.scene.to_dict(), loaded.scene))
    assert mine.dtype == its.dtype and np.array_equal(mine, its)


@pytest.mark.parametrize("name", ZOO)
def test_every_scene_of_the_zoo_is_read_back(name, tmp_path):
    sim = sc.Sim(sc.loads(ZOO[name].text))
    if not sim.model.nv:
        return
    sim.step(3)
    sim.qfrc_applied[:] = 1e308
    sim.qvel[:] = 1e250
    read_back(failure(sim), tmp_path / "zoo.json")


@pytest.fixture(scope="module")
def real():
    sim = sc.Sim(sc.loads(EVERYTHING), ledger=True)
    sim.reset(0)
    return failure(sim).replay.to_json()


def test_a_changed_byte_is_refused(real, tmp_path):
    path, data = tmp_path / "changed.json", real.encode() + b"\n"
    path.write_bytes(data)
    sc.Replay.load(path)
    for at in np.random.default_rng(0).integers(len(data), size=100):
        path.write_bytes(data[:at] + bytes([data[at] ^ 1]) + data[at + 1 :])
        with pytest.raises(ValueError, match=r"changed\.json: [^\n]+\Z"):
            sc.Replay.load(path)


@pytest.mark.parametrize(
    ("change", "said"),
    [
        (lambda text: text.replace('"steps": ', '"steps":  '), "was edited or damaged"),
        (lambda text: text.replace('"check"', '"chalk"'), "was edited or damaged"),
        (lambda text: "[" * 100_000, "not a replay file, or incomplete"),
    ],
)
def test_other_files_are_refused(real, change, said, tmp_path):
    path = tmp_path / "other.json"
    path.write_text(change(real))
    with pytest.raises(ValueError, match=said):
        sc.replay(path)


def test_a_file_that_this_build_cannot_run_is_refused(real, tmp_path):
    """Another build wrote it, with a setting that this one does not have."""
    path, data = tmp_path / "other.json", json.loads(real)
    data |= {"check": "", "settings": data["settings"] | {"new": 1}}
    text = json.dumps(data, indent=1)
    check = files._checksum(text.encode())
    path.write_text(text.replace('"check": ""', f'"check": "{check}"', 1))
    with pytest.raises(ValueError, match=r"this replay file cannot be used: .*new"):
        sc.replay(path)


# What is in the way of saving is told after the failure.


@pytest.fixture
def scene(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    (tmp_path / "all.xml").write_text(EVERYTHING)
    return ["run", "all.xml", "--key", "0", "--horizon", "5"]


def test_a_failure_with_a_mesh_is_saved_by_the_command(scene, capsys):
    assert main(scene) == 1
    said = capsys.readouterr().err.splitlines()
    path = said[-1].rpartition(" ")[2]
    assert "diverged in step" in said[-1] and path.endswith(".replay.json")
    assert main(["replay", path]) == 0
    assert "with the same bits" in capsys.readouterr().out


@pytest.mark.parametrize(
    "error", [OSError(28, "No space left on device", "x.json"), TypeError("ndarray"), MemoryError()]
)
def test_what_goes_wrong_in_saving_does_not_hide_the_failure(scene, capsys, monkeypatch, error):
    def fails(*_):
        raise error

    monkeypatch.setattr(sc.Replay, "save", fails)
    monkeypatch.setattr(sc.Trajectory, "save", fails)
    assert main([*scene, "--save", "x.npz"]) == 1
    said = capsys.readouterr().err
    first, _, rest = said.partition("The replay was not saved: ")
    assert "diverged in step" in first and rest.count("Not saved: ") == 1
    assert "Traceback" not in said


@pytest.mark.skipif(not Path("/dev/full").exists(), reason="only Linux has a disk that is full")
def test_a_full_disk_is_told_after_the_failure(scene, capsys):
    assert main([*scene, "--replay", "/dev/full"]) == 1
    said = capsys.readouterr().err
    assert said.endswith("The replay was not saved: /dev/full: No space left on device.\n")
    assert "diverged in step" in said


def test_a_page_that_cannot_be_written_does_not_hide_the_failure(scene, capsys, monkeypatch):
    def full(*_):
        raise OSError(28, "No space left on device", "x.html")

    monkeypatch.setattr(sc.Trajectory, "save_html", full)
    assert main(["view", "all.xml", "--horizon", "5", "--html", "x.html"]) != 0
    said = capsys.readouterr().err.splitlines()
    assert (
        "diverged in step" in said[-2] and said[-1] == "stepcore: x.html: No space left on device"
    )


def test_a_plot_that_cannot_be_written_does_not_hide_the_result(scene, capsys, monkeypatch):
    assert main(scene) == 1
    path = capsys.readouterr().err.rpartition(" ")[2].strip()

    def full(*_):
        raise OSError(28, "No space left on device", "x.png")

    monkeypatch.setattr(sc.PostMortem, "plot", full)
    assert main(["replay", path, "--plot", "x.png"]) == 2
    said = capsys.readouterr()
    assert "with the same bits" in said.out and "No space left on device" in said.err
