"""Every term, stage, row kind, pair and file of a model: used, or left out with its reason."""

from __future__ import annotations

import operator
from collections import Counter
from collections.abc import Callable, Iterable, Iterator, Sequence
from typing import Any

from stepcore._core import Settings
from stepcore.engine.model import Model
from stepcore.measure.ablation.changes import Change, Features
from stepcore.measure.plan.result import Entry

Priced = tuple[Entry, Change | None]


def entries(model: Model, settings: Settings, rows: Counter[str]) -> Iterator[Priced]:
    """Entries, each with the change of the scene that would leave it out; rows: by kind."""
    what = _Listing(model, settings, rows)
    parts = (what.files, what.bodies, what.terms, what.pairs, what.rows, what.commit)
    for part in parts:
        # What the scene has none of is neither used nor left out.
        yield from (priced for priced in part() if priced[0].count)


class _Listing:
    def __init__(self, model: Model, settings: Settings, rows: Counter[str]) -> None:
        self.model, self.scene, self.now = model, model.scene, rows
        self.features = Features(model)
        self.plan = self.features.plan
        self.settings = settings
        self.body = _named(model.body_names, "body")
        self.geoms = _named(model.geom_names, "geom")
        self.joints = _named(model.joint_names, "joint")
        # Joints and geoms in the model's order.
        self.joint = [model.scene.joints[i] for i in self.features.joint]
        self.geom = [model.scene.geoms[i] for i in self.features.geom]
        self.tree_of: dict[int, int] = {}
        for tree, (first, count, _, _) in enumerate(self.plan["trees"]):
            self.tree_of |= dict.fromkeys(range(first, first + count), tree)

    def files(self) -> Iterator[Priced]:
        """Files that were read, and those that only draw."""
        source = self.scene._source
        files = [file for file in (source.files if source else ()) if file != "<string>"]
        unread = list(source.unread) if source else []
        yield _entry("files", "file", "files read", files)
        yield _entry("files", "file", "files never read", unread, "only draw", used=False)
        ignored = [line.rsplit(" (", 1)[0] for line in self.scene.ignored]
        yield _entry(
            *("files", "file", "elements of the file", ignored),
            "only draw, sense or say what no equation reads",
            used=False,
        )

    def bodies(self) -> Iterator[Priced]:
        """Poses: of bodies, their rotations, geoms and sites."""
        seen, turns = self.plan["seen"], self.plan["turns"]
        placed = [i for i, tree in self.tree_of.items() if seen[tree]]
        names = self.body
        part = ("place/kinematics",)
        yield _entry("place", "term", "poses of bodies", _of(names, placed), parts=part)
        fixed = [i for i in range(1, len(names)) if i not in self.tree_of]
        hidden = [i for i, tree in self.tree_of.items() if not seen[tree]]
        yield _out("place", "poses of bodies", _of(names, fixed), "cannot move: placed once")
        yield _out("place", "poses of bodies", _of(names, hidden), "nothing reads them in a step")
        level = [i for i in placed if not turns[i]]
        turning = [i for i in placed if turns[i]]
        yield _entry("place", "term", "rotations of bodies", _of(names, turning))
        yield _out("place", "rotations of bodies", _of(names, level), "no joint turns them")
        solid, owner = self.plan["collides"], self.model.geom_body.tolist()
        moving = [i for i, on in enumerate(solid) if on and owner[i] in self.tree_of]
        still = [i for i, on in enumerate(solid) if on and owner[i] not in self.tree_of]
        free = [i for i, on in enumerate(solid) if not on]
        yield _entry("place", "term", "poses of geoms", _of(self.geoms, moving))
        yield _out("place", "poses of geoms", _of(self.geoms, still), "cannot move: placed once")
        yield _out("place", "poses of geoms", _of(self.geoms, free), "meet nothing")
        sites = _named(self.model.site_names, "site")
        yield _out("place", "poses of sites", sites, "no force acts there: placed when read")

    def terms(self) -> Iterator[Priced]:
        """Inertia and the smooth forces."""
        constant, slides = self.plan["constant"], self.plan["slides"]
        trees = [self.body[first] for first, *_ in self.plan["trees"]]
        changing = [name for name, fixed in zip(trees, constant, strict=True) if not fixed]
        parts = ("place/inertia", "place/factor")
        yield _entry(
            "place", "term", "mass matrix and its factors, of trees", changing, parts=parts
        )
        name = "bias force (gravity, velocities), of trees"
        yield _entry("place", "term", name, changing, parts=("place/bias",))
        sliding = [n for n, s in zip(trees, slides, strict=True) if s]
        balls = [n for n, c, s in zip(trees, constant, slides, strict=True) if c and not s]
        gone = "mass matrix, factors and bias force, of trees"
        yield _out("place", gone, sliding, "constant: nothing turns")
        yield _out("place", gone, balls, "isotropic: constant, and no gyroscopic term")
        by_kind = {change.kind: change for change in self.features.terms()}
        on = self.scene.features
        name = "of that: Coriolis, centrifugal, gyroscopic"
        if on.coriolis:
            change = by_kind.get("velocity forces")
            yield _entry("place", "term", name, changing, change=change)
        else:
            yield _out("place", name, changing, "switched off (coriolis)")
        for field, flag, kind, word in (
            ("stiffness", "spring", "joint springs", "springs"),
            ("damping", "damper", "joint damping", "dampers"),
        ):
            have = [n for n, j in zip(self.joints, self.joint, strict=True) if getattr(j, field)]
            lack = [
                n for n, j in zip(self.joints, self.joint, strict=True) if not getattr(j, field)
            ]
            if getattr(on, flag):
                yield _entry("place", "term", word, have, change=by_kind.get(kind))
            else:
                yield _out("place", word, have, f"switched off ({flag})")
            yield _out("place", word, lack, f"{field} 0")
        motors = _named(self.model.actuator_names, "actuator")
        off = Change("actuators", "", (("feature", "actuation"),))
        if on.actuation:
            yield _entry("place", "term", "actuators", motors, change=off)
        else:
            yield _out("place", "actuators", motors, "switched off (actuation)")
        name = "guess: velocity with nothing in the way, dofs of"
        yield _entry("place", "term", name, self.joints, parts=("place/guess",))
        if not on.gravity or not any(self.scene.gravity):
            yield _out("place", "gravity", [], "switched off" if not on.gravity else "0", 1)

    def pairs(self) -> Iterator[Priced]:
        """Pairs of geoms by the shapes that meet."""
        tests: dict[str, list[int]] = {}
        pairs = self.features.pairs
        skips = self.settings.law in ("solref", "penalty")
        for index, (a, b) in enumerate(pairs):
            if not (skips and self.plan["apart"][index]):
                tests.setdefault(f"{self.geom[a].type}-{self.geom[b].type}", []).append(index)
        for shapes, indices in tests.items():
            change = self._without(indices)
            names = self._pairs(indices)
            yield _entry("detect", "pair", f"{shapes} pairs", names, change=change)
        apart = [i for i, is_apart in enumerate(self.plan["apart"]) if is_apart]
        if apart:
            guards = _of(self.joints, sorted({joint for joint, _, _ in self.plan["guards"]}))
            why = f"kept apart by the ranges of {', '.join(guards)}; tested only beyond them"
            if skips:
                yield _out("detect", "pairs", self._pairs(apart), why, kind="pair")
        for why, count, examples in self.plan["unmet"]:
            some = [f"{self.geoms[a]}/{self.geoms[b]}" for a, b in examples]
            yield _out("detect", "pairs", some, why, count, kind="pair")
        ghosts = [n for n, g in zip(self.geoms, self.geom, strict=True) if not _solid(g)]
        why = "contype and conaffinity are 0"
        yield _out("detect", "geoms in any pair", ghosts, why, kind="pair")

    def _pairs(self, indices: Iterable[int]) -> list[str]:
        pairs = self.features.pairs
        return [f"{self.geoms[a]}/{self.geoms[b]}" for a, b in (pairs[i] for i in indices)]

    def _without(self, indices: Sequence[int]) -> Change | None:
        """Excluding these pairs, where their bodies have no others."""
        owner = self.model.geom_body.tolist()
        bodies = {
            tuple(sorted((owner[a], owner[b])))
            for a, b in (self.features.pairs[i] for i in indices)
        }
        own = self.features.body_pairs()
        if sum(len(own[pair]) for pair in bodies) != len(indices):
            return None
        order = self.features.body
        return Change("pairs", "", (("exclude", tuple((order[a], order[b]) for a, b in bodies)),))

    def rows(self) -> Iterator[Priced]:
        """Kinds of rows, and what makes none."""
        yield from self._equality_rows()
        yield from self._joint_rows("friction loss", "frictionloss")
        yield from self._limit_rows()
        yield from self._contact_rows()

    def _equality_rows(self) -> Iterator[Priced]:
        features = self.scene.features
        ties = self.scene.equalities
        names = _named([e.name for e in ties], "equality")
        on = [n for n, e in zip(names, ties, strict=True) if e.active]
        off = [n for n, e in zip(names, ties, strict=True) if not e.active]
        if features.equality and features.constraint:
            change = Change("equality", "", (("feature", "equality"),))
            rows = self.now["connect"]
            name = "connections, 3 rows each"
            yield _entry("solve", "row", name, on, rows=rows, change=change)
            yield _out("solve", "connections", off, "not active", kind="row")
        else:
            yield _out("solve", "connections", names, "switched off", kind="row")

    def _joint_rows(self, kind: str, field: str) -> Iterator[Priced]:
        features = self.scene.features
        have, lack = self._split(operator.attrgetter(field))
        if features.frictionloss and features.constraint:
            change = Change(kind, "", (("feature", field),))
            name = f"{kind}, a row a dof"
            rows = self.now["friction loss"]
            yield _entry("solve", "row", name, have, rows=rows, change=change)
        else:
            yield _out("solve", kind, have, "switched off", kind="row")
        yield _out("solve", kind, lack, f"{field} 0", kind="row")

    def _limit_rows(self) -> Iterator[Priced]:
        features = self.scene.features
        have, lack = self._split(lambda joint: joint.range is not None)
        free, _ = self._split(lambda joint: joint.type == "free")
        lack = [name for name in lack if name not in free]
        if features.limit and features.constraint:
            change = Change("limits", "", (("feature", "limit"),))
            name = "limits, a row where one is reached"
            rows = self.now["limit"]
            yield _entry("solve", "row", name, have, rows=rows, change=change)
        else:
            yield _out("solve", "limits", have, "switched off", kind="row")
        yield _out("solve", "limits", lack, "no range", kind="row")
        yield _out("solve", "limits", free, "free joints have none", kind="row")

    def _contact_rows(self) -> Iterator[Priced]:
        plan, law = self.plan, self.settings.law
        condim, still, mu = plan["condim"], plan["still"], plan["friction"]
        every = range(len(condim))
        normal = [i for i in every if condim[i] == 1]
        zero = [i for i in every if condim[i] > 1 and mu[i] == 0]
        coulomb = law in ("lesson", "relaxed", "rigid")
        if law == "penalty":
            yield _out("solve", "contact rows", self._pairs(every), "law penalty: springs, no rows")
            return
        dropped = zero if coulomb else []
        sliding = [i for i in every if condim[i] > 1 and i not in dropped]
        change = Change("friction", "", (("smooth", self.features.rubbing()),))
        yield _entry("solve", "row", "contacts, normal row only", self._pairs(normal))
        yield _out("solve", "friction of contacts", self._pairs(normal), "condim 1", kind="row")
        yield _out("solve", "friction of contacts", self._pairs(dropped), "μ is 0", kind="row")
        moving: dict[int, list[int]] = {}
        for i in sliding:
            moving.setdefault(2 - sum(still[i]), []).append(i)
        for tangents, indices in sorted(moving.items(), reverse=True):
            name, count = self._contact(tangents)
            whole = len(indices) == len(condim)
            yield _entry(
                *("solve", "row", f"contacts, {name}", self._pairs(indices)),
                rows=self.now["contact"] if whole else None,
                change=change if len(moving) == 1 else None,
            )
            if tangents < 2:
                why = f"nothing can move along: {count} rows and not {self._contact(2)[1]}"
                word = "a tangent" if tangents else "both tangents"
                names = self._pairs(indices)
                yield _out("solve", f"friction along {word}", names, why, kind="row")
        if zero and not coulomb:
            why = "μ is 0, but MuJoCo's law has at least 1e-5: say condim 1 to be rid of its rows"
            yield _entry("solve", "row", "friction of contacts, μ 0", self._pairs(zero), why)

    def _contact(self, tangents: int) -> tuple[str, int]:
        """The rows of one contact with friction that can move along so many tangents."""
        if self.settings.law != "solref" or self.settings.cone == "elliptic":
            count = 1 + tangents
        else:
            count = {2: 4, 1: 3, 0: 1}[tangents]
        return f"{count} row{'s' * (count > 1)} each ({self.settings.cone} cone)", count

    def commit(self) -> Iterator[Priced]:
        """What the integrator adds, and quaternions."""
        s, on, plan = self.settings, self.scene.features, self.plan
        name = f"impulses: {s.solver}, by islands"
        yield _entry("solve", "term", name, self._islands(), parts=("solve/impulses",))
        name = f"integrator: {s.integrator}, dofs of"
        yield _entry("commit", "term", name, self.joints, parts=("commit",))
        if not s.warm_start:
            yield _out("solve", "warm start", [], "switched off", 1)
        names = [self.body[first] for first, *_ in plan["trees"]]
        fast = s.integrator == "implicitfast"
        damped = [d or (fast and v) for d, v in zip(plan["damped"], plan["served"], strict=True)]
        have = [n for n, d in zip(names, damped, strict=True) if d]
        lack = [n for n, d in zip(names, damped, strict=True) if not d]
        word = "implicit damping, of trees"
        if fast or (s.integrator == "euler" and on.eulerdamp):
            yield _entry("commit", "term", word, have)
            yield _out("commit", word, lack, "nothing is damped")
        else:
            why = "switched off (eulerdamp)" if s.integrator == "euler" else f"not {s.integrator}'s"
            yield _out("commit", word, have, why)
        if fast:
            word = "gyroscopic derivative, of free bodies"
            free = [i for i, is_free in enumerate(plan["free"]) if is_free]
            odd = [names[i] for i in free if plan["gyroscopic"][i]]
            even = [names[i] for i in free if not plan["gyroscopic"][i]]
            yield _entry("commit", "term", word, odd)
            yield _out("commit", word, even, "isotropic" if on.coriolis else "switched off")
        turning, plain = self._split(lambda joint: joint.type in ("free", "ball"))
        yield _entry("commit", "term", "quaternions", turning)
        yield _out("commit", "quaternions", plain, "one coordinate each")

    def _split(self, test: Callable[[Any], object]) -> tuple[list[str], list[str]]:
        """Names of the joints that pass a test, and of the others."""
        have = [n for n, j in zip(self.joints, self.joint, strict=True) if test(j)]
        lack = [n for n, j in zip(self.joints, self.joint, strict=True) if not test(j)]
        return have, lack

    def _islands(self) -> list[str]:
        """The islands, each by its trees."""
        names = [self.body[first] for first, *_ in self.plan["trees"]]
        found: dict[int, list[str]] = {}
        for island, name in zip(self.plan["islands"], names, strict=True):
            found.setdefault(island, []).append(name)
        return ["+".join(trees) for trees in found.values()]


def _entry(
    stage: str,
    kind: str,
    name: str,
    names: Iterable[str],
    why: str = "",
    count: int | None = None,
    used: bool = True,
    rows: int | None = None,
    change: Change | None = None,
    parts: tuple[str, ...] = (),
) -> Priced:
    listed = tuple(names)
    number = len(listed) if count is None else count
    return Entry(stage, kind, name, listed, used, why, number, rows, parts), change


def _out(
    stage: str,
    name: str,
    names: Iterable[str],
    why: str,
    count: int | None = None,
    kind: str = "term",
) -> Priced:
    return _entry(stage, kind, name, names, why, count, used=False)


def _of(names: Sequence[str], indices: Iterable[int]) -> list[str]:
    return [names[i] for i in indices]


def _named(names: Iterable[str], kind: str) -> list[str]:
    """Names, or "kind 3" where there is none."""
    return [name or f"{kind} {i}" for i, name in enumerate(names)]


def _solid(geom: Any) -> bool:
    return bool(geom.contype or geom.conaffinity)
