"""The entries of a plan with names: the engine's plan, and what only the scene knows."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterable, Iterator, Sequence
from typing import TYPE_CHECKING, Any

from stepcore._core import Settings
from stepcore.engine.features import RemovableFeatures, Removal, is_belt, is_sticky
from stepcore.engine.plan.result import PlanEntry
from stepcore.scene.layout import Layout

if TYPE_CHECKING:
    from stepcore.engine.model import Model

# By the beginning of an entry's name: the stages of `Sim.stage_flops` that are its own.
STAGES = {
    "poses of bodies": ("place/kinematics",),
    "mass matrix and its factors": ("place/inertia", "place/factor"),
    "bias force": ("place/bias",),
    "velocity before constraints": ("place/guess",),
    "impulses": ("solve/impulses",),
    "integrator": ("commit",),
}
# The same: the kind of `Removal` that leaves it out, or the feature of the scene that switches it.
REMOVALS = {
    "of which Coriolis": "velocity forces",
    "springs": "joint springs",
    "dampers": "joint damping",
    "tendon springs": "tendon springs",
    "tendon damping": "tendon damping",
    "tendon armature": "tendon armature",
    "fluid drag": "fluid",
    "gravity compensation": "gravity compensation",
}
FEATURES = {
    "actuators": "actuation",
    "friction loss": "frictionloss",
    "limits": "limit",
    "connections": "equality",
    "welds": "equality",
    "joint equalities": "equality",
    "tendon equalities": "equality",
}
# An entry, and the removal of the entry, if there is one.
Listed = tuple[PlanEntry, Removal | None]


def entries(model: Model, settings: Settings, rows: Counter[str]) -> Iterator[Listed]:
    """Yield all entries of a plan. rows: the number of rows of each kind at the state."""
    listing = _Listing(model, settings, rows)
    parts = (listing.files, listing.engine, listing.sites, listing.unmet, listing.surfaces)
    for part in parts:
        # Work without elements in the scene is neither used nor left out.
        yield from (listed for listed in part() if listed[0].count)


class _Listing:
    def __init__(self, model: Model, settings: Settings, rows: Counter[str]) -> None:
        self.model, self.scene, self.settings, self.row_count = model, model.scene, settings, rows
        self.features = RemovableFeatures(model)
        self.plan = self.features.plan
        self.geom_names = model.called("geom")
        # Geoms in the model's order.
        self.geoms = [model.scene.geoms[i] for i in self.features.geom]
        self.tree_names = [model.called("body")[first] for first, *_ in self.plan["trees"]]
        self.removals = {removal.kind: removal for removal in self.features.terms()}

    def files(self) -> Iterator[Listed]:
        """Yield files that were read, and files and elements that were not."""
        source = self.scene._source
        files = [file for file in (source.files if source else ()) if file != "<string>"]
        unread = list(source.unread) if source else []
        yield _used("files", "files read", files, kind="file")
        yield _out("files", "files not read", unread, "used for drawing only", kind="file")
        without = self.scene.without
        yield _out("files", "left out on purpose", without, "left out by without=", kind="file")
        ignored = [line.rsplit(" (", 1)[0] for line in self.scene.ignored]
        why = "only for drawing or sensing, or unused by every equation"
        yield _out("files", "elements of the file", ignored, why, kind="file")

    def engine(self) -> Iterator[Listed]:
        """Yield the entries of the engine's plan, with names."""
        listed = self.model.core.entries(self.settings)
        # Contacts with friction, by the number of their rows.
        ways = sum(_has_friction(entry[2]) for entry in listed)
        for stage, kind, name, of, elements, count, used, why, rows in listed:
            names = tuple(self._names(of, elements))
            number = self.row_count[rows] if rows is not None else None
            stages = _first(STAGES, name) or () if used else ()
            entry = PlanEntry(stage, kind, name, names, used, why, count, number, stages)
            removal = self._removal(name, kind, elements, ways) if used else None
            yield entry, removal

    def _names(self, of: str, elements: Sequence[int]) -> list[str]:
        if of == "pair":
            return self._pair_names(elements)
        if of == "tree":
            return _pick(self.tree_names, elements)
        if of == "island":
            islands: dict[int, list[str]] = {}
            for island, name in zip(self.plan["islands"], self.tree_names, strict=True):
                islands.setdefault(island, []).append(name)
            return ["+".join(islands[island]) for island in elements]
        return _pick(self.model.called(of), elements)

    def _removal(self, name: str, kind: str, elements: Sequence[int], ways: int) -> Removal | None:
        if kind == "pair":
            return self._excluding(elements) if elements else None
        if _has_friction(name):
            geoms = self.features.geoms_with_friction()
            return Removal("friction", "", (("frictionless", geoms),)) if ways == 1 else None
        feature = _first(FEATURES, name)
        if feature is not None:
            return Removal(feature, "", (("feature", feature),))
        return self.removals.get(_first(REMOVALS, name) or "")

    def sites(self) -> Iterator[Listed]:
        """Yield the sites on the paths of tendons, and the others."""
        tendons = zip(self.scene.tendons, self.plan["tendons"], strict=True)
        passed = {id(e) for tendon, used in tendons if used for e in tendon.elements()}
        sites = Layout(self.scene).sites
        names = list(zip(self.model.called("site"), sites, strict=True))
        name = "poses of sites"
        yield _used("place", name, [n for n, site in names if id(site) in passed])
        left = [n for n, site in names if id(site) not in passed]
        yield _out("place", name, left, "no force acts there: computed when read")

    def unmet(self) -> Iterator[Listed]:
        """Yield the pairs that were not made candidates, by reason."""
        for why, count, examples in self.plan["unmet"]:
            some = [f"{self.geom_names[a]}/{self.geom_names[b]}" for a, b in examples]
            yield _out("detect", "pairs", some, why, count=count, kind="pair")

    def surfaces(self) -> Iterator[Listed]:
        """Yield moving and adhesive surfaces."""
        why = "they collide with nothing"
        used, unused = (_pick(self.geom_names, own) for own in self.features.split(is_belt))
        name = "surfaces that move (by geom)"
        yield _used("solve", name, used, removal=self.removals.get("moving surfaces"))
        yield _out("solve", name, unused, why)
        used, unused = (_pick(self.geom_names, own) for own in self.features.split(is_sticky))
        called = dict(zip(map(id, self.geoms), self.geom_names, strict=True))
        pairs = [pair for pair in self.scene.pairs if pair.adhesion > 0]
        used += [f"{called[id(pair.geom1)]}/{called[id(pair.geom2)]}" for pair in pairs]
        name = "adhesion (by geom)"
        yield _used("solve", name, used, removal=self.removals.get("adhesion"))
        yield _out("solve", name, unused, why)

    def _pair_names(self, indices: Iterable[int]) -> list[str]:
        pairs = self.features.pairs
        return [f"{self.geom_names[a]}/{self.geom_names[b]}" for a, b in _pick(pairs, indices)]

    def _excluding(self, indices: Sequence[int]) -> Removal | None:
        """Return the removal of these pairs; None if their bodies have further pairs."""
        owner = self.model.geom_body.tolist()
        pairs = _pick(self.features.pairs, indices)
        bodies = {tuple(sorted((owner[a], owner[b]))) for a, b in pairs}
        own = self.features.body_pairs()
        if sum(len(own[pair]) for pair in bodies) != len(indices):
            return None
        body = self.features.body
        excluded = tuple((body[a], body[b]) for a, b in bodies)
        return Removal("pairs", "", (("exclude", excluded),))


def _has_friction(name: str) -> bool:
    """Return whether an entry is of contacts with friction."""
    return name.startswith("contacts, ") and not name.startswith("contacts, normal")


def _first(table: dict[str, Any], name: str) -> Any:
    """Return the value of the key with which a name begins."""
    return next((value for key, value in table.items() if name.startswith(key)), None)


def _used(
    stage: str,
    name: str,
    names: Iterable[str],
    *,
    kind: str = "term",
    removal: Removal | None = None,
) -> Listed:
    names = tuple(names)
    return PlanEntry(stage, kind, name, names, True, "", len(names)), removal


def _out(
    stage: str,
    name: str,
    names: Iterable[str],
    why: str,
    *,
    count: int | None = None,
    kind: str = "term",
) -> Listed:
    names = tuple(names)
    number = len(names) if count is None else count
    return PlanEntry(stage, kind, name, names, False, why, number), None


def _pick(items: Sequence[Any], indices: Iterable[int]) -> list[Any]:
    return [items[i] for i in indices]
