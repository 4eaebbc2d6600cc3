"""Bad MJCF: one line with file, line and the nearest name, and never another exception."""

import pickle
import random
import re
from pathlib import Path

import pytest

import stepcore as sc
from stepcore import load, loads
from stepcore.loading import find_asset
from stepcore.mjcf.nodes import MJCFError


def world(inside: str, before: str = "", after: str = "") -> str:
    return f"<mujoco>{before}\n<worldbody>{inside}</worldbody>\n{after}</mujoco>"


def body(inside: str, before: str = "", after: str = "") -> str:
    return world(f'<body name="b">{inside}<geom name="g" size="1"/></body>', before, after)


def motor(attributes: str, before: str = "") -> str:
    return body(
        '<joint name="j"/><site name="s"/>', before, f"<actuator><motor {attributes}/></actuator>"
    )


def servo(tag: str, attributes: str) -> str:
    return f'<actuator><{tag} joint="j" {attributes}/></actuator>'


def wrong_servo(tag: str, attributes: str, joint: str = "", before: str = "") -> str:
    return body(f'<joint name="j" {joint}/>', before, servo(tag, attributes))


# (text, line of the error, part of the message)
MISTAKES = {
    "unknown attribute": (
        body('<joint dampng="1"/>'),
        2,
        'unknown attribute "dampng" of <joint>; nearest: "damping"',
    ),
    "unknown element": (body("<jiont/>"), 2, 'unknown element <jiont> in <body>; nearest: "joint"'),
    "element in the wrong place": (world("<motor/>"), 2, "unknown element <motor> in <worldbody>"),
    "unknown section": ("<mujoco>\n\n<worldbdy/></mujoco>", 3, '"worldbody"'),
    "unknown keyword": (body('<joint type="hing"/>'), 2, "type = 'hing': must be one of"),
    "keyword in the wrong case": ('<mujoco><option integrator="rk4"/></mujoco>', 1, '"RK4"'),
    "unknown flag value": (
        '<mujoco><option><flag limit="off"/></option></mujoco>',
        1,
        "disable, enable",
    ),
    "too few numbers": (world('<geom size="1" pos="1 2"/>'), 2, "must be 3 finite numbers"),
    "too many numbers": (world('<geom size="1 2 3 4"/>'), 2, "must be 1 to 3 finite numbers"),
    "not a number": (world('<geom size="one"/>'), 2, "size = 'one'"),
    "nan": (world('<geom size="nan"/>'), 2, "finite"),
    "infinity": (world('<geom size="1" pos="0 inf 0"/>'), 2, "finite"),
    "overflow": (world('<geom size="1e999"/>'), 2, "finite"),
    "python's own spelling": (world('<geom size="1_0"/>'), 2, "finite"),
    "commas": (world('<geom size="1,2,3" type="box"/>'), 2, "finite"),
    "not an integer": (world('<geom size="1" condim="3.0"/>'), 2, "an integer"),
    "a long integer": (world('<geom size="1" contype="4294967296"/>'), 2, "32-bit integer"),
    "missing attribute": (
        body('<inertial pos="0 0 0"/>'),
        2,
        'lacks the required attribute "mass"',
    ),
    "negative mass": (body('<inertial pos="0 0 0" mass="-1" diaginertia="1 1 1"/>'), 2, ">= 0"),
    "mass without inertia": (
        body('<inertial pos="0 0 0" mass="1"/><joint/>'),
        2,
        "needs diaginertia",
    ),
    "two inertias": (
        body('<inertial pos="0 0 0" mass="1" diaginertia="1 1 1" fullinertia="1 1 1 0 0 0"/>'),
        2,
        "both fullinertia",
    ),
    "two inertials": (body('<inertial pos="0 0 0" mass="0"/>' * 2), 2, "second <inertial>"),
    "negative size": (world('<geom name="g" size="-1"/>'), 2, 'geom "g": size = '),
    "no size": (world('\n<geom type="box" size="1 2"/>'), 3, "3 half sizes > 0 for a box"),
    "two orientations": (
        world('<geom size="1" quat="1 0 0 0" euler="0 0 0"/>'),
        2,
        "two orientations",
    ),
    "no direction": (world('<geom size="1" zaxis="0 0 0"/>'), 2, "zaxis"),
    "zero quaternion": (world('<geom size="1" quat="0 0 0 0"/>'), 2, "quat"),
    "a mesh geom without mesh": (world('<geom type="mesh"/>'), 2, "names no mesh"),
    "fromto of a sphere": (world('<geom size="1" fromto="0 0 0 1 1 1"/>'), 2, "fromto"),
    "fromto and pos": (
        world('<geom type="capsule" size="1" pos="0 0 1" fromto="0 0 0 1 1 1"/>'),
        2,
        "both pos and fromto",
    ),
    "bad condim": (world('<geom size="1" condim="2"/>'), 2, "one of 1, 3, 4, 6"),
    "mixed solref": (world('<geom size="1" solref="-100 1"/>'), 2, "both > 0"),
    "moving plane": (body('<joint/>\n<geom type="plane" size="1 1 1"/>'), 3, "cannot move"),
    "limited without range": (body('<joint limited="true"/>'), 2, "range"),
    "range without limited": (
        body('<joint range="0 1"/>', '<compiler autolimits="false"/>'),
        2,
        "autolimits",
    ),
    "range of a ball": (body('<joint type="ball" range="-1 1"/>'), 2, "ball"),
    "no axis": (body('<joint axis="0 0 0"/>'), 2, "axis"),
    "joint in the world": (world("<joint/>"), 2, "unknown element <joint> in <worldbody>"),
    "joint in a frame of the world": (
        world("<frame><joint/></frame>"),
        2,
        "cannot be in the world",
    ),
    "ball, then hinge": (body('<joint type="ball"/>\n<joint/>'), 3, "ball joint must be"),
    "seven dofs": (body('<freejoint/><joint name="j"/>'), 2, "more than 6 dofs"),
    "free on a child": (body("<joint/><body>\n<freejoint/></body>"), 3, "parent is the world"),
    "a name twice": (body('<joint name="a"/>\n<joint name="a"/>'), 3, "used twice"),
    "the world's name": (world('<body name="world"/>'), 2, "used twice"),
    "unknown class": (world('<geom size="1" class="a"/>'), 2, 'unknown default class "a"'),
    "unknown childclass": (world('<body childclass="mian"/>'), 2, '"main"'),
    "class twice": (
        world("", '<default><default class="a"/>\n<default class="a"/></default>'),
        2,
        "defined twice",
    ),
    "class without name": (world("", "<default><default/></default>"), 1, "needs class"),
    "main renamed": (world("", '<default class="a"/>'), 1, "main"),
    "two geoms in a default": (world("", "<default><geom/><geom/></default>"), 1, "second <geom>"),
    "unknown joint": (motor('joint="jj"'), 3, 'no joint is named "jj"; nearest: "j"'),
    "no transmission": (motor('name="m"'), 3, "needs joint"),
    "an unknown site": (motor('site="t" refsite="s"'), 3, 'no site is named "t"'),
    "a crank without a pin": (motor('slidersite="s"'), 3, "cranksite"),
    "a damper that pushes": (motor('joint="j"').replace("<motor", "<damper"), 3, "ctrlrange"),
    "two transmissions": (motor('joint="j" site="s"'), 3, "two transmissions"),
    "reversed clamp": (motor('joint="j" forcelimited="true" forcerange="1 0"'), 3, "forcerange"),
    "inherited activation": (
        motor('joint="j"', '<default><general actrange="0 1"/></default>'),
        3,
        "actrange",
    ),
    "negative kv": (wrong_servo("position", 'kv="-1"'), 3, "kv = -1.0: must be >= 0"),
    "negative dampratio": (wrong_servo("position", 'dampratio="-1"'), 3, "dampratio = -1.0"),
    "negative timeconst": (wrong_servo("position", 'timeconst="-1"'), 3, "timeconst = -1.0"),
    "two dampings": (wrong_servo("position", 'kv="1" dampratio="1"'), 3, "both kv and dampratio"),
    "damping ratio of a pushing servo": (
        wrong_servo("position", 'kp="-1" dampratio="1"'),
        3,
        "kp = -1.0: must be >= 0",
    ),
    "kp of a velocity servo": (wrong_servo("velocity", 'kp="1"'), 3, 'unknown attribute "kp"'),
    "kp that is no number": (wrong_servo("position", 'kp="nan"'), 3, "1 finite number"),
    "two ranges": (
        wrong_servo("position", 'ctrlrange="0 1" inheritrange="1"', 'range="0 1"'),
        3,
        "both ctrlrange and inheritrange",
    ),
    "no range to inherit": (
        wrong_servo("position", 'inheritrange="1"'),
        3,
        'joint "j" has no range',
    ),
    "a range to inherit that nothing limits": (
        wrong_servo("position", 'inheritrange="1"', 'range="0 1" limited="true"').replace(
            "<mujoco>", '<mujoco><compiler autolimits="false"/>', 1
        ),
        3,
        'inheritrange without ctrllimited="true", and autolimits is "false"',
    ),
    "an unknown dyntype": (wrong_servo("general", 'dyntype="pdi"'), 3, "pid"),
    "activations of nothing": (wrong_servo("general", 'actdim="1"'), 3, "actdim = 1"),
    "unknown input": (wrong_servo("general", 'input="speed"'), 3, "pos, vel or pressure"),
    "bad gains in a class": (
        wrong_servo("position", "", "", '<default><position kv="-1"/></default>'),
        1,
        "kv = -1.0",
    ),
    "unknown body": (
        world("", "", '<contact><exclude body1="a" body2="world"/></contact>'),
        3,
        'no body is named "a"',
    ),
    "connect to itself": (
        body("", "", '<equality><connect body1="b" body2="b" anchor="0 0 0"/></equality>'),
        3,
        "to itself",
    ),
    "connect of nothing": (body("", "", '<equality><connect body1="b"/></equality>'), 3, "anchor"),
    "long key": (
        body("<joint/>", "", '<keyframe><key qpos="1 2"/></keyframe>'),
        3,
        "at most 1 numbers, not 2",
    ),
    "key of an activation": (
        body("", "", '<keyframe><key act="1"/></keyframe>'),
        3,
        "at most 0 numbers, not 1",
    ),
    "unknown material": (
        world('<geom size="1" material="rde"/>', '<asset><material name="red"/></asset>'),
        2,
        'no such material; nearest: "red"',
    ),
    "unknown sensor target": (
        body('<joint name="j"/>', "", '<sensor><jointpos joint="k"/></sensor>'),
        3,
        'no joint is named "k"',
    ),
    "zero step": ('<mujoco><option timestep="0"/></mujoco>', 1, "> 0 s"),
    "negative iterations": ('<mujoco><option iterations="-1"/></mujoco>', 1, ">= 0"),
    "no friction ratio": ('<mujoco><option impratio="0"/></mujoco>', 1, "> 0"),
    "global coordinates": ('<mujoco><compiler coordinate="global"/></mujoco>', 1, "local"),
    "bad eulerseq": ('<mujoco><compiler eulerseq="xyq"/></mujoco>', 1, "three letters"),
    "negative bound": ('<mujoco><compiler boundmass="-1"/></mujoco>', 1, ">= 0"),
    "too many keys": ('<mujoco><size nkey="999999999"/></mujoco>', 1, "nkey"),
    "another root": ("<robt/>", 1, "not <mujoco>"),
    "not closed": ("<mujoco>\n<worldbody>", 2, "not well-formed"),
    "closed wrongly": ("<mujoco>\n<worldbody></mujoco>", 2, "mismatched tag"),
    "an attribute twice": (world('<geom size="1" size="2"/>'), 2, "duplicate attribute"),
    "empty": ("", 1, "the file is empty"),
    "plain text": ("torso: 1", 1, "is no XML; `load` reads a file by its path"),
    "binary": ("<\1\2", 1, "not well-formed XML: (invalid token)"),
    "two roots": ("<mujoco/><mujoco/>", 1, "junk after"),
    "entities": ('<!DOCTYPE m [<!ENTITY a "b">]>\n<mujoco model="&a;"/>', 1, "DOCTYPE"),
    "an outside DTD": ('<!DOCTYPE m SYSTEM "x.dtd">\n<mujoco/>', 1, "DOCTYPE"),
    "an undefined entity": ('<mujoco model="&a;"/>', 1, "undefined entity"),
    "too deep": ("<mujoco><worldbody>" + "<body>" * 600, 1, "nested deeper"),
    "a strange encoding": (b'<?xml version="1.0" encoding="klingon"?><mujoco/>', 1, "encoding"),
    "bad bytes": (b'<mujoco model="\xff"/>', 1, "not well-formed"),
    "a zero byte": ("<mujoco>\0</mujoco>", 1, "not well-formed"),
    "half a character": ("<mujoco model='\ud800'/>", 1, "unreadable"),
    "an include without a place": ('<mujoco><include file="a.xml"/></mujoco>', 1, "needs loads"),
    "an include without a file": ("<mujoco><include/></mujoco>", 1, "exactly one attribute"),
}

# What would change the motion; a value without effect is accepted.
UNBUILT = {
    "<flex> in <equality>": ("", '<equality><flex flex="b"/></equality>'),
    "an <orientation> that turns a site": (
        '<site name="s"/>',
        '<actuator><orientation site="s" refsite="s"/></actuator>',
    ),
    'gaintype="user"': ('<joint name="j"/>', servo("general", 'gaintype="user"')),
    'biastype="user"': ('<joint name="j"/>', servo("general", 'biastype="user"')),
    "<plugin> in <extension>": ("", '<extension><plugin plugin="a"/></extension>'),
    "<flex> in <deformable>": ("", "<deformable><flex/></deformable>"),
    "<flexcomp> in <body>": ("<flexcomp/>", ""),
    "<composite> in <body>": ("<composite/>", ""),
    "scaling": ('<frame scale="2"/>', ""),
    "springyield": ('<joint springyield="1"/>', ""),
    "type sdf": ('<geom type="sdf" mesh="m"/>', ""),
    **{
        f'flag "{flag}"': ("", f'<option><flag {flag}="enable"/></option>')
        for flag in ("diagexact", "ipc", "speculative")
    },
}


@pytest.mark.parametrize("mistake", MISTAKES)
def test_a_mistake_is_one_line_with_its_place(mistake: str) -> None:
    text, line, says = MISTAKES[mistake]
    with pytest.raises(MJCFError) as caught:
        loads(text, name="m.xml")
    message = str(caught.value)
    assert message.startswith(f"m.xml:{line}: ")
    assert says in message
    assert "\n" not in message
    assert (caught.value.file, caught.value.line) == ("m.xml", line)
    assert str(pickle.loads(pickle.dumps(caught.value))) == message


@pytest.mark.parametrize("what", UNBUILT)
def test_what_is_not_built_is_refused_by_name(what: str) -> None:
    inside, after = UNBUILT[what]
    with pytest.raises(MJCFError) as caught:
        loads(body(inside, "", after), name="m.xml")
    assert re.match(r"m\.xml:[23]: ", str(caught.value))
    assert what in str(caught.value)
    assert re.search(r"is not built yet(: |\n)", str(caught.value))


def test_values_without_effect_are_accepted() -> None:
    loads(
        body(
            '<joint name="j" stiffness="1 0 0" damping="1 0" springdamper="0 1" springyield="0"'
            ' actuatorfrcrange="-1 1" actuatorfrclimited="false"/><geom size="1" adhesion="0"'
            ' surfacevel="0 0 0 0 0 0"/><body mocap="false" gravcomp="0" sleep="auto"/>'
            '<frame scale="1 1 1" massscale="0"/>',
            '<compiler alignfree="false" fusestatic="false"/><option density="0" wind="1 0 0"'
            ' noslip_iterations="0"><flag sleep="disable" multiccd="enable"/></option>',
            '<actuator><motor joint="j" damping="0" armature="0" delay="0"/>'
            '<position joint="j" timeconst="0" kv="0" inheritrange="0"/>'
            '<general joint="j" dyntype="none" dynprm="1 2" actdim="0" actearly="true"'
            ' input="pos"/>'
            "</actuator>",
        )
    )


@pytest.mark.parametrize("read", [load, sc.trade, sc.ablate, sc.converge, sc.diagnose])
def test_a_missing_file_is_the_same_error_everywhere(read, tmp_path: Path) -> None:
    with pytest.raises(FileNotFoundError) as caught:
        read("nothing.xml")
    assert str(caught.value) == "nothing.xml: no such file"
    with pytest.raises(IsADirectoryError, match="is a folder, not an MJCF or URDF file"):
        read(tmp_path)


def test_files_that_are_not_there_or_no_files(tmp_path: Path) -> None:
    with pytest.raises(FileNotFoundError, match=r"nothing\.xml"):
        load(tmp_path / "nothing.xml")
    with pytest.raises(IsADirectoryError, match="is a folder"):
        load(tmp_path)
    with pytest.raises(ValueError, match="cannot be read"):
        load("a\0b.xml")
    with pytest.raises(MJCFError, match="must be a str or bytes"):
        loads(None)  # type: ignore[arg-type]
    path = tmp_path / "m.xml"
    path.write_text('<mujoco>\n<include file="gone.xml"/></mujoco>')
    with pytest.raises(FileNotFoundError, match=r"m\.xml:2: .*gone\.xml"):
        load(path)
    path.write_bytes(b"")
    with pytest.raises(MJCFError, match=r"m\.xml:1: .*the file is empty"):
        load(path)


def test_includes_that_cannot_end(tmp_path: Path) -> None:
    first, second = tmp_path / "a.xml", tmp_path / "b.xml"
    first.write_text('<mujoco>\n<include file="b.xml"/></mujoco>')
    second.write_text('<mujoco>\n\n<include file="a.xml"/></mujoco>')
    with pytest.raises(MJCFError, match=r"b\.xml:3: .*includes itself"):
        load(first)
    first.write_text('<mujoco>\n<include file="a.xml"/></mujoco>')
    with pytest.raises(MJCFError, match=r"a\.xml:2: .*includes itself"):
        load(first)
    first.write_text('<mujoco>\n<include file="b.xml"/>\n<include file="b.xml"/></mujoco>')
    second.write_text("<x><option/></x>")
    with pytest.raises(MJCFError, match=r"a\.xml:3: .*already included"):
        load(first)
    first.write_text('<mujoco>\n<include file="b.xml"/></mujoco>')
    second.write_text("<x/>")
    with pytest.raises(MJCFError, match=r"a\.xml:2: .*has no elements"):
        load(first)
    second.write_text("<x>\n<optoin/></x>")
    with pytest.raises(MJCFError, match=r'b\.xml:2: .*"option"'):
        load(first)


def texts() -> list[str]:
    names = ("ant", "hopper", "half_cheetah")
    return [find_asset("gymnasium", name).read_text(encoding="utf-8") for name in names]


@pytest.mark.parametrize("seed", range(300))
def test_damaged_files_give_a_scene_or_a_clean_error(seed: int) -> None:
    """Any damage is either harmless or an MJCFError with a line for each part of it."""
    chance = random.Random(seed)
    text = chance.choice(texts())
    words = re.findall(r"[\w.+-]+", text)
    for _ in range(chance.randint(1, 4)):
        spans = [match.span() for match in re.finditer(r"[\w.+-]+", text)]
        start, end = chance.choice(spans)
        damage = chance.choice(
            [
                "",
                "nan",
                "-1",
                "0",
                "1e400",
                "é",
                "<",
                '"',
                "&x;",
                "1 2 3 4 5 6 7",
                chance.choice(words),
            ]
        )
        text = text[:start] + damage + text[end:]
    try:
        scene = loads(text, name="m.xml")
    except MJCFError as error:
        lines = str(error).split("\n")
        assert len(lines) <= 22
        assert re.match(r"m\.xml:\d+: \S", lines[0])
        assert all(re.match(r"m\.xml:\d+: \S|… and|without=", line) for line in lines)
        assert max(map(len, lines)) < 700
    else:
        scene.to_dict()
