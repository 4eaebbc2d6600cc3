"""What a contact's numbers are mixed from: condim, friction, softness, explicit pairs."""

from __future__ import annotations

from .entry import BOXES, CAPSULE, CONTACT, FLOOR, INERT, LIMIT, MEETS_BOXES, SPHERE, add, mover

add(
    "condim_mixed",
    FLOOR.replace("/>", ' condim="1" friction=".3"/>')
    + mover("0 0 .1", SPHERE + ' condim="1"')
    + mover(".5 0 .1", SPHERE + ' condim="3" friction=".7"')
    + mover("1 0 .1", CAPSULE + ' condim="1" priority="1"')
    + mover("1.5 0 .1", SPHERE + ' friction="0 0 0"'),
    CONTACT,
)
# Parent and child, geoms without a bit, excluded bodies; the geoms' own parameters do not count.
add(
    "explicit_pairs",
    FLOOR.replace("/>", ' friction="3" solref=".1 1"/>')
    + f"""
    <body name="a" pos="0 0 .1"><freejoint/><geom name="a" {SPHERE}/>
      <body name="b" pos=".19 0 0"><joint axis="0 1 0"/><geom name="b" {SPHERE}/></body></body>
    <body name="c" pos=".1 .15 .12"><freejoint/><geom name="c" {CAPSULE} {INERT}/></body>
    <body name="d" pos=".1 0 .26"><freejoint/><geom name="d" {SPHERE} condim="1"/></body>
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
add(
    "condim_4",
    FLOOR.replace("/>", ' friction=".6 .02 .001"/>')
    + mover("0 0 .1", SPHERE + ' condim="4"')
    + mover(".5 0 .1", SPHERE + ' condim="4" friction=".3 .05 .1"')
    + mover("1 0 .1", CAPSULE + ' condim="4" friction="0 .1"')
    + mover(".52 .05 .29", SPHERE + ' condim="3" friction=".9 .03"'),
    CONTACT,
    spread=0.05,
    speed=2.0,
)
# Rolling as well; defaults of 0.005 and 0.0001 m among them.
add(
    "condim_6",
    FLOOR
    # No coefficient is near the smallest that MuJoCo allows, which is a number in any unit.
    + mover("0 0 .1", SPHERE + ' condim="6" friction="1 .005 .002"')
    + mover(".5 0 .1", SPHERE + ' condim="6" friction=".3 .05 .02"')
    + mover("1 0 .1", CAPSULE + ' condim="6" friction="1.2 .1 .01"')
    + mover(".52 .05 .29", SPHERE + ' condim="6" friction=".7 .3 .2"'),
    CONTACT,
    spread=0.05,
    speed=2.0,
)
# 1, 3, 4 and 6 in one heap, by priority and by the larger one; bodies that cannot turn or leave
# a plane, whose torsion and rolling move nothing.
add(
    "condim_all",
    FLOOR.replace("/>", ' condim="4" friction=".8 .03 .01"/>')
    + mover("0 0 .1", SPHERE + ' condim="1"')
    + mover(".19 0 .1", SPHERE + ' condim="6" friction=".5 .04 .03"')
    + mover(".1 .02 .25", SPHERE + ' condim="3" priority="1"')
    + mover("1 0 .1", CAPSULE + ' condim="6" solref="-2000 -40"')
    + mover(
        "1.5 0 .1", SPHERE, '<joint type="slide" axis="1 0 0"/><joint type="slide" axis="0 0 1"/>'
    ).replace("<geom type", '<geom condim="6" type')
    + '<body pos="2 0 .1"><joint type="slide" axis="1 0 0"/><joint type="slide" axis="0 0 1"/>'
    '<joint axis="0 1 0"/>'
    f'<geom {CAPSULE} euler="0 80 0" condim="6" friction=".7 .1 .05"/></body>',
    CONTACT,
    spread=0.03,
)
# Pyramids of almost no friction: μ 1e-5, edges that hardly differ and R as small as 1e-12.
add(
    "slippery",
    FLOOR.replace("/>", ' friction="0"/>')
    + mover("0 0 .06", CAPSULE + ' euler="0 90 0" friction="0" mass="30"')
    + mover("0 .1 .17", CAPSULE + ' euler="80 5 0" friction="0"')
    + mover("0 -.13 .12", SPHERE + ' friction="0" mass=".05"')
    + '<body pos="0 .3 .1"><joint type="slide" axis="0 1 0"/><joint type="slide" axis="0 0 1"/>'
    f'<joint axis="1 0 0" range="-10 10"/><geom {CAPSULE} euler="90 0 0" friction="0"/></body>',
    CONTACT,
    spread=0.03,
)
add(
    "margin_gap",
    FLOOR.replace("/>", ' margin=".01" gap=".02"/>')
    + mover("0 0 .12", SPHERE + ' margin=".02"')
    + mover(".5 0 .13", SPHERE + ' gap=".05"')
    + mover("1 0 .12", CAPSULE + ' margin=".03" gap=".01"')
    + mover(".15 .1 .14", SPHERE),
    CONTACT,
    spread=0.05,
)
add(
    "solmix_priority",
    FLOOR.replace("/>", ' solref=".01 1.2" solimp=".8 .9 .01 .4 2" friction=".4"/>')
    + mover("0 0 .1", SPHERE + ' solref=".03 2" solimp=".6 .97 .02 .6 3"')
    + mover(".5 0 .1", SPHERE + ' solmix="3" solref=".04 .5" solimp=".7 .7 .02 .6 1"')
    + mover("1 0 .1", CAPSULE + ' solref="-2000 -40" friction="1.3"')
    + mover("1.5 0 .1", SPHERE + ' priority="2" solref="-900 -25" friction=".15" solimp=".9 .9 0"')
    + mover(".25 .1 .25", SPHERE + ' solmix="0" solref=".05 1"')
    + mover("2 0 .1", SPHERE + ' solref=".002 1"'),
    CONTACT,
    spread=0.05,
)
add(
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
    + mover(".1 -.3 .45", CAPSULE)
    + FLOOR,
    CONTACT,
    spread=0.1,
)
add(
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
# A belt that turns, and balls with surfaces of their own, on what slides, rolls and does not rub.
add(
    "surfacevel",
    FLOOR.replace("/>", ' surfacevel=".8 .3 2 .1 .2 1.5"/>')
    + mover("0 0 .1", SPHERE + ' condim="4" friction="1 .02"')
    + mover(".5 0 .1", SPHERE + ' condim="6" friction="1 .01 .002" surfacevel="0 0 0 1 2 3"')
    + mover("1 0 .1", CAPSULE + ' condim="3" surfacevel="-1 .5 .2 0 0 1"')
    + mover("1.5 0 .1", SPHERE + ' condim="1" surfacevel="2 0 0 0 0 0"')
    + mover(".52 .05 .29", 'type="box" size=".1 .08 .06"'),
    CONTACT,
    spread=0.05,
)
# Geoms whose contacts pull, within their gap too: on the floor, on each other, and as a pair.
STICKY = ' gap=".03" adhesion="4"'
add(
    "sticky",
    FLOOR.replace("/>", ' adhesion="2" gap=".01"/>')
    + mover("0 0 .11", SPHERE + ' condim="4" friction="1 .02"' + STICKY)
    + mover(".5 0 .1", SPHERE + ' condim="6" friction="1 .01 .002" priority="1"' + STICKY)
    + mover("1 0 .12", CAPSULE + ' condim="3"' + STICKY)
    + mover("1.5 0 .1", SPHERE + ' condim="1"' + STICKY)
    + mover(".52 .05 .29", 'type="box" size=".1 .08 .06"' + STICKY)
    + mover("2 0 .1", SPHERE + ' name="paired"'),
    CONTACT,
    extra='<contact><pair geom1="floor" geom2="paired" condim="1" adhesion="9" gap=".05"/>'
    "</contact>",
    spread=0.05,
)
