"""The `solref` of limits, connects, friction losses and contacts, and what `refsafe` does to it.

In standard form (positive) it is a time constant and a damping ratio; `refsafe` keeps the time
constant at 2 dt or above, so that from dt = tc/2 on the row gets softer as dt grows, and what it
asks for no longer depends on the scene alone. In direct form (negative) it is a stiffness and a
damping, which nothing softens.
"""

from __future__ import annotations

import math

from stepcore.engine.model import Model
from stepcore.measure.diagnosis.element_forces import Key
from stepcore.scene.elements import Geom
from stepcore.scene.frames import Vec
from stepcore.scene.layout import Layout


def solref_of(model: Model, layout: Layout, key: Key) -> Vec | None:
    """The solref of a soft element; None for one that is not a row of the law `solref`."""
    law = model.settings.law
    if key.kind == "limit" and law in ("solref", "penalty"):
        return layout.joints[key.index[0]].solreflimit
    if law != "solref":
        return None
    if key.kind == "friction loss":
        return layout.joints[key.index[0]].solreffriction
    if key.kind == "connect":
        return model.scene.equalities[key.index[0]].solref
    if key.kind == "contact":
        return mixed(*(layout.geoms[geom] for geom in key.index))
    return None


def mixed(x: Geom, y: Geom) -> Vec:
    """The solref of two geoms together, as MuJoCo mixes it."""
    if x.priority != y.priority:
        return x.solref if x.priority > y.priority else y.solref
    if x.solref[0] <= 0 or y.solref[0] <= 0:
        return tuple(min(p, q) for p, q in zip(x.solref, y.solref, strict=True))
    total = x.solmix + y.solmix
    share = x.solmix / total if total > 0 else 0.5
    return tuple(share * p + (1 - share) * q for p, q in zip(x.solref, y.solref, strict=True))


def may_limit(solref: Vec, refsafe: bool) -> bool:
    """Whether a row with this solref could limit dt: refsafe keeps those of the standard form
    stable, h²/(tc ζ)² + 4h/tc < 4 at h = tc/2, where ζ > 1/√8."""
    return not refsafe or solref[0] <= 0 or solref[1] < math.sqrt(1 / 8)


def softened_beyond(model: Model, layout: Layout, key: Key) -> float:
    """The dt [s] from which `refsafe` softens an element; inf where it never does."""
    solref = solref_of(model, layout, key)
    if solref is None or not model.settings.refsafe or solref[0] <= 0:
        return math.inf
    return solref[0] / 2


def first_softened(model: Model) -> float:
    """The least dt [s] from which `refsafe` softens anything that has a row; inf where nothing."""
    if model.settings.law not in ("solref", "penalty") or not model.settings.refsafe:
        return math.inf
    scene = model.scene
    solrefs = [joint.solreflimit for joint in scene.joints if joint.range is not None]
    solrefs += [joint.solreffriction for joint in scene.joints if joint.frictionloss > 0]
    solrefs += [equality.solref for equality in scene.equalities]
    # A mean of two time constants is at least the smaller.
    solrefs += [geom.solref for geom in scene.geoms]
    return min((solref[0] / 2 for solref in solrefs if solref[0] > 0), default=math.inf)
