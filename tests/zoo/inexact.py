"""Shapes that MuJoCo rounds to single precision, or whose contacts it finds by an iteration."""

from __future__ import annotations

from .entry import ALOOF, CONTACT, GROUND, SPHERE, Entry, mjcf, mover

INEXACT: dict[str, Entry] = {}


def _entry(body: str, **kw: str) -> Entry:
    return Entry(mjcf(body, **kw), frozenset({CONTACT}), 0.02, 0.3)


_CORNERS = "-1 -1 -1 1 -1 -1 -1 1 -1 1 1 -1 -1 -1 1 1 -1 1 -1 1 1 1 1 1"
_ASSETS = f"""<asset><mesh name="block" scale=".125 .1875 .0625" vertex="{_CORNERS}"/>
  <mesh name="plate" scale=".5 .375 .125" vertex="{_CORNERS}"/></asset>"""
INEXACT["plane_mesh"] = _entry(
    f'<geom type="plane" size="2 2 .1" euler="5 -8 0" {GROUND}/>'
    + mover("0 0 .15", f'type="mesh" mesh="block" euler="20 10 5" {ALOOF}')
    + mover(".5 0 .25", f'type="mesh" mesh="block" euler="30 10 0" friction=".3" {ALOOF}')
    + mover("-.5 .1 .2", f'type="mesh" mesh="block" euler="40 70 10" condim="1" {ALOOF}'),
    extra=_ASSETS,
)
_CONVEX = 'ccd_tolerance="1e-12" ccd_iterations="500"'
INEXACT["ellipsoid_ellipsoid"] = _entry(
    f'<geom type="ellipsoid" size=".35 .32 .3" euler="5 -7 20" {GROUND}/>'
    + mover("0 0 .37", f'type="ellipsoid" size=".1 .1 .09" {ALOOF}')
    + mover(".2 -.1 .33", f'type="ellipsoid" size=".08 .09 .08" friction=".3" {ALOOF}'),
    option=_CONVEX,
)
INEXACT["sphere_mesh"] = _entry(
    f'<geom type="mesh" mesh="plate" euler="2 -3 20" {GROUND}/>'
    + mover("0 0 .22", f"{SPHERE} {ALOOF}")
    + mover(".24 -.02 .19", f'type="sphere" size=".06" friction=".3" {ALOOF}'),
    option=_CONVEX,
    extra=_ASSETS,
)
