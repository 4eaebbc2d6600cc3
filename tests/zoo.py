"""Small MJCF scenes, one per row kind, per shape pair and per joint, and one with all together.

`ZOO[name]` is an `Entry`: the text, the kinds of rows its states must reach
(so that a scene that never touches anything fails instead of passing idly),
and how far from the initial configuration its states start.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

CONTACT, LIMIT, FRICTION, EQUALITY = "contact", "limit", "friction", "equality"


@dataclass(frozen=True)
class Entry:
    """One scene: MJCF text, the rows its states must reach, how widely they start."""

    text: str
    rows: frozenset[str] = frozenset()
    spread: float = 0.3
    speed: float = 1.0


def mjcf(body: str, extra: str = "", dt: float = 0.004, option: str = "") -> str:
    """A whole MJCF document around the children of its world body."""
    return (
        f'<mujoco><option timestep="{dt}" {option}/><worldbody>{body}</worldbody>{extra}</mujoco>'
    )


FLOOR = '<geom name="floor" type="plane" size="3 3 .1"/>'
# Weighs, never collides.
INERT = 'contype="0" conaffinity="0"'
# Box against capsule is not built: boxes meet only what carries their bit, the spheres.
# What carries these bits meets the ground that carries these, and not its like.
ALOOF, GROUND = 'contype="1" conaffinity="2"', 'contype="2" conaffinity="1"'
BOXES, MEETS_BOXES = 'contype="2" conaffinity="2"', 'contype="3" conaffinity="3"'

ZOO: dict[str, Entry] = {}


def _add(name: str, body: str, *rows: str, spread: float = 0.3, speed: float = 1.0, **kw) -> None:
    ZOO[name] = Entry(mjcf(body, **kw), frozenset(rows), spread, speed)


# --- joints, inertia, smooth forces -------------------------------------------------------------

_add(
    "slide_springs",
    f"""
    <body pos="0 0 1"><joint type="slide" axis="0 0 1" stiffness="80" springref=".2" damping="2"/>
      <geom size=".1" mass="1" {INERT}/>
      <body pos=".3 0 0"><joint type="slide" axis="1 1 0" ref=".4" stiffness="30" armature=".3"/>
        <geom type="box" size=".1 .05 .2" quat=".8 .2 -.3 .1" mass="2" {INERT}/></body></body>
    <body pos="1 0 1"><joint type="slide" axis="0 1 0" armature=".5"/>
      <geom type="box" size=".1 .2 .3" mass="1.5" {INERT}/></body>
    """,
)
_add(
    "several_joints",
    f"""
    <body pos="0 0 1" euler="20 -30 10">
      <joint type="slide" axis="1 0 .2" pos=".1 0 0" damping=".5"/>
      <joint axis="0 1 0" pos="0 .1 .05" armature=".02"/>
      <joint axis="1 0 1" pos="-.05 0 .1" stiffness="3" springref="25"/>
      <geom type="capsule" size=".04" fromto="0 0 0 .3 .1 -.1" {INERT}/>
      <site name="tip" pos=".3 .1 -.1" euler="0 40 0"/>
      <body pos=".3 .1 -.1" quat=".5 .1 -.7 .2">
        <joint axis="0 0 1" ref="35"/><joint axis="0 1 0" pos="0 0 .1"/>
        <geom type="ellipsoid" size=".1 .06 .04" pos=".05 .02 0" {INERT}/>
        <geom type="cylinder" size=".03 .1" pos="0 .1 0" {INERT}/>
        <site name="end" pos="0 .2 .1"/></body></body>
    """,
)
_add(
    "ball_joints",
    f"""
    <body pos="0 0 1"><joint type="ball" pos=".05 0 .1" damping=".2" stiffness="1.5"/>
      <geom type="capsule" size=".04" fromto="0 0 0 .3 .1 0" {INERT}/>
      <body pos=".3 .1 0" euler="30 40 0">
        <joint type="slide" axis="1 0 0" stiffness="50"/><joint type="ball" armature=".01"/>
        <inertial pos=".1 .05 0" mass=".7" fullinertia=".02 .03 .025 .004 -.003 .002"/>
      </body></body>
    """,
    speed=3.0,
)
_add(
    "free_offset",
    """
    <body pos="0 0 1" euler="10 20 30"><freejoint/>
      <inertial pos=".1 .05 -.02" mass="2" diaginertia=".1 .2 .25" quat=".5 .1 .3 .2"/></body>
    <body pos="1 0 1"><joint type="free" damping=".4" armature=".05" stiffness="2"/>
      <inertial pos="0 .1 0" mass="1" diaginertia=".05 .05 .05"/>
      <body pos=".2 0 .1" euler="0 50 0">
        <inertial pos=".1 0 0" mass=".5" diaginertia=".01 .02 .025"/></body></body>
    """,
    speed=4.0,
)
_add(
    "free_limb",
    f"""
    <body pos="0 0 1"><freejoint/><geom type="box" size=".1 .2 .05" pos=".05 0 0" {INERT}/>
      <body pos=".1 .2 0"><joint axis="1 2 0" damping=".3"/>
        <geom type="capsule" size=".03" fromto="0 0 0 0 .3 .1" {INERT}/>
        <body pos="0 .3 .1"><joint type="ball"/>
          <geom type="capsule" size=".03 .1" pos=".1 0 0" {INERT}/></body></body></body>
    """,
    speed=3.0,
)
_add(
    "motors",
    f"""
    <body pos="0 0 1"><joint name="a" axis="0 1 0" damping="1"/>
      <geom type="capsule" size=".04" fromto="0 0 0 .3 0 0" {INERT}/>
      <body pos=".3 0 0"><joint name="b" axis="0 1 0"/>
        <geom type="capsule" size=".03" fromto="0 0 0 .2 0 0" {INERT}/>
        <body pos=".2 0 0"><joint name="c" type="slide" axis="1 0 0" stiffness="40"/>
          <geom size=".05" {INERT}/></body></body></body>
    """,
    extra="""<actuator><motor joint="a" gear="3" ctrlrange="-.5 .5"/>
      <motor joint="b" gear="-1.5" forcerange="-.2 .4"/>
      <motor joint="c" gear="20" ctrllimited="true" ctrlrange="-1 .3" forcerange="-.5 .5"/>
      <motor joint="a" gear=".1"/></actuator>""",
)

# Six joints, each with a servo of another kind; their forces are often at their bounds.
_add(
    "servo_arm",
    f"""
    <body pos="0 0 .2"><joint name="j1" axis="0 0 1" damping=".5" armature=".1" range="-90 90"/>
      <geom type="capsule" size=".06" fromto="0 0 0 0 0 .2" {INERT}/>
      <body pos="0 0 .2"><joint name="j2" axis="0 1 0" armature=".1"/>
        <geom type="capsule" size=".05" fromto="0 0 0 .3 0 0" {INERT}/>
        <body pos=".3 0 0"><joint name="j3" axis="0 1 0" armature=".05" damping=".2"/>
          <geom type="capsule" size=".04" fromto="0 0 0 .25 0 0" {INERT}/>
          <body pos=".25 0 0"><joint name="j4" axis="1 0 0" armature=".01"/>
            <geom type="capsule" size=".035" fromto="0 0 0 .1 0 0" {INERT}/>
            <body pos=".1 0 0"><joint name="j5" axis="0 1 0" ref="20"/>
              <geom type="capsule" size=".03" fromto="0 0 0 .08 0 0" {INERT}/>
              <body pos=".08 0 0"><joint name="j6" type="slide" axis="1 0 0"/>
                <geom type="box" size=".02 .04 .01" {INERT}/>
              </body></body></body></body></body></body>
    """,
    extra="""<actuator>
      <position name="s1" joint="j1" kp="200" dampratio="1" inheritrange=".9"/>
      <position name="s2" joint="j2" kp="300" kv="20" forcerange="-30 30"/>
      <position name="s3" joint="j3" kp="4" dampratio=".5" gear="5" ctrlrange="-2 2"
        forcerange="-3 4"/>
      <velocity name="s4" joint="j4" kv=".8" gear="2" forcerange="-.5 .5"/>
      <general name="s5" joint="j5" gainprm="7" biastype="affine" biasprm=".1 -5 -.02"/>
      <position name="s6" joint="j6" kp="500" dampratio="1.2" gear="-1"/>
      <velocity name="s7" joint="j1" kv="-.3"/>
      <motor name="m" joint="j2" gear="2"/></actuator>""",
    speed=2.0,
    dt=0.002,
)

# --- friction loss, limits, connect -------------------------------------------------------------

_add(
    "friction_loss",
    f"""
    <body pos="0 0 1"><joint axis="0 1 0" frictionloss="3"/>
      <geom type="capsule" size=".04" fromto="0 0 0 .3 0 0" {INERT}/>
      <body pos=".3 0 0"><joint axis="0 1 1" frictionloss=".02" damping=".1"
          solimpfriction=".6 .9 0 .5 2"/>
        <geom type="capsule" size=".03" fromto="0 0 0 .2 0 0" {INERT}/></body></body>
    <body pos="1 0 1"><joint type="slide" axis="0 0 1" frictionloss="40" solreffriction=".05 1"
        solimpfriction=".7 .9 .01 .5 2"/><geom size=".1" mass="1" {INERT}/></body>
    <body pos="2 0 1"><joint type="ball" frictionloss=".05" solreffriction="-60 -8"/>
      <geom type="box" size=".1 .05 .2" pos=".1 0 0" {INERT}/></body>
    <body pos="3 0 1"><joint type="free" frictionloss=".3"/>
      <inertial pos=".05 0 0" mass="1" diaginertia=".01 .02 .025"/></body>
    """,
    FRICTION,
    speed=0.3,
)
_add(
    "limits",
    f"""
    <body pos="0 0 1"><joint axis="0 1 0" range="-20 25" margin="2"/>
      <geom type="capsule" size=".04" fromto="0 0 0 .3 0 0" {INERT}/>
      <body pos=".3 0 0"><joint axis="0 1 1" range="-10 5" solreflimit="-400 -15" damping=".05"
          solimplimit=".8 .97 .03 .3 3"/>
        <geom type="capsule" size=".03" fromto="0 0 0 .2 0 0" {INERT}/></body></body>
    <body pos="1 0 1"><joint type="slide" axis="0 0 1" range="-.1 .1" solreflimit=".05 .6"/>
      <geom size=".1" mass="1" {INERT}/></body>
    <body pos="2 0 1"><joint type="slide" axis="1 0 1" range="-.01 .02" margin=".04"
        solimplimit=".5 .5 .01 .5 2"/><geom type="box" size=".1 .1 .05" mass="1" {INERT}/></body>
    """,
    LIMIT,
)
_add(
    "ball_limit",
    f"""
    <body pos="0 0 1"><joint type="ball" pos="0 0 .1" range="0 20" margin="3"/>
      <geom type="capsule" size=".04" fromto="0 0 0 .3 .1 0" {INERT}/>
      <body pos=".3 .1 0"><joint type="ball" range="0 35" damping=".02" solreflimit=".03 .8"/>
        <geom type="box" size=".1 .06 .04" pos=".1 0 0" {INERT}/></body></body>
    """,
    LIMIT,
)
_add(
    "connect",
    f"""
    <body name="a" pos="0 0 1"><freejoint/>
      <geom type="box" size=".1 .2 .15" pos=".1 0 .05" {INERT}/>
      <body name="b" pos=".3 0 0">
        <joint type="slide" axis="0 1 .2"/><joint axis="1 2 3" pos=".05 .02 0"/>
        <geom type="capsule" size=".05 .1" pos="0 .1 0" quat=".3 .4 .5 .6" {INERT}/></body></body>
    <body name="c" pos="0 1 1"><joint type="ball" pos="0 0 .1"/>
      <geom type="box" size=".1 .1 .3" {INERT}/></body>
    """,
    EQUALITY,
    extra="""<equality>
      <connect body1="b" body2="c" anchor=".1 .2 .3" solref=".03 .9" solimp=".8 .93 .02 .4 3"/>
      <connect body1="a" anchor=".1 -.2 .1"/>
      <connect body1="c" body2="a" anchor="0 0 0" solref="-300 -20"/>
      <connect body1="a" body2="c" anchor="1 0 0" active="false"/></equality>""",
    spread=0.1,
)

# --- one scene per pair of shapes ---------------------------------------------------------------


def _mover(pos: str, geom: str, joint: str = "<freejoint/>") -> str:
    return f'<body pos="{pos}">{joint}<geom {geom}/></body>'


_SPHERE, _CAPSULE = 'type="sphere" size=".1"', 'type="capsule" size=".06 .12"'
_TILTED = f'<geom type="plane" size="3 3 .1" euler="8 -6 0" {{}}/>{FLOOR}'

_add(
    "plane_sphere",
    _TILTED.format("") + _mover(".3 0 .12", _SPHERE) + _mover("-.3 0 .1", _SPHERE),
    CONTACT,
)
_add(
    "plane_capsule",
    _TILTED.format('friction=".4"') + _mover("0 0 .12", _CAPSULE) + _mover("1 0 .1", _CAPSULE),
    CONTACT,
    spread=0.05,
)
_add(
    "sphere_sphere",
    "".join(f'<geom {_SPHERE} pos="{x} {y} 0"/>' for x in (0, 0.2) for y in (0, 0.2))
    + _mover(".11 .1 .13", _SPHERE)
    + _mover(".12 .11 .3", 'type="sphere" size=".08" friction=".3"'),
    CONTACT,
    spread=0.03,
)
_add(
    "sphere_capsule",
    '<geom type="capsule" size=".1 .3" euler="0 80 0"/>'
    '<geom type="capsule" size=".1 .3" pos="0 .25 0" euler="0 95 0"/>'
    + _mover(".1 .1 .18", _SPHERE)
    + '<body pos="-.2 .1 .18"><freejoint/><geom type="capsule" size=".05 .05"/>'
    '<geom type="sphere" size=".07" pos=".1 0 0"/></body>',
    CONTACT,
    spread=0.03,
)
_add(
    "capsule_capsule",
    '<geom type="capsule" size=".1 .4" euler="0 85 10"/>'
    '<geom type="capsule" size=".1 .4" pos="0 .25 0" euler="3 95 0"/>'
    + _mover(".1 .12 .16", 'type="capsule" size=".06 .15" euler="20 80 30"')
    + _mover(".05 .14 .32", 'type="capsule" size=".06 .12" euler="80 30 10"'),
    CONTACT,
    spread=0.03,
)
_add(
    "sphere_box",
    '<geom type="box" size=".4 .4 .1" euler="5 -7 20"/>'
    '<geom type="box" size=".1 .1 .1" pos=".2 .1 .2" euler="30 20 0"/>'
    + _mover("-.1 .1 .2", _SPHERE)
    + _mover(".2 -.1 .2", _SPHERE)
    + _mover("-.38 -.38 .19", 'type="sphere" size=".05" friction=".2"'),
    CONTACT,
    spread=0.03,
)

_add(
    "plane_ellipsoid",
    f'<geom type="plane" size="2 2 .1" euler="5 -8 0" {GROUND}/>'
    + _mover("0 0 .1", f'type="ellipsoid" size=".1 .06 .14" euler="80 30 10" {ALOOF}')
    + _mover(".4 0 .08", f'type="ellipsoid" size=".2 .15 .02" friction=".3" {ALOOF}')
    + _mover("-.4 .1 .1", f'type="ellipsoid" size=".1 .1 .1" pos=".02 0 0" {ALOOF}'),
    CONTACT,
    spread=0.05,
)
_add(
    "plane_cylinder",
    f'<geom type="plane" size="2 2 .1" euler="5 -8 0" {GROUND}/>'
    + _mover("0 0 .14", f'type="cylinder" size=".1 .15" {ALOOF}')
    + _mover(".4 0 .06", f'type="cylinder" size=".07 .2" euler="88 10 0" {ALOOF}')
    + _mover("-.4 .1 .1", f'type="cylinder" size=".1 .01" euler="40 20 0" condim="1" {ALOOF}'),
    CONTACT,
    spread=0.05,
)
_add(
    "plane_box",
    f'<geom type="plane" size="2 2 .1" euler="5 -8 0" {GROUND}/>'
    + _mover("0 0 .1", f'type="box" size=".15 .1 .1" {ALOOF}')
    + _mover(".5 0 .06", f'type="box" size=".02 .2 .06" euler="30 10 0" friction=".3" {ALOOF}')
    + _mover("-.5 .1 .2", f'type="box" size=".1 .2 .08" euler="40 70 10" condim="1" {ALOOF}')
    + '<body pos="0 .5 .1"><joint type="slide" axis="1 0 0"/><joint type="slide" axis="0 0 1"/>'
    f'<joint axis="0 1 0"/><geom type="box" size=".1 .1 .1" {ALOOF}/></body>',
    CONTACT,
    spread=0.05,
)

_add(
    "sphere_cylinder",
    f'<geom type="cylinder" size=".3 .1" euler="5 -7 20" {GROUND}/>'
    f'<geom type="cylinder" size=".06 .3" pos=".1 .1 .2" euler="80 20 0" {GROUND}/>'
    + _mover("-.1 .1 .19", f"{_SPHERE} {ALOOF}")
    + _mover(".15 -.05 .19", f"{_SPHERE} {ALOOF}")
    + _mover("-.28 -.2 .1", f'type="sphere" size=".05" friction=".2" {ALOOF}'),
    CONTACT,
    spread=0.03,
)
_add(
    "capsule_box",
    f'<geom type="box" size=".4 .4 .1" euler="5 -7 20" {GROUND}/>'
    f'<geom type="box" size=".1 .1 .1" pos=".2 .1 .2" euler="30 20 0" {GROUND}/>'
    + _mover("-.1 .1 .19", f'{_CAPSULE} euler="88 20 0" {ALOOF}')
    + _mover(".1 -.15 .2", f'type="capsule" size=".05 .2" euler="5 84 0" friction=".3" {ALOOF}')
    + _mover("-.3 -.2 .2", f'type="capsule" size=".06 .1" euler="40 10 0" condim="1" {ALOOF}'),
    CONTACT,
    spread=0.03,
)
_add(
    "box_box",
    '<geom type="box" size=".5 .4 .1" euler="2 -3 20"/>'
    + _mover("-.2 .05 .18", 'type="box" size=".1 .12 .08"')
    + _mover("-.2 .08 .33", 'type="box" size=".15 .05 .07" euler="2 1 30" friction=".3"')
    + _mover(".2 .05 .24", 'type="box" size=".1 .1 .1" euler="40 30 10"')
    + _mover(".55 -.1 .14", 'type="box" size=".15 .1 .04" euler="1 5 60" condim="1"'),
    CONTACT,
    spread=0.02,
)

# --- what a contact's numbers are mixed from ----------------------------------------------------

_add(
    "condim_mixed",
    FLOOR.replace("/>", ' condim="1" friction=".3"/>')
    + _mover("0 0 .1", _SPHERE + ' condim="1"')
    + _mover(".5 0 .1", _SPHERE + ' condim="3" friction=".7"')
    + _mover("1 0 .1", _CAPSULE + ' condim="1" priority="1"')
    + _mover("1.5 0 .1", _SPHERE + ' friction="0 0 0"'),
    CONTACT,
)
# Parent and child, geoms without a bit, excluded bodies; the geoms' own parameters do not count.
_add(
    "explicit_pairs",
    FLOOR.replace("/>", ' friction="3" solref=".1 1"/>')
    + f"""
    <body name="a" pos="0 0 .1"><freejoint/><geom name="a" {_SPHERE}/>
      <body name="b" pos=".19 0 0"><joint axis="0 1 0"/><geom name="b" {_SPHERE}/></body></body>
    <body name="c" pos=".1 .15 .12"><freejoint/><geom name="c" {_CAPSULE} {INERT}/></body>
    <body name="d" pos=".1 0 .26"><freejoint/><geom name="d" {_SPHERE} condim="1"/></body>
    """,
    CONTACT,
    extra="""<contact><exclude body1="a" body2="d"/>
      <pair name="parent" geom1="b" geom2="a" friction=".3 .3" solref=".03 .8"/>
      <pair geom1="c" geom2="floor" friction=".6 .6" margin=".01" solimp=".8 .9 .01"/>
      <pair geom1="floor" geom2="a" condim="1" solref="-900 -30"/>
      <pair name="excluded" geom1="d" geom2="a" friction=".4 .4" gap=".02"/></contact>""",
    spread=0.02,
)
# Torsion: the dimension is the larger one, the coefficients the larger ones.
_add(
    "condim_4",
    FLOOR.replace("/>", ' friction=".6 .02 .001"/>')
    + _mover("0 0 .1", _SPHERE + ' condim="4"')
    + _mover(".5 0 .1", _SPHERE + ' condim="4" friction=".3 .05 .1"')
    + _mover("1 0 .1", _CAPSULE + ' condim="4" friction="0 .1"')
    + _mover(".52 .05 .29", _SPHERE + ' condim="3" friction=".9 .03"'),
    CONTACT,
    spread=0.05,
    speed=2.0,
)
# Rolling as well; defaults of 0.005 and 0.0001 m among them.
_add(
    "condim_6",
    FLOOR
    # No coefficient is near the smallest that MuJoCo allows, which is a number in any unit.
    + _mover("0 0 .1", _SPHERE + ' condim="6" friction="1 .005 .002"')
    + _mover(".5 0 .1", _SPHERE + ' condim="6" friction=".3 .05 .02"')
    + _mover("1 0 .1", _CAPSULE + ' condim="6" friction="1.2 .1 .01"')
    + _mover(".52 .05 .29", _SPHERE + ' condim="6" friction=".7 .3 .2"'),
    CONTACT,
    spread=0.05,
    speed=2.0,
)
# 1, 3, 4 and 6 in one heap, by priority and by the larger one; bodies that cannot turn or leave
# a plane, whose torsion and rolling move nothing.
_add(
    "condim_all",
    FLOOR.replace("/>", ' condim="4" friction=".8 .03 .01"/>')
    + _mover("0 0 .1", _SPHERE + ' condim="1"')
    + _mover(".19 0 .1", _SPHERE + ' condim="6" friction=".5 .04 .03"')
    + _mover(".1 .02 .25", _SPHERE + ' condim="3" priority="1"')
    + _mover("1 0 .1", _CAPSULE + ' condim="6" solref="-2000 -40"')
    + _mover(
        "1.5 0 .1", _SPHERE, '<joint type="slide" axis="1 0 0"/><joint type="slide" axis="0 0 1"/>'
    ).replace("<geom type", '<geom condim="6" type')
    + '<body pos="2 0 .1"><joint type="slide" axis="1 0 0"/><joint type="slide" axis="0 0 1"/>'
    '<joint axis="0 1 0"/>'
    f'<geom {_CAPSULE} euler="0 80 0" condim="6" friction=".7 .1 .05"/></body>',
    CONTACT,
    spread=0.03,
)
# Pyramids of almost no friction: μ 1e-5, edges that hardly differ and R as small as 1e-12.
_add(
    "slippery",
    FLOOR.replace("/>", ' friction="0"/>')
    + _mover("0 0 .06", _CAPSULE + ' euler="0 90 0" friction="0" mass="30"')
    + _mover("0 .1 .17", _CAPSULE + ' euler="80 5 0" friction="0"')
    + _mover("0 -.13 .12", _SPHERE + ' friction="0" mass=".05"')
    + '<body pos="0 .3 .1"><joint type="slide" axis="0 1 0"/><joint type="slide" axis="0 0 1"/>'
    f'<joint axis="1 0 0" range="-10 10"/><geom {_CAPSULE} euler="90 0 0" friction="0"/></body>',
    CONTACT,
    spread=0.03,
)
_add(
    "margin_gap",
    FLOOR.replace("/>", ' margin=".01" gap=".02"/>')
    + _mover("0 0 .12", _SPHERE + ' margin=".02"')
    + _mover(".5 0 .13", _SPHERE + ' gap=".05"')
    + _mover("1 0 .12", _CAPSULE + ' margin=".03" gap=".01"')
    + _mover(".15 .1 .14", _SPHERE),
    CONTACT,
    spread=0.05,
)
_add(
    "solmix_priority",
    FLOOR.replace("/>", ' solref=".01 1.2" solimp=".8 .9 .01 .4 2" friction=".4"/>')
    + _mover("0 0 .1", _SPHERE + ' solref=".03 2" solimp=".6 .97 .02 .6 3"')
    + _mover(".5 0 .1", _SPHERE + ' solmix="3" solref=".04 .5" solimp=".7 .7 .02 .6 1"')
    + _mover("1 0 .1", _CAPSULE + ' solref="-2000 -40" friction="1.3"')
    + _mover(
        "1.5 0 .1", _SPHERE + ' priority="2" solref="-900 -25" friction=".15" solimp=".9 .9 0"'
    )
    + _mover(".25 .1 .25", _SPHERE + ' solmix="0" solref=".05 1"')
    + _mover("2 0 .1", _SPHERE + ' solref=".002 1"'),
    CONTACT,
    spread=0.05,
)
_add(
    "static_geoms",
    '<body pos="0 0 .1" euler="10 0 0"><geom type="box" size=".4 .3 .1" '
    f"{BOXES}/>"
    '<body pos=".3 0 .2" euler="0 30 0"><geom type="capsule" size=".05 .2"/></body></body>'
    '<geom type="capsule" size=".06" fromto="-.5 -.3 .3 .5 -.3 .35"/>'
    # The child of a static body collides with it; a child of a moving one does not.
    '<body pos="0 0 .32"><joint type="slide" axis="0 0 1"/><joint axis="0 1 0"/>'
    f'<geom type="sphere" size=".1" {MEETS_BOXES}/>'
    '<body pos=".12 0 0"><joint axis="0 1 0" range="-40 40"/>'
    '<geom type="capsule" size=".05" fromto="0 0 0 .2 0 0"/>'
    f'<body pos="-.1 0 .1"><geom type="sphere" size=".06" {MEETS_BOXES}/></body></body></body>'
    + _mover(".1 -.3 .45", _CAPSULE)
    + FLOOR,
    CONTACT,
    spread=0.1,
)
_add(
    "self_collision",
    FLOOR + '<body name="t" pos="0 0 .3"><freejoint/>'
    '<geom type="capsule" size=".06" fromto="-.15 0 0 .15 0 0"/>'
    + "".join(
        f'<body name="l{i}" pos="{x} 0 0"><joint axis="0 1 .3" range="-50 50" damping=".05"/>'
        f'<geom type="capsule" size=".04" fromto="0 0 0 {x} {y} -.1"/>'
        f'<body name="f{i}" pos="{x} {y} -.1"><joint axis="1 0 0"/>'
        f'<geom type="capsule" size=".03" fromto="0 0 0 {-x} {-y} -.05" '
        'contype="2" conaffinity="3"/></body></body>'
        for i, (x, y) in enumerate(((0.15, 0.05), (-0.15, 0.05), (0.14, -0.06)))
    )
    + "</body>",
    CONTACT,
    LIMIT,
    extra='<contact><exclude body1="f0" body2="l2"/></contact>',
    spread=0.05,
)

# --- all together -------------------------------------------------------------------------------

_add(
    "all_together",
    f"""
    <geom name="floor" type="plane" size="3 3 .1" margin=".01" friction=".8" solref=".015 1.1"/>
    <geom name="post" type="capsule" size=".05" fromto=".6 0 0 .6 0 .5" condim="1"/>
    <geom name="block" type="box" size=".1 .1 .05" pos="-.6 0 .05" solmix="2" friction=".5"
      {BOXES}/>
    <body name="arm" pos="0 0 .45"><joint name="yaw" axis="0 0 1" frictionloss=".8" damping=".1"/>
      <geom type="capsule" size=".04" fromto="0 0 0 .2 0 0"/>
      <body name="fore" pos=".2 0 0">
        <joint name="elbow" axis="0 1 0" range="-5 50" margin="1" frictionloss=".005"/>
        <joint name="reach" type="slide" axis="1 0 0" range="-.02 .05" solreflimit="-500 -30"/>
        <geom type="capsule" size=".03" fromto="0 0 0 .2 0 -.05" gap=".01"/>
        <body name="hand" pos=".2 0 -.05">
          <joint type="ball" range="0 25" damping=".01" stiffness=".3"/>
          <geom type="sphere" size=".06" pos=".05 0 0" condim="1" {MEETS_BOXES}/>
          <site name="grip" pos=".1 0 0"/>
        </body></body></body>
    <body name="rod" pos=".1 .35 .2" euler="70 10 0"><freejoint/>
      <geom type="capsule" size=".04 .15" margin=".01" gap=".01" friction="1.2"/></body>
    <body name="link" pos="0 .6 .3"><joint type="ball"/>
      <geom type="capsule" size=".03" fromto="0 0 0 .1 -.25 -.1"/></body>
    <body name="ballA" pos="-.6 .02 .2"><freejoint/>
      <geom size=".1" priority="1" friction=".3" solref=".03 .7" {MEETS_BOXES}/></body>
    <body name="ballB" pos="-.3 0 .09"><joint type="free" frictionloss=".1" damping=".05"/>
      <geom size=".1" condim="1" solmix=".5" solref="-3000 -60" {MEETS_BOXES}/></body>
    <body name="cart" pos="-.9 0 .1">
      <joint type="slide" axis="1 0 0" range="-.3 .2" frictionloss="2"/>
      <geom type="sphere" size=".08" mass=".4" {MEETS_BOXES}/></body>
    """,
    CONTACT,
    LIMIT,
    FRICTION,
    EQUALITY,
    extra="""<equality>
      <connect body1="rod" body2="link" anchor="0 .05 .15" solref=".03 1"/></equality>
      <actuator><motor joint="yaw" gear="2" ctrlrange="-1 1"/>
      <motor joint="elbow" forcerange="-.5 .5"/>
      <motor joint="reach" gear="5"/></actuator>""",
    spread=0.08,
)


def marbles(count: int = 24) -> str:
    """Spheres and short capsules thrown into a bin of five planes: many contacts at once."""
    rng = np.random.default_rng(11)
    bin_ = FLOOR + "".join(
        f'<geom type="plane" size="3 3 .1" pos="{-0.24 * x} {-0.24 * y} 0" zaxis="{x} {y} .1"/>'
        for x, y in ((1, 0), (-1, 0), (0, 1), (0, -1))
    )
    shapes = (
        'type="sphere" size=".07"',
        'type="sphere" size=".05" friction=".4"',
        'type="capsule" size=".04 .04"',
    )
    text = bin_
    for i in range(count):
        x, y, z = 0.16 * (i % 3 - 1), 0.16 * (i // 3 % 3 - 1), 0.08 + 0.15 * (i // 9)
        x, y = x + rng.uniform(-0.01, 0.01), y + rng.uniform(-0.01, 0.01)
        text += _mover(f"{x:.4f} {y:.4f} {z:.4f}", shapes[i % 3])
    return mjcf(text)


def capsules27() -> str:
    """Twenty-seven free capsules, randomly turned, above a floor: they fall into a heap."""
    rng = np.random.default_rng(27)
    text = FLOOR
    for i in range(27):
        quat = rng.normal(size=4)
        quat /= np.linalg.norm(quat)
        spot = np.array([0.17 * (i % 3 - 1), 0.17 * (i // 3 % 3 - 1), 0.22 + 0.33 * (i // 9)])
        text += (
            f'<body pos="{spot[0]:.3f} {spot[1]:.3f} {spot[2]:.3f}" '
            f'quat="{quat[0]:.6f} {quat[1]:.6f} {quat[2]:.6f} {quat[3]:.6f}"><freejoint/>'
            '<geom type="capsule" size=".05 .08" density="1000"/></body>'
        )
    return mjcf(text, dt=0.002)


ZOO["marbles"] = Entry(marbles(), frozenset({CONTACT}), 0.01)
ZOO["capsules27"] = Entry(capsules27(), frozenset({CONTACT}), 0.01)
# Scenes too large to be visited at as many states as the others.
HEAPS = ("marbles", "capsules27")

# --- shapes that MuJoCo rounds to single precision, or whose contacts it finds by an iteration ----

INEXACT: dict[str, Entry] = {}


def _entry(body: str, **kw: str) -> Entry:
    return Entry(mjcf(body, **kw), frozenset({CONTACT}), 0.02, 0.3)


_CORNERS = "-1 -1 -1 1 -1 -1 -1 1 -1 1 1 -1 -1 -1 1 1 -1 1 -1 1 1 1 1 1"
_ASSETS = f"""<asset><mesh name="block" scale=".125 .1875 .0625" vertex="{_CORNERS}"/>
  <mesh name="plate" scale=".5 .375 .125" vertex="{_CORNERS}"/></asset>"""
INEXACT["plane_mesh"] = _entry(
    f'<geom type="plane" size="2 2 .1" euler="5 -8 0" {GROUND}/>'
    + _mover("0 0 .15", f'type="mesh" mesh="block" euler="20 10 5" {ALOOF}')
    + _mover(".5 0 .25", f'type="mesh" mesh="block" euler="30 10 0" friction=".3" {ALOOF}')
    + _mover("-.5 .1 .2", f'type="mesh" mesh="block" euler="40 70 10" condim="1" {ALOOF}'),
    extra=_ASSETS,
)
_CONVEX = 'ccd_tolerance="1e-12" ccd_iterations="500"'
INEXACT["ellipsoid_ellipsoid"] = _entry(
    f'<geom type="ellipsoid" size=".35 .32 .3" euler="5 -7 20" {GROUND}/>'
    + _mover("0 0 .37", f'type="ellipsoid" size=".1 .1 .09" {ALOOF}')
    + _mover(".2 -.1 .33", f'type="ellipsoid" size=".08 .09 .08" friction=".3" {ALOOF}'),
    option=_CONVEX,
)
INEXACT["sphere_mesh"] = _entry(
    f'<geom type="mesh" mesh="plate" euler="2 -3 20" {GROUND}/>'
    + _mover("0 0 .22", f"{_SPHERE} {ALOOF}")
    + _mover(".24 -.02 .19", f'type="sphere" size=".06" friction=".3" {ALOOF}'),
    option=_CONVEX,
    extra=_ASSETS,
)
