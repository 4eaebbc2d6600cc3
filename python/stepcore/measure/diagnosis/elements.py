"""Find the elements that act at a state, and the solref from which a row's stiffness comes."""

from __future__ import annotations

import math
from collections.abc import Iterator

from stepcore.engine.element import EQUALITIES, FRICTION_LOSSES, ROWS, Element, ElementSlopes
from stepcore.engine.model import Model
from stepcore.engine.sim import Sim
from stepcore.scene.elements import Joint, Tendon
from stepcore.scene.frames import Vec
from stepcore.scene.scene import Scene

# The elements that a diagnosis names. All other forces (gravity, fluid, applied forces) count with
# the inertial forces.
NAMED = ("spring", "damper", "actuator", "tendon spring", "tendon damper", "spin", *ROWS)


def named_slopes(sim: Sim) -> dict[Element, ElementSlopes]:
    """Return stiffness and damping of every named element at the present state of a Sim."""
    return {e: slopes for e, slopes in sim.element_slopes().items() if e.kind in NAMED}


def row_elements(sim: Sim) -> Iterator[Element]:
    """Yield the element of every row of the last solve, in order."""
    for kind, index in zip(sim.rows["kind"].tolist(), sim.rows["index"].tolist(), strict=True):
        yield Element.of(sim.model, kind, index)


def acting_elements(sim: Sim) -> tuple[Element, ...]:
    """Return the elements whose rows act at the present state.

    Equalities and friction losses always act; limits and contacts act if they push.
    """
    rows = zip(row_elements(sim), (sim.rows["impulse"] != 0).tolist(), strict=True)
    always = (*EQUALITIES, *FRICTION_LOSSES)
    return tuple(dict.fromkeys(e for e, pushes in rows if pushes or e.kind in always))


def slipping_elements(sim: Sim) -> frozenset[Element]:
    """Return the friction losses that give their full force, where they have no stiffness."""
    rows = sim.rows
    ends = (rows["impulse"] <= rows["lo"]) | (rows["impulse"] >= rows["hi"])
    both = zip(row_elements(sim), ends.tolist(), strict=True)
    return frozenset(e for e, slips in both if slips and e.kind in FRICTION_LOSSES)


def penalised_contacts(sim: Sim) -> tuple[Element, ...]:
    """Return the contacts that overlap under the law `penalty`, which gives them no rows."""
    if sim.settings.law != "penalty" or sim.overlap <= 0:
        return ()
    contacts = sim.contacts
    pairs = contacts["index"][contacts["dist"] < 0].tolist()
    return tuple(Element.of(sim.model, "contact", pair) for pair in dict.fromkeys(pairs))


def solref_of(model: Model, element: Element) -> Vec | None:
    """Return the solref of an element, or None if its law gives it no row with a solref."""
    limit = element.kind in ("limit", "tendon limit") and model.settings.law == "penalty"
    if model.settings.law != "solref" and not limit:
        return None
    if element.kind == "contact":
        return model.contact_pair(element.index).solref
    fields = (field for field in element.fields(model) if field.name.startswith("solref"))
    return next((field.value for field in fields), None)


def may_limit_dt(solref: Vec, refsafe: bool) -> bool:
    """Return whether a row with this solref could limit dt.

    For ζ > 1/√8, refsafe keeps rows of the standard form stable:
    h²/(tc ζ)² + 4h/tc < 4 at h = tc/2.
    """
    return not refsafe or solref[0] <= 0 or solref[1] < math.sqrt(1 / 8)


def softened_from(model: Model, element: Element) -> float:
    """Return the dt [s] above which `refsafe` softens an element; inf if none."""
    solref = solref_of(model, element)
    return math.inf if solref is None else softened_dt(solref, model.settings.refsafe)


def softened_dt(solref: Vec, refsafe: bool) -> float:
    """Return the dt [s] above which `refsafe` softens a row with this solref; inf if none."""
    return solref[0] / 2 if refsafe and solref[0] > 0 else math.inf


def first_softened(model: Model) -> float:
    """Return the least dt [s] above which `refsafe` softens any row; inf if it softens none."""
    scene, law = model.scene, model.settings.law
    solrefs = [solref for _, solref in solrefs_of(scene, law)]
    if law == "solref":
        # A pair's solref is a mixture and lies between those of its geoms.
        solrefs += [g.solref for g in scene.geoms] if model.is_heap else model.pair_solref.tolist()
    return min((softened_dt(s, model.settings.refsafe) for s in solrefs), default=math.inf)


def solrefs_of(scene: Scene, law: str) -> Iterator[tuple[str, Vec]]:
    """Yield kind and solref of all limits, friction losses and equalities with rows under a law."""
    features = scene.features
    if not features.constraint or law not in ("solref", "penalty"):
        return
    for prefix, lengths in (("", scene.joints), ("tendon ", scene.tendons)):
        length: Joint | Tendon
        for length in lengths:
            if features.limit and length.range is not None:
                yield f"{prefix}limit", length.solreflimit
            if features.frictionloss and length.frictionloss > 0 and law == "solref":
                yield f"{prefix}friction loss", length.solreffriction
    if features.equality and law == "solref":
        yield from ((e.row_kind, e.solref) for e in scene.equalities if e.active)
