"""The softness of a scene: the solref of every element that can make constraint rows; its size."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from stepcore.scene.elements import Joint, Tendon

if TYPE_CHECKING:
    from stepcore.scene.scene import Scene

Ref = tuple[float, ...]
# The size of a scene in which nothing has a length [m].
UNKNOWN = 1.0


def solrefs(scene: Scene) -> list[Ref]:
    """Return the solref values of all elements of a scene that can make constraint rows."""
    refs = [g.solref for g in scene.geoms if g.contype or g.conaffinity]
    lengths: list[Joint | Tendon] = [*scene.joints, *scene.tendons]
    refs += [length.solreflimit for length in lengths if length.range is not None]
    refs += [length.solreffriction for length in lengths if length.frictionloss > 0]
    refs += [e.solref for e in scene.equalities if e.active]
    refs += [pair.solref for pair in scene.pairs]
    refs += [scene.contact_override.solref] * scene.contact_override.enable
    return refs


def clamping(scene: Scene) -> float | None:
    """Return the shortest solref time constant [s], or None if no solref is a time constant.

    At a dt above half of this time constant, `refsafe` softens rows.
    """
    return min((ref[0] for ref in solrefs(scene) if ref[0] > 0), default=None)


def extent(scene: Scene) -> float:
    """Return the size of a scene at rest [m]; 0 if nothing in it has a length.

    The size is the largest distance of a body from its parent plus the largest half size of a geom.
    """
    thick = max((geom.half_size for geom in scene.geoms), default=0.0)
    arm = max((float(np.linalg.norm(body.pos)) for body in scene.bodies), default=0.0)
    return thick + arm
