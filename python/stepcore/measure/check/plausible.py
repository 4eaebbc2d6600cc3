"""Findings on implausible values: inertias, centres of mass, mass matrix."""

from __future__ import annotations

import math
from collections.abc import Iterator
from typing import NamedTuple

import numpy as np

from stepcore.engine.arrays import Floats
from stepcore.engine.model import Model
from stepcore.engine.sim import Sim
from stepcore.measure.check.described import LIST, Described
from stepcore.measure.monitors.finding import FEW, HALF, Finding, listed, named, others, worst
from stepcore.report.units import metres
from stepcore.scene.elements import Geom
from stepcore.viewing import surfaces

# Largest and smallest radius of gyration over the reach of the geoms from the centre of mass. 25
# files (12 models) with explicit inertias have 0.24 (a finger of Panda) to 2.4 (its link1).
# Exceptions are 5.5 in dm_control's arm.xml, which is wrong, and 3.9 and 50 in parts whose meshes
# were left out. In 58-finger3.urdf, whose inertias are 1000 times too small, it is 0.02.
TOO_FAR, TOO_NEAR = 3.0, FEW
# Smallest eigenvalue of the mass matrix of joints scaled to a unit diagonal. The smallest in about
# 90 files are 0.0029 and, for a worm that fails, 3.4e-4.
SINGULAR = 1e-6


def plausibility(scene: Described) -> Iterator[Finding]:
    """Yield the findings on values that no real object has."""
    sim = Sim(scene.model)
    bodies = _given(scene, sim)
    yield from _inertias(scene, bodies)
    yield from _centres(scene, bodies)
    yield from _singular(scene, sim)


# Bodies.


class _Body(NamedTuple):
    """A body with an explicit inertia: the radius of gyration and the extent of the body [m].

    points: on its geoms, from the centre of mass, in the body's frame, (n, 3). outline: these, its
    joints and the frames of its children; a link reaches from joint to joint.
    """

    gyration: float
    points: Floats
    outline: Floats

    @property
    def reach(self) -> float:
        """The distance from the centre of mass to the furthest point [m]."""
        return float(np.linalg.norm(self.points, axis=1).max())


def _given(scene: Described, sim: Sim) -> dict[int, _Body]:
    """Return the bodies with an explicit inertia and with geoms of finite size."""
    model, found = scene.model, dict[int, _Body]()
    turns = np.reshape(sim.xmat, (-1, 3, 3))
    for body in scene.moving:
        mass, geoms = float(model.body_mass[body]), scene.geoms(body)
        if scene.layout.bodies[body].mass is None or not geoms or mass <= 0:
            continue
        each = [_surface(model, geom, index) for index, geom in geoms.items()]
        axes = np.reshape(sim.geom_xmat, (-1, 3, 3))[[*geoms]]
        places = zip(each, sim.geom_xpos[[*geoms]], axes, strict=True)
        points = np.concatenate([at + of @ turn.T for of, at, turn in places])
        if len(points) and np.isfinite(points).all():
            trace = float(np.trace(np.asarray(model.body_inertia[body])))
            children, centre = model.body_parent == body, model.body_ipos[body]
            own = (points - sim.xpos[body]) @ turns[body] - centre
            ends = (sim.xpos[children] - sim.xpos[body]) @ turns[body] - centre
            joints = model.jnt_pos[model.jnt_body == body] - centre
            outline = np.concatenate([own, ends, joints, -centre[None]])
            found[body] = _Body(math.sqrt(max(trace, 0.0) / 2 / mass), own, outline)
    return found


def _surface(model: Model, geom: Geom, index: int) -> Floats:
    """Return points on a geom in its frame [m], (n, 3); not finite for an infinite geom."""
    if geom.type == "mesh":
        return model.geom_hull(index)[0]
    if geom.type in ("plane", "hfield"):
        return np.full((1, 3), np.inf)
    points: Floats = surfaces.of_primitive(geom.type, tuple(model.geom_size[index]), 1.0)[0]
    return points


def _inertias(scene: Described, bodies: dict[int, _Body]) -> Iterator[Finding]:
    """Yield explicit inertias that do not fit the mass and the extent of the body."""
    model = scene.model
    # Visual meshes are not read, so a body may reach further than its geoms.
    whole = not any("only draws" in line for line in model.scene.ignored)

    def over(body: int) -> float:
        of = bodies[body]
        near = TOO_NEAR * of.reach / max(of.gyration, 1e-300)
        return max(near, of.gyration / (TOO_FAR * of.reach) if whole and of.reach else 0.0)

    wrong = worst(bodies, over)
    if not wrong:
        return
    of, mass = bodies[wrong[0]], float(model.body_mass[wrong[0]])
    elements, ball = named(model, "body", wrong), 0.4 * mass * of.reach**2
    only = "only " * (of.gyration > of.reach)
    problem = (
        f"the inertia of {listed(elements, 'body')} belongs to mass {metres(of.gyration)} from its "
        f"centre, but the body reaches {only}{metres(of.reach)} (a ball of its mass and "
        f"size has {ball:.2g} kg·m²)"
    )
    fix = "correct its <inertial>, or let mass and inertia come from the geoms "
    fix += '(inertiafromgeom="true")'
    severity = "error" if only else "warning"
    yield Finding("inertia", severity, problem, fix, elements, of.gyration, "m", LIST)


def _centres(scene: Described, bodies: dict[int, _Body]) -> Iterator[Finding]:
    """Yield centres of mass far outside of the convex hull of the body's geoms."""
    model = scene.model
    # The furthest of 25 files (12 models) is 0.18 of the half size outside (go2_mjx.xml), except
    # for a light switch of a kitchen with 5.1, which has the <inertial> of another body.
    # com_outside.xml has 3.1.
    wrong = worst(bodies, lambda k: outside(bodies[k].outline)[0] / HALF)
    if wrong:
        elements, (share, size) = named(model, "body", wrong), outside(bodies[wrong[0]].outline)
        problem = (
            f"the centre of mass of {listed(elements, 'body')} is {metres(share * size)} outside "
            f"of the convex hull of its geoms and joints, which is {metres(2 * size)} large"
        )
        fix, value = "correct the pos of its <inertial>", share * size
        yield Finding("centre of mass", "warning", problem, fix, elements, value, "m", LIST)


def outside(points: Floats) -> tuple[float, float]:
    """Return the distance of the origin from the convex hull of points, and half its size [m].

    The unit of the distance is the half size. It is a lower bound by Gilbert's method: the hull
    lies behind the plane through its furthest point towards the origin.

    >>> share, size = outside(np.array([[2.0, 1.0, 0.0], [2.0, -1.0, 0.0]]))
    >>> print(f"{share:.3f} {size:.3f}")
    2.000 1.000
    """
    size = float(np.linalg.norm(np.ptp(points, axis=0))) / 2 or 1.0
    nearest, far = points[0], 0.0
    for _ in range(100):
        away = float(np.linalg.norm(nearest))
        if away <= far * (1 + 1e-3) or away < 1e-6 * size:
            break
        point = points[np.argmin(points @ nearest)]
        far, edge = max(far, float(point @ nearest) / away), point - nearest
        share = -float(nearest @ edge) / max(float(edge @ edge), 1e-300)
        nearest = nearest + min(max(share, 0.0), 1.0) * edge
    return far / size, size


# The mass matrix.


def _singular(scene: Described, sim: Sim) -> Iterator[Finding]:
    """Yield joints that move the same masses in the same way, at the start or in a keyframe."""
    model = scene.model
    states = [(f"{name[:1].lower()}{name[1:]}", qpos) for name, qpos, _ in scene.keys]
    if scene.key is None:
        states.insert(0, ("the start", scene.start.qpos))
    for where, qpos in states:
        share, dofs = alike(sim, qpos)
        if share < SINGULAR:
            owner = np.searchsorted(model.jnt_dofadr, dofs, side="right") - 1
            elements = named(model, "joint", owner)
            problem = (
                f"{elements[0].name}{others(elements[1:], 'joint')} move the same masses alike at "
                f"{where}, so the mass matrix is singular (smallest "
                f"eigenvalue {share:.2g}, scaled to a unit diagonal)"
            )
            fix = "give one of them an armature, remove it, or start from another pose"
            yield Finding("mass matrix", "error", problem, fix, elements, share, "1", LIST)
            return


def alike(sim: Sim, qpos: Floats) -> tuple[float, list[int]]:
    """Return the smallest eigenvalue of the mass matrix at a pose, and the dofs of its eigenvector.

    The matrix is scaled to a unit diagonal. The dofs are in order of their share.
    """
    sim.qpos = qpos
    mass = np.array(sim.mass_matrix())
    scale = np.sqrt(np.maximum(np.diag(mass), 1e-300))
    values, vectors = np.linalg.eigh(mass / np.outer(scale, scale))
    shares = np.abs(vectors[:, 0])
    dofs = np.argsort(-shares, kind="stable")
    return float(values[0]), [int(k) for k in dofs if shares[k] > FEW * shares.max()]
