"""`ElementId`: the element of a model that a stiffness, a share or a limit belongs to."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, field

from stepcore.engine.model import Model
from stepcore.engine.sim import Sim

# Kinds that are rows of the solver (contacts except under the law `penalty`).
EQUALITIES = ("connect", "weld", "joint equality", "tendon equality")
ROWS = (
    *("contact", "limit", "tendon limit"),
    *EQUALITIES,
    *("friction loss", "tendon friction loss"),
)


@dataclass(frozen=True, order=True)
class ElementId:
    """One element of a model.

    kind: "spring", "damper", "actuator", "limit", "friction loss", "connect", "weld",
    "joint equality", "contact", "tendon spring", "tendon damper", "tendon limit" or "friction
    loss" as in `Sim.rows` and `Sim.contacts`, or "spin", the gyroscopic torque of a body, or
    "control", what the user's control function makes of an actuator. index: of its joint, tendon,
    actuator, equality, pair of geoms or body. name: as `Model.element_name` has it.
    """

    kind: str
    index: int
    name: str = field(compare=False)

    @classmethod
    def of(cls, model: Model, kind: str, index: int) -> ElementId:
        """The element of a kind with its name."""
        if kind == "spin":
            return cls(kind, index, f"spin of {model.element_name('body', index)}")
        if kind == "control":
            return cls(kind, index, f"control of {model.element_name('actuator', index)}")
        return cls(kind, index, model.element_name(kind, index))


# What no element accounts for: gravity, Coriolis and centrifugal forces.
INERTIAL = ElementId("inertial forces", 0, "inertial forces")


def row_elements(sim: Sim) -> Iterator[ElementId]:
    """The element of every row of the last solve, in order."""
    rows = sim.rows
    names = zip(rows["kind"].tolist(), rows["index"].tolist(), rows["name"].tolist(), strict=True)
    return (ElementId(*row) for row in names)


def acting_elements(sim: Sim) -> tuple[ElementId, ...]:
    """The elements whose rows act: equalities, friction losses; limits and contacts that push."""
    always = (*EQUALITIES, "friction loss", "tendon friction loss")
    rows = zip(row_elements(sim), (sim.rows["impulse"] != 0).tolist(), strict=True)
    return tuple(dict.fromkeys(e for e, pushes in rows if pushes or e.kind in always))


def slipping_elements(sim: Sim) -> frozenset[ElementId]:
    """The friction losses whose rows are at the ends of their range, where nothing is stiff."""
    rows = sim.rows
    ends = (rows["impulse"] <= rows["lo"]) | (rows["impulse"] >= rows["hi"])
    losses = ("friction loss", "tendon friction loss")
    both = zip(row_elements(sim), ends.tolist(), strict=True)
    return frozenset(e for e, slips in both if slips and e.kind in losses)


def penalised_contacts(sim: Sim) -> tuple[ElementId, ...]:
    """The contacts that overlap under the law `penalty`, where they have no rows."""
    if sim.settings.law != "penalty" or sim.overlap <= 0:
        return ()
    contacts = sim.contacts
    pairs = contacts["index"][contacts["dist"] < 0].tolist()
    return tuple(ElementId.of(sim.model, "contact", pair) for pair in dict.fromkeys(pairs))
