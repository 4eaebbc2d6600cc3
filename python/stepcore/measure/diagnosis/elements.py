"""Which elements act at a state, and how stiff each is."""

from __future__ import annotations

import math
from collections.abc import Iterator

from stepcore.engine.element import EQUALITIES, FRICTION_LOSSES, ROWS, Element, ElementSlopes
from stepcore.engine.model import Model
from stepcore.engine.sim import Sim
from stepcore.scene.contents import Contents
from stepcore.scene.elements import Joint, Tendon
from stepcore.scene.frames import Vec

# The elements that a diagnosis names. What the others do (gravity, a fluid, applied forces) counts
# with the inertial forces.
NAMED = ("spring", "damper", "actuator", "tendon spring", "tendon damper", "spin", *ROWS)


def named_slopes(sim: Sim) -> dict[Element, ElementSlopes]:
    """Stiffness and damping at the present state of a Sim, of every element that is named."""
    return {e: slopes for e, slopes in sim.element_slopes().items() if e.kind in NAMED}


def row_elements(sim: Sim) -> Iterator[Element]:
    """The element of every row of the last solve, in order."""
    for kind, index in zip(sim.rows["kind"].tolist(), sim.rows["index"].tolist(), strict=True):
        yield Element.of(sim.model, kind, index)


def acting_elements(sim: Sim) -> tuple[Element, ...]:
    """The elements whose rows act: equalities, friction losses; limits and contacts that push."""
    rows = zip(row_elements(sim), (sim.rows["impulse"] != 0).tolist(), strict=True)
    always = (*EQUALITIES, *FRICTION_LOSSES)
    return tuple(dict.fromkeys(e for e, pushes in rows if pushes or e.kind in always))


def slipping_elements(sim: Sim) -> frozenset[Element]:
    """The friction losses whose rows are at the ends of their range, where nothing is stiff."""
    rows = sim.rows
    ends = (rows["impulse"] <= rows["lo"]) | (rows["impulse"] >= rows["hi"])
    both = zip(row_elements(sim), ends.tolist(), strict=True)
    return frozenset(e for e, slips in both if slips and e.kind in FRICTION_LOSSES)


def penalised_contacts(sim: Sim) -> tuple[Element, ...]:
    """The contacts that overlap under the law `penalty`, where they have no rows."""
    if sim.settings.law != "penalty" or sim.overlap <= 0:
        return ()
    contacts = sim.contacts
    pairs = contacts["index"][contacts["dist"] < 0].tolist()
    return tuple(Element.of(sim.model, "contact", pair) for pair in dict.fromkeys(pairs))


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
    return math.inf if solref is None else softened_dt(solref, model.settings.refsafe)


def softened_dt(solref: Vec, refsafe: bool) -> float:
    """The dt [s] from which `refsafe` softens a row with this solref; inf where it never does."""
    return solref[0] / 2 if refsafe and solref[0] > 0 else math.inf


def first_softened(model: Model) -> float:
    """The least dt [s] from which `refsafe` softens any row; inf where it softens none."""
    scene, law = model.scene, model.settings.law
    solrefs = [solref for _, solref in solrefs_of(scene, law)]
    if law == "solref":
        # What is mixed of two geoms lies between theirs.
        solrefs += [g.solref for g in scene.geoms] if model.is_heap else model.pair_solref.tolist()
    return min((softened_dt(s, model.settings.refsafe) for s in solrefs), default=math.inf)


def solrefs_of(scene: Contents, law: str) -> Iterator[tuple[str, Vec]]:
    """Kind and solref of all limits, friction losses and equalities that a law gives rows."""
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
