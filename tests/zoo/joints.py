"""Joints, inertia and smooth forces; friction loss, limits and connections."""

from __future__ import annotations

from .entry import EQUALITY, FRICTION, INERT, LIMIT, add

# --- joints, inertia, smooth forces -------------------------------------------------------------

add(
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
add(
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
add(
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
add(
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
add(
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
add(
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
add(
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

add(
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
add(
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
add(
    "ball_limit",
    f"""
    <body pos="0 0 1"><joint type="ball" pos="0 0 .1" range="0 20" margin="3"/>
      <geom type="capsule" size=".04" fromto="0 0 0 .3 .1 0" {INERT}/>
      <body pos=".3 .1 0"><joint type="ball" range="0 35" damping=".02" solreflimit=".03 .8"/>
        <geom type="box" size=".1 .06 .04" pos=".1 0 0" {INERT}/></body></body>
    """,
    LIMIT,
)
add(
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
