"""`<contact>` and the contact override in MJCF and in Python: read, written, changed, refused."""

from __future__ import annotations

import random

import pytest

import stepcore as sc

BODIES = """<worldbody><geom name="floor" type="plane" size="1 1 1"/>
  <body name="a" pos="0 0 .1"><freejoint/><geom name="ga" size=".1" contype="0" conaffinity="0"/>
    <body name="b" pos=".19 0 0"><joint/><geom name="gb" size=".1"/></body></body></worldbody>"""


def model(contact: str, option: str = "", default: str = "") -> str:
    return f"<mujoco>{option}{default}{BODIES}<contact>{contact}</contact></mujoco>"


def test_a_pair_overrides_filters_and_excludes():
    """Masks of 0, parent and child, an excluded pair of bodies: an explicit pair meets anyway."""
    plain = sc.loads(model('<exclude body1="a" body2="b"/>'))
    assert plain.compile().pair_geoms.tolist() == [[0, 2]]
    scene = sc.loads(
        model(
            '<exclude body1="a" body2="b"/><pair geom1="gb" geom2="ga"/>'
            '<pair geom1="ga" geom2="floor"/>'
        )
    )
    assert scene.compile().pair_geoms.tolist() == [[0, 1], [0, 2], [1, 2]]
    scene.features.contact = False
    assert len(scene.compile().pair_geoms) == 0


def test_the_fields_of_a_pair_and_their_defaults():
    pair = '<pair name="grip" geom1="ga" geom2="floor" {}/>'
    empty = sc.loads(model(pair.format(""))).pair("grip")
    assert (empty.condim, empty.friction) == (3, (1.0, 1.0, 0.005, 0.0001, 0.0001))
    assert (empty.solref, empty.solreffriction, empty.margin, empty.gap) == ((0.02, 1), None, 0, 0)
    given = 'condim="4" friction=".5 .6" solref=".1" solimp=".8" solreffriction=".3" margin=".1"'
    default = '<default><pair gap=".2" friction="3 3 3" solimp=".7 .8 .9"/></default>'
    whole = sc.loads(model(pair.format(given), default=default)).pair("grip")
    assert (whole.condim, whole.friction) == (4, (0.5, 0.6, 3.0, 0.0001, 0.0001))
    assert whole.solref == (0.1, 1.0)
    assert whole.solimp == (0.8, 0.8, 0.9, 0.5, 2.0)
    assert whole.solreffriction == (0.3, 0.0)
    assert (whole.margin, whole.gap) == (0.1, 0.2)
    assert sc.loads(model(pair.format('solreffriction="0 0"'))).pair("grip").solreffriction is None


def test_python_writes_the_same_scene():
    scene = sc.loads(model(""))
    scene.add_pair("gb", scene.geom("ga"), name="x", condim=1, friction=(0.3, 0.3), margin=0.01)
    scene.add_pair("ga", "floor", solreffriction=(-100, -10))
    text = scene.to_mjcf()
    assert sc.loads(text) == scene
    assert scene.to_dict()["pairs"][0]["geom1"] == 2
    scene.geom("ga").name = ""
    again = sc.loads(scene.to_mjcf())
    assert again == scene
    assert again.pairs[1].geom1.name == ""


def pairs(scene):
    compiled = scene.compile()
    return [compiled.contact_pair(k) for k in range(compiled.npair)]


def test_the_override_comes_back_and_acts_only_with_its_flag():
    option = '<option o_margin=".1" o_solref=".3" o_friction=".5 .5">{}</option>'
    off = sc.loads(model('<pair geom1="ga" geom2="floor"/>', option.format("")))
    assert off.contact_override.margin == 0.1
    assert off.contact_override.friction == (0.5, 0.5, 0.005, 0.0001, 0.0001)
    assert off.to_dict()["contact_override"] is None
    assert [pair.solref for pair in pairs(off)] == [(0.02, 1.0)] * 2
    flag = '<flag override="enable"/>'
    on = sc.loads(model('<pair geom1="ga" geom2="floor"/>', option.format(flag)))
    assert [pair.solref for pair in pairs(on)] == [(0.3, 1.0)] * 2
    assert [pair.friction for pair in pairs(on)] == [0.5] * 2
    assert sc.loads(on.to_mjcf()) == on
    assert sc.loads(off.to_mjcf()).contact_override.margin == 0.1


def test_values_of_a_pair_by_path():
    compiled = sc.loads(model('<pair name="a/b" geom1="ga" geom2="floor"/>')).compile()
    changed = compiled.with_values({"pair/a/b/friction": (0.25, 0.25), "pair/a/b/gap": 1})
    assert changed.scene.pair("a/b").friction == (0.25, 0.25, 0.005, 0.0001, 0.0001)
    assert changed.contact_pair(0).friction == 0.25
    with pytest.raises(ValueError, match='no pair is named "ab"; nearest: "a/b"'):
        compiled.with_values({"pair/ab/friction": 1})
    with pytest.raises(ValueError, match='a pair has no value "geom1"'):
        compiled.with_values({"pair/a/b/geom1": 1})


def test_an_ablation_takes_explicit_pairs_out():
    """Without a collider, or friction, the explicit pair goes as well."""
    scene = sc.loads(model('<pair geom1="ga" geom2="floor"/><pair geom1="gb" geom2="ga"/>'))
    from stepcore.engine.features import Removal, without

    one = without(scene, [Removal("collider", "", (("exclude", ((1, 2),)),))])
    assert one.compile().pair_geoms.tolist() == [[0, 1], [0, 2]]
    one = without(scene, [Removal("friction", "", (("frictionless", (0, 1, 2)),))])
    assert one.compile().core.plan()["condim"] == [1, 1, 1]
    one = without(scene, [Removal("collider group", "", (("no contact", (1,)),))])
    assert one.compile().pair_geoms.tolist() == [[0, 2]]


MISTAKES = {
    '<pair geom1="ga"/>': '<pair> lacks the required attribute "geom2"',
    '<pair geom1="ga" geom2="gc"/>': 'no geom is named "gc"; ',
    '<pair geom1="ga" geom2="ga"/>': 'pairs geom "ga" with itself',
    '<pair geom1="ga" geom2="gb" condim="2"/>': "condim = 2: must be one of 1, 3, 4, 6",
    '<pair geom1="ga" geom2="gb" condim="3.5"/>': "condim = '3.5': must be an integer",
    '<pair geom1="ga" geom2="gb" friction="-1"/>': "must be",
    '<pair geom1="ga" geom2="gb" friction="1 2 3 4 5 6"/>': "must be 1 to 5 finite numbers",
    '<pair geom1="ga" geom2="gb" friction="nan"/>': "must be 1 to 5 finite numbers",
    '<pair geom1="ga" geom2="gb" friction="1e999"/>': "must be 1 to 5 finite numbers",
    '<pair geom1="ga" geom2="gb" solref="1 -1"/>': "solref = (1.0, -1.0): must be",
    '<pair geom1="ga" geom2="gb" solreffriction="1 -1"/>': "solreffriction = (1.0, -1.0): must be",
    '<pair geom1="ga" geom2="gb" solreffriction="1 1 1"/>': "must be 1 to 2 finite numbers",
    '<pair geom1="ga" geom2="gb" margin="x"/>': "must be 1 finite number",
    '<pair geom1="ga" geom2="gb" gap="-1"/>': "gap = -1.0: must be",
    '<pair geom1="ga" geom2="gb" adhesion="-1"/>': "adhesion = -1.0: must be",
    '<pair geom1="ga" geom2="gb" frition="1"/>': 'unknown attribute "frition" of <pair>; nearest',
    '<pair name="x" geom1="ga" geom2="gb"/><pair name="x" geom1="ga" geom2="floor"/>': "used twice",
    '<exclude body1="a"/>': '<exclude> lacks the required attribute "body2"',
    '<exclude body1="a" body2="c"/>': 'no body is named "c"; ',
}


@pytest.mark.parametrize("contact", MISTAKES)
def test_mistakes_have_file_line_and_limit(contact):
    with pytest.raises(sc.MJCFError) as caught:
        sc.loads(model(contact), name="m.xml")
    assert str(caught.value).startswith("m.xml:3: ")
    assert MISTAKES[contact] in str(caught.value)


@pytest.mark.parametrize(
    "option",
    ['o_solref="1 -1"', 'o_solimp="x"', 'o_friction="-1"', 'o_margin="1 2"', 'o_solref="nan"'],
)
def test_a_bad_override_is_refused_though_it_is_off(option):
    with pytest.raises(sc.MJCFError, match=r"m\.xml:1: .*must be"):
        sc.loads(model("", f"<option {option}/>"), name="m.xml")


@pytest.mark.parametrize("seed", range(200))
def test_any_numbers_are_a_scene_or_an_error_with_its_line(seed):
    """Attributes with any words: a scene whose text reads back, or an MJCFError."""
    draw = random.Random(seed)
    words = ["nan", "inf", "-1", "0", "1e-320", "1e308", "0.5", "", "x", "1 1", "1,1", "0x10", "3"]
    names = ("condim", "friction", "solref", "solreffriction", "solimp", "gap", "margin")
    chosen = draw.sample(names, draw.randint(1, 3))
    more = {n: " ".join(draw.choices(words, k=draw.randint(1, 3))) for n in chosen}
    given = " ".join(f'{name}="{value}"' for name, value in more.items())
    try:
        scene = sc.loads(model(f'<pair geom1="ga" geom2="gb" {given}/>'), name="m.xml")
    except sc.MJCFError as error:
        assert str(error).startswith("m.xml:3: ")
    else:
        assert sc.loads(scene.to_mjcf()) == scene
