"""Removable features of a model; each removal is a list of edits of the scene.

A removal never deletes a body, a joint or an actuator, so states and controls keep their meaning.
Edits name elements by their index in the scene's lists, so a removal can be sent to another process
and applied to any copy of the scene.
"""

from __future__ import annotations

import copy
from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import dataclass
from itertools import product
from typing import TYPE_CHECKING, Any, TypeVar

from stepcore._core import Settings
from stepcore.report.units import counted
from stepcore.scene.layout import Layout

if TYPE_CHECKING:
    from stepcore.engine.model import Model
    from stepcore.scene.scene import Scene

SomeScene = TypeVar("SomeScene", bound="Scene")
Edit = tuple[str, Any]


@dataclass(frozen=True)
class Removal:
    """The removal of one feature.

    kind: the kind of feature. name: the name of the feature.
    edits: the changes of the scene; see `without`.
    """

    kind: str
    name: str
    edits: tuple[Edit, ...]

    @property
    def label(self) -> str:
        """Short label made of kind and name."""
        return f"{self.kind}: {self.name}" if self.name else self.kind


@dataclass(frozen=True)
class MotionUsage:
    """The pairs of bodies that touched, and the elements that reached a limit, during a motion.

    limited: ("joint" or "tendon", index). All indices are in the order of the compiled model.
    """

    touched: frozenset[tuple[int, int]]
    limited: frozenset[tuple[str, int]]


def without(scene: SomeScene, removals: Iterable[Removal]) -> SomeScene:
    """Return a copy of the scene with these features removed."""
    scene = copy.deepcopy(scene)
    for removal in removals:
        for edit, value in removal.edits:
            _change(scene, edit, value)
    return scene


def _change(scene: Scene, edit: str, value: Any) -> None:
    match edit:
        case "feature":
            setattr(scene.features, value, False)
        case "exclude":
            # Faster than `Scene.exclude`, which searches all bodies.
            excluded = [(scene.bodies[a], scene.bodies[b]) for a, b in value]
            scene.excludes += excluded
            # Excludes do not apply to explicit pairs.
            ends = [{id(a), id(b)} for a, b in excluded]
            pairs = [(pair, {id(pair.geom1.body), id(pair.geom2.body)}) for pair in scene.pairs]
            scene.pairs = [pair for pair, bodies in pairs if bodies not in ends]
        case "no fluid":
            scene.density = scene.viscosity = 0.0
        case "frictionless" | "sliding only":
            most, geoms = 1 if edit == "frictionless" else 3, [scene.geoms[geom] for geom in value]
            ids = set(map(id, geoms))
            inner = [p for p in scene.pairs if {id(p.geom1), id(p.geom2)} <= ids]
            for element in (*geoms, *inner):
                element.condim = min(element.condim, most)
        case "no contact":
            geoms = [scene.geoms[geom] for geom in value]
            for geom in geoms:
                geom.contype = geom.conaffinity = 0
            ids = set(map(id, geoms))
            scene.pairs = [p for p in scene.pairs if not ids & {id(p.geom1), id(p.geom2)}]
        case "inactive":
            for equality in value:
                scene.equalities[equality].active = False
        case "cleared":
            # Fields of some elements get their defaults.
            container, indices, fields = value
            for index, field in product(indices, fields):
                element = getattr(scene, container)[index]
                setattr(element, field, getattr(type(element), field))
        case "settings":
            scene.options.update(value)


def _cleared(
    kind: str, indices: Sequence[int], container: str, *fields: str, name: str
) -> list[Removal]:
    """Return the removal that clears fields of elements; none without elements.

    container: the scene's list of the elements. name: the noun of one element, which is counted.
    """
    edit = ("cleared", (container, tuple(indices), fields))
    return [Removal(kind, counted(len(indices), name), (edit,))] if indices else []


# Test for a feature, its fields and its name; joints and tendons share the first four features.
HAS: dict[str, tuple[Callable[[Any], bool], tuple[str, ...], str]] = {
    "spring": (lambda e: e.sprung, ("stiffness", "stiffnesspoly"), "springs"),
    "damper": (lambda e: e.damped, ("damping", "dampingpoly"), "damping"),
    "frictionloss": (lambda e: e.frictionloss > 0, ("frictionloss",), "friction loss"),
    "armature": (lambda e: e.armature > 0, ("armature",), "armature"),
    "belt": (lambda geom: any(geom.surfacevel), ("surfacevel",), "moving surfaces"),
    "adhesion": (lambda e: e.adhesion > 0, ("adhesion",), "adhesion"),
}
OF_TENDONS = list(HAS)[:4]


class RemovableFeatures:
    """The removable features of a model.

    plan: the engine's data on the work of a step. pairs: pairs of geoms, in the model's order.
    body, joint, geom: for each index in the compiled model, the index in the scene's lists.
    """

    def __init__(self, model: Model) -> None:
        self.model, self.scene = model, model.scene
        self.plan: dict[str, Any] = model.core.plan()
        self.pairs: list[tuple[int, int]] = model.core.pairs()
        layout = Layout(self.scene)
        self.body = _positions(layout.bodies, self.scene.bodies)
        self.joint = _positions(layout.joints, self.scene.joints)
        self.geom = _positions(layout.geoms, self.scene.geoms)

    def removals(self, usage: MotionUsage, settings: Settings) -> list[Removal]:
        """Return the removal of every feature, one at a time."""
        # Every solve starts from zero impulses.
        cold = Removal("warm start", "", (("settings", (("warm_start", False),)),))
        return [
            *self._friction(settings),
            *self.terms(),
            *self._limits(usage),
            *self._colliders(usage),
            *self._equalities(),
            *([cold] if settings.warm_start else []),
        ]

    def _friction(self, settings: Settings) -> Iterator[Removal]:
        """Yield the other cone, no friction, and friction without torsion and rolling."""
        if geoms := self.geoms_with_friction():
            other = "pyramidal" if settings.cone == "elliptic" else "elliptic"
            edit = ("settings", (("cone", other),))
            yield Removal("cone", f"{settings.cone} → {other}", (edit,))
            yield Removal("friction", "condim 1", (("frictionless", geoms),))
        if turning := self.geoms_with_friction(3):
            edits = (("sliding only", turning),)
            yield Removal("torsional and rolling friction", "condim 3", edits)

    def geoms_with_friction(self, above: int = 1) -> tuple[int, ...]:
        """Return the geoms of pairs with condim > `above`, by index in the scene."""
        pairs = zip(self.pairs, self.plan["condim"], strict=True)
        geoms = {self.geom[g] for pair, condim in pairs if condim > above for g in pair}
        return tuple(sorted(geoms))

    def terms(self) -> list[Removal]:
        """Return the removals of smooth forces, armature and friction loss."""
        scene, features = self.scene, self.scene.features
        heavy = [i for i, joint in enumerate(scene.joints) if joint.armature > 0]
        belts = [self.geom[i] for i in self.split("belt")[0]]
        bodies = enumerate(scene.bodies if features.gravity else ())
        light = [i for i, body in bodies if body.gravcomp != 0]
        fluid = Removal("fluid", "", (("no fluid", None),))
        coriolis = Removal("velocity forces", "Coriolis, gyroscopic", (("feature", "coriolis"),))
        return [
            *self._joints("friction loss", "frictionloss"),
            *_cleared("armature", heavy, "joints", "armature", name="joint"),
            *self._joints("joint damping", "damper"),
            *self._joints("joint springs", "spring"),
            *self.tendons(),
            *([fluid] if scene.density > 0 or scene.viscosity > 0 else []),
            *_cleared("moving surfaces", belts, "geoms", "surfacevel", name="geom"),
            *self._adhesion(),
            *_cleared("gravity compensation", light, "bodies", "gravcomp", name="body"),
            *([coriolis] if features.coriolis and not all(self.plan["constant"]) else []),
        ]

    def _adhesion(self) -> list[Removal]:
        """Return the removal of the adhesion of colliding geoms and explicit pairs."""
        geoms = tuple(self.geom[i] for i in self.split("adhesion")[0])
        pairs = tuple(i for i, pair in enumerate(self.scene.pairs) if pair.adhesion > 0)
        both = [("geom", geoms), ("pair", pairs)]
        edits = tuple(
            ("cleared", (f"{noun}s", indices, ("adhesion",))) for noun, indices in both if indices
        )
        words = " and ".join(counted(len(indices), noun) for noun, indices in both if indices)
        return [Removal("adhesion", words, edits)] if edits else []

    def split(self, feature: str) -> tuple[list[int], list[int]]:
        """Return the geoms that have a feature, colliding and other, by index in the model."""
        has, collides = HAS[feature][0], self.plan["collides"]
        having = [i for i, index in enumerate(self.geom) if has(self.scene.geoms[index])]
        return [i for i in having if collides[i]], [i for i in having if not collides[i]]

    def _acts(self, feature: str) -> bool:
        features = self.scene.features
        rows = feature != "frictionloss" or features.constraint
        return rows and bool(getattr(features, feature, True))

    def _joints(self, kind: str, feature: str) -> list[Removal]:
        """Return the removal of a joint feature, which keeps the same feature of tendons."""
        has, fields, _ = HAS[feature]
        joints = [j for j, joint in enumerate(self.scene.joints) if has(joint)]
        if not joints or not self._acts(feature):
            return []
        if any(has(tendon) for tendon in self.scene.tendons):
            return _cleared(kind, joints, "joints", *fields, name="joint")
        return [Removal(kind, counted(len(joints), "joint"), (("feature", feature),))]

    def tendons(self) -> list[Removal]:
        """Return the removals of spring, damping, friction loss and armature."""
        tendons, removals = self.scene.tendons, list[Removal]()
        for feature in OF_TENDONS:
            has, fields, words = HAS[feature]
            having = [i for i, t in enumerate(tendons) if has(t) and self._acts(feature)]
            removals += _cleared(f"tendon {words}", having, "tendons", *fields, name="tendon")
        return removals

    def _limits(self, usage: MotionUsage) -> Iterator[Removal]:
        """Yield the removals of all unreached limits together, and of each reached limit."""
        features, tendons = self.scene.features, range(len(self.scene.tendons))
        if not (features.limit and features.constraint):
            return
        for noun, word, container, order in (
            ("joint", "limit", "joints", self.joint),
            ("tendon", "tendon limit", "tendons", tendons),
        ):
            elements = getattr(self.scene, container)
            ranged = {i: j for i, j in enumerate(order) if elements[j].range is not None}
            unused = [j for i, j in ranged.items() if (noun, i) not in usage.limited]
            if unused:
                never = f"{counted(len(unused), noun)} whose limit is never reached"
                yield Removal(
                    f"{word}s", never, (("cleared", (container, tuple(unused), ("range",))),)
                )
            for i, j in ranged.items():
                if (noun, i) in usage.limited:
                    name = self.model.called(noun)[i]
                    yield Removal(word, name, (("cleared", (container, (j,), ("range",))),))

    def _colliders(self, usage: MotionUsage) -> Iterator[Removal]:
        """Yield the removals of body pairs, self-collision and groups of geoms."""
        pairs, called = list(self.body_pairs()), self.model.called("body")
        unused = [pair for pair in pairs if pair not in usage.touched]
        met = [pair for pair in pairs if pair in usage.touched]
        if unused:
            never = f"{counted(len(unused), 'pair')} of bodies that never touch"
            yield self._excluding("colliders", never, unused)
        # More pairs in contact are removed body by body.
        if len(met) <= 30:
            for a, b in met:
                yield self._excluding("collider", f"{called[a]}/{called[b]}", [(a, b)])
        else:
            for body in sorted({body for pair in met for body in pair}):
                chosen = [pair for pair in met if body in pair]
                name = f"{called[body]} ({counted(len(chosen), 'pair')})"
                yield self._excluding("collider", name, chosen)
        trees = [range(first, first + count) for first, count, _, _ in self.plan["trees"]]
        chosen = [(a, b) for a, b in pairs if any(a in tree and b in tree for tree in trees)]
        if chosen and len(chosen) < len(pairs):
            name = counted(len(chosen), "pair") + " of bodies"
            yield self._excluding("self-collision", name, chosen)
        groups: dict[int, list[int]] = {}
        for i, collides in zip(self.geom, self.plan["collides"], strict=True):
            if collides:
                groups.setdefault(self.scene.geoms[i].group, []).append(i)
        for group in sorted(groups) if len(groups) > 1 else ():
            name = f"group {group} ({counted(len(groups[group]), 'geom')})"
            yield Removal("collider group", name, (("no contact", tuple(groups[group])),))

    def body_pairs(self) -> dict[tuple[int, int], list[tuple[int, int]]]:
        """Return the pairs of geoms by pair of bodies, the smaller index first."""
        pairs: dict[tuple[int, int], list[tuple[int, int]]] = {}
        owner = self.model.geom_body.tolist()
        for a, b in self.pairs:
            key = (min(owner[a], owner[b]), max(owner[a], owner[b]))
            pairs.setdefault(key, []).append((a, b))
        return pairs

    def _excluding(self, kind: str, name: str, pairs: Iterable[tuple[int, int]]) -> Removal:
        value = tuple((self.body[a], self.body[b]) for a, b in pairs)
        return Removal(kind, name, (("exclude", value),))

    def _equalities(self) -> list[Removal]:
        features, names = self.scene.features, self.model.called("equality")
        on = features.equality and features.constraint
        return [
            Removal("equality", names[i], (("inactive", (i,)),))
            for i, equality in enumerate(self.scene.equalities)
            if on and equality.active
        ]


def _positions(compiled: Iterable[Any], elements: Iterable[Any]) -> list[int]:
    """Map compiled elements, in model order, to their indices in the scene's list."""
    index = {id(element): i for i, element in enumerate(elements)}
    return [index[id(element)] for element in compiled]
