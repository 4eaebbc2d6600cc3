"""Stage 4, commit: one function an integrator, and addition in the space of qpos."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from .model import Model
from .rotation import Array, cross, from_vector, multiply, unit
from .world import World

Acceleration = Callable[[Array, Array], Array]  # of any qpos and qvel
Smooth = tuple[Array, Array]  # the mean velocity of the smooth motion, and its last one
# Of a world, its velocity at the start, and its accelerations.
Rule = Callable[[World, Array, Acceleration], Smooth]


def add(model: Model, qpos: Array, change: Array) -> Array:
    """qpos moved by a small motion in the coordinates of qvel; quaternions turn."""
    out = np.array(qpos, float)
    for joint in model.joints:
        at, dof, width = joint["qpos"], joint["dof"], joint["width"]
        if width == 6:
            out[at : at + 3] += change[dof : dof + 3]
            at, dof = at + 3, dof + 3
        if width == 1:
            out[at] += change[dof]
        else:
            turn = from_vector(change[dof : dof + 3])
            out[at : at + 4] = unit(multiply(unit(out[at : at + 4]), turn))
    return out


def pulled_back(model: Model, moved: Array, v: Array) -> Array:
    """Rate of the rotation vectors `moved` under the velocity v, shape (nv,).

    In body axes, u' = w + u x w / 2 + g u x (u x w), g = (1 - (a/2) cot(a/2)) / a^2, a = |u|
    (Munthe-Kaas): with it Runge-Kutta keeps its fourth order on rotations.
    """
    rate = v.copy()
    for joint in model.joints:
        if joint["width"] >= 3:
            own = slice(joint["dof"] + joint["width"] - 3, joint["dof"] + joint["width"])
            u, w = moved[own], v[own]
            a = np.sqrt(u @ u)
            g = (1 - a / 2 / np.tan(a / 2)) / a**2 if a > 1e-2 else 1 / 12 + a * a / 720
            twist = cross(u, w)
            rate[own] = w + twist / 2 + g * cross(u, twist)
    return rate


def euler(world: World, v: Array, acceleration: Acceleration) -> Smooth:
    """The guess of both Euler rules: forces at the start."""
    v1 = v + world.settings.dt * acceleration(world.qpos, v)
    return v1, v1


def midpoint(world: World, v: Array, acceleration: Acceleration) -> Smooth:
    """v1 = v + dt a(q_m, v_m) at the middle of the step, solved to rounding.

    Newton with a Jacobian by differences, kept for the whole step.
    """
    dt = world.settings.dt

    def middle(v1: Array) -> Array:
        return (v + v1) / 2

    def error(v1: Array) -> Array:
        q_m = add(world.model, world.qpos, dt / 2 * middle(v1))
        return v1 - v - dt * acceleration(q_m, middle(v1))

    v1 = v + dt * acceleration(world.qpos, v)
    start = error(v1)
    h = 1e-6 * (1 + np.abs(v1))
    slope = np.array([(error(v1 + h * e) - start) / (h @ e) for e in np.eye(len(v))]).T
    last = np.inf
    for _ in range(60):
        change = np.linalg.solve(slope, error(v1))
        size = np.abs(change).max()
        if size >= last:  # rounding reached: no step is better than the last one
            break
        v1, last = v1 - change, size
    return middle(v1), v1


def rk4(world: World, v: Array, acceleration: Acceleration) -> Smooth:
    """Classical Runge-Kutta, fourth order."""
    dt = world.settings.dt
    rate, push = np.zeros_like(v), np.zeros_like(v)
    total_rate, total_push = np.zeros_like(v), np.zeros_like(v)
    for reach, weight in ((0, 1), (0.5, 2), (0.5, 2), (1, 1)):
        moved, speed = reach * dt * rate, v + reach * dt * push
        rate = pulled_back(world.model, moved, speed)
        push = acceleration(add(world.model, world.qpos, moved), speed)
        total_rate, total_push = total_rate + weight * rate, total_push + weight * push
    return total_rate / 6, v + dt / 6 * total_push


SMOOTH: dict[str, Rule] = {
    "explicit": euler,
    "semi-implicit": euler,
    "midpoint": midpoint,
    "rk4": rk4,
}


def commit(world: World, mean: Array, last: Array) -> None:
    """Positions by the rule of the integrator, `mean` solved; one more dt on the clock."""
    moving = world.qvel if world.settings.integrator == "explicit" else mean
    world.qpos[:] = add(world.model, world.qpos, world.settings.dt * moving)
    world.qvel[:] = last
    world.steps += 1
