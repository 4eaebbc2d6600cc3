"""One scene per pair of shapes."""

from __future__ import annotations

from .entry import ALOOF, CAPSULE, CONTACT, FLOOR, GROUND, SPHERE, add, mover

_TILTED = f'<geom type="plane" size="3 3 .1" euler="8 -6 0" {{}}/>{FLOOR}'

add(
    "plane_sphere",
    _TILTED.format("") + mover(".3 0 .12", SPHERE) + mover("-.3 0 .1", SPHERE),
    CONTACT,
)
add(
    "plane_capsule",
    _TILTED.format('friction=".4"') + mover("0 0 .12", CAPSULE) + mover("1 0 .1", CAPSULE),
    CONTACT,
    spread=0.05,
)
add(
    "sphere_sphere",
    "".join(f'<geom {SPHERE} pos="{x} {y} 0"/>' for x in (0, 0.2) for y in (0, 0.2))
    + mover(".11 .1 .13", SPHERE)
    + mover(".12 .11 .3", 'type="sphere" size=".08" friction=".3"'),
    CONTACT,
    spread=0.03,
)
add(
    "sphere_capsule",
    '<geom type="capsule" size=".1 .3" euler="0 80 0"/>'
    '<geom type="capsule" size=".1 .3" pos="0 .25 0" euler="0 95 0"/>'
    + mover(".1 .1 .18", SPHERE)
    + '<body pos="-.2 .1 .18"><freejoint/><geom type="capsule" size=".05 .05"/>'
    '<geom type="sphere" size=".07" pos=".1 0 0"/></body>',
    CONTACT,
    spread=0.03,
)
add(
    "capsule_capsule",
    '<geom type="capsule" size=".1 .4" euler="0 85 10"/>'
    '<geom type="capsule" size=".1 .4" pos="0 .25 0" euler="3 95 0"/>'
    + mover(".1 .12 .16", 'type="capsule" size=".06 .15" euler="20 80 30"')
    + mover(".05 .14 .32", 'type="capsule" size=".06 .12" euler="80 30 10"'),
    CONTACT,
    spread=0.03,
)
add(
    "sphere_box",
    '<geom type="box" size=".4 .4 .1" euler="5 -7 20"/>'
    '<geom type="box" size=".1 .1 .1" pos=".2 .1 .2" euler="30 20 0"/>'
    + mover("-.1 .1 .2", SPHERE)
    + mover(".2 -.1 .2", SPHERE)
    + mover("-.38 -.38 .19", 'type="sphere" size=".05" friction=".2"'),
    CONTACT,
    spread=0.03,
)

add(
    "plane_ellipsoid",
    f'<geom type="plane" size="2 2 .1" euler="5 -8 0" {GROUND}/>'
    + mover("0 0 .1", f'type="ellipsoid" size=".1 .06 .14" euler="80 30 10" {ALOOF}')
    + mover(".4 0 .08", f'type="ellipsoid" size=".2 .15 .02" friction=".3" {ALOOF}')
    + mover("-.4 .1 .1", f'type="ellipsoid" size=".1 .1 .1" pos=".02 0 0" {ALOOF}'),
    CONTACT,
    spread=0.05,
)
add(
    "plane_cylinder",
    f'<geom type="plane" size="2 2 .1" euler="5 -8 0" {GROUND}/>'
    + mover("0 0 .14", f'type="cylinder" size=".1 .15" {ALOOF}')
    + mover(".4 0 .06", f'type="cylinder" size=".07 .2" euler="88 10 0" {ALOOF}')
    + mover("-.4 .1 .1", f'type="cylinder" size=".1 .01" euler="40 20 0" condim="1" {ALOOF}'),
    CONTACT,
    spread=0.05,
)
add(
    "plane_box",
    f'<geom type="plane" size="2 2 .1" euler="5 -8 0" {GROUND}/>'
    + mover("0 0 .1", f'type="box" size=".15 .1 .1" {ALOOF}')
    + mover(".5 0 .06", f'type="box" size=".02 .2 .06" euler="30 10 0" friction=".3" {ALOOF}')
    + mover("-.5 .1 .2", f'type="box" size=".1 .2 .08" euler="40 70 10" condim="1" {ALOOF}')
    + '<body pos="0 .5 .1"><joint type="slide" axis="1 0 0"/><joint type="slide" axis="0 0 1"/>'
    f'<joint axis="0 1 0"/><geom type="box" size=".1 .1 .1" {ALOOF}/></body>',
    CONTACT,
    spread=0.05,
)

add(
    "sphere_cylinder",
    f'<geom type="cylinder" size=".3 .1" euler="5 -7 20" {GROUND}/>'
    f'<geom type="cylinder" size=".06 .3" pos=".1 .1 .2" euler="80 20 0" {GROUND}/>'
    + mover("-.1 .1 .19", f"{SPHERE} {ALOOF}")
    + mover(".15 -.05 .19", f"{SPHERE} {ALOOF}")
    + mover("-.28 -.2 .1", f'type="sphere" size=".05" friction=".2" {ALOOF}'),
    CONTACT,
    spread=0.03,
)
add(
    "capsule_box",
    f'<geom type="box" size=".4 .4 .1" euler="5 -7 20" {GROUND}/>'
    f'<geom type="box" size=".1 .1 .1" pos=".2 .1 .2" euler="30 20 0" {GROUND}/>'
    + mover("-.1 .1 .19", f'{CAPSULE} euler="88 20 0" {ALOOF}')
    + mover(".1 -.15 .2", f'type="capsule" size=".05 .2" euler="5 84 0" friction=".3" {ALOOF}')
    + mover("-.3 -.2 .2", f'type="capsule" size=".06 .1" euler="40 10 0" condim="1" {ALOOF}'),
    CONTACT,
    spread=0.03,
)
add(
    "box_box",
    '<geom type="box" size=".5 .4 .1" euler="2 -3 20"/>'
    + mover("-.2 .05 .18", 'type="box" size=".1 .12 .08"')
    + mover("-.2 .08 .33", 'type="box" size=".15 .05 .07" euler="2 1 30" friction=".3"')
    + mover(".2 .05 .24", 'type="box" size=".1 .1 .1" euler="40 30 10"')
    + mover(".55 -.1 .14", 'type="box" size=".15 .1 .04" euler="1 5 60" condim="1"'),
    CONTACT,
    spread=0.02,
)
