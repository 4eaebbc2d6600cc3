"""The entries of a plan: every term, stage, row kind, pair and file, used or omitted."""

from __future__ import annotations

import operator
from collections import Counter
from collections.abc import Callable, Iterable, Iterator, Sequence
from typing import TYPE_CHECKING, Any

from stepcore._core import Settings
from stepcore.engine.features import RemovableFeatures, Removal, is_belt, is_sticky
from stepcore.engine.linear_maps import DAMPING_IMPLICIT
from stepcore.engine.plan.result import PlanEntry
from stepcore.scene.elements.equality import ROW_KINDS
from stepcore.scene.layout import Layout

if TYPE_CHECKING:
    from stepcore.engine.model import Model

# Equalities: displayed name, number of rows, type.
EQUALITIES = (
    ("connections", "3 rows", "connect"),
    ("welds", "6 rows", "weld"),
    ("joint equalities", "1 row", "joint"),
    ("tendon equalities", "1 row", "tendon"),
)
# An entry, and the removal of the entry, if there is one.
Listed = tuple[PlanEntry, Removal | None]


def entries(model: Model, settings: Settings, rows: Counter[str]) -> Iterator[Listed]:
    """Yield all entries of a plan. rows: the number of rows of each kind at the state."""
    listing = _Listing(model, settings, rows)
    parts = (
        listing.files,
        listing.poses,
        listing.terms,
        listing.pairs,
        listing.rows,
        listing.commit,
        listing.sensors,
    )
    for part in parts:
        # Work without elements in the scene is neither used nor left out.
        yield from (listed for listed in part() if listed[0].count)


class _Listing:
    def __init__(self, model: Model, settings: Settings, rows: Counter[str]) -> None:
        self.model, self.scene, self.settings, self.row_count = model, model.scene, settings, rows
        self.features = RemovableFeatures(model)
        self.plan = self.features.plan
        self.body_names = model.called("body")
        self.geom_names = model.called("geom")
        self.tendon_names = model.called("tendon")
        self.joint_names = model.called("joint")
        # Joints and geoms in the model's order.
        self.joints = [model.scene.joints[i] for i in self.features.joint]
        self.geoms = [model.scene.geoms[i] for i in self.features.geom]
        self.tree_names = [self.body_names[first] for first, *_ in self.plan["trees"]]
        self.tree_of: dict[int, int] = {}
        for tree, (first, count, _, _) in enumerate(self.plan["trees"]):
            self.tree_of |= dict.fromkeys(range(first, first + count), tree)

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

    def poses(self) -> Iterator[Listed]:
        """Yield the poses of bodies, geoms and sites."""
        visible, turns = self.plan["seen"], self.plan["turns"]
        names = self.body_names
        placed = [i for i, tree in self.tree_of.items() if visible[tree]]
        fixed = [i for i in range(1, len(names)) if i not in self.tree_of]
        unused = [i for i, tree in self.tree_of.items() if not visible[tree]]
        name = "poses of bodies"
        yield _used("place", name, _pick(names, placed), stages=("place/kinematics",))
        yield _out("place", name, _pick(names, fixed), "fixed: computed once, at compilation")
        yield _out("place", name, _pick(names, unused), "no step uses them")
        name = "rotations of bodies"
        yield _used("place", name, _pick(names, [i for i in placed if turns[i]]))
        level = [i for i in placed if not turns[i]]
        yield _out("place", name, _pick(names, level), "no joint rotates them")
        collides, owner = self.plan["collides"], self.model.geom_body.tolist()
        name = "poses of geoms"
        moving = [i for i, on in enumerate(collides) if on and owner[i] in self.tree_of]
        still = [i for i, on in enumerate(collides) if on and owner[i] not in self.tree_of]
        free = [i for i, on in enumerate(collides) if not on]
        yield _used("place", name, _pick(self.geom_names, moving))
        why = "fixed: computed once, at compilation"
        yield _out("place", name, _pick(self.geom_names, still), why)
        yield _out("place", name, _pick(self.geom_names, free), "they collide with nothing")
        yield from self._tendon_lengths()

    def _tendon_lengths(self) -> Iterator[Listed]:
        """Yield the lengths of tendons, and the sites on their paths."""
        tendons = list(
            zip(self.tendon_names, self.scene.tendons, self.plan["tendons"], strict=True)
        )
        name = "lengths of tendons"
        yield _used("place", name, [n for n, _, used in tendons if used])
        why = "nothing pulls along them: computed when read"
        yield _out("place", name, [n for n, _, used in tendons if not used], why)
        passed = {id(e) for _, tendon, used in tendons if used for e in tendon.elements()}
        sites = Layout(self.scene).sites
        names = list(zip(self.model.called("site"), sites, strict=True))
        name = "poses of sites"
        yield _used("place", name, [n for n, site in names if id(site) in passed])
        left = [n for n, site in names if id(site) not in passed]
        yield _out("place", name, left, "no force acts there: computed when read")

    def _surfaces(self, removals: dict[str, Removal]) -> Iterator[Listed]:
        """Yield moving and adhesive surfaces."""
        why = "they collide with nothing"
        used, unused = (_pick(self.geom_names, own) for own in self.features.split(is_belt))
        name = "surfaces that move (by geom)"
        yield _used("solve", name, used, removal=removals.get("moving surfaces"))
        yield _out("solve", name, unused, why)
        used, unused = (_pick(self.geom_names, own) for own in self.features.split(is_sticky))
        called = dict(zip(map(id, self.geoms), self.geom_names, strict=True))
        pairs = [pair for pair in self.scene.pairs if pair.adhesion > 0]
        used += [f"{called[id(pair.geom1)]}/{called[id(pair.geom2)]}" for pair in pairs]
        name = "adhesion (by geom)"
        yield _used("solve", name, used, removal=removals.get("adhesion"))
        yield _out("solve", name, unused, why)

    def _tendon_terms(self, removals: dict[str, Removal]) -> Iterator[Listed]:
        """Yield springs, dampers and armature of tendons."""
        on, tendons = self.scene.features, self.scene.tendons
        for words, has, flag in (("springs", "sprung", "spring"), ("damping", "damped", "damper")):
            names = _pick(self.tendon_names, [i for i, t in enumerate(tendons) if getattr(t, has)])
            name = f"tendon {words}"
            if getattr(on, flag):
                yield _used("place", name, names, removal=removals.get(name))
            else:
                yield _out("place", name, names, f"switched off ({flag})")
        heavy = [i for i, tendon in enumerate(tendons) if tendon.armature > 0]
        name = "tendon armature"
        yield _used("place", name, _pick(self.tendon_names, heavy), removal=removals.get(name))
        beyond = [
            i for i, is_beyond in enumerate(self.plan["armature_beyond_the_tree"]) if is_beyond
        ]
        why = "left out, as MuJoCo does: the mass matrix has no entry for such two dofs"
        name = "tendon armature, between dofs of which neither moves the other"
        yield _out("place", name, _pick(self.tendon_names, beyond), why)

    def terms(self) -> Iterator[Listed]:
        """Yield inertia and the smooth forces."""
        constant, slides = self.plan["constant"], self.plan["slides"]
        trees, on = self.tree_names, self.scene.features
        changing = [name for name, fixed in zip(trees, constant, strict=True) if not fixed]
        stages = ("place/inertia", "place/factor")
        yield _used("place", "mass matrix and its factors (by tree)", changing, stages=stages)
        name = "bias force of gravity and velocity (by tree)"
        yield _used("place", name, changing, stages=("place/bias",))
        sliding = [n for n, s in zip(trees, slides, strict=True) if s]
        balls = [n for n, c, s in zip(trees, constant, slides, strict=True) if c and not s]
        name = "mass matrix, factors and bias force (by tree)"
        yield _out("place", name, sliding, "constant: nothing rotates")
        yield _out("place", name, balls, "isotropic: constant, and no gyroscopic term")
        forces = ", mass matrix and bias force" if self.settings.integrator != "implicit" else ""
        for k, axis in enumerate("xyz"):
            flat = [n for n, normal in zip(trees, self.plan["normals"], strict=True) if normal == k]
            why = f"hinges turn about {axis}, slides lie across it: two dimensions"
            yield _out("place", f"poses{forces} out of a plane (by tree)", flat, why)
        removals = {removal.kind: removal for removal in self.features.terms()}
        name = "of which Coriolis, centrifugal, gyroscopic"
        if on.coriolis:
            yield _used("place", name, changing, removal=removals.get("velocity forces"))
        else:
            yield _out("place", name, changing, "switched off (coriolis)")
        for field, has, flag, kind, name in (
            ("stiffness", "sprung", "spring", "joint springs", "springs"),
            ("damping", "damped", "damper", "joint damping", "dampers"),
        ):
            have, lack = self._split(operator.attrgetter(has))
            if getattr(on, flag):
                yield _used("place", name, have, removal=removals.get(kind))
            else:
                yield _out("place", name, have, f"switched off ({flag})")
            yield _out("place", name, lack, f"{field} 0")
        yield from self._tendon_terms(removals)
        passive = on.spring or on.damper
        wet = [n for n, has in zip(self.body_names, self.plan["fluid"], strict=True) if has]
        yield _used("place", "fluid drag (by body)", wet, removal=removals.get("fluid"))
        yield from self._surfaces(removals)
        bodies = Layout(self.scene).bodies
        light = [n for n, b in zip(self.body_names, bodies, strict=True) if b.gravcomp != 0]
        name = "gravity compensation (by body)"
        if on.gravity and passive:
            removal = removals.get("gravity compensation")
            yield _used("place", name, light, removal=removal)
        else:
            yield _out("place", name, light, "switched off")
        actuators = self.model.called("actuator")
        if on.actuation:
            removal = Removal("actuators", "", (("feature", "actuation"),))
            yield _used("place", "actuators", actuators, removal=removal)
        else:
            yield _out("place", "actuators", actuators, "switched off (actuation)")
        name = "velocity before constraints (by joint)"
        yield _used("place", name, self.joint_names, stages=("place/guess",))
        if not on.gravity or not any(self.scene.gravity):
            yield _out("place", "gravity", [], "0" if on.gravity else "switched off", count=1)

    def pairs(self) -> Iterator[Listed]:
        """Yield pairs of geoms by their shapes, and by the method that finds near pairs."""
        for (one, two), count in self.model.heap.items():
            name = f"{one}-{two} pairs, found as they come near"
            why = "a heap: too many pairs could meet for a list of them"
            yield _used("detect", name, [], kind="pair", count=count, why=why)
        by_shapes: dict[str, list[int]] = {}
        skips = self.settings.law in ("solref", "penalty")
        for index, (a, b) in enumerate(self.features.pairs):
            if not (skips and self.plan["apart"][index]):
                shapes = f"{self.geoms[a].type}-{self.geoms[b].type}"
                by_shapes.setdefault(shapes, []).append(index)
        for shapes, indices in by_shapes.items():
            removal = self._excluding(indices)
            names = self._pair_names(indices)
            yield _used("detect", f"{shapes} pairs", names, kind="pair", removal=removal)
        apart = [i for i, is_apart in enumerate(self.plan["apart"]) if is_apart]
        if apart and skips:
            guards = sorted({joint for joint, _, _ in self.plan["guards"]})
            joints = ", ".join(_pick(self.joint_names, guards))
            why = f"kept apart by the ranges of {joints}; tested only outside them"
            yield _out("detect", "pairs", self._pair_names(apart), why, kind="pair")
        for why, count, examples in self.plan["unmet"]:
            some = [f"{self.geom_names[a]}/{self.geom_names[b]}" for a, b in examples]
            yield _out("detect", "pairs", some, why, count=count, kind="pair")
        geoms = zip(self.geom_names, self.geoms, strict=True)
        ghosts = [n for n, geom in geoms if not (geom.contype or geom.conaffinity)]
        why = "contype and conaffinity are 0"
        yield _out("detect", "all pairs of geoms", ghosts, why, kind="pair")

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

    def rows(self) -> Iterator[Listed]:
        """Yield the kinds of rows, and the elements without rows."""
        equalities, on = self.scene.equalities, self.scene.features
        names = self.model.called("equality")
        for name, per, type in EQUALITIES:
            tied = [(n, e) for n, e in zip(names, equalities, strict=True) if e.type == type]
            active = [n for n, e in tied if e.active]
            if on.equality and on.constraint:
                kind = ROW_KINDS[type]
                yield self._rows(f"{name}, {per} each", active, kind, "equality")
                inactive = [n for n, e in tied if not e.active]
                yield _out("solve", name, inactive, "not active", kind="row")
            else:
                yield _out("solve", name, [n for n, _ in tied], "switched off", kind="row")
        have, lack = self._split(lambda joint: joint.frictionloss)
        if on.frictionloss and on.constraint:
            name = "friction loss, one row per dof"
            yield self._rows(name, have, "friction loss", "frictionloss")
        else:
            yield _out("solve", "friction loss", have, "switched off", kind="row")
        yield _out("solve", "friction loss", lack, "frictionloss 0", kind="row")
        have, lack = self._split(lambda joint: joint.range is not None)
        free, _ = self._split(lambda joint: joint.type == "free")
        lack = [name for name in lack if name not in free]
        if on.limit and on.constraint:
            yield self._rows("limits, one row while reached", have, "limit", "limit")
        else:
            yield _out("solve", "limits", have, "switched off", kind="row")
        yield _out("solve", "limits", lack, "no range", kind="row")
        yield _out("solve", "limits", free, "free joints have none", kind="row")
        yield from self._tendon_rows()
        yield from self._contact_rows()

    def _tendon_rows(self) -> Iterator[Listed]:
        """Yield friction losses and limits of tendons."""
        on, tendons = self.scene.features, self.scene.tendons
        for name, per, flag, has in (
            ("tendon friction loss", "one row each", on.frictionloss, "frictionloss"),
            ("tendon limits", "one row while reached", on.limit, "range"),
        ):
            names = _pick(self.tendon_names, [i for i, t in enumerate(tendons) if getattr(t, has)])
            if flag and on.constraint:
                kind = name.removesuffix("s") if has == "range" else name
                rows = self.row_count[kind]
                yield _used("solve", f"{name}, {per}", names, kind="row", rows=rows)
            else:
                yield _out("solve", name, names, "switched off", kind="row")

    def _rows(self, name: str, names: list[str], kind: str, feature: str) -> Listed:
        """Return the entry of rows that a feature of the scene makes."""
        removal = Removal(feature, "", (("feature", feature),))
        count = self.row_count[kind]
        return _used("solve", name, names, kind="row", rows=count, removal=removal)

    def _contact_rows(self) -> Iterator[Listed]:
        plan, law = self.plan, self.settings.law
        if self.model.is_heap and law != "penalty":
            # The contacts of a heap, and their rows, are known only during the run.
            name = f"contacts of what touches ({self.settings.cone} cone)"
            count = self.row_count["contact"]
            yield _used("solve", name, [], kind="row", count=self.model.npair, rows=count)
            return
        condim, friction = plan["condim"], plan["friction"]
        every = range(len(condim))
        if law == "penalty":
            why = "the law penalty uses springs, not rows"
            yield _out("solve", "contact rows", self._pair_names(every), why, kind="row")
            return
        normal = self._pair_names(i for i in every if condim[i] == 1)
        ways = [(soft if law == "solref" else plain, still) for soft, plain, still in plan["ways"]]
        zero = [i for i in every if condim[i] > 1 and friction[i] == 0]
        none = [i for i in zero if plan["ways"][i][1] == 0]
        dropped = none if law in ("lesson", "relaxed", "rigid") else []
        removal = Removal("friction", "", (("frictionless", self.features.geoms_with_friction()),))
        name = "friction of contacts"
        yield _used("solve", "contacts, normal row only", normal, kind="row")
        yield _out("solve", name, normal, "condim 1", kind="row")
        yield _out("solve", name, self._pair_names(dropped), "μ is 0", kind="row")
        by_ways: dict[tuple[int, int], list[int]] = {}
        for i in every:
            if condim[i] > 1 and i not in dropped:
                by_ways.setdefault(ways[i], []).append(i)
        for (moving, still), indices in sorted(
            by_ways.items(), key=lambda item: (-item[0][0], item)
        ):
            rows = self._rows_of_contact(moving, still)
            names = self._pair_names(indices)
            yield _used(
                "solve",
                f"contacts, {rows} row{'s' * (rows > 1)} each ({self.settings.cone} cone)",
                names,
                kind="row",
                rows=self.row_count["contact"] if len(indices) == len(condim) else None,
                removal=removal if len(by_ways) == 1 else None,
            )
            if still:
                full = self._rows_of_contact(moving + still, 0)
                why = f"no body can move that way: {rows} rows instead of {full}"
                word = "one tangent" if still == 1 else "both tangents"
                yield _out("solve", f"friction along {word}", names, why, kind="row")
        if zero and law == "solref":
            why = "μ is 0, but MuJoCo's law uses at least 1e-5; condim 1 removes these rows"
            name = "friction of contacts, μ 0"
            yield _used("solve", name, self._pair_names(zero), why=why, kind="row")

    def _rows_of_contact(self, moving: int, still: int) -> int:
        """Return the number of rows of a contact.

        moving, still: the number of directions of friction (tangents, torsion, rolling) in which
            the bodies can and cannot move.
        """
        if self.settings.law != "solref" or self.settings.cone == "elliptic":
            return 1 + moving
        return 2 * moving + (1 if still else 0)

    def commit(self) -> Iterator[Listed]:
        """Yield the solver, the integrator and quaternions."""
        settings, plan = self.settings, self.plan
        stages = ("solve/impulses",)
        if self.model.is_heap:
            name = f"impulses: {settings.solver} (by island of what touches, one world at a time)"
            yield _used("solve", name, self.tree_names, stages=stages)
        else:
            name = f"impulses: {settings.solver} (by island)"
            yield _used("solve", name, self._islands(), stages=stages)
        if settings.law == "solref":
            condim = plan["condim"]
            rubbing = self._pair_names(i for i in range(len(condim)) if condim[i] > 1)
            many = self.model.npair if self.model.is_heap else None
            if settings.noslip_iterations:
                sweeps = (
                    f"{settings.noslip_iterations} sweep{'s' * (settings.noslip_iterations > 1)}"
                )
                yield _used("solve", f"noslip: {sweeps} over friction", rubbing, count=many)
            if settings.stiction:
                yield _used("solve", "stiction: friction held by a spring", rubbing, count=many)
        if settings.sleep:
            yield _used("solve", "sleep: islands at rest make no rows", self.tree_names)
        name = f"integrator: {settings.integrator} (by joint)"
        yield _used("commit", name, self.joint_names, stages=("commit",))
        if not settings.warm_start:
            yield _out("solve", "warm start", [], "switched off", count=1)
        yield from self._implicit()
        have, lack = self._split(lambda joint: joint.type in ("free", "ball"))
        yield _used("commit", "quaternions", have)
        yield _out("commit", "quaternions", lack, "slides and hinges have none")

    def _implicit(self) -> Iterator[Listed]:
        """Yield the terms that the integrator treats implicitly."""
        plan, on = self.plan, self.scene.features
        names, integrator = self.tree_names, self.settings.integrator

        def split(flags: Sequence[bool]) -> tuple[list[str], list[str]]:
            pairs = list(zip(names, flags, strict=True))
            return [n for n, flag in pairs if flag], [n for n, flag in pairs if not flag]

        have, lack = split(plan["damped" if integrator == "euler" else "damped_by_any"])
        name = "implicit damping (by tree)"
        if integrator == "discrete":
            have, lack = split(plan["sloped"])
            name = "implicit stiffness and damping (by tree)"
            yield _used("place", name, have)
            yield _out("place", name, lack, "nothing is stiff or damped")
        elif integrator in DAMPING_IMPLICIT and (integrator != "euler" or on.eulerdamp):
            yield _used("commit", name, have)
            yield _out("commit", name, lack, "nothing is damped")
        else:
            have, _ = split(plan["damped"])
            why = f"{integrator} treats damping explicitly"
            if integrator == "euler":
                why = "switched off (eulerdamp)"
            yield _out("commit", name, have, why)
        if integrator == "implicit":
            still = zip(plan["slides"], plan["constant"], strict=True)
            have, lack = split([on.coriolis and not (slides or same) for slides, same in still])
            name = "derivative of the bias forces (by tree)"
            yield _used("commit", name, have)
            yield _out("commit", name, lack, "constant" if on.coriolis else "switched off")
        if integrator in ("implicitfast", "discrete"):
            name = "gyroscopic derivative (by free body)"
            free = [i for i, is_free in enumerate(plan["free"]) if is_free]
            have = [names[i] for i in free if plan["gyroscopic"][i]]
            lack = [names[i] for i in free if not plan["gyroscopic"][i]]
            yield _used("commit", name, have)
            yield _out("commit", name, lack, "isotropic" if on.coriolis else "switched off")

    def sensors(self) -> Iterator[Listed]:
        names = self.model.called("sensor")
        yield _out("commit", "sensors", names, "computed when they are read, never in a step")

    def _split(self, test: Callable[[Any], object]) -> tuple[list[str], list[str]]:
        """Return the names of the joints that pass a test, and of the others."""
        have = [n for n, j in zip(self.joint_names, self.joints, strict=True) if test(j)]
        lack = [n for n, j in zip(self.joint_names, self.joints, strict=True) if not test(j)]
        return have, lack

    def _islands(self) -> list[str]:
        """Return the names of the islands, joined from the names of their trees."""
        islands: dict[int, list[str]] = {}
        for island, name in zip(self.plan["islands"], self.tree_names, strict=True):
            islands.setdefault(island, []).append(name)
        return ["+".join(trees) for trees in islands.values()]


def _used(
    stage: str,
    name: str,
    names: Iterable[str],
    *,
    kind: str = "term",
    why: str = "",
    count: int | None = None,
    rows: int | None = None,
    stages: tuple[str, ...] = (),
    removal: Removal | None = None,
) -> Listed:
    names = tuple(names)
    number = len(names) if count is None else count
    return PlanEntry(stage, kind, name, names, True, why, number, rows, stages), removal


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
