"""`Element`: what pushes, holds or constrains in a model, as the engine tells it apart.

`Elements`: several of them, which know how they are named in a sentence.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterable
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any

import numpy as np

from stepcore.report.units import counted, plural, unit_of
from stepcore.scene.elements.actuator_laws import LAW_FIELDS
from stepcore.scene.layout import Layout

if TYPE_CHECKING:
    from stepcore._core import Sim as CoreSim
    from stepcore.engine.arrays import Floats
    from stepcore.engine.model import Model

# Kinds that are rows of the solver (contacts except under the law `penalty`).
EQUALITIES = ("connect", "weld", "joint equality", "tendon equality")
FRICTION_LOSSES = ("friction loss", "tendon friction loss")
ROWS = ("contact", "limit", "tendon limit", *EQUALITIES, *FRICTION_LOSSES)

# By kind of element: whose fields set what it does, and which.
_LIMIT, _LOSS = ("solreflimit", "solimplimit", "range"), ("solreffriction", "solimpfriction")
FIELDS: dict[str, tuple[str, tuple[str, ...]]] = {
    "spring": ("joint", ("stiffness",)),
    "damper": ("joint", ("damping",)),
    "limit": ("joint", _LIMIT),
    "friction loss": ("joint", (*_LOSS, "frictionloss")),
    "tendon spring": ("tendon", ("stiffness",)),
    "tendon damper": ("tendon", ("damping",)),
    "tendon limit": ("tendon", _LIMIT),
    "tendon friction loss": ("tendon", (*_LOSS, "frictionloss")),
    **dict.fromkeys(EQUALITIES, ("equality", ("solref", "solimp"))),
}
OVERRIDE = "contact_override"

# The most names in a list.
NAMES = 4


@dataclass(frozen=True, order=True)
class Element:
    """One element of a model.

    kind: "spring", "damper", "actuator", "limit", "contact", "tendon spring" and so on, as in
    `Sim.rows` and `Sim.element_forces`; "spin" is the gyroscopic torque of a body, "control" what
    the user's control function makes of an actuator. index: of its joint, tendon, actuator,
    equality, body or pair of geoms. part: which part of it, -1 for the whole. name: what a user
    calls it. noun, owner, label: the parts of the name, as in "spring", "joint", "`knee`".
    """

    kind: str
    index: int
    part: int = field(default=-1, repr=False)
    name: str = field(default="", compare=False)
    noun: str = field(default="", compare=False, repr=False)
    owner: str = field(default="", compare=False, repr=False)
    label: str = field(default="", compare=False, repr=False)

    @classmethod
    def of(cls, model: Model, kind: str, index: int, part: int = -1) -> Element:
        """The element of a kind with its name."""
        known = "actuator" if kind == "control" else kind
        noun, owner, label = model.element_words(known, index, part)
        if kind == "control":
            noun, owner = "control", noun
        words = f"{noun} of {owner}" if owner else noun
        return cls(kind, index, part, f"{words} {label}".rstrip(), noun, owner, label)

    def fields(self, model: Model) -> tuple[SceneField, ...]:
        """The values of the scene that a user can change to change this element.

        Of a contact: those of its pair or of both its geoms, or of the override that replaces them.
        """
        scene, layout = model.scene, Layout(model.scene)
        if self.kind == "contact":
            return _contact_fields(model, layout, self.index)
        if self.kind == "actuator":
            names = (*LAW_FIELDS[scene.actuators[self.index].type], "gear", "forcerange")
            return tuple(SceneField.of(layout, "actuator", self.index, name) for name in names)
        kind, names = FIELDS.get(self.kind, ("", ()))
        return tuple(SceneField.of(layout, kind, self.index, name) for name in names)


@dataclass(frozen=True)
class SceneField:
    """A value of a scene, which sets what an element does.

    kind, index: whose it is, in the order of the compiled model. name: its name there. value,
    default, unit: the present value, that of a new scene, and the unit of both ("" for none). path:
    as `Model.with_values` takes it; "" where its owner has no name.
    """

    kind: str
    index: int
    name: str
    value: Any
    default: Any
    unit: str
    path: str

    @classmethod
    def of(cls, layout: Layout, kind: str, index: int, name: str) -> SceneField:
        """The field of the element of a kind with this index."""
        owner = _owner(layout, kind, index)
        joint, default = owner, getattr(type(owner), name, None)
        value = getattr(owner, name)
        if kind == "actuator":
            joint = owner.joint or owner.jointinparent
            if name in LAW_FIELDS[owner.type]:
                value, default = owner.law_value(name), LAW_FIELDS[owner.type][name]
        unit = unit_of(name, getattr(joint, "type", "") in ("hinge", "ball"))
        called = getattr(owner, "name", "")
        path = f"{kind}/{called}/{name}" if called else ""
        return cls(kind, index, name, value, default, unit, path)

    def assign(self, layout: Layout, value: Any) -> None:
        """Gives this field a value in a scene of this layout, a copy of the one that it is of."""
        setattr(_owner(layout, self.kind, self.index), self.name, value)


def _owner(layout: Layout, kind: str, index: int) -> Any:
    """The part of the scene that has a field."""
    scene: Any = layout.scene
    return scene.contact_override if kind == OVERRIDE else layout.elements[kind][index]


def _contact_fields(model: Model, layout: Layout, index: int) -> tuple[SceneField, ...]:
    scene, geoms = model.scene, model.contact_pair(index).geoms
    if scene.contact_override.enable:
        owners = [(OVERRIDE, 0)]
    else:
        both = {id(layout.geoms[geom]) for geom in geoms}
        pairs = enumerate(scene.pairs)
        owners = [("pair", k) for k, p in pairs if {id(p.geom1), id(p.geom2)} == both]
        owners = owners or [("geom", geom) for geom in geoms]
    return tuple(
        SceneField.of(layout, kind, k, name)
        for name in ("solref", "solimp", "friction", "margin")
        for kind, k in owners
    )


# What no element accounts for: Coriolis and centrifugal forces, and gravity.
INERTIAL = Element("inertial forces", 0, -1, "inertial forces", "inertial forces")


class Elements(tuple[Element, ...]):
    """Several elements, in order.

    >>> springs = [Element("spring", i, -1, f"spring of joint `h{i}`", "spring", "joint", f"`h{i}`")
    ...            for i in range(10)]
    >>> Elements(springs).name
    'the 10 springs of joints `h0`, `h1`, `h2`, `h3` and 6 more'
    >>> Elements(springs).summary
    '10 springs'
    """

    __slots__ = ()

    @property
    def several(self) -> bool:
        """Whether their name is that of several things, as the verb after it must be."""
        return len(self) > 1 or self == (INERTIAL,)

    @property
    def name(self) -> str:
        """One element by its name; elements of one kind as what they are."""
        if len(self) < 2:
            return "".join(element.name for element in self)
        nouns = {(element.noun, element.owner) for element in self}
        if len(nouns) > 1 or not all(element.label.startswith("`") for element in self):
            return listed([element.name for element in self])
        ((noun, owner),) = nouns
        kind = plural(noun) + (f" of {plural(owner)}" if owner else "")
        return f"the {len(self)} {kind} {listed([element.label for element in self])}"

    @property
    def together(self) -> str:
        """Their name as that of what does something together."""
        return self.name + (" together" if len(self) > 1 else "")

    @property
    def summary(self) -> str:
        """A few elements by name; more of them by how many there are of each noun."""
        if len(self) <= NAMES:
            return listed([element.name for element in self])
        counts = [counted(n, noun) for noun, n in Counter(e.noun for e in self).items()]
        return " and ".join(filter(None, (", ".join(counts[:-1]), counts[-1])))


def listed(names: Iterable[str]) -> str:
    """The first names, and how many more there are."""
    every = list(names)
    more = len(every) - NAMES
    return ", ".join(every[:NAMES]) + (f" and {more} more" if more > 0 else "")


@dataclass(frozen=True)
class ElementSlopes:
    """What an element does at a state, and how that changes.

    stiffness [N/m or N·m/rad], damping: minus the derivatives of its generalised force by position
    (in the coordinates of qvel) and velocity, shape (nv, nv) each. force: shape (nv,) [N or N·m].
    energy: what it stores [J].
    """

    stiffness: Floats
    damping: Floats
    force: Floats
    energy: float = 0.0

    @classmethod
    def of(cls, stiffness: Floats, damping: Floats) -> ElementSlopes:
        """Those of what pushes with no force of its own at the state."""
        return cls(stiffness, damping, np.zeros(len(stiffness)))

    def change(self, x: Floats) -> Floats:
        """How the force changes, −K dq − D dv, for a block of x = [dq, dv]; shape (nv, …)."""
        n = len(self.stiffness)
        return -(self.stiffness @ x[:n] + self.damping @ x[n:])


def element_slopes(model: Model, core: CoreSim) -> dict[Element, ElementSlopes]:
    """Those of every element that acts at the present state; see `Sim.element_slopes`."""
    ids, forces, energies, entries = core.element_slopes()
    matrices = np.zeros((len(ids), 2, model.nv, model.nv))
    nth, i, j = entries[:, :3].astype(int).T
    matrices[nth, :, i, j] = entries[:, 3:]
    return {
        Element.of(model, *element): ElementSlopes(stiffness, damping, force, energy)
        for element, (stiffness, damping), force, energy in zip(
            ids, matrices, forces, energies, strict=True
        )
    }
