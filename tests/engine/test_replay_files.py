"""Replay files: any scene bit for bit; any content, or one line; never in the way of a failure."""

import copy
import json
import warnings
from pathlib import Path

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
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
    return json.loads(failure(sim).replay.to_json())


def forged(data):
    """The text of a file whose checksum is right."""
    body = {name: value for name, value in data.items() if name not in ("kind", "version", "check")}
    return json.dumps(data | {"check": files._check(body)})


def used(path):
    """What comes of a file: a post-mortem that can be printed, or one line that says why not."""
    try:
        again = sc.replay(path)
    except ValueError as error:
        text = str(error)
        assert str(path) in text and "cannot be used: " in text
        assert "\n" not in text and len(text) < 1500
        return text
    assert again.text(full=True) and again.to_json()
    return ""


@pytest.mark.parametrize(
    ("change", "said"),
    [
        ({"happened": {}}, "happened.step: missing"),
        ({"happened": {"element": 3}}, "happened.step: missing"),
        ({"steps": 10**12}, "steps = 1000000000000: must be a whole number from 0 to 100000"),
        ({"steps": -1}, "steps = -1: must be"),
        ({"steps": True}, "steps = True: must be"),
        ({"name": 3}, "name = 3: must be a string"),
        ({"state": "ä"}, "state = 'ä': must be base64"),
        ({"state": ""}, "state"),
        ({"scene": {}}, "missing"),
        ({"settings": {"dt": -1}}, "dt"),
        ({"settings": {"tolerence": 1}}, "tolerence"),
        ({"inputs": 3}, "inputs = 3: must be a list"),
        ({"inputs": [[0]]}, "inputs[0] = [0]: must be a list of 7 entries"),
        ({"inputs": [[0, [1, 2], [], [], [], [], []]]}, "an input of ctrl has 2 numbers"),
        ({"inputs": [[0, [None], [], [], [], [], []]]}, "inputs[0][1] = [None]: must be"),
        ({"more": 1}, "more: no such field"),
    ],
    ids=str,
)
def test_a_forged_file_is_refused_by_the_field_that_is_wrong(real, change, said, tmp_path):
    path = tmp_path / "forged.json"
    path.write_text(forged(real | change))
    assert said in used(path)


@pytest.mark.parametrize(
    "wrong",
    [
        *({"element": "x", "step": [], "shares": 1.5}, {"time": "x"}, {"share_ids": []}),
        *({"state": 1}, {"element_id": [1, 2, 3]}, {"growth": 10**400}, {"gained": 1}, {"more": 1}),
    ],
    ids=str,
)
def test_what_happened_is_checked_field_by_field(real, wrong, tmp_path):
    path = tmp_path / "forged.json"
    path.write_text(forged(real | {"happened": real["happened"] | wrong}))
    assert "happened." in used(path)


@pytest.mark.parametrize(
    "array", [3, [], ["<f8", [1], "AAAA"], ["O", [1], ""], ["<f8", [-1, 0], ""], ["<f8", "x", ""]]
)
def test_an_array_that_is_none(real, array, tmp_path):
    path = tmp_path / "forged.json"
    scene = real["scene"] | {
        "meshes": [real["scene"]["meshes"][0] | {"vertices": {"array": array}}]
    }
    path.write_text(forged(real | {"scene": scene}))
    assert used(path)


JUNK = st.one_of(
    *(st.none(), st.booleans(), st.integers(), st.floats(), st.text(max_size=5), st.just([])),
    *(st.just({}), st.just(10**400), st.just([[]]), st.just({"array": ["<f8", [2], "AA=="]})),
)


@st.composite
def mutations(draw):
    """Where to go in the data, by fractions, and what to do there."""
    path = draw(st.lists(st.floats(0, 1, exclude_max=True), min_size=1, max_size=6))
    return path, draw(st.sampled_from(["put", "drop", "double"])), draw(JUNK)


def mutated(data, path, how, junk):
    at = data
    for depth, part in enumerate(path):
        keys = list(at) if isinstance(at, dict) else range(len(at))
        key = keys[int(part * len(keys))]
        below = at[key]
        if depth + 1 < len(path) and isinstance(below, (dict, list)) and below:
            at = below
            continue
        if how == "put":
            at[key] = copy.deepcopy(junk)
        elif how == "drop":
            del at[key]
        elif isinstance(at, list):
            at.append(copy.deepcopy(below))
        return


@settings(
    max_examples=150,
    deadline=None,
    derandomize=True,
    suppress_health_check=[HealthCheck.function_scoped_fixture],
)
@given(st.lists(mutations(), min_size=1, max_size=3))
def test_mutations_of_a_real_file(real, tmp_path, changes):
    data = json.loads(json.dumps(real))
    for change in changes:
        mutated(data, *change)
    data |= {"kind": files.KIND, "version": files.VERSION}
    path = tmp_path / "mutated.json"
    path.write_text(forged(data))
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        used(path)


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
