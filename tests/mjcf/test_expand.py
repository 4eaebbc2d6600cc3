"""`<replicate>` and `<attach>` make the model that MuJoCo makes of them."""

from pathlib import Path

import compiled
import mujoco
import pytest
from covering import every_pair

from stepcore import Sim, load, loads
from stepcore.experiment.mujoco_engine import MuJoCo
from stepcore.mjcf.nodes import MJCFError

REPLICATED = {
    "names, order and what refers to copies": """
  <worldbody><geom name="floor" type="plane" size="1 1 1"/>
    <body name="o"><joint name="oj"/><geom size="1"/></body>
    <replicate count="2" offset="1 0 0" sep="-">
      <body name="b"><joint name="j"/><joint name="k" axis="1 0 0"/><geom name="g" size=".1"/>
        <site name="s"/></body>
      <geom name="h" size="1"/>
    </replicate>
    <body name="z"><joint name="zj"/><geom size="1"/></body></worldbody>
  <contact><exclude body1="b" body2="o"/><pair geom1="g" geom2="floor"/></contact>
  <equality><connect name="e" body1="b" body2="o" anchor="0 0 0"/></equality>
  <actuator><motor name="m0" joint="zj"/><motor name="m1" joint="j"/><motor name="m2" joint="k"/>
    <motor name="m3" joint="oj"/></actuator>
  <sensor><jointpos joint="j"/><actuatorpos actuator="m1"/></sensor>
  <keyframe><key name="h" qpos="1 2 3 4 5 6" ctrl="1 2 3 4 5 6"/></keyframe>""",
    "ten have two digits": """
  <worldbody><replicate count="10" offset="1 0 0"><body><joint name="h"/><geom size=".1"/></body>
  </replicate></worldbody>""",
    "one": """
  <worldbody><replicate count="1"><body><joint name="h"/><geom size=".1"/></body></replicate>
  </worldbody>""",
    "none": """
  <worldbody><replicate count="0"><geom name="h" size=".1"/></replicate>
  <body><joint/><geom size="1"/></body></worldbody>""",
    "nested, turning": """
  <compiler angle="radian" eulerseq="ZYX"/>
  <worldbody><replicate count="3" offset="1 0 .1" euler="0 .2 .5">
    <replicate count="2" offset="0 1 0" sep="_" euler=".1 0 0">
      <frame pos="0 0 1" euler="0 0 1"><body name="c" pos="0 1 0"><joint name="j"/>
        <geom name="h" type="box" size=".1 .2 .3" pos=".1 0 0"/></body></frame>
    </replicate><site name="a" pos="1 2 3"/></replicate></worldbody>
  <actuator><motor name="m" joint="j"/></actuator>""",
    "within a body, with a class": """
  <default><default class="a"><geom size=".2"/></default></default>
  <worldbody><body name="w" childclass="a"><freejoint/>
    <replicate count="4" euler="0 0 90"><geom name="h" pos="1 0 0"/>
      <body name="in" pos="2 0 0"><joint name="hinge"/><geom mass="1"/></body></replicate>
    <geom name="k"/></body></worldbody>""",
    "of a class, and with attributes that do nothing": """
  <default><default class="a"><geom size=".3"/><joint damping="2"/></default>
    <default class="b"><geom size=".4"/></default></default>
  <worldbody><replicate count="2" childclass="a" class="b" name="r" pos="9 9 9" mocap="true">
    <body name="b"><joint name="j"/><geom name="g"/></body></replicate>
    <replicate count="3" class="b"><geom name="h" size=".1"/><geom name="i"/></replicate>
    <frame class="a" count="2"><body name="f"><joint name="k"/><geom/></body></frame></worldbody>
  """,
    "a copy named in its new name": """
  <worldbody><replicate count="2" offset="1 0 0"><body name="c"><joint name="j"/>
    <geom size=".1"/></body></replicate></worldbody>
  <actuator><motor joint="j1"/></actuator>""",
}
CHILD = """<mujoco model="kid"><compiler angle="radian" autolimits="true" eulerseq="zyx"/>
  <option timestep="0.005" gravity="0 0 -1"/>
  <default><geom size=".3"/><motor gear="7"/>
    <default class="a"><geom size=".2"/></default></default>
  <asset><mesh name="me" vertex="0 0 0 1 0 0 0 1 0 0 0 1"/></asset>
  <worldbody><geom name="wg"/>
    <body name="b" pos="1 0 0" euler=".1 .2 .3"><joint name="j" range="-1 1"/>
      <geom name="g" class="a"/><site name="s"/><geom type="mesh" mesh="me"/>
      <body name="bb" childclass="a"><joint name="jj"/><geom name="gg"/></body></body>
    <body name="c"><joint name="k"/><geom/></body>
    <frame name="fr" pos="0 0 9" euler="0 0 1">
      <body name="d" pos="1 0 0"><joint type="slide" name="l"/><geom/></body></frame>
  </worldbody>
  <contact><pair name="p" geom1="g" geom2="wg"/><exclude name="x" body1="b" body2="c"/>
    <exclude name="y" body1="b" body2="world"/></contact>
  <equality><connect name="e" body1="b" body2="bb" anchor="0 0 0"/>
    <connect name="e2" body1="b" body2="c" anchor="0 0 0"/>
    <connect name="e3" body1="b" anchor="0 0 0"/></equality>
  <actuator><motor name="m" joint="j"/><motor name="mk" joint="k"/>
    <motor name="ml" joint="l"/></actuator>
  <sensor><jointpos name="q" joint="j"/><clock name="t"/></sensor>
  <keyframe><key name="h" qpos=".1 .2 .3 .4" qvel="1 2 3 4" ctrl="1 2 3" time="2"/><key/></keyframe>
</mujoco>"""


def parent(attach: str, before: str = "", world: str = "", after: str = "") -> str:
    return f"""<mujoco>{before}<asset><model name="kid" file="kid.xml"/></asset>
  <default><geom size=".5"/><joint damping="1"/></default>
  <worldbody><body name="o" pos="0 0 1"><joint name="oj" range="0 45"/><geom name="og"/>
    <frame pos="0 0 1" euler="0 90 0">{attach}</frame>
    <body name="z"><joint name="zj"/><geom/></body></body>{world}</worldbody>
  <actuator><motor name="mo" joint="oj"/></actuator>
  <keyframe><key name="hh" qpos="9 8"/></keyframe>{after}</mujoco>"""


ATTACHED = {
    "a whole model": parent('<attach model="kid" prefix="K-"/>'),
    "a body": parent('<attach model="kid" body="b" prefix="K-"/>'),
    "an inner body": parent('<attach model="kid" body="bb" prefix="K-"/>'),
    "a frame": parent('<attach model="kid" frame="fr" prefix="K-"/>'),
    "two": parent(
        '<attach model="kid" body="b" prefix="K-"/><attach model="kid" body="b" prefix="L-"/>'
    ),
    "copies": parent(
        '<replicate count="3" offset="0 1 0"><attach model="kid" body="c" prefix="K-"/></replicate>'
    ),
    "named from outside": parent(
        '<attach model="kid" body="b" prefix="K-"/>',
        after='<actuator><motor joint="K-jj" name="own"/></actuator>',
        world='<body><geom name="y" class="K-a"/><geom name="zz" class="K-main"/></body>',
    ),
    "with rules for masses of this model": parent(
        '<attach model="kid" prefix="K-"/>', '<compiler boundmass="700" settotalmass="2000"/>'
    ),
    "with rules that take masses from geoms": parent(
        '<attach model="kid" prefix="K-"/>',
        '<compiler inertiafromgeom="true" inertiagrouprange="0 0"/>',
    ),
    "merged": parent(
        '<attach model="kid" body="b" prefix="K-"/>',
        '<compiler conflict="merge"/><option timestep="0.001"/>',
    ),
    "without conflict": parent(
        '<attach model="kid" body="b" prefix="K-"/>',
        '<compiler conflict="error"/><option timestep="0.005"/>',
    ),
}


@pytest.mark.parametrize("what", REPLICATED)
def test_replicas_are_mujocos(what: str) -> None:
    text = f"<mujoco>{REPLICATED[what]}</mujoco>"
    theirs = mujoco.MjModel.from_xml_string(text)
    scene = loads(text)
    compiled.compare(scene, theirs)
    # What stands for copies is written as copies.
    compiled.compare(loads(scene.to_mjcf()), theirs)


@pytest.mark.parametrize("what", ATTACHED)
def test_attached_models_are_mujocos(what: str, tmp_path: Path) -> None:
    (tmp_path / "kid.xml").write_text(CHILD)
    (tmp_path / "m.xml").write_text(ATTACHED[what])
    theirs = mujoco.MjModel.from_xml_path(str(tmp_path / "m.xml"))
    scene = load(tmp_path / "m.xml")
    compiled.compare(scene, theirs)
    pairs = theirs.nexclude, theirs.npair, theirs.neq
    assert (len(scene.excludes), len(scene.pairs), len(scene.equalities)) == pairs
    gears = [actuator.gear[0] for actuator in scene.actuators]
    assert gears == list(theirs.actuator_gear[:, 0])
    assert [j.damping for j in scene.joints] == list(theirs.dof_damping)


CLASSES = """<default><geom size="{0}"/><motor gear="{0}"/>
  <default class="a"><geom size="{1}"/><joint damping="{1}"/><motor gear="{1}"/></default>
</default>"""
WITH_CLASSES = """<mujoco model="kid">{}<worldbody>
  <body name="k"><geom name="k0"/><geom name="ka" class="a"/><joint name="kj" class="a"/></body>
  <body name="m" childclass="a"><geom name="ma"/><joint name="mj"/></body></worldbody>
  <actuator><motor name="ka" joint="kj" class="a"/><motor name="k0" joint="kj"/></actuator>
  <keyframe><key name="h" qpos=".1 .2"/></keyframe></mujoco>"""
ATTACHING = """<mujoco>{}<asset><model name="kid" file="kid.xml"/></asset><worldbody>
  <body name="p"><geom name="p0"/><geom name="pa" class="{}a"/><joint name="pj"/>
    {}</body><body name="q"><geom name="qa" class="{}a"/></body></worldbody>
  <actuator><motor name="pm" joint="pj" class="{}a"/></actuator></mujoco>"""


@every_pair(main=(0.1, 0.3), part=("", 'body="m"'))
def test_classes_of_the_same_name_stay_those_of_their_models(main, part, tmp_path):
    """Attaching puts the prefix before the names of classes."""
    prefix = "K-"
    (tmp_path / "kid.xml").write_text(WITH_CLASSES.format(CLASSES.format(0.3, 0.4)))
    own = CLASSES.format(main, 0.2)
    attach = f'<attach model="kid" {part} prefix="{prefix}"/>'
    text = ATTACHING.format(own, "", attach, "", "")
    (tmp_path / "m.xml").write_text(text)
    theirs = mujoco.MjModel.from_xml_path(str(tmp_path / "m.xml"))
    scene = load(tmp_path / "m.xml")
    for one in (scene, loads(scene.to_mjcf())):
        ours = compiled.compare(one, theirs)
        assert [g.size[0] for g in one.geoms] == list(theirs.geom_size[:, 0])
        assert [j.damping for j in one.joints] == list(theirs.dof_damping)
        gears = {actuator.name: actuator.gear[0] for actuator in one.actuators}
        assert gears == {
            theirs.actuator(i).name: theirs.actuator_gear[i, 0] for i in range(ours.nu)
        }


def test_attributes_that_do_nothing_are_listed() -> None:
    text = """<mujoco><worldbody><replicate count="2" foo="1"><geom size=".1"/></replicate>
  <frame name="f" mocap="true"><geom size=".1"/></frame></worldbody></mujoco>"""
    assert loads(text).ignored == [
        "<string>:1: <replicate> (foo does nothing in replicate)",
        '<string>:2: <frame> "f" (mocap does nothing in frame)',
    ]


RULES = {
    "bounds": 'boundmass="9" boundinertia=".5"',
    "a total mass of its own, which counts for nothing": 'settotalmass="5"',
    "balance": 'balanceinertia="true"',
    "always from geoms": 'inertiafromgeom="true"',
    "groups": 'inertiagrouprange="3 4"',
}
HEAVY = """<mujoco><compiler {0}/><worldbody><body name="a"><joint axis="1 0 0"/>
    <geom type="box" size=".1 .2 .3" group="3" pos=".1 0 0"/><geom size=".2" group="2"/>
    <body pos="0 1 0"><joint/><inertial pos="0 0 .1" mass="2" diaginertia="1 2 {1}"/>
      <geom size=".1" group="2"/></body></body></worldbody></mujoco>"""


@every_pair(turned=(False, True), what=RULES)
def test_bodies_follow_the_rules_of_their_own_model(
    what: str, turned: bool, tmp_path: Path
) -> None:
    """And those of the other model the other's; turned: which of them has the rules."""
    one, other = HEAVY.format(RULES[what], 4 if "balance" in what else 2.5), HEAVY.format("", 2.5)
    attach = '<asset><model name="kid" file="kid.xml"/></asset><worldbody>{}<attach model="kid" '
    attach = attach.format('<frame pos="3 0 0"/>') + 'prefix="k"/>'
    outer, inner = (one, other) if turned else (other, one)
    (tmp_path / "kid.xml").write_text(inner)
    (tmp_path / "m.xml").write_text(outer.replace("<worldbody>", attach))
    theirs = mujoco.MjModel.from_xml_path(str(tmp_path / "m.xml"))
    scene = load(tmp_path / "m.xml")
    compiled.compare(scene, theirs)
    compiled.compare(loads(scene.to_mjcf()), theirs)


STATEFUL = """<mujoco><worldbody>
  <body name="h" mocap="true" pos="1 2 3"><geom size=".1"/></body>
  <body name="b"><joint name="j"/><geom size=".1"/>
    <body name="c"><joint name="k" type="ball"/><geom size=".1"/></body></body>
  <body name="i" mocap="true"><geom size=".1"/></body></worldbody>
  <actuator><motor name="m" joint="j"/><position name="p" joint="j" kp="2" timeconst=".1"/>
    <pid name="d" joint="j" kp="3" ki="2" input="pos"/><intvelocity name="v" joint="j" kp="1"
    actrange="-9 9"/><motor name="n" joint="j"/></actuator>
  <keyframe><key name="x" qpos="1 0 0 1 0" ctrl="1 2 3 4 5" act="7 8 9" mpos="1 2 3 4 5 6"
    mquat="0 1 0 0 0 0 1 0"/></keyframe></mujoco>"""


def test_keyframes_come_with_their_activations_and_mocap_bodies(tmp_path: Path) -> None:
    """Those of bodies and actuators that come along, each in its new place."""
    (tmp_path / "kid.xml").write_text(STATEFUL)
    (tmp_path / "m.xml").write_text("""<mujoco>
  <asset><model name="kid" file="kid.xml"/></asset><worldbody>
  <body name="o" mocap="true"><geom size=".1"/></body>
  <body><joint name="oj"/><geom size=".1"/></body>
  <attach model="kid" prefix="K-"/></worldbody>
  <actuator><intvelocity joint="oj" kp="1" actrange="-1 1"/></actuator></mujoco>""")
    theirs = mujoco.MjModel.from_xml_path(str(tmp_path / "m.xml"))
    model = load(tmp_path / "m.xml").compile()
    sim, data = Sim(model), mujoco.MjData(theirs)
    mujoco.mj_resetDataKeyframe(theirs, data, 0)
    sim.reset(key="K-x")
    for field in ("qpos", "ctrl", "act", "mocap_pos", "mocap_quat"):
        assert getattr(sim, field) == pytest.approx(getattr(data, field), abs=1e-15), field
    assert sim.act == pytest.approx([0, 7, 8, 9])


ALIGNING = """<mujoco><compiler alignfree="true"/>
  <asset><model name="kid" file="kid.xml"/></asset><worldbody>
    <body name="a" pos="1 2 3" euler="10 20 30"><freejoint/>
      <geom type="box" size="1 .2 .3" pos="1 0 0" euler="0 0 40"/><geom size=".3"/></body>
    <frame pos="0 0 9"><attach model="kid" prefix="K-"/></frame></worldbody></mujoco>"""
KID = """<mujoco><worldbody><body name="k" pos="0 0 1"><joint type="slide"/><geom size=".1"/></body>
    <body name="f" pos="0 3 1" euler="0 0 30"><freejoint/><geom size=".1" pos=".2 0 0"/>
      <geom type="box" size=".1 .2 .3"/></body></worldbody>
  <keyframe><key name="x" {}/></keyframe></mujoco>"""


@pytest.mark.parametrize("key", ['qpos=".4 1 2 3 0 1 0 0"', 'qvel="1 2 3 4 5 6 7"', 'time="2"'])
def test_keyframes_leave_other_free_bodies_where_they_are_aligned(key, tmp_path: Path) -> None:
    (tmp_path / "kid.xml").write_text(KID.format(key))
    (tmp_path / "main.xml").write_text(ALIGNING)
    theirs = mujoco.MjModel.from_xml_path(str(tmp_path / "main.xml"))
    model = load(tmp_path / "main.xml").compile()
    assert model.qpos0 == pytest.approx(theirs.qpos0, abs=1e-9)
    assert list(model.keys[0].qpos) == pytest.approx(theirs.key_qpos[0], abs=1e-9)


def test_models_are_attached_in_the_order_of_the_file(tmp_path: Path) -> None:
    """Actuators too, whether the <attach> stands in an inner body or in a frame."""
    (tmp_path / "kid.xml").write_text(CHILD.split("<keyframe>")[0] + "</mujoco>")
    (tmp_path / "m.xml").write_text(
        parent(
            '<body name="q"><joint name="qj"/><geom/><attach model="kid" body="b" prefix="K-"/>'
            '</body><frame><attach model="kid" body="c" prefix="L-"/></frame>',
            world='<attach model="kid" frame="fr" prefix="M-"/>',
        )
    )
    scene = load(tmp_path / "m.xml")
    compiled.compare(scene, mujoco.MjModel.from_xml_path(str(tmp_path / "m.xml")))
    assert [a.name for a in scene.actuators] == ["mo", "K-m", "L-mk", "M-ml"]


def test_models_within_models_find_their_files(tmp_path: Path) -> None:
    """Each model's files lie beside it; keyframes come through both."""
    (tmp_path / "deep").mkdir()
    (tmp_path / "deep" / "shapes").mkdir()
    obj = "v 0 0 0\nv 1 0 0\nv 0 1 0\nv 0 0 1\nf 1 3 2\nf 1 2 4\nf 2 3 4\nf 3 1 4\n"
    (tmp_path / "deep" / "shapes" / "tetra.obj").write_text(obj)
    (tmp_path / "deep" / "in.xml").write_text(
        """<mujoco><compiler meshdir="shapes" angle="radian"/>
  <asset><mesh file="tetra.obj"/></asset>
  <worldbody><body name="i"><joint name="j" range="0 1"/><geom type="mesh" mesh="tetra"/></body>
  </worldbody><actuator><motor name="m" joint="j"/></actuator>
  <keyframe><key name="k" qpos=".5" ctrl="3"/></keyframe></mujoco>"""
    )
    (tmp_path / "deep" / "mid.xml").write_text(
        """<mujoco><asset><model name="in" file="in.xml"/></asset><worldbody>
  <body name="p"><joint name="j"/><geom size=".1"/></body>
  <attach model="in" prefix="in-"/></worldbody></mujoco>"""
    )
    (tmp_path / "m.xml").write_text(
        """<mujoco><asset><model name="mid" file="deep/mid.xml"/></asset><worldbody>
  <frame pos="1 0 0"><attach model="mid" prefix="mid-"/></frame></worldbody></mujoco>"""
    )
    scene = load(tmp_path / "m.xml")
    # MuJoCo loses the outer prefix of such a keyframe, and says so.
    assert scene.keys[0].name == "in-k"
    assert any("They will not be namespaced correctly" in note for note in scene.notes)
    assert (scene.keys[0].qpos, scene.keys[0].ctrl) == ((0.0, 0.5), (3.0,))
    inner = (tmp_path / "deep" / "in.xml").read_text().split("<keyframe>")[0] + "</mujoco>"
    (tmp_path / "deep" / "in.xml").write_text(inner)
    theirs = mujoco.MjModel.from_xml_path(str(tmp_path / "m.xml"))
    compiled.compare(load(tmp_path / "m.xml"), theirs)
    assert [mesh.name for mesh in scene.meshes] == ["mid-in-tetra"]
    files = [Path(file).name for file in scene._source.files]
    assert files == ["m.xml", "mid.xml", "in.xml", "tetra.obj"]


CLASSED = """<mujoco model="next"><default>{defaults}</default>{asset}<worldbody>
  <body name="{name}"><joint/><geom class="own"/>{inside}</body></worldbody></mujoco>"""


@pytest.mark.parametrize("named", ['name="next"', ""])
def test_models_without_a_prefix_keep_their_own_defaults(named: str, tmp_path: Path) -> None:
    """Each has a class of the same name, at another depth; MuJoCo cannot read what it writes."""
    own = '<default class="own"><geom size="{}"/></default>'
    inner = CLASSED.format(
        defaults=f'<default class="all">{own.format(0.2)}</default>', asset="", name="in", inside=""
    )
    asset = f'<asset><model {named} file="{{}}"/></asset>'
    attach = '<frame pos="1 0 0"><attach model="next" prefix=""/></frame>'
    middle = CLASSED.format(
        defaults=own.format(0.3), asset=asset.format("in.xml"), name="mid", inside=attach
    )
    (tmp_path / "in.xml").write_text(inner)
    (tmp_path / "mid.xml").write_text(middle)
    outer = f"<mujoco>{asset.format('mid.xml')}<worldbody>{attach}</worldbody></mujoco>"
    (tmp_path / "m.xml").write_text(outer)
    scene = load(tmp_path / "m.xml")
    assert [geom.size[0] for geom in scene.geoms] == [0.3, 0.2]


def test_options_that_are_not_taken_over_are_noted(tmp_path: Path) -> None:
    (tmp_path / "kid.xml").write_text(CHILD)
    text = parent('<attach model="kid" body="b" prefix="K-"/>')
    (tmp_path / "m.xml").write_text(text)
    notes = load(tmp_path / "m.xml").notes
    assert any("timestep: parent has 0.002" in note and "gravity: " in note for note in notes)


WRONG = {
    'no such model; nearest: "kid"': '<attach model="kit" prefix="a"/>',
    "could not find body 'bbb'": '<attach model="kid" body="bbb" prefix="a"/>',
    "could not find frame 'frr'": '<attach model="kid" frame="frr" prefix="a"/>',
    "<attach> of a part of the same model is not built": '<attach prefix="a"/>',
    "direct child of replicate": '<replicate count="2"><joint/></replicate>',
    "at most 1000000 copied elements": '<replicate count="2000000000"><geom/></replicate>',
    "count = -1: must be >= 0": '<replicate count="-1"><geom/></replicate>',
    "already exists with prefix a": '<attach model="kid" body="b" prefix="a"/>' * 2,
}


@pytest.mark.parametrize("says", WRONG)
def test_mistakes_have_their_line(says: str, tmp_path: Path) -> None:
    (tmp_path / "kid.xml").write_text(CHILD)
    with pytest.raises(MJCFError, match=f"^<string>:4: .*{says}"):
        loads(parent(WRONG[says]), base=tmp_path)


def test_conflicts_and_circles_are_errors(tmp_path: Path) -> None:
    (tmp_path / "kid.xml").write_text(CHILD)
    body = '<attach model="kid" body="b" prefix="K-"/>'
    for policy, option in (("error", 'timestep="1"'), ("merge", 'gravity="0 0 -2"')):
        before = f'<compiler conflict="{policy}"/><option {option}/>'
        with pytest.raises(MJCFError, match=r"^<string>:4: .*conflict"):
            loads(parent(body, before), base=tmp_path)
    (tmp_path / "kid.xml").write_text(parent('<attach model="kid" prefix="x"/>'))
    with pytest.raises(MJCFError, match="attaches itself"):
        load(tmp_path / "kid.xml")
    with pytest.raises(MJCFError, match="needs loads"):
        loads(parent(body))
    with pytest.raises(FileNotFoundError, match=r"<string>:1: .*gone\.xml"):
        loads(parent(body).replace("kid.xml", "gone.xml"), base=tmp_path)
    (tmp_path / "kid.xml").write_text(CHILD.replace("<option", '<option foo="1"'))
    with pytest.raises(MJCFError, match=r"kid\.xml:2: unknown attribute"):
        loads(parent(body), base=tmp_path)


def test_what_an_attach_tears_apart_is_left_out_with_a_note(tmp_path):
    """A tendon between what is attached and what is not; what has nothing of it needs no word."""
    (tmp_path / "kid.xml").write_text(
        """<mujoco model="kid"><worldbody><site name="post"/>
        <body name="arm"><joint name="hinge"/><geom size=".1"/><site name="tip"/></body>
        <body name="leg"><joint name="knee"/><geom size=".1"/></body></worldbody>
        <tendon><spatial name="rope" stiffness="1"><site site="post"/><site site="tip"/></spatial>
        <fixed name="both"><joint joint="hinge" coef="1"/></fixed></tendon>
        <equality><weld body1="leg" body2="world"/></equality>
        <actuator><motor joint="knee"/><motor tendon="rope"/></actuator></mujoco>"""
    )
    (tmp_path / "m.xml").write_text(
        """<mujoco><asset><model name="kid" file="kid.xml"/></asset><worldbody>
        <attach model="kid" body="arm" prefix="k_"/></worldbody></mujoco>"""
    )
    scene = load(tmp_path / "m.xml")
    assert [tendon.name for tendon in scene.tendons] == ["k_both"] and not scene.actuators
    told = [note for note in scene.notes if "leaves out" in note]
    assert len(told) == 1
    assert told[0].endswith("m.xml:2: <attach> leaves out rope")


def test_mujoco_writes_no_warnings_while_it_expands(tmp_path, monkeypatch, capfd):
    """Its C code wrote them to stderr and into MUJOCO_LOG.TXT, beside the note that is kept."""
    monkeypatch.chdir(tmp_path)
    body = '<body name="b"><joint/><geom size="1"/></body>'
    (tmp_path / "part.xml").write_text(
        f'<mujoco model="part"><option timestep=".01"/><worldbody>{body}</worldbody></mujoco>'
    )
    (tmp_path / "whole.xml").write_text(
        '<mujoco model="whole"><asset><model name="part" file="part.xml"/></asset><worldbody>'
        '<attach model="part" body="b" prefix=""/></worldbody></mujoco>'
    )
    scene = load(tmp_path / "whole.xml")
    MuJoCo(tmp_path / "whole.xml")
    (said,) = [note for note in scene.notes if "MuJoCo: " in note]
    assert "timestep: parent has 0.002 (default), child has 0.01, keeping parent value" in said
    assert capfd.readouterr().err == ""
    assert sorted(file.name for file in tmp_path.iterdir()) == ["part.xml", "whole.xml"]
