"""Scenes on which recommendations are put to the test.

Every scene is named with the error that is asked for [m]: where the shipped settings are far off,
where they are far too good, and between.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import partial
from typing import Any

import numpy as np
import scenes

import stepcore as sc
from stepcore import lesson

G = (0, 0, -9.81)


@dataclass(frozen=True)
class Case:
    """A scene, the error to be kept to [m], and how long it runs [s]."""

    name: str
    make: Callable[[], sc.Scene]
    error: float
    horizon: float = 1.0


def chain(links: int = 8, stiff: float = 0.0) -> sc.Scene:
    """Links on hinges, let go from the horizontal; `stiff`: a spring in the third [N·m/rad]."""
    scene = sc.Scene(gravity=G, name="chain")
    body: Any = "world"
    for k in range(links):
        body = scene.add_body(f"link{k}", body, pos=(0.1 if k else 0, 0, 0))
        spring = stiff if k == 2 else 0.0
        scene.add_joint(
            body, "hinge", name=f"hinge{k}", axis=(0, 1, 0), stiffness=spring, damping=1e-3
        )
        scene.add_geom(
            body,
            "capsule",
            0.02,
            fromto=(0, 0, 0, 0.1, 0, 0),
            contype=0,
            conaffinity=0,
        )
    scene.options = {"dt": 0.002}
    return scene


def balls(masses: tuple[float, ...], solref: tuple[float, float], **options: Any) -> sc.Scene:
    """Free balls [kg] one on the other, let go just above the floor."""
    scene = sc.Scene(gravity=G, name="balls")
    scene.add_geom("world", "plane", size=(5, 5, 0.1), solref=solref)
    for k, mass in enumerate(masses):
        body = scene.add_body(f"ball{k}", pos=(0, 0, 0.101 + 0.201 * k))
        scene.add_joint(body, "slide", axis=(0, 0, 1))
        scene.add_geom(body, "sphere", 0.1, mass=mass, solref=solref)
    scene.options = {"dt": 0.002} | options
    return scene


def plate() -> sc.Scene:
    """A thin plate that spins about its middle axis, free."""
    scene = sc.Scene(gravity=(0, 0, 0), name="plate")
    body = scene.add_body("plate", pos=(0, 0, 1), mass=1.0, inertia=(1e-3, 4e-3, 5e-3))
    scene.add_joint(body, "free")
    scene.add_geom(body, "box", (0.1, 0.05, 0.002), mass=0.0, contype=0, conaffinity=0)
    scene.options = {"dt": 0.005}
    scene.add_key("spin", qvel=[0.1, 0, 0, 0.3, 12.0, 0.2])
    return scene


def slider(cone: str) -> sc.Scene:
    """A ball thrown along a floor with friction: it slides, then rolls."""
    scene = sc.Scene(gravity=G, name=f"slider {cone}")
    scene.add_geom("world", "plane", size=(5, 5, 0.1))
    body = scene.add_body("ball", pos=(0, 0, 0.0999))
    scene.add_joint(body, "free")
    scene.add_geom(body, "sphere", 0.1, mass=1.0, friction=(0.4, 0, 0))
    scene.options = {"dt": 0.004, "cone": cone}
    scene.add_key("thrown", qvel=[2.0, 0.7, 0, 0, 0, 0])
    return scene


def arm() -> sc.Scene:
    """Three joints held by position servos, the last one stiff."""
    scene = sc.Scene(gravity=G, name="servo arm")
    body: Any = "world"
    for k, gain in enumerate((200.0, 100.0, 2000.0)):
        body = scene.add_body(f"link{k}", body, pos=(0.3 if k else 0, 0, 0))
        joint = scene.add_joint(body, "hinge", name=f"j{k}", axis=(0, 1, 0), armature=0.01)
        scene.add_geom(body, "capsule", 0.03, fromto=(0, 0, 0, 0.3, 0, 0), contype=0, conaffinity=0)
        scene.add_actuator(joint, "position", kp=gain, kv=gain / 20, ctrlrange=(-0.5, 0.5))
    scene.options = {"dt": 0.002, "integrator": "implicitfast"}
    return scene


def limit() -> sc.Scene:
    """A pendulum that falls against its stop."""
    scene = sc.Scene(gravity=G, name="limit")
    body = scene.add_body("rod", pos=(0, 0, 1))
    scene.add_joint(body, "hinge", axis=(0, 1, 0), range=(-0.5, 0.6), damping=0.01)
    scene.add_geom(body, "capsule", 0.03, fromto=(0, 0, 0, 0.5, 0, 0), contype=0, conaffinity=0)
    scene.options = {"dt": 0.002}
    return scene


def bridge() -> sc.Scene:
    """A chain of five links tied to the world at its end."""
    scene = chain(5)
    scene.name = "bridge"
    scene.add_equality("connect", "link4", "world", anchor=(0.1, 0, 0))
    return scene


def capsules() -> sc.Scene:
    """Four capsules that fall on one another."""
    rng = np.random.default_rng(2)
    scene = sc.Scene(gravity=G, name="capsules")
    scene.add_geom("world", "plane", size=(5, 5, 0.1))
    for k in range(4):
        quat = rng.normal(size=4)
        body = scene.add_body(f"c{k}", pos=(0.06 * k, 0, 0.15 + 0.12 * k), quat=tuple(quat))
        scene.add_joint(body, "free")
        scene.add_geom(body, "capsule", (0.05, 0.08))
    scene.options = {"dt": 0.002}
    return scene


def text(name: str, **values: Any) -> sc.Scene:
    return sc.loads(getattr(scenes, name)(**values))


def gym(name: str) -> sc.Scene:
    return sc.load(f"gymnasium:{name}")


CASES = (
    Case("lesson spring", lesson.spring, 1e-3),
    Case("lesson drop", lesson.drop, 2e-3),
    Case("lesson stack", lesson.stack, 1e-4),
    Case("lesson grasp", lesson.grasp, 5e-3, 0.32),
    Case("stiff spring", partial(lesson.spring, k=1e4, dt=0.002), 1e-3),
    Case("stiff spring in a chain", partial(chain, 6, stiff=300.0), 1e-3, 0.48),
    Case("chain", partial(chain, 8), 1e-3, 0.48),
    Case("bridge", bridge, 1e-4, 0.48),
    Case("spinning plate", plate, 1e-5),
    Case("soft contact", partial(balls, (1.0, 1.0), (0.1, 0.5)), 1e-4),
    Case("stiff contact", partial(balls, (1.0, 1.0), (0.004, 1.0)), 3e-5, 0.48),
    Case("mass ratio 100", partial(balls, (1.0, 100.0), (0.02, 1.0)), 1e-4),
    Case("slider, pyramid", partial(slider, "pyramidal"), 2e-3),
    Case("slider, cone", partial(slider, "elliptic"), 2e-3),
    Case("servo arm", arm, 1e-4),
    Case("limit", limit, 3e-4),
    Case("capsules", capsules, 5e-3, 0.32),
    Case("inverted_pendulum", partial(gym, "inverted_pendulum"), 1e-3),
    Case("inverted_double_pendulum", partial(gym, "inverted_double_pendulum"), 1e-2, 0.48),
    Case("reacher", partial(gym, "reacher"), 1e-4),
    Case("hopper", partial(gym, "hopper"), 5e-3, 0.48),
    Case("walker2d", partial(gym, "walker2d"), 5e-3, 0.48),
    Case("half_cheetah", partial(gym, "half_cheetah"), 1e-2),
    Case("ant", partial(gym, "ant"), 1e-2, 0.48),
)
