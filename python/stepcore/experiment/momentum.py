"""Momentum that nothing in the scene can have given or taken."""

from __future__ import annotations

import numpy as np

from stepcore.engine.model import Model
from stepcore.scene.elements import Equality
from stepcore.scene.layout import Layout
from stepcore.scene.tying import LENGTHS


def _inside(layout: Layout, equality: Equality) -> bool:
    """It ties only what moves; one end of a connect or weld may be the world."""
    moving = all(layout.moving(body) for body in equality.bodies)
    return moving and (equality.type in LENGTHS or len(equality.bodies) == 2)


class Balance:
    """Whether a scene's momentum can be known, and how much of it a run lost.

    known: every tree hangs on the world by a free joint on which nothing but gravity acts. Then
    internal forces, actuators and contacts among the bodies included, cancel: p = p₀ + m g t, and
    the angular momentum about the centre of mass stays as it is. Forces written to a Sim from
    outside and contacts with what stands still would have to be measured, not known.
    """

    def __init__(self, model: Model, layout: Layout, gravity: np.ndarray, mass: np.ndarray) -> None:
        scene = model.scene
        roots = [
            joint
            for joint in layout.joints
            if joint.body.parent is None or not layout.moving(joint.body.parent)
        ]
        driven = {id(actuator.target[1]) for actuator in scene.actuators}
        # A jet pushes on the world.
        jets = any(a.site is not None and a.refsite is None for a in scene.actuators)
        tied = any(e.active and not _inside(layout, e) for e in scene.equalities)
        self.gravity, self.mass = gravity, mass
        held = scene.density > 0 or scene.viscosity > 0 or any(b.gravcomp for b in scene.bodies)
        self.known = not (tied or held or jets) and all(
            joint.type == "free"
            and not (joint.damped or joint.sprung or joint.armature or joint.frictionloss)
            and id(joint) not in driven
            for joint in roots
        )

    def lost(self, momenta: np.ndarray, com: np.ndarray, times: np.ndarray) -> tuple[float, float]:
        """The most linear [kg·m/s] and angular momentum [kg·m²/s] unexplained at a sample.

        momenta, com: see `States`, first those of the start; times: of these samples [s].
        """
        linear, total = momenta[:, :3], self.mass.sum()
        centre = np.einsum("b,nbi->ni", self.mass, com) / total
        spin = momenta[:, 3:] - np.cross(centre, linear)
        pushed = linear - linear[0] - total * times[: len(momenta), None] * self.gravity
        return (
            float(np.linalg.norm(pushed, axis=1).max()),
            float(np.linalg.norm(spin - spin[0], axis=1).max()),
        )
