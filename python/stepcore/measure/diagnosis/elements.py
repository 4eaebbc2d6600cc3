"""Which elements act at a state, and how stiff each is."""

from __future__ import annotations

from collections.abc import Iterator

from stepcore.engine.element import EQUALITIES, FRICTION_LOSSES, ROWS, Element, ElementSlopes
from stepcore.engine.sim import Sim

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
