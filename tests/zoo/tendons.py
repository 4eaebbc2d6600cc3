"""Tendons: over joints, through sites, over pulleys, and round and through geoms."""

from __future__ import annotations

from .entry import FRICTION, INERT, LIMIT, add

ARM = f"""
    <site name="wall" pos="0 .1 1.3"/>
    <geom name="peg" type="cylinder" size=".08 .2" pos=".25 0 1.1" euler="90 0 0" {INERT}/>
    <site name="over" pos=".25 0 1.3"/>
    <body name="upper" pos="0 0 1"><joint name="a" axis="0 1 0"/>
      <geom type="capsule" fromto="0 0 0 .4 0 0" size=".03" {INERT}/>
      <site name="u" pos=".3 .05 .05"/>
      <body name="lower" pos=".4 0 0"><joint name="b" axis="0 1 0"/>
        <joint name="c" type="slide" axis="1 0 0" stiffness="50"/>
        <geom type="capsule" fromto="0 0 0 .3 0 0" size=".03" {INERT}/>
        <geom name="ball" size=".06" pos=".1 0 .02" mass="0" {INERT}/>
        <site name="l" pos=".2 .1 .05"/><site name="within" pos=".1 0 .03"/></body></body>
    <body name="load" pos="0 .5 1.5"><freejoint/>
      <geom type="box" size=".1 .05 .02" {INERT}/><site name="hook" pos=".05 0 0"/></body>
"""

add(
    "tendon_springs",
    ARM,
    extra="""<tendon>
      <fixed stiffness="20 3 10" springlength=".2 .4" damping=".5"><joint joint="a" coef="1.5"/>
        <joint joint="b" coef="-.7"/></fixed>
      <spatial stiffness="80" damping="3 1 .5"><site site="wall"/>
        <geom geom="peg" sidesite="over"/><site site="u"/><geom geom="ball"/><site site="l"/>
        <pulley divisor="2"/><site site="wall"/><site site="hook"/></spatial>
      <spatial stiffness="60" springlength=".1"><site site="wall"/><geom geom="peg"/>
        <site site="l"/></spatial>
      <spatial damping="2"><site site="l"/><site site="hook"/></spatial></tendon>""",
)
add(
    "tendon_limits",
    ARM,
    LIMIT,
    extra="""<tendon>
      <fixed range="-.1 .1" margin=".02"><joint joint="a" coef="1"/>
        <joint joint="b" coef="-1"/></fixed>
      <spatial range=".2 .5" solreflimit=".03 .8" solimplimit=".9 .9"><site site="wall"/>
        <geom geom="peg"/><site site="l"/></spatial>
      <spatial range="0 .6"><site site="u"/><site site="hook"/></spatial></tendon>""",
)
add(
    "tendon_friction",
    ARM,
    FRICTION,
    extra="""<tendon>
      <fixed frictionloss=".4"><joint joint="a" coef="1"/><joint joint="b" coef=".5"/></fixed>
      <spatial frictionloss="3" solreffriction=".03 1" solimpfriction=".8 .8"><site site="wall"/>
        <geom geom="peg"/><site site="l"/></spatial>
      <spatial frictionloss="60" stiffness="30"><site site="u"/><site site="hook"/></spatial>
      </tendon>""",
)
# An inertia along a chain, whose dofs all move one another.
add(
    "tendon_armature",
    f"""
    <site name="wall" pos="0 .1 1.3"/>
    <body pos="0 0 1"><joint name="a" axis="0 1 0"/>
      <geom type="capsule" fromto="0 0 0 .4 0 0" size=".03" {INERT}/>
      <site name="u" pos=".3 .05 .05"/>
      <body pos=".4 0 0"><joint name="b" axis="0 1 0"/>
        <joint name="c" type="slide" axis="1 0 0" stiffness="50"/>
        <geom type="capsule" fromto="0 0 0 .3 0 0" size=".03" {INERT}/>
        <site name="l" pos=".2 .1 .05"/></body></body>
    """,
    extra="""<tendon><fixed armature=".05"><joint joint="a" coef="1"/><joint joint="b" coef="-2"/>
      </fixed><spatial armature=".8" stiffness="20" damping="1"><site site="wall"/>
      <site site="u"/><site site="l"/></spatial></tendon>""",
    speed=3.0,
)
