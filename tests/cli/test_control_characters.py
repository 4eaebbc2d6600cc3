"""Names of models and files cannot command a terminal: control characters become their codes."""

import json
import re
import subprocess
import sys
import warnings

import pytest

import stepcore as sc
from stepcore.cli import main
from stepcore.escapes import printable
from stepcore.report.progress import Progress

# C1 that XML allows, DEL, and characters that turn the direction of writing.
BAD = "\x9b31m\x9d0;x\x9c\x7f\u202eabc\u2066\u2028"
RAW = re.compile("[\x00-\x08\x0b-\x1f\x7f-\x9f\u061c\u200e\u200f\u2028-\u202e\u2066-\u2069]")
MODEL = f"""<mujoco model="m{BAD}"><option timestep="0.05"/><worldbody>
<geom name="f{BAD}" type="plane" size="1 1 1"/>
<body name="b{BAD}" pos="0 0 0.05"><joint name="j{BAD}" type="slide" axis="0 0 1" STIFF/>
<geom name="g{BAD}" size=".1"/></body></worldbody>
<actuator><motor name="a{BAD}" joint="j{BAD}"/></actuator>
<keyframe><key name="k{BAD}" qvel="1"/></keyframe>
<custom><text name="stepcore" data="integrator=explicit"/></custom></mujoco>"""
CALM, WILD = MODEL.replace("STIFF", 'stiffness="10"'), MODEL.replace("STIFF", 'stiffness="1e12"')
FILES = ("name\x1b[31m.xml", "name\x9b\u202e.xml")


pytestmark = pytest.mark.filterwarnings("default")


@pytest.fixture
def folder(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    for name in ("calm.xml", *FILES):
        (tmp_path / name).write_text(CALM)
    (tmp_path / "wild.xml").write_text(WILD)
    (tmp_path / "bad\x1b[1m.xml").write_text("<mujoco><wordbody/></mujoco>")
    return tmp_path


COMMANDS = [
    ["check", "calm.xml"],
    ["run", "calm.xml", "--horizon", "0.5"],
    ["run", "wild.xml", "--horizon", "5"],
    ["run", "calm.xml", "--key", "zz"],
    ["plan", "calm.xml", "--all"],
    ["diagnose", "wild.xml"],
    ["predict", "calm.xml", "--horizon", "0.2"],
    ["converge", "calm.xml", "--horizon", "0.2", "--starts", "2"],
    ["ablate", "calm.xml", "--horizon", "0.2", "--starts", "2"],
    ["view", "calm.xml", "--horizon", "0.1", "--html", "page\x1b[1m.html"],
    ["run", "no\x1b[1m.xml"],
    ["run", "bad\x1b[1m.xml"],
    ["replay", "bad\x1b[1m.xml"],
    ["run", "calm.xml", "--set", "\x1b[1m=3"],
    ["run", "calm.xml", "--nonsense\x1b[1m"],
    ["no\x1b[1mcommand"],
    *(["run", name, "--horizon", "0.1"] for name in FILES),
]


@pytest.mark.parametrize("command", COMMANDS, ids=lambda command: printable(" ".join(command)))
def test_no_command_prints_a_control_character(folder, capfd, command):
    main(command)
    said = capfd.readouterr()
    assert said.out + said.err
    assert not RAW.findall(said.out + said.err)


def test_a_failure_is_replayed_without_one(folder, capfd):
    assert main(["run", "wild.xml", "--horizon", "5", "--replay", "w.json"]) == 1
    assert "\\x9b31m" in capfd.readouterr().err
    for options in ([], ["--json"], ["--html", "w.html"]):
        assert main(["replay", "w.json", *options]) == 0
        said = capfd.readouterr()
        assert not RAW.findall(said.out + said.err)
    page = (folder / "w.html").read_text()
    assert not RAW.findall(re.sub(r"base64,[^\"]*", "", page)) and "\\x9b31m" in page


def test_json_keeps_the_name(folder, capfd):
    # Explicit steps of a spring gain energy, which is an error of the model.
    assert main(["check", "calm.xml", "--json"]) == 1
    data = json.loads(capfd.readouterr().out)
    assert data["model"] == f"m{BAD}"


def texts(scene):
    """What Python prints of a model: its forms, its errors, its warnings."""
    sim = sc.Sim(scene, ledger=True)
    yield from map(repr, (scene, sim.model, sim, sc.Batch(scene, 1), sim.joint(0), scene.bodies[1]))
    yield sim.model.element_name("joint", 0)
    for wrong in (
        lambda: sim.body(BAD),
        lambda: scene.add_body(f"b{BAD}"),
        lambda: scene.geom(f"g{BAD}").__setattr__("size", -1),
        lambda: scene.compile(),
        lambda: sc.load(FILES[0]),
        lambda: sc.loads("<mujoco><x/></mujoco>", name=BAD),
        lambda: sc.replay(BAD),
        lambda: sim.step(1000),
    ):
        try:
            wrong()
        except (ValueError, OSError, RuntimeError) as error:
            yield str(error)
            if isinstance(error, sc.SimulationError):
                yield repr(error.replay)
                yield error.replay.run().text(full=True)
                yield error.replay.run()._repr_html_().partition("<img")[0]


def test_what_python_prints_has_none_either(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always")
        scene = sc.loads(WILD)
        said = list(texts(scene))
        sim = sc.Sim(sc.loads(WILD))
        sim.reset(0)
        try:
            sim.step(1000)
        except sc.SimulationError as error:
            said.append(str(error))
    said += [str(warning.message) for warning in caught]
    assert len(said) > 12 and any("\\x9b31m" in text for text in said)
    assert [text for text in said if RAW.search(text)] == []


def test_a_bar_has_a_label_of_text(capsys, monkeypatch):
    monkeypatch.setattr(sys.stderr, "isatty", lambda: True, raising=False)
    with Progress(f"runs{BAD}\r\x1b[2J", 2) as bar:
        bar.advance()
    shown = capsys.readouterr().err
    assert "\\x9b31m" in shown and not RAW.findall(shown.replace("\r", ""))


def test_a_traceback_has_none(folder):
    code = "import stepcore as sc; sc.loads(open('calm.xml').read()).compile().index('body', 'x')"
    run = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=False)
    assert "ValueError" in run.stderr and not RAW.findall(run.stderr)
