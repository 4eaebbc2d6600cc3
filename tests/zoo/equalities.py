"""Welds, connects by sites, and joints that follow one another."""

from __future__ import annotations

from .entry import EQUALITY, INERT, add

# One impedance, so that the scene has the same motion in units of another length.
EVEN = 'solimp=".93 .93"'

# What is tied stands where it is to be, so that the laws without softness can hold it.
add(
    "weld",
    f"""
    <body name="a" pos="0 0 1"><freejoint/>
      <geom type="box" size=".1 .2 .15" pos=".1 0 .05" {INERT}/>
      <body name="b" pos=".3 0 0"><joint axis="1 2 3" pos=".05 .02 0"/>
        <geom type="capsule" size=".05 .1" pos="0 .1 0" quat=".3 .4 .5 .6" {INERT}/></body></body>
    <body name="c" pos="0 1 1"><joint type="ball" pos="0 0 .1"/>
      <geom type="box" size=".1 .1 .3" {INERT}/><site name="grip" pos=".1 0 .3" euler="0 0 30"/>
    </body>
    <body name="d" pos=".2 1.1 1.3"><freejoint/><geom type="ellipsoid" size=".1 .06 .04" {INERT}/>
      <site name="hand" pos="-.1 -.1 0" euler="0 0 30"/></body>
    <body name="e" pos="2 0 1"><freejoint/><geom type="box" size=".1 .15 .1" {INERT}/></body>
    <body name="f" pos="2.2 .3 1.1" quat=".8 0 .6 0"><freejoint/>
      <geom type="capsule" size=".05 .1" pos="0 .1 0" {INERT}/></body>
    """,
    EQUALITY,
    extra=f"""<equality>
      <weld body1="b" body2="c" anchor=".1 .2 .3" solref=".03 .9" {EVEN}/>
      <weld site1="hand" site2="grip" torquescale="2" solref=".05 1" {EVEN}/>
      <weld body1="e" body2="f" relpose=".2 .3 .1 .8 0 .6 0" torquescale=".5" {EVEN}/>
      <weld body1="e" {EVEN} solref="-300 -20"/></equality>""",
    spread=0.1,
)
add(
    "connected_sites",
    f"""
    <body pos="0 0 1"><freejoint/><geom type="box" size=".1 .2 .15" {INERT}/>
      <site name="here" pos=".1 .2 .1"/><site name="foot" pos="-.1 -.2 -.1"/></body>
    <body pos=".1 .4 1.1"><joint axis="0 1 .2"/><joint type="slide" axis="1 0 0"/>
      <geom type="capsule" size=".05 .1" {INERT}/><site name="there" pos="0 -.2 0"/></body>
    <site name="wall" pos="-.1 -.2 .9"/>
    """,
    EQUALITY,
    extra="""<equality><connect site1="here" site2="there" solimp=".8 .93 .02 .4 3"/>
      <connect site1="wall" site2="foot" solref=".04 1"/></equality>""",
    spread=0.1,
)
# Hinges follow hinges, and slides slides: MuJoCo's R adds up the inverse weights of both joints,
# which have one unit only then.
add(
    "joint_equality",
    f"""
    <body pos="0 0 1"><joint name="a" axis="0 1 0"/>
      <geom type="capsule" size=".04" fromto="0 0 0 .3 0 0" {INERT}/>
      <body pos=".3 0 0"><joint name="b" axis="0 1 1" ref="20"/>
        <geom type="capsule" size=".03" fromto="0 0 0 .2 0 0" {INERT}/>
        <body pos=".2 0 0"><joint name="c" type="slide" axis="1 0 0" ref=".1"/>
          <geom size=".05" {INERT}/></body></body></body>
    <body pos="1 0 1"><joint name="d" type="slide" axis="0 0 1" armature=".2"/>
      <geom type="box" size=".1 .1 .05" mass="1" {INERT}/></body>
    <body pos="2 0 1"><joint name="e" axis="1 0 0"/>
      <geom type="box" size=".1 .1 .05" pos="0 .1 0" {INERT}/></body>
    """,
    EQUALITY,
    extra="""<equality>
      <joint joint1="a" joint2="b" polycoef=".1 -.5 .3 .2 -.1" solimp=".8 .95 .05 .4 3"/>
      <joint joint1="d" joint2="c" polycoef=".02 1.5 .4" solref="-400 -30"/>
      <joint joint1="e" polycoef=".3"/></equality>""",
)
add(
    "tendon_equality",
    f"""
    <site name="wall" pos="0 .1 1.3"/>
    <body pos="0 0 1"><joint name="a" axis="0 1 0"/>
      <geom type="capsule" size=".04" fromto="0 0 0 .3 0 0" {INERT}/>
      <body pos=".3 0 0"><joint name="b" axis="0 1 1"/>
        <geom type="capsule" size=".03" fromto="0 0 0 .2 0 0" {INERT}/>
        <site name="tip" pos=".2 0 0"/></body></body>
    <body pos="1 0 1"><joint name="c" axis="1 0 0" armature=".1"/>
      <geom type="box" size=".1 .1 .05" pos="0 .1 0" {INERT}/></body>
    <body pos=".5 .5 1.2"><freejoint/><geom type="box" size=".1 .05 .02" {INERT}/>
      <site name="hook" pos=".05 0 0"/></body>
    """,
    EQUALITY,
    extra="""<tendon>
      <fixed name="one"><joint joint="a" coef="1.5"/><joint joint="b" coef="-.7"/></fixed>
      <fixed name="two"><joint joint="c" coef="2"/></fixed>
      <spatial name="rope"><site site="wall"/><site site="tip"/></spatial>
      <spatial name="line"><site site="tip"/><site site="hook"/></spatial></tendon>
      <equality><tendon tendon1="one" tendon2="two" polycoef=".1 .5 .2" solimp=".8 .95 .05 .4 3"/>
      <tendon tendon1="line" tendon2="rope" polycoef="0 .8 .3" solref=".04 .8"/>
      <tendon tendon1="rope" solref="-300 -20"/></equality>""",
)
