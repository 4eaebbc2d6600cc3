"""Fluids, gravity compensation, and springs and dampers by their times."""

from __future__ import annotations

from .entry import INERT, add

LIMBS = f"""
    <body pos="0 0 1" euler="10 20 30"><freejoint/>
      <geom type="box" size=".1 .2 .05" pos=".05 0 0" {INERT} {{0}}/>
      <body pos=".1 .2 0"><joint axis="1 2 0" damping=".3"/>
        <geom type="capsule" size=".03" fromto="0 0 0 0 .3 .1" {INERT} {{1}}/>
        <body pos="0 .3 .1"><joint type="ball"/>
          <geom type="cylinder" size=".06 .1" pos=".1 0 0" {INERT} {{2}}/></body></body></body>
    <body pos="1 0 1" euler="0 30 0"><joint type="slide" axis="1 0 .2"/>
      <joint type="slide" axis="0 1 0"/>
      <geom type="ellipsoid" size=".1 .2 .05" quat=".5 .1 .3 .2" {INERT} {{3}}/></body>
    <body pos="2 0 1"><joint axis="0 1 0" pos="0 0 .2"/>
      <geom type="sphere" size=".1" {INERT}/>
      <geom type="box" size=".03 .1 .2" pos=".2 0 0" {INERT}/>
    </body>
    """

add(
    "fluid_boxes",
    LIMBS.format("", "", "", ""),
    option='density="60" viscosity=".4" wind="1 -.5 .3"',
    speed=3.0,
)
add(
    "fluid_ellipsoids",
    LIMBS.format(
        'fluidshape="ellipsoid"',
        'fluidshape="ellipsoid" fluidcoef=".7 .1 1 1.5 .5"',
        'fluidshape="ellipsoid"',
        'fluidshape="ellipsoid" fluidcoef="1.2 .3 2"',
    ),
    option='density="60" viscosity=".4" wind="1 -.5 .3"',
    speed=3.0,
)
add(
    "gravcomp",
    f"""
    <body pos="0 0 1" gravcomp="1"><freejoint/>
      <geom type="box" size=".1 .2 .05" pos=".05 0 0" {INERT}/>
      <body pos=".1 .2 0" gravcomp=".6"><joint axis="1 2 0" damping=".3"/>
        <geom type="capsule" size=".03" fromto="0 0 0 0 .3 .1" {INERT}/></body></body>
    <body pos="1 0 1" gravcomp="1.5"><joint type="slide" axis="1 0 1"/>
      <geom type="ellipsoid" size=".1 .2 .05" {INERT}/></body>
    <body pos="2 0 1"><joint axis="0 1 0" damping=".1"/>
      <geom type="capsule" size=".03" fromto="0 0 0 .3 0 0" {INERT}/>
      <body pos=".3 0 0" gravcomp="-.3"><joint type="ball" stiffness="1"/>
        <geom type="box" size=".1 .05 .1" {INERT}/></body></body>
    """,
)
add(
    "springdamper",
    f"""
    <body pos="0 0 1"><joint type="slide" axis="1 0 .2" springdamper=".1 .7" springref=".1"/>
      <geom size=".1" mass="2" {INERT}/>
      <body pos=".3 0 0"><joint axis="0 1 0" springdamper=".2 .5" armature=".1" stiffness="3"/>
        <geom type="box" size=".1 .05 .02" pos=".2 0 0" {INERT}/></body></body>
    <body pos="1 0 1"><joint type="ball" springdamper=".15 1"/>
      <geom type="box" size=".1 .2 .05" pos=".1 0 0" {INERT}/></body>
    """,
)
