"""Options of `<compiler>` that move bodies or change masses make MuJoCo's model."""

import compiled
import mujoco
import numpy as np
import pytest
from covering import every_pair

from stepcore import Scene, loads
from stepcore.mjcf.nodes import MJCFError

FREE = """<mujoco><compiler {0}/><default><geom density="800"/></default>
  <asset><mesh name="m" vertex="0 0 0 .5 0 0 0 .25 0 0 0 1"/></asset>
  <worldbody><body name="a" pos="1 2 3" euler="10 20 30"><freejoint {1}/>{2}
    <site name="s" pos="1 1 1"/></body></worldbody>
  <keyframe><key qpos="5 6 7 1 0 0 0"/><key qvel="1 2 3 4 5 6"/></keyframe></mujoco>"""
BOX = '<geom type="box" size="1 .2 .3" pos="1 0 0" euler="0 0 40"/>'
TWO = BOX + '<geom size=".3"/>'
ON = 'alignfree="true"'
ALIGNED = {
    "two geoms": FREE.format(ON, "", TWO),
    "by the joint": FREE.format("", 'align="true"', TWO),
    "not by the joint": FREE.format(ON, 'align="false"', TWO),
    "one geom": FREE.format(ON, "", BOX),
    "one with mass": FREE.format(ON, "", BOX + '<geom size="1" mass="0"/>'),
    "one in the groups": FREE.format(
        f'{ON} inertiagrouprange="0 2"', "", BOX + '<geom size="1" group="3"/>'
    ),
    "moments that a bound makes equal": FREE.format(f'{ON} boundinertia="900"', "", TWO),
    "with a child": FREE.format(ON, "", TWO + '<body name="c"><geom size=".1"/></body>'),
    "moments": FREE.format(
        ON, "", TWO + '<inertial pos="1 2 3" mass="2" diaginertia="1 2 2.5" euler="10 0 0"/>'
    ),
    "a full inertia": FREE.format(
        ON, "", TWO + '<inertial pos="1 2 3" mass="2" fullinertia="1 2 2.5 .1 .2 .3"/>'
    ),
    "geoms instead of moments": FREE.format(
        f'{ON} inertiafromgeom="true"',
        "",
        TWO + '<inertial pos="1 2 3" mass="2" diaginertia="1 2 2.5"/>',
    ),
    "a joint of type free": FREE.format(ON, "", TWO).replace("<freejoint", '<joint type="free"'),
}
FUSED = """<mujoco><compiler fusestatic="true" {0}/><worldbody><geom name="w" size=".1"/>
  <body name="mv" pos="0 1 0"><joint name="j" axis="1 0 0"/>{1}
    <body name="st" {2} pos="0 0 1" euler="90 0 10"><geom name="gs" type="box" size=".1 .2 .3"/>{3}
      <site name="s" pos="1 0 0"/>
      <body name="in" pos="1 0 0"><geom name="gi" size=".1"/>
        <body name="k1" pos="0 0 1"><joint name="jk"/><geom name="gk" size=".1"/></body></body>
    </body>
    <body name="k2" pos="0 2 0"><joint name="j2"/><geom size=".1"/></body>
    <body name="st2" pos=".1 0 0"><geom name="gs2" size=".1"/></body>
    <geom name="gm2" size=".2" pos="1 1 1"/></body>
  <body name="W" pos="1 1 1" euler="0 45 0"><geom name="wg" size="1"/>
    <body name="k3" pos="1 0 0"><joint name="j3"/><geom size=".1" name="k3g"/></body></body>
  <geom name="w2" size=".1"/></worldbody>{4}</mujoco>"""
GM = '<geom name="gm" size=".2"/>'
INERTIAL = '<inertial pos="1 0 0" mass="2" diaginertia="1 2 2.5" euler="0 0 20"/>'
FUSING = {
    "geoms": FUSED.format("", GM, "", "", ""),
    "the parent's inertial": FUSED.format("", INERTIAL, "", "", ""),
    "its own inertial": FUSED.format("", GM, "", INERTIAL, ""),
    "both": FUSED.format("", INERTIAL, "", INERTIAL, ""),
    "always from geoms": FUSED.format('inertiafromgeom="true"', INERTIAL, "", INERTIAL, ""),
    "a total mass": FUSED.format('settotalmass="7"', GM, "", INERTIAL, ""),
    "kept by its attribute": FUSED.format("", GM, 'fuse="false"', "", ""),
    "kept by a pair": FUSED.format(
        "", GM, "", "", '<contact><exclude body1="st" body2="k2"/></contact>'
    ),
    "kept by a tuple": FUSED.format(
        "",
        GM,
        "",
        "",
        '<custom><tuple name="t"><element objtype="body" objname="st"/></tuple></custom>',
    ),
    "kept by a force": FUSED.format("", GM, "", "", '<sensor><force site="s"/></sensor>'),
    "under a bound of masses": FUSED.format('boundmass="3"', GM, "", INERTIAL, ""),
    "under a bound of geoms' masses": FUSED.format('boundmass="3"', GM, "", "", ""),
    "under a bound of inertias": FUSED.format('boundinertia=".7"', INERTIAL, "", "", ""),
    "of the world, held up": FUSED.format("", GM, "", "", "").replace(
        'name="W"', 'name="W" gravcomp=".5"'
    ),
    "within a body of the world, held up": FUSED.format("", GM, "", "", "").replace(
        '<body name="k3"', '<body name="V" gravcomp="1"><geom size=".2"/></body><body name="k3"'
    ),
    "held up alone, in a massless body": FUSED.format("", GM, 'gravcomp="1"', "", "").replace(
        '<geom name="gs" type="box" size=".1 .2 .3"/>', ""
    ),
    "kept by a camera": FUSED.format(
        "", GM + '<camera target="st" mode="targetbody"/>', "", "", ""
    ),
}
MASSES = {
    "boundmass": 'boundmass="9"',
    "boundinertia": 'boundinertia=".5"',
    "settotalmass": 'settotalmass="5"',
    "balanceinertia": 'balanceinertia="true"',
    "inertiafromgeom": 'inertiafromgeom="true"',
    "inertiagrouprange": 'inertiagrouprange="2 4"',
    "several": 'inertiagrouprange="0 2" boundmass="9" boundinertia=".5" settotalmass="100"',
}
HEAVY = """<mujoco><compiler {0}/><worldbody><body name="a"><joint axis="1 0 0"/>
    <geom type="box" size=".1 .2 .3" group="3" pos=".1 0 0"/><geom size=".2" group="2"/>
    <body pos="0 1 0"><joint/><inertial pos="0 0 .1" mass="2" diaginertia="1 2 {1}"/>
      <geom size=".1" group="2"/></body></body>
  <body name="still"><geom size=".1"/></body></worldbody></mujoco>"""


DISCARDED = """<mujoco><compiler discardvisual="true" {0}/>
  <asset><mesh name="m" vertex="0 0 0 .5 0 0 0 .25 0 0 0 1"/></asset>
  <worldbody><body name="a"><joint/><geom name="v" type="box" size="1 .5 .2" pos="1 0 0" contype="0"
      conaffinity="0"/><geom name="c" size=".5"/>{1}</body>
    <body name="b"><joint/><geom name="v2" size="1" contype="0" conaffinity="0"/>
      <geom name="pc" size=".1" contype="0" conaffinity="0"/></body>
    <geom name="wv" size="1" contype="0" conaffinity="0"/></worldbody>{2}</mujoco>"""
DISCARDING = {
    "masses stay": DISCARDED.format("", "", ""),
    "an inertial": DISCARDED.format("", '<inertial pos="0 0 1" mass="1" diaginertia="1 1 1"/>', ""),
    "in pairs": DISCARDED.format("", "", '<contact><pair geom1="pc" geom2="c"/></contact>'),
    "sensed": DISCARDED.format(
        "", "", '<sensor><distance geom1="v" geom2="c" cutoff="1"/></sensor>'
    ),
    "and fused": DISCARDED.format('fusestatic="true"', "<body>" + TWO + "</body>", ""),
}


# A body that weighs nothing by itself, and how it is held.
WEIGHTLESS = """<mujoco><compiler {rules}/><worldbody>{before}
    <body name="b" pos=".3 0 1" euler="30 20 0">{inside}</body>{after}</worldbody>
  <sensor><framepos objtype="body" objname="{name}"/></sensor></mujoco>"""
HOLDS = {
    "nothing": ("", ""),
    "a frame": ('<frame pos="0 0 .3" euler="0 0 20">', "</frame>"),
    "two frames": ('<frame pos="1 0 0"><frame euler="0 0 20">', "</frame></frame>"),
    "copies": ('<replicate count="2" offset="0 1 0" euler="0 0 20">', "</replicate>"),
    "a frame of a body": (
        '<body pos="0 0 1"><joint/><geom size=".1"/><frame pos="0 0 .3" euler="0 0 20">',
        "</frame></body>",
    ),
}
INSIDE = {
    "nothing": "",
    "a geom": '<geom size=".1"/>',
    "a joint": '<joint type="slide"/>',
    "a weightless geom": '<geom size=".1" mass="0"/>',
    "an empty inertial": '<inertial mass="0" pos=".1 .2 0" euler="20 0 0"/>',
}


@every_pair(
    rules=["", 'inertiafromgeom="false"', 'inertiagrouprange="3 4"', 'inertiafromgeom="true"'],
    inside=INSIDE,
    held=HOLDS,
)
def test_bodies_without_mass(rules: str, inside: str, held: str) -> None:
    """MuJoCo takes the pose that such a body is written with for that of its inertia."""
    before, after = HOLDS[held]
    for bounds in ("", ' boundmass="5" boundinertia=".1"'):
        text = WEIGHTLESS.format(
            rules=rules + bounds,
            before=before,
            inside=INSIDE[inside],
            after=after,
            name="b0" if held == "copies" else "b",
        )
        try:
            theirs = mujoco.MjModel.from_xml_string(text)
        except ValueError:
            with pytest.raises(ValueError, match="mass"):
                loads(text).compile()
            continue
        scene = loads(text)
        for ours in (scene, loads(scene.to_mjcf())):
            model = ours.compile()
            for name in ("mass", "ipos") + (("iquat",) if bounds or theirs.nv == 0 else ()):
                got = np.array(getattr(model, f"body_{name}"))
                assert got[1:] == pytest.approx(getattr(theirs, f"body_{name}")[1:], abs=1e-12)


@pytest.mark.parametrize("what", DISCARDING)
def test_visual_geoms_are_discarded(what: str) -> None:
    compiled.compare(loads(DISCARDING[what]), mujoco.MjModel.from_xml_string(DISCARDING[what]))


def test_visual_geoms_that_alone_give_mass_are_not_discarded() -> None:
    with pytest.raises(MJCFError, match="would change the inertia"):
        loads(DISCARDED.format('inertiafromgeom="true"', "", ""))


@pytest.mark.parametrize("what", ALIGNED)
def test_free_bodies_are_aligned(what: str) -> None:
    compiled.compare(loads(ALIGNED[what]), mujoco.MjModel.from_xml_string(ALIGNED[what]))


@pytest.mark.parametrize("what", FUSING)
def test_static_bodies_are_fused(what: str) -> None:
    compiled.compare(loads(FUSING[what]), mujoco.MjModel.from_xml_string(FUSING[what]))


@pytest.mark.parametrize("what", MASSES)
def test_rules_for_masses(what: str) -> None:
    text = HEAVY.format(MASSES[what], 4 if what == "balanceinertia" else 2.5)
    compiled.compare(loads(text), mujoco.MjModel.from_xml_string(text))


def test_a_mesh_is_aligned_up_to_single_precision() -> None:
    text = ALIGNED["one geom"].replace(BOX, '<geom type="mesh" mesh="m"/>')
    scene, theirs = loads(text), mujoco.MjModel.from_xml_string(text)
    assert scene.compile().qpos0 == pytest.approx(theirs.qpos0, abs=1e-6)


def test_principal_axes_are_mujocos() -> None:
    chance = np.random.default_rng(3)
    scene, quats = Scene(), []
    for _ in range(300):
        root = chance.normal(size=(3, 3)) * chance.choice([1.0, 0.3], size=(1, 3))
        spread = root @ root.T * 10.0 ** chance.integers(-6, 4)
        inertia = np.trace(spread) * np.eye(3) - spread
        moments, axes, quat = np.zeros(3), np.zeros(9), np.zeros(4)
        mujoco.mju_eig3(moments, axes, quat, inertia.ravel())
        quats.append(quat)
        six = inertia[[0, 1, 2, 0, 0, 1], [0, 1, 2, 1, 2, 2]]
        scene.add_body(mass=1.0, inertia=six)
    assert scene.compile().body_iquat[1:] == pytest.approx(np.array(quats), abs=1e-9)


def test_fusing_under_bounds_is_refused() -> None:
    with pytest.raises(MJCFError, match="with bounds of their inertia is not built yet"):
        loads(FUSED.format('boundmass="1" inertiafromgeom="true"', GM, "", "", ""))
