"""Scenes whose stiff element is known, and what the real step does with them."""

from __future__ import annotations

import math
from collections.abc import Callable

import numpy as np

import stepcore as sc
from stepcore.engine.sim import unwatched

INERT = {"contype": 0, "conaffinity": 0}


def slider(k: float, damping: float = 0.0, mass: float = 1.0, **options) -> sc.Scene:
    """One mass on a spring and a damper."""
    scene = sc.Scene(gravity=(0, 0, 0), name="slider").with_settings(**options)
    body = scene.add_body("mass")
    scene.add_joint(body, "slide", name="slide", stiffness=k, damping=damping)
    scene.add_geom(body, "sphere", 0.1, mass=mass, **INERT)
    return scene


SERVO = '<position name="s" joint="j" kp="330" kv="66" forcerange="-56 56"/>'
# Its fast pole [1/s].
POLE = (66 + math.sqrt(66**2 - 4 * 330 * 0.1)) / 0.2


def damped_servo(actuator: str = SERVO, dt: float = 1e-3, key: str = "") -> str:
    """A joint on a strongly damped servo of limited force, as UR3e's; or on another actuator."""
    return f"""<mujoco><option timestep="{dt}" gravity="0 0 0"/><worldbody><body>
      <joint name="j" axis="0 1 0" armature="0.1"/><geom size=".01" mass="1e-6"/></body></worldbody>
      <actuator>{actuator}</actuator>{key}</mujoco>"""


def chain(stiffnesses, damping: float = 0.02, gravity=(0, 0, 0), **options) -> sc.Scene:
    """Links of 0.3 m and 0.5 kg in a row, a spring in every joint."""
    scene = sc.Scene(gravity=gravity, name="chain").with_settings(**options)
    parent = scene.world
    for i, stiffness in enumerate(stiffnesses):
        parent = scene.add_body(f"link{i}", parent=parent, pos=(0, 0, 1) if i == 0 else (0.3, 0, 0))
        axis = (0, 1, 0) if i % 2 == 0 else (0, 0, 1)
        scene.add_joint(
            parent, "hinge", name=f"joint{i}", axis=axis, stiffness=stiffness, damping=damping
        )
        ends = (0, 0, 0, 0.3, 0, 0)
        scene.add_geom(parent, "capsule", 0.03, fromto=ends, mass=0.5, **INERT)
    return scene


NAMES = ("base", "shoulder", "elbow", "forearm", "wrist", "tool")


def arm(kp=(200.0,) * 6, kv: float = 1.0, damping: float = 0.1, **options) -> sc.Scene:
    """Six joints, a position servo on each."""
    scene = sc.Scene(gravity=(0, 0, 0), name="arm").with_settings(**options)
    parent, last = scene.world, 0.0
    axes = ((0, 0, 1), (0, 1, 0), (0, 1, 0), (1, 0, 0), (0, 1, 0), (1, 0, 0))
    lengths = (0.15, 0.4, 0.35, 0.1, 0.1, 0.08)
    for i, name in enumerate(NAMES):
        parent = scene.add_body(name, parent=parent, pos=(0, 0, 0.1) if i == 0 else (last, 0, 0))
        scene.add_joint(
            parent, "hinge", name=name, axis=axes[i], damping=damping, armature=0.01 * 0.6**i
        )
        last = lengths[i]
        scene.add_geom(
            parent,
            "capsule",
            0.04 - 0.005 * i,
            fromto=(0, 0, 0, last, 0, 0.01),
            mass=2.0 * 0.5**i,
            **INERT,
        )
        scene.add_actuator(name, type="position", name=name, kp=kp[i], kv=kv)
    return scene


def plate(spin: float, **options) -> sc.Scene:
    """A thin plate that spins about its axis of symmetry, free in space."""
    scene = sc.Scene(gravity=(0, 0, 0), name="plate").with_settings(**options)
    body = scene.add_body("plate")
    scene.add_joint(body, "free")
    scene.add_geom(body, "box", (0.3, 0.3, 0.005), mass=1.0, **INERT)
    scene.add_key("spinning", qvel=(0, 0, 0, 0, 0, spin))
    return scene


def pad(solref=(-1e6, -200.0), mass: float = 1.0, **options) -> sc.Scene:
    """A ball at rest on the floor, the contact as stiff as solref says."""
    scene = sc.Scene(name="pad").with_settings(**options)
    body = scene.add_body("ball", pos=(0, 0, 0.1))
    scene.add_joint(body, "slide", name="up")
    scene.add_geom(body, "sphere", 0.1, mass=mass, name="ball", condim=1, solref=solref)
    scene.add_geom("world", "plane", name="floor", solref=solref)
    return scene


def table(solref=(-1e5, -500.0), **options) -> sc.Scene:
    """A board on four balls on the floor."""
    scene = sc.Scene(name="table").with_settings(**options)
    board = scene.add_body("board", pos=(0, 0, 0.1))
    scene.add_joint(board, "free")
    for i, (x, y) in enumerate(((0.2, 0.1), (-0.2, 0.1), (0.2, -0.1), (-0.2, -0.1))):
        scene.add_geom(
            board, "sphere", 0.1, pos=(x, y, 0), mass=0.5, name=f"foot{i}", solref=solref
        )
    scene.add_geom("world", "plane", name="floor", solref=solref)
    return scene


def bisected(stable: Callable[[float], bool], low: float, high: float, fine: float = 2e-3) -> float:
    """The step between one that is stable and one that is not."""
    assert stable(low) and not stable(high)
    while high / low > 1 + fine:
        middle = math.sqrt(low * high)
        low, high = (middle, high) if stable(middle) else (low, middle)
    return low


def stays(model: sc.Model, integrator: str, dt: float, steps: int = 4000, grown=1e4) -> bool:
    """Whether a small push stays small in the real step. The model's pose is an equilibrium."""
    sim = unwatched(sc.Sim(model, integrator=integrator, dt=dt))
    rng = np.random.default_rng(1)
    sim.qvel[:] = rng.uniform(-1, 1, model.nv) * 1e-6
    size = [float(np.abs(sim.qvel).max())]
    try:
        for _ in range(20):
            sim.step(steps // 20)
            size.append(float(np.abs(sim.qvel).max()))
    except sc.SimulationError:
        return False
    return max(size[1:]) < grown * size[0]


def twins(model: sc.Model, integrator: str, dt: float, seconds: float) -> np.ndarray:
    """The largest kinetic energy [J] of a motion, how far one from a start moved by 1e-6 is from
    it, in velocities, at most and in the last quarter, and the largest velocity itself, likewise;
    inf if one does not stay finite."""
    pair = [unwatched(sc.Sim(model, integrator=integrator, dt=dt)) for _ in range(2)]
    for sim in pair if model.keys else ():
        sim.reset(key=0)
    pair[1].qvel[:] += np.random.default_rng(2).choice([-1e-6, 1e-6], model.nv)
    count, energy, apart, speed = math.ceil(seconds / dt), 1e-6, list[float](), list[float]()
    for _ in range(count):
        try:
            for sim in pair:
                sim.step()
        except sc.SimulationError:
            return np.full(5, np.inf)
        energy = max(energy, *(sim.energy.kinetic for sim in pair))
        apart.append(float(np.abs(pair[0].qvel - pair[1].qvel).max()))
        speed.append(float(np.abs(pair[0].qvel).max()))
    late = slice(3 * count // 4, None)
    return np.array([energy, max(apart), max(apart[late]), max(speed), max(speed[late])])


def goes_wrong(model: sc.Model, integrator: str, dt: float, true: np.ndarray, seconds: float):
    """Whether a motion has thirty times the energy, ends thirty times as far from its neighbour, or
    goes on thirty times as fast, as in the `true` twins: what `diagnose` calls a failure, from
    steps alone. (A leg on servos that has long been at rest swings for ever at longer steps.)"""
    energy, _, late, _, speed = twins(model, integrator, dt, seconds)
    swings = speed > max(30 * true[4], 0.01 * true[3])
    return energy > 30 * true[0] or late > 30 * true[1] or swings


def diagnosed(scene, integrators=(), **options):
    """`diagnose` in one thread, under the scene's own integrator and these alone."""
    options = {"threads": 1, "progress": False, "integrators": tuple(integrators)} | options
    return sc.diagnose(scene, **options)
