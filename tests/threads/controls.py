"""Controls with which people asked for help; the scenes beside have the names of their threads."""

import math


def fast(t, sim):
    """A cup that is shaken at 3 Hz."""
    return [0.3 * math.sin(2 * math.pi * 3 * t)]


def pd(t, sim):
    """A leg under a PD controller."""
    q, v = sim.qpos, sim.qvel
    return [20.0 * (0.8 - q[0]) - 0.5 * v[0], 20.0 * (-1.5 - q[1]) - 0.5 * v[1]]


def sine10(t, sim):
    """A servo that is asked for 10 Hz."""
    return [0.5 * math.sin(2 * math.pi * 10 * t)]


def pid(t, sim):
    """p = 100 and d = 10 on each joint, as one sets for Gazebo's controllers."""
    return [100.0 * (0.5 - q) - 10.0 * v for q, v in zip(sim.qpos, sim.qvel, strict=True)]


def impedance(t, sim):
    """Joint impedance, with the same stiffness and damping on all joints."""
    goal, q, v = [0.5, 1.3, 0.6, 0.2], sim.qpos, sim.qvel
    return [100.0 * (g - a) - 20.0 * b for g, a, b in zip(goal, q, v, strict=True)]


def damping10(t, sim):
    """D (v_target - v) of each wheel, with D = 10."""
    return [10.0 * (w - x) for w, x in zip((12, 4, 12, 4), sim.qvel[6:10], strict=True)]


def damping20(t, sim):
    """The same with D = 20."""
    return [2 * force for force in damping10(t, sim)]


def shake(t, sim):
    """A carriage that shakes its gripper by 10 cm at 2 Hz."""
    return [-0.6, 0.0 if t < 0.3 else 0.1 * math.sin(2 * math.pi * 2.0 * (t - 0.3)), 0.0]
