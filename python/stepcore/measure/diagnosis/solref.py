"""The `solref` of limits, equalities, friction losses and contacts, and what `refsafe` does to it.

In standard form (positive) it is a time constant and a damping ratio. `refsafe` keeps the time
constant at 2 dt or above, so from dt = tc/2 on the row gets softer as dt grows, and its stiffness
no longer depends on the scene alone. In direct form (negative) it is a stiffness and a damping,
which nothing softens.
"""

from __future__ import annotations

import math

from stepcore.engine.element import Element
from stepcore.engine.model import Model
from stepcore.scene.elements import Joint, Tendon
from stepcore.scene.frames import Vec


def solref_of(model: Model, element: Element) -> Vec | None:
    """The solref of an element; None for one that is not a row with a solref under the law."""
    limit = element.kind in ("limit", "tendon limit") and model.settings.law == "penalty"
    if model.settings.law != "solref" and not limit:
        return None
    if element.kind == "contact":
        return model.contact_pair(element.index).solref
    fields = (field for field in element.fields(model) if field.name.startswith("solref"))
    return next((field.value for field in fields), None)


def may_limit_dt(solref: Vec, refsafe: bool) -> bool:
    """Whether a row with this solref could limit dt.

    refsafe keeps rows of the standard form stable, h²/(tc ζ)² + 4h/tc < 4 at h = tc/2, if
    ζ > 1/√8.
    """
    return not refsafe or solref[0] <= 0 or solref[1] < math.sqrt(1 / 8)


def softened_from(model: Model, element: Element) -> float:
    """The dt [s] from which `refsafe` softens an element; inf where it never does."""
    solref = solref_of(model, element)
    if solref is None or not model.settings.refsafe or solref[0] <= 0:
        return math.inf
    return solref[0] / 2


def first_softened(model: Model) -> float:
    """The least dt [s] from which `refsafe` softens any row; inf where it softens none."""
    law, scene = model.settings.law, model.scene
    if law not in ("solref", "penalty") or not model.settings.refsafe:
        return math.inf
    lengths: list[Joint | Tendon] = [*scene.joints, *scene.tendons]
    solrefs = [length.solreflimit for length in lengths if length.range is not None]
    if law == "solref":
        solrefs += [length.solreffriction for length in lengths if length.frictionloss > 0]
        solrefs += [equality.solref for equality in scene.equalities]
        # What is mixed of two geoms lies between theirs.
        pairs = [g.solref for g in scene.geoms] if model.is_heap else model.pair_solref.tolist()
        solrefs += [tuple(solref) for solref in pairs]
    return min((solref[0] / 2 for solref in solrefs if solref[0] > 0), default=math.inf)
