"""All that is wrong with a file is listed at once, and named kinds are left out on purpose."""

import copy
import json
import pickle
from pathlib import Path

import pytest

import stepcore as sc
from stepcore import load, loads
from stepcore.cli import main
from stepcore.mjcf.nodes import MJCFError

# Three kinds that are not built, one of them twice, and a misspelt word.
MANY = """<mujoco>
  <worldbody>
    <body name="b"><joint name="j" dampng="1"/><geom size="1"/>
      <flexcomp name="f"/>
      <flexcomp name="g"/>
    </body>
  </worldbody>
  <extension><plugin plugin="p"/></extension>
  <actuator><motor name="m" joint="j"/></actuator>
</mujoco>
"""
# Plugins and flexes beside what can be read.
MIXED = """<mujoco model="mixed">
  <extension><plugin plugin="p"/></extension>
  <worldbody>
    <geom type="plane" size="1 1 1"/>
    <flexcomp name="f"/>
    <body name="b" pos="0 0 2"><joint name="j" springyield="1"/><joint name="k" axis="1 0 0"/>
      <geom size=".1" pos=".2 0 0"/></body>
  </worldbody>
  <actuator>
    <motor name="first" joint="j"/><plugin name="odd" joint="j" plugin="p"/>
    <motor name="last" joint="k"/>
  </actuator>
  <sensor><actuatorfrc actuator="odd"/><jointpos joint="j"/></sensor>
  <keyframe><key name="home" ctrl="1 2 3"/></keyframe>
</mujoco>
"""
KINDS = ["flex", "plugin", "joint/springyield"]


def test_all_errors_are_listed_at_once_each_with_its_line() -> None:
    with pytest.raises(MJCFError) as caught:
        loads(MANY, name="m.xml")
    lines = str(caught.value).split("\n")
    assert [line.partition(" ")[0] for line in lines] == ["m.xml:3:", "m.xml:4:", "m.xml:8:"]
    assert 'unknown attribute "dampng"' in lines[0]
    assert "<flexcomp> in <body> is not built yet: its points move" in lines[1]
    assert lines[1].endswith("(also in line 5)")
    assert "<plugin> in <extension> is not built yet: it computes" in lines[2]
    # The motor on the joint that could not be read is no error of its own.
    assert [error.line for error in caught.value.errors] == [3, 4, 5, 8]
    again = pickle.loads(pickle.dumps(caught.value))
    assert str(again) == str(caught.value)
    assert [str(e) for e in again.errors[1:]] == [str(e) for e in caught.value.errors[1:]]


def test_where_all_is_only_unbuilt_the_message_says_how_to_leave_it_out() -> None:
    with pytest.raises(MJCFError) as caught:
        loads(MIXED, name="m.xml")
    last = str(caught.value).split("\n")[-1]
    assert last.startswith('without=["extension/plugin", "worldbody/flexcomp", ')
    kinds = [error.kind for error in caught.value.errors]
    assert loads(MIXED, without=kinds) == loads(MIXED, without=KINDS)


@pytest.mark.parametrize("tty", [True, False])
def test_on_a_shell_a_refusal_begins_with_the_command_that_works(
    tmp_path, capsys, monkeypatch, tty
):
    """A line a reason on a terminal, and none for what only follows from another."""
    file = tmp_path / "m.xml"
    exclude = '<contact><exclude body1="f_0" body2="b"/></contact>'
    file.write_text(MIXED.replace("<actuator>", f"{exclude}<actuator>", 1))
    monkeypatch.setattr("stepcore.cli.terminal.watched", lambda: tty)
    assert main(["check", str(file)]) == 2
    said = capsys.readouterr().err.replace(f"{file}:", "m.xml:")
    assert f"`stepcore trade {file} --engine mujoco` works." in said.split(" m.xml:")[0]
    assert "f_0" not in said and "without=" not in said
    *_, last = said.rstrip().split("--without extension/plugin")
    assert last.endswith("leaves these things out.")
    places = [line.partition(" ")[0] for line in said.splitlines()[1:-1]]
    assert places == (["m.xml:2:", "m.xml:5:", "m.xml:6:", "m.xml:10:"] if tty else [])


def test_a_geom_that_is_not_built_cannot_be_left_out() -> None:
    with pytest.raises(MJCFError) as caught:
        loads('<mujoco><worldbody><geom type="sdf"/></worldbody></mujoco>')
    assert "without=" not in str(caught.value) and 'engine="mujoco"' in str(caught.value)


def test_the_same_error_in_many_places_is_one_line() -> None:
    bodies = "\n".join(f'<body name="b{i}"><flexcomp/></body>' for i in range(100))
    with pytest.raises(MJCFError) as caught:
        loads(f"<mujoco><worldbody>{bodies}</worldbody></mujoco>")
    first, _ = str(caught.value).split("\n")
    assert first.endswith("(also in line 2, 3, 4, 5 and 95 more)")
    assert len(caught.value.errors) == 100
    wrong = "\n".join(f'<body a{i}=""/>' for i in range(100))
    with pytest.raises(MJCFError) as caught:
        loads(f"<mujoco><worldbody>{wrong}</worldbody></mujoco>")
    assert str(caught.value).split("\n")[20:] == ["… and 80 more"]


def test_named_kinds_are_left_out_with_what_refers_to_them() -> None:
    scene = loads(MIXED, name="m.xml", without=KINDS)
    assert [actuator.name for actuator in scene.actuators] == ["first", "last"]
    assert scene.key("home").ctrl == (1.0, 3.0)
    assert scene.without == ["flex (1)", "plugin (3)", "joint/springyield (1)"]
    notes = [note for note in scene.notes if "without" in note]
    assert notes == [
        'm.xml:5: without flex: 1 left out (<flexcomp> "f"): its points move, collide, and pull '
        "on what they are pinned to",
        'm.xml:2: without plugin: 3 left out (<plugin> "odd"): it computes forces, shapes or '
        "sensors outside of the file",
        'm.xml:6: without joint/springyield: 1 left out (<joint> "j"): the spring of the joint '
        "yields",
    ]
    for same in (copy.deepcopy(scene), pickle.loads(pickle.dumps(scene))):
        assert same.without == scene.without
    # What is left out is not written.
    assert loads(scene.to_mjcf()) == scene


def test_a_whole_section_and_a_kind_that_is_not_there() -> None:
    scene = loads(MIXED, without=[*KINDS, "actuators", "equality/weld"])
    assert scene.actuators == []
    # The sensor of one of them counts too.
    assert "actuator (4)" in scene.without
    assert "without equality/weld: the file has none" in scene.notes
    assert "weld" not in " ".join(scene.without)


def test_an_element_named_without_its_section() -> None:
    assert loads(MIXED, without=[*KINDS, "motor"]).without[-1] == "actuator/motor (2)"


@pytest.mark.parametrize(
    ("without", "says"),
    [
        (["flx"], "without = 'flx': no such kind; nearest: \"flex\""),
        (["joint/springyeld"], 'nearest: "joint/springyield"'),
        (["body"], "no such kind"),
        (["geom"], "no such kind"),
        ("flex", 'must be a list of kinds, such as \\["flex"\\]'),
        ([1], "must be the name of a kind"),
    ],
)
def test_a_kind_that_does_not_exist_is_an_error(without: object, says: str) -> None:
    with pytest.raises(ValueError, match=says):
        loads(MIXED, without=without)  # type: ignore[arg-type]


def test_every_result_says_what_was_left_out(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    file = tmp_path / "m.xml"
    file.write_text(MIXED)
    scene = load(file, without=KINDS)
    said = "; without flex (1), plugin (3), joint/springyield (1)"
    assert said in sc.check(scene, horizon=0.01, progress=False).ran
    assert said in sc.converge(scene, horizon=0.01, progress=False).text(1000)
    options = [word for kind in KINDS for word in ("--without", kind)]
    assert main(["run", str(file), "--horizon", "0.01", "--json", *options]) == 0
    assert said in json.loads(capsys.readouterr().out)["ran"]
    assert main(["check", str(file), "--horizon", "0.01", "--json", *options]) == 0
    result = json.loads(capsys.readouterr().out)
    assert said in result["ran"]
    assert " ".join(options) in str(result)
    assert main(["plan", str(file), "--all", *options]) == 0
    assert "joint/springyield (1)" in capsys.readouterr().out
    assert main(["run", str(file), "--without", "flx"]) == 2
    assert "no such kind" in capsys.readouterr().err
