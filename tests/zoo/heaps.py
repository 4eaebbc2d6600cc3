"""Everything together, and scenes too large to be visited at as many states as the others."""

from __future__ import annotations

import numpy as np

from .entry import (
    BOXES,
    CONTACT,
    EQUALITY,
    FLOOR,
    FRICTION,
    LIMIT,
    MEETS_BOXES,
    ZOO,
    Entry,
    add,
    mjcf,
    mover,
)

add(
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
        text += mover(f"{x:.4f} {y:.4f} {z:.4f}", shapes[i % 3])
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
