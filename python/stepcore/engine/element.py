"""`Element`: a force or constraint element of a model, as the engine distinguishes them.

`Elements`: several elements, with their name in a sentence.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterable
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any

import numpy as np

from stepcore.report.units import counted, kind_unit, plural
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

# For each kind of element: the part of the scene that parametrises the element, and its fields.
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
CONTACT = ("solref", "solimp", "friction", "margin")
OVERRIDE = "contact_override"

# The maximum number of names in a list.
NAMES = 4


@dataclass(frozen=True, order=True)
class Element:
    """One element of a model.

    kind: "spring", "damper", "actuator", "limit", "contact", "tendon spring" and so on, as in
    `Sim.rows` and `Sim.element_forces`; "spin" is the gyroscopic torque of a body, "control" an
    actuator driven by the user's control function. index: of the joint, tendon, actuator, equality,
    body or pair of geoms. part: the number of the part, -1 for the whole. name: the full name.
    noun, owner, label: the parts of the name, as in "spring", "joint", "`knee`".
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
        """Create the element of a kind, with its name."""
        named_kind = "actuator" if kind == "control" else kind
        noun, owner, label = model.element_words(named_kind, index, part)
        if kind == "control":
            noun, owner = "control", noun
        words = f"{noun} of {owner}" if owner else noun
        return cls(kind, index, part, f"{words} {label}".rstrip(), noun, owner, label)

    @property
    def owner_kind(self) -> str:
        """The kind of the part of the scene that parametrises this element, such as "joint"."""
        return FIELDS.get(self.kind, (self.kind, ()))[0]

    def fields(self, model: Model) -> tuple[SceneField, ...]:
        """Return the scene fields that parametrise this element.

        A contact has the fields of its explicit pair or of both its geoms, or of the override that
        replaces them.
        """
        scene, layout = model.scene, Layout(model.scene)
        kind, names = FIELDS.get(self.kind, (self.kind, ()))
        owners = [(kind, self.index)]
        if kind == "contact":
            owners, names = _owners_of_contact(model, layout, self.index), CONTACT
        elif kind == "actuator":
            names = (*LAW_FIELDS[scene.actuators[self.index].type], "gear", "forcerange")
        return tuple(SceneField.of(layout, *owner, name) for name in names for owner in owners)


@dataclass(frozen=True)
class SceneField:
    """A field of a scene that parametrises an element.

    kind, index: the owner of the field, in the order of the compiled model. name: the field's name.
    value, default, unit: the present value, the value in a new scene, and the unit of both (""
    for none). path: the argument of `Model.with_values`; "" if the owner has no name.
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
        """Return the field of the element of this kind and index."""
        owner = _owner(layout, kind, index)
        joint, default = owner, getattr(type(owner), name, None)
        value = getattr(owner, name)
        if kind == "actuator":
            joint = owner.joint or owner.jointinparent
            if name in LAW_FIELDS[owner.type]:
                value, default = owner.law_value(name), LAW_FIELDS[owner.type][name]
        unit = kind_unit(name, getattr(joint, "type", "") in ("hinge", "ball"))
        called = getattr(owner, "name", "")
        path = f"{kind}/{called}/{name}" if called else ""
        return cls(kind, index, name, value, default, unit, path)

    def assign(self, layout: Layout, value: Any) -> None:
        """Set this field in the scene of `layout`, a copy of the field's scene."""
        setattr(_owner(layout, self.kind, self.index), self.name, value)


def _owner(layout: Layout, kind: str, index: int) -> Any:
    scene: Any = layout.scene
    return scene.contact_override if kind == OVERRIDE else layout.elements(kind)[index]


def _owners_of_contact(model: Model, layout: Layout, index: int) -> list[tuple[str, int]]:
    scene, geoms = model.scene, model.contact_pair(index).geoms
    if scene.contact_override.enable:
        return [(OVERRIDE, 0)]
    both, pairs = {id(layout.geoms[geom]) for geom in geoms}, enumerate(scene.pairs)
    explicit = [("pair", k) for k, p in pairs if {id(p.geom1), id(p.geom2)} == both]
    return explicit or [("geom", geom) for geom in geoms]


# Coriolis, centrifugal and gravity forces, which belong to no element.
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
    def is_plural(self) -> bool:
        """Whether the name is a plural, which needs a plural verb."""
        return len(self) > 1 or self == (INERTIAL,)

    @property
    def name(self) -> str:
        """The name of a single element; several elements of one kind share a noun."""
        if len(self) < 2:
            return "".join(element.name for element in self)
        nouns = {(element.noun, element.owner) for element in self}
        if len(nouns) > 1 or not all(element.label.startswith("`") for element in self):
            return name_list([element.name for element in self])
        ((noun, owner),) = nouns
        kind = plural(noun) + (f" of {plural(owner)}" if owner else "")
        return f"the {len(self)} {kind} {name_list([element.label for element in self])}"

    @property
    def together(self) -> str:
        """The name as the subject of a joint action."""
        return self.name + (" together" if len(self) > 1 else "")

    @property
    def summary(self) -> str:
        """Names of a few elements; for more elements, the count of each noun."""
        if len(self) <= NAMES:
            return name_list([element.name for element in self])
        counts = [counted(n, noun) for noun, n in Counter(e.noun for e in self).items()]
        return " and ".join(filter(None, (", ".join(counts[:-1]), counts[-1])))


def name_list(names: Iterable[str]) -> str:
    """Join the first names, and add the number of names left out."""
    every = list(names)
    more = len(every) - NAMES
    return ", ".join(every[:NAMES]) + (f" and {more} more" if more > 0 else "")


@dataclass(frozen=True)
class ElementSlopes:
    """The force and energy of an element at a state, and the derivatives of the force.

    dofs: the dofs on which it depends or acts, (k,). blocks: minus the derivatives of its force on
    them by position (in the coordinates of qvel) and by velocity, (2, k, k) [N/m or N·m/rad,
    N·s/m or N·m·s/rad]. force: the generalised force, shape (nv,) [N or N·m]. energy: the stored
    energy [J].
    """

    dofs: np.ndarray
    blocks: Floats
    force: Floats
    energy: float = 0.0

    @property
    def stiffness(self) -> Floats:
        """Minus the derivatives of the force by position, shape (nv, nv)."""
        return self._whole(0)

    @property
    def damping(self) -> Floats:
        """Minus the derivatives of the force by velocity, shape (nv, nv)."""
        return self._whole(1)

    def _whole(self, block: int) -> Floats:
        matrix = np.zeros((len(self.force), len(self.force)))
        matrix[np.ix_(self.dofs, self.dofs)] = self.blocks[block]
        return matrix

    def change(self, x: Floats, v: Floats) -> Floats:
        """Return the change −K x − D v of the force on its dofs, shape (k,).

        x, v: changes of all positions and velocities, (nv,).
        """
        stiffness, damping = self.blocks
        return -(stiffness @ x[self.dofs] + damping @ v[self.dofs])


def element_slopes(model: Model, core: CoreSim) -> dict[Element, ElementSlopes]:
    """Return the slopes of every element active at the state; see `Sim.element_slopes`."""
    ids, forces, energies, entries = core.element_slopes()
    entries = entries[entries[:, 3:].any(axis=1)]
    entries = entries[np.argsort(entries[:, 0], kind="stable")]
    first = np.searchsorted(entries[:, 0], np.arange(len(ids) + 1))
    slopes = {}
    for k, (element, force, energy) in enumerate(zip(ids, forces, energies, strict=True)):
        rows = entries[first[k] : first[k + 1]]
        dofs, places = np.unique(rows[:, 1:3].T.astype(int), return_inverse=True)
        i, j = places.reshape(2, -1)
        blocks = np.zeros((2, len(dofs), len(dofs)))
        blocks[:, i, j] = rows[:, 3:].T
        slopes[Element.of(model, *element)] = ElementSlopes(dofs, blocks, force, energy)
    return slopes
