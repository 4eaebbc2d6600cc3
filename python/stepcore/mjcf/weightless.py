"""Bodies in frames that weigh nothing: where their inertia is.

MuJoCo gives a body without mass the pose that the file gives the body as that of its inertia: the
one written there, before the frames that hold it. It counts where `boundmass` or `boundinertia`
make a mass of it, for the inverse weight at its contacts, and where a sensor tells of it.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np

from stepcore.mjcf.masses import Weight, give, weights_under
from stepcore.mjcf.visual_geoms import senses_mass
from stepcore.scene.elements import Body, MassRules

if TYPE_CHECKING:
    from stepcore.mjcf.worldbody import WorldReader


def place_weightless(world: WorldReader) -> None:
    """Gives such bodies an inertial of no mass there."""
    scene = world.scene
    touching, sensed = {id(geom.body) for geom in scene.geoms}, senses_mass(scene)
    groups: dict[tuple[tuple[str, Any], ...], list[Body]] = {}
    for body in scene.bodies:
        rules = world.rules_of(body)
        counts = sensed or id(body) in touching or rules.boundmass > 0 or rules.boundinertia > 0
        if counts and body.mass is None and id(body) in world.written:
            unbounded = rules.values() | {"boundmass": 0.0, "boundinertia": 0.0}
            groups.setdefault(tuple(unbounded.items()), []).append(body)
    for kept, bodies in groups.items():
        known = weights_under(MassRules(**dict(kept)), scene, bodies)
        for body in bodies:
            if known[id(body)].mass == 0.0:
                pos, quat = world.written[id(body)]
                give(body, Weight(0.0, np.array(pos), np.zeros((3, 3)), quat))
