"""Texts that are not well-formed XML, but that MuJoCo reads, are read too, as MuJoCo reads them."""

import mujoco
import pytest

import stepcore as sc
from stepcore.mjcf.nodes import MJCFError

BODY = '<worldbody><body name="a &amp; b"><joint/>\n<geom{} size=".1"/></body></worldbody>'
GROUP = ' group="1"condim="4"'
# What MuJoCo lets pass.
TEXTS = {
    "dashes in a comment": f"<mujoco><!-- one -- two -->{BODY.format('')}</mujoco>",
    "a rule": f"<mujoco><!---------\n rule ---->{BODY.format('')}</mujoco>",
    "blanks first": f'\n\n <?xml version="1.0"?><mujoco>{BODY.format("")}</mujoco>',
    "an ampersand": f'<mujoco model="a & b &amp; c">{BODY.format("")}</mujoco>',
    "attributes side by side": f"<mujoco>{BODY.format(GROUP)}</mujoco>",
    "an end that is there twice": f"<mujoco>{BODY.format('')}\n </mujoco>\n</mujoco>\n",
}


@pytest.mark.parametrize("name", TEXTS)
def test_what_mujocos_parser_lets_pass_is_read(name):
    text = TEXTS[name]
    theirs = mujoco.MjModel.from_xml_string(text)
    for given in (text, text.encode()):
        scene = sc.loads(given)
        assert scene.bodies[1].name == theirs.body(1).name == "a & b"
        assert scene.geoms[0].condim == theirs.geom_condim[0]
        assert scene.compile().nv == 1


@pytest.mark.parametrize("name", TEXTS)
def test_lines_keep_their_numbers(name):
    text = TEXTS[name].replace("<geom", "<gem")
    line = 1 + text[: text.index("<gem")].count("\n")
    with pytest.raises(MJCFError, match="unknown element <gem>") as caught:
        sc.loads(text)
    assert caught.value.line == line


@pytest.mark.parametrize(
    "text", ["<mujoco><!-- a --", "<mujoco", "<mujoco>&</mujoco", "& <a", "<?xml"]
)
def test_what_is_no_xml_is_still_an_error(text):
    with pytest.raises(MJCFError, match="not well-formed XML"):
        sc.loads(text)


EMPTY = {
    "geom": ("condim", "friction", "margin", "material", "mass", "pos", "group", "rgba"),
    "joint": ("range", "damping", "armature", "axis", "ref"),
}


@pytest.mark.parametrize(("tag", "name"), [(t, n) for t, names in EMPTY.items() for n in names])
def test_empty_numbers_and_names_say_nothing(tag, name):
    text = f"<mujoco>{BODY.format('')}</mujoco>"
    given = text.replace(f"<{tag}", f'<{tag} {name}=" "')
    mujoco.MjModel.from_xml_string(given.replace('" "', '""'))
    assert sc.loads(given) == sc.loads(given.replace('" "', '""')) == sc.loads(text)


def test_load_and_loads_name_each_other():
    with pytest.raises(FileNotFoundError, match="no such file; `loads` reads a text"):
        sc.load("<mujoco/>")
    for path in ("robot.xml", "gymnasium:ant"):
        with pytest.raises(sc.MJCFError, match="is no XML; `load` reads a file by its path"):
            sc.loads(path)


def test_names_of_mujoco_are_answered_with_ours():
    scene = sc.loads("<mujoco><worldbody/></mujoco>")
    for call in (sc.Sim, sc.diagnose, lambda *args, **given: sc.Batch(*args, 2, **given)):
        with pytest.raises(TypeError, match='no argument "timestep"; here it is "dt"'):
            call(scene, timestep=0.01)
    for name in ("RK4", "Euler"):
        with pytest.raises(ValueError, match=f"one of .*{name.lower()}"):
            sc.Sim(scene, integrator=name)
