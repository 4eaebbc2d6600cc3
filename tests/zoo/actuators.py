"""Actuators: every law, every transmission, the bounds of joints and tendons, adhesion."""

from __future__ import annotations

from .entry import CONTACT, INERT, add

ARM = f"""
    <body pos="0 0 1"><joint name="a" axis="0 1 0" damping=".2"/>
      <geom type="capsule" fromto="0 0 0 .4 0 0" size=".04" {INERT}/>
      <body pos=".4 0 0"><joint name="b" axis="0 .3 1" damping=".1"/>
        <joint name="c" type="slide" axis="1 0 .2" stiffness="30"/>
        <geom type="capsule" fromto="0 0 0 .3 0 0" size=".03" {INERT}/></body></body>
"""
add(
    "actuator_laws",
    ARM,
    extra="""<actuator>
      <position joint="a" kp="30" kv="2" timeconst=".03" forcerange="-9 8"/>
      <position joint="b" kp="20" dampratio=".7" gear="1.5"/>
      <intvelocity joint="c" kp="40" kv="3" actrange="-.1 .3"/>
      <damper joint="a" kv="3" ctrlrange="0 2"/>
      <cylinder joint="c" timeconst=".05" area="3" bias=".2 -5 -.4"/>
      <motor joint="b" gear="1.5" damping=".2 .3 .1" armature=".05" ctrlrange="-.5 .5"/>
      <general joint="b" gaintype="affine" gainprm="2 .5 -.3" biastype="affine"
        biasprm=".1 -4 -.6" dyntype="filter" dynprm=".03" actearly="true"/></actuator>""",
)
add(
    "controllers",
    ARM,
    extra="""<actuator>
      <pid joint="a" input="pos" kp="30" kv="2" forcerange="-9 9"/>
      <pid joint="b" input="vel" kp="3" kv=".7" gear="1.5"/>
      <pid joint="c" input="ff" kp="40" kv="3"/>
      <dcmotor joint="a" nominal="12 3 20" saturation="2"/>
      <dcmotor joint="b" motorconst=".3" resistance="2" gear="3" input="pos" controller="4 0 .2"/>
    </actuator>""",
)
add(
    "controller_states",
    ARM,
    extra="""<actuator>
      <pid joint="a" input="pos" kp="30" kv="2" ki="40" imax=".02" slewmax="3" forcerange="-9 9"/>
      <pid joint="c" input="pos" kp="40" kv="3" slewmax="2"/>
      <dcmotor joint="b" nominal="12 3 20" gear="2" input="pos voltage" controller="4 9 .2 5 .1 7"
        inductance=".01" thermal="2 .03 0 .04 20 25" lugre="9 .2 .2 .3 .5" cogging=".2 7 .3"
        saturation="2 0 90"/>
      <dcmotor joint="a" nominal="12 3 20" lugre="20 .3 .2 .4 .3" saturation=".4"/></actuator>""",
)
add(
    "orientations",
    f"""
    <body pos="0 0 1"><joint name="ball" type="ball" damping=".1"/>
      <geom type="box" size=".1 .2 .05" pos=".1 0 .1" {INERT}/>
      <body pos=".3 0 0"><joint name="wrist" type="ball"/>
        <geom type="capsule" fromto="0 0 0 .3 .1 0" size=".03" {INERT}/></body></body>""",
    extra="""<actuator>
      <orientation name="turn" joint="ball" kp="4" kv=".3" forcerange="0 40"/>
      <orientation name="point" joint="wrist" kp="2" dampratio=".7" input="quat"/></actuator>""",
)
add(
    "late_controls",
    ARM,
    extra="""<actuator>
      <position joint="a" kp="30" kv="2" nsample="3" delay=".006" timeconst=".03"/>
      <motor joint="a" nsample="4" delay=".005" interp="linear" gear="2"/>
      <position joint="b" kp="20" kv=".7" nsample="5" delay=".007" interp="cubic"/>
      <intvelocity joint="c" kp="40" kv="3" actrange="-.1 .3" nsample="2" delay=".05"/>
      <motor joint="b" nsample="6"/></actuator>""",
)
add(
    "muscles",
    ARM,
    extra="""<actuator>
      <muscle joint="a" lengthrange="-1.5 1.5" force="30"/>
      <muscle joint="a" lengthrange="-1.5 1.5" force="25" gear="-1"/>
      <muscle joint="b" lengthrange="-2 2" tausmooth=".4" timeconst=".02 .06" range=".6 1.3"
        force="9" lmin=".4" lmax="1.7" vmax="1.1" fpmax="1.6" fvmax="1.4"/></actuator>""",
)
LIMBS = f"""
    <site name="wall" pos=".1 .2 1.4" euler="20 30 40"/>
    <body pos="0 0 1"><joint name="a" axis="0 1 0" damping=".2" {{0}}/>
      <geom type="capsule" fromto="0 0 0 .4 0 0" size=".04" {INERT}/>
      <site name="u" pos=".2 .03 .04" euler="15 -20 70"/>
      <body pos=".4 0 0" gravcomp=".8"><joint name="b" axis="0 .3 1" {{1}}/>
        <joint name="c" type="slide" axis="1 0 .2"/>
        <geom type="capsule" fromto="0 0 0 .3 0 0" size=".03" {INERT}/>
        <site name="l" pos=".1 .02 .03" euler="40 10 -30"/></body></body>
    <body pos="0 1 1"><joint name="ball" type="ball" pos="0 0 .1"/>
      <geom type="box" size=".1 .2 .05" {INERT}/>
      <site name="s" pos=".05 .1 0" euler="10 20 30"/></body>
    <body pos="1 0 1"><joint name="free" type="free"/>
      <geom type="box" size=".1 .15 .05" {INERT}/>
      <site name="f" pos=".02 .03 0" euler="-10 50 30"/></body>
"""
TENDONS = """<tendon>
      <fixed name="both" {0}><joint joint="a" coef=".7"/><joint joint="c" coef="-1.2"/></fixed>
      <spatial name="rope" {0}><site site="wall"/><site site="l"/></spatial></tendon>"""
add(
    "actuator_transmissions",
    LIMBS.format("", ""),
    extra=TENDONS.format("")
    + """<actuator>
      <motor tendon="both" gear="2"/><position tendon="rope" kp="20" kv="1"/>
      <motor joint="ball" gear="1 2 3"/><position joint="ball" gear="0 0 2" kp="3" kv=".4"/>
      <position jointinparent="ball" gear="1 -2 .5" kp="2" dampratio="1"/>
      <motor joint="free" gear="1 2 3 .4 .5 .6"/>
      <velocity jointinparent="free" gear="1 2 0 .4 0 .6" kv=".5"/>
      <motor site="l" gear="1 2 3 .4 .5 .6"/><velocity site="f" gear="0 0 1 .1 0 0"/>
      <position site="l" refsite="u" gear="1 .5 0 0 0 0" kp="20" kv="1"/>
      <position site="f" refsite="wall" gear="0 0 0 0 1 .3" kp="5" dampratio=".8"/>
      <motor site="s" refsite="l" gear="1 0 2 .3 .4 0"/>
      <motor cranksite="l" slidersite="wall" cranklength=".9" gear="1.5"/>
      <position cranksite="u" slidersite="wall" cranklength=".3" kp="6"/></actuator>""",
)
# The weight that drives hold counts within the bounds of its joints.
add(
    "actuator_bounds",
    LIMBS.format(
        'actuatorfrcrange="-6 1.5" actuatorgravcomp="true"',
        'actuatorgravcomp="true"',
    ),
    extra=TENDONS.format('actuatorfrcrange="-1 1.5"')
    + """<actuator>
      <motor joint="a" gear="2"/><position joint="a" kp="9" kv=".5"/><motor joint="b"/>
      <general tendon="both" gear="2" gainprm="3"/><general tendon="rope" gear="2" gainprm="2"/>
      <general tendon="rope" gainprm="4" biastype="affine" biasprm="1 -9 -1"/></actuator>""",
)
add(
    "adhesion",
    """
    <geom type="plane" size="2 2 .1"/>
    <body name="base" pos="0 0 .095"><freejoint/><geom type="capsule" size=".1 .12" euler="90 0 0"/>
      <body pos="0 0 .19"><joint axis="0 1 .2" damping=".1"/>
        <geom size=".08" gap=".03"/></body></body>
    <body name="foot" pos=".5 0 .095"><freejoint/><geom size=".1" condim="1"/>
      <geom size=".1" pos=".15 0 0" friction=".4"/></body>
    """,
    CONTACT,
    extra="""<actuator><adhesion body="foot" gain="30" ctrlrange="0 1"/>
      <adhesion body="base" gain="12" ctrlrange="0 1"/></actuator>""",
    spread=0.02,
    speed=0.3,
)
