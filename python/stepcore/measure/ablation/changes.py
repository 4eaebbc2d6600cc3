"""Features of a scene that can be switched off, one at a time: each is a list of plain edits.

A change never removes a body, a joint or an actuator, so that states and controls keep their
meaning. Edits name elements by their place in the scene's lists: a change can be sent to another
process, and made on any copy of the scene.
"""

from __future__ import annotations

import copy
from collections.abc import Iterable
from dataclasses import dataclass
from typing import Any

from stepcore._core import Settings
from stepcore.engine.model import Model
from stepcore.scene.scene import Scene

# More colliding pairs of bodies than this are taken together, by body.
PAIRS = 30
Edit = tuple[str, Any]


@dataclass(frozen=True)
class Change:
    """One feature switched off. kind: of feature; name: of what exactly; edits: see `made`."""

    kind: str
    name: str
    edits: tuple[Edit, ...]

    @property
    def label(self) -> str:
        """Kind and name in a few words."""
        return f"{self.kind}: {self.name}" if self.name else self.kind


@dataclass(frozen=True)
class Seen:
    """What a motion used: pairs of bodies that touched, joints that met a limit, by index.

    bodies and joints count in the order of the compiled model.
    """

    touched: frozenset[tuple[int, int]]
    limited: frozenset[int]


def made(scene: Scene, changes: Iterable[Change]) -> Scene:
    """A copy of the scene with these features switched off."""
    scene = copy.deepcopy(scene)
    for change in changes:
        for what, value in change.edits:
            _EDITS[what](scene, value)
    return scene


def _feature(scene: Scene, name: str) -> None:
    setattr(scene.features, name, False)


def _exclude(scene: Scene, pairs: Iterable[tuple[int, int]]) -> None:
    for a, b in pairs:
        # Not by `Scene.exclude`, which looks the two up among all bodies.
        scene.excludes.append((scene.bodies[a], scene.bodies[b]))


def _no_range(scene: Scene, joints: Iterable[int]) -> None:
    for joint in joints:
        scene.joints[joint].range = None


def _no_armature(scene: Scene, joints: Iterable[int]) -> None:
    for joint in joints:
        scene.joints[joint].armature = 0.0


def _smooth(scene: Scene, geoms: Iterable[int]) -> None:
    for geom in geoms:
        scene.geoms[geom].condim = 1


def _ghost(scene: Scene, geoms: Iterable[int]) -> None:
    for geom in geoms:
        scene.geoms[geom].contype = scene.geoms[geom].conaffinity = 0


def _untie(scene: Scene, equalities: Iterable[int]) -> None:
    for equality in equalities:
        scene.equalities[equality].active = False


def _setting(scene: Scene, values: tuple[tuple[str, Any], ...]) -> None:
    scene.options.update(values)


_EDITS: dict[str, Any] = {
    **{"feature": _feature, "exclude": _exclude, "no range": _no_range, "setting": _setting},
    **{"no armature": _no_armature, "smooth": _smooth, "ghost": _ghost, "untie": _untie},
}


class Features:
    """What a model has that could be switched off."""

    def __init__(self, model: Model) -> None:
        self.model, self.scene = model, model.scene
        self.plan: dict[str, Any] = model.core.plan()
        # Of geoms, in the model's order.
        self.pairs: list[tuple[int, int]] = model.core.pairs()
        # From the order of the compiled model to that of the scene's lists.
        from stepcore.scene.layout import Layout

        layout = Layout(self.scene)
        place = {id(e): i for i, e in enumerate(self.scene.bodies)}
        self.body = [place[id(e)] for e in layout.bodies]
        place = {id(e): i for i, e in enumerate(self.scene.joints)}
        self.joint = [place[id(e)] for e in layout.joints]
        place = {id(e): i for i, e in enumerate(self.scene.geoms)}
        self.geom = [place[id(e)] for e in layout.geoms]

    def changes(self, seen: Seen, settings: Settings) -> list[Change]:
        """Everything that can be switched off, one at a time."""
        return [
            *self.cone(settings),
            *self.friction(settings),
            *self.terms(),
            *self.limits(seen),
            *self.colliders(seen),
            *self.equalities(),
            *self.warm_start(settings),
        ]

    def cone(self, settings: Settings) -> list[Change]:
        """The other cone, where there is friction."""
        if not self.rubbing():
            return []
        other = "pyramidal" if settings.cone == "elliptic" else "elliptic"
        return [Change("cone", f"{settings.cone} → {other}", (("setting", (("cone", other),)),))]

    def friction(self, settings: Settings) -> list[Change]:
        """Contacts without friction."""
        return (
            [Change("friction", "condim 1", (("smooth", geoms),))]
            if (geoms := self.rubbing())
            else []
        )

    def rubbing(self) -> tuple[int, ...]:
        """Geoms of pairs with friction, in the scene's order."""
        pairs = zip(self.pairs, self.plan["condim"], strict=True)
        geoms = {self.geom[g] for pair, condim in pairs if condim > 1 for g in pair}
        return tuple(sorted(geoms))

    def terms(self) -> list[Change]:
        """Smooth forces and inertias, and friction loss."""
        scene, features = self.scene, self.scene.features
        found: list[Change] = []
        held = [j for j in scene.joints if j.frictionloss > 0]
        if held and features.frictionloss and features.constraint:
            found.append(_off("friction loss", held, "frictionloss"))
        heavy = tuple(i for i, joint in enumerate(scene.joints) if joint.armature > 0)
        if heavy:
            found.append(Change("armature", _count(heavy, "joint"), (("no armature", heavy),)))
        damped = [j for j in scene.joints if j.damping != 0]
        if damped and features.damper:
            found.append(_off("joint damping", damped, "damper"))
        sprung = [j for j in scene.joints if j.stiffness != 0]
        if sprung and features.spring:
            found.append(_off("joint springs", sprung, "spring"))
        if features.coriolis and not all(self.plan["constant"]):
            name = "Coriolis, gyroscopic"
            found.append(Change("velocity forces", name, (("feature", "coriolis"),)))
        return found

    def limits(self, seen: Seen) -> list[Change]:
        """Limits that the motion never reached, and each that it did."""
        features = self.scene.features
        if not (features.limit and features.constraint):
            return []
        names = self.model.joint_names
        index = [i for i, j in enumerate(self.joint) if self.scene.joints[j].range is not None]
        idle = tuple(self.joint[i] for i in index if i not in seen.limited)
        found = []
        if idle:
            name = f"{_count(idle, 'joint')} that never reached one"
            found.append(Change("limits", name, (("no range", idle),)))
        for i in index:
            if i in seen.limited:
                name = names[i] or f"joint {i}"
                found.append(Change("limit", name, (("no range", (self.joint[i],)),)))
        return found

    def colliders(self, seen: Seen) -> list[Change]:
        """Pairs of bodies that never met, each that did, self-collision, groups of geoms."""
        pairs = self.body_pairs()
        found = []
        idle = [pair for pair in pairs if pair not in seen.touched]
        if idle:
            name = f"{_count(idle, 'pair')} of bodies that never met"
            found.append(self._excluded("colliders", name, idle))
        met = [pair for pair in pairs if pair in seen.touched]
        if len(met) <= PAIRS:
            found += [self._excluded("collider", self._between(pair), [pair]) for pair in met]
        else:
            for body in sorted({body for pair in met for body in pair}):
                own = [pair for pair in met if body in pair]
                name = f"{self._body(body)} ({_count(own, 'pair')})"
                found.append(self._excluded("collider", name, own))
        own = [pair for pair in pairs if self._same_tree(*pair)]
        if own and len(own) < len(pairs):
            name = _count(own, "pair") + " of bodies"
            found.append(self._excluded("self-collision", name, own))
        return found + self._groups()

    def body_pairs(self) -> dict[tuple[int, int], list[tuple[int, int]]]:
        """Pairs of geoms by their pair of bodies, the smaller index first."""
        pairs: dict[tuple[int, int], list[tuple[int, int]]] = {}
        owner = self.model.geom_body.tolist()
        for a, b in self.pairs:
            key = (min(owner[a], owner[b]), max(owner[a], owner[b]))
            pairs.setdefault(key, []).append((a, b))
        return pairs

    def lessened(self, change: Change, seen: Seen) -> Change | None:
        """A group of what was never used, less what another motion uses; None if that is all."""
        if change.kind not in ("limits", "colliders"):
            return change
        ((what, values),) = change.edits
        if change.kind == "limits":
            used = {self.joint[i] for i in seen.limited}
            left = tuple(joint for joint in values if joint not in used)
            name = f"{_count(left, 'joint')} that never reached one"
        else:
            met = {tuple(sorted((self.body[a], self.body[b]))) for a, b in seen.touched}
            left = tuple(pair for pair in values if tuple(sorted(pair)) not in met)
            name = f"{_count(left, 'pair')} of bodies that never met"
        return Change(change.kind, name, ((what, left),)) if left else None

    def _excluded(self, kind: str, name: str, pairs: Iterable[tuple[int, int]]) -> Change:
        value = tuple((self.body[a], self.body[b]) for a, b in pairs)
        return Change(kind, name, (("exclude", value),))

    def _groups(self) -> list[Change]:
        """Each group of geoms, where several collide."""
        geoms = self.scene.geoms
        solid = [self.geom[i] for i, on in enumerate(self.plan["collides"]) if on]
        groups = sorted({geoms[i].group for i in solid})
        found = []
        for group in groups if len(groups) > 1 else ():
            own = tuple(i for i in solid if geoms[i].group == group)
            name = f"group {group} ({_count(own, 'geom')})"
            found.append(Change("collider group", name, (("ghost", own),)))
        return found

    def equalities(self) -> list[Change]:
        """Each active connection."""
        features = self.scene.features
        if not (features.equality and features.constraint):
            return []
        return [
            Change("equality", equality.name or f"equality {i}", (("untie", (i,)),))
            for i, equality in enumerate(self.scene.equalities)
            if equality.active
        ]

    def warm_start(self, settings: Settings) -> list[Change]:
        """Starting every solve from nothing."""
        if not settings.warm_start:
            return []
        return [Change("warm start", "", (("setting", (("warm_start", False),)),))]

    def _body(self, index: int) -> str:
        return self.model.body_names[index] or f"body {index}"

    def _between(self, pair: tuple[int, int]) -> str:
        return f"{self._body(pair[0])}/{self._body(pair[1])}"

    def _same_tree(self, a: int, b: int) -> bool:
        spans = [range(first, first + count) for first, count, _, _ in self.plan["trees"]]
        return any(a in span and b in span for span in spans)


def _off(kind: str, elements: list[Any], feature: str) -> Change:
    return Change(kind, _count(elements, "joint"), (("feature", feature),))


def _count(elements: Any, word: str) -> str:
    return f"{len(elements)} {word}{'s' * (len(elements) != 1)}"
