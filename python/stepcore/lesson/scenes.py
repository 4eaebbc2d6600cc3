"""The lesson's scenes, with their settings (`scene.options`) and start (key "start").

Parameters that the lesson does not state were chosen so that its results are reproduced.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

from stepcore.scene.scene import Scene

G = 9.81  # [m/s²]
HEIGHT = 0.3  # drop height [m]
RADIUS = 0.1  # radius of every ball [m]

# The lesson's solver: one sweep per step, no warm start.
PLAIN: dict[str, Any] = {
    "solver": "pgs",
    "acceleration": "none",
    "integrator": "semi-implicit",
    "sweeps": 1,
    "tolerance": 0.0,
    "warm_start": False,
    "beta": 0.2,
}


def spring(k: float = 100.0, m: float = 1.0, damping: float = 0.0, **settings: Any) -> Scene:
    """Return a scene with a mass on a spring along x, stretched by 1 m, without gravity.

    k: stiffness [N/m]. m: mass [kg]. damping: [N·s/m]. settings: fields of `Settings`.
    """
    scene = Scene(gravity=(0, 0, 0), name="spring")
    body = scene.add_body("mass", mass=m, inertia=(m, m, m))
    scene.add_joint(body, "slide", name="spring", axis=(1, 0, 0), stiffness=k, damping=damping)
    return _ready(scene, [1.0], {"law": "lesson", "dt": 0.01}, settings)


def tower(masses: Sequence[float], radius: float = RADIUS, gravity: float = G) -> Scene:
    """Return a scene with balls stacked on a floor, each on a vertical slide, just touching.

    masses: from the floor up [kg]. radius: of every ball [m]. gravity: downwards [m/s²].
    """
    scene = Scene(gravity=(0, 0, -gravity), name="tower")
    scene.add_geom("world", "plane", name="floor", condim=1)
    for i, mass in enumerate(masses):
        ball = scene.add_body(f"ball{i}", pos=(0, 0, radius * (2 * i + 1)))
        scene.add_joint(ball, "slide", name=f"height{i}", axis=(0, 0, 1))
        scene.add_geom(ball, "sphere", radius, name=f"shape{i}", mass=mass, condim=1)
    return scene


def drop(law: str = "lesson", m: float = 1.0, **settings: Any) -> Scene:
    """Return a scene with a ball 0.3 m above a floor; qpos is the ball's height [m].

    law: the contact law. m: mass [kg]. settings: fields of `Settings`.
    """
    chosen = {"law": law, "dt": 0.002, "softness": 0.5}
    return _ready(tower([m]), [HEIGHT], chosen, settings)


def stack(
    sweeps: int = 1, law: str = "relaxed", masses: Sequence[float] = (1.0, 1.0), **settings: Any
) -> Scene:
    """Return a scene with balls stacked on a floor, in contact at the start.

    The rows have the order of the contacts from the floor up.

    sweeps: of the solver. law: the contact law. masses: from the floor up [kg]. settings: fields of
    `Settings`.
    """
    chosen = {"law": law, "dt": 0.002, "softness": 0.5, "sweeps": sweeps}
    return _ready(tower(masses), [0.0] * len(masses), chosen, settings)


def grasp(grip: float = 3.0, **settings: Any) -> Scene:
    """Return a scene with a cube between two fingers on an arm at its wrist limit: five rows.

    The wrist is a hinge about y; the weight of the arm turns it into its upper limit. The fingers
    slide along the same axis. Each finger is a pad (a ball) that a motor pushes inwards with the
    force `grip`. The two fingers differ in mass. They grip the 100 g cube 2 mm above its centre, by
    friction alone.

    grip: force of each motor [N]. settings: fields of `Settings`.
    """
    scene = Scene(gravity=(0, 0, -G), name="grasp")
    arm = scene.add_body("arm", mass=0.5, ipos=(0.1, 0, 0), inertia=(1e-3, 2e-3, 2e-3))
    scene.add_joint(arm, "hinge", name="wrist", axis=(0, 1, 0), range=(-1.5, 0.0))
    half, pad, above = 0.02, 0.01, 0.002
    for name, side, mass in (("left", 1.0, 0.05), ("right", -1.0, 0.08)):
        finger = scene.add_body(name, arm, pos=(0.2, side * (half + pad), 0))
        # The damper models the gearbox; without it the two fingers could drift together along y.
        slide = scene.add_joint(
            finger, "slide", name=f"{name}_slide", axis=(0, -side, 0), damping=5.0
        )
        scene.add_geom(finger, "sphere", pad, name=f"{name}_pad", mass=mass)
        scene.add_actuator(slide, name=f"{name}_motor")
    cube = scene.add_body("cube", pos=(0.2, 0, -above))
    scene.add_joint(cube, "free", name="cube")
    scene.add_geom(cube, "box", (half, half, half), name="cube", mass=0.1)
    chosen = {"law": "lesson", "dt": 0.002, "sweeps": 200, "tolerance": 1e-13}
    chosen |= {"warm_start": True, "cone": "elliptic"}
    start = [0.0, 0.0, 0.0, 0.2, 0.0, -above, 1.0, 0.0, 0.0, 0.0]
    return _ready(scene, start, chosen, settings, ctrl=[grip, grip])


def slip(sim: Any, start: Any) -> float:
    """Return the slip of the cube of `grasp` between the pads since the start [m].

    The slip is the displacement of the cube's centre in the arm's frame, minus the mean
    displacement of the pads.

    sim: the `Sim` of a grasp. start: the initial qpos.
    """
    import numpy as np

    def held(qpos: Any) -> Any:
        wrist, left, right = qpos[:3]
        c, s = np.cos(wrist), np.sin(wrist)
        x, y, z = qpos[3:6]
        return np.array([c * x - s * z, y - (right - left) / 2, s * x + c * z])

    return float(np.linalg.norm(held(np.array(sim.qpos)) - held(np.array(start))))


def _ready(
    scene: Scene,
    start: Sequence[float],
    chosen: dict[str, Any],
    settings: dict[str, Any],
    ctrl: Sequence[float] | None = None,
) -> Scene:
    scene.options = PLAIN | chosen | settings
    scene.add_key("start", qpos=start, ctrl=ctrl)
    return scene
