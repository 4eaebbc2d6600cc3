"""Findings on contacts in a run: initial overlap, creep, resting depth, frictionless sliding."""

from __future__ import annotations

import math
from collections.abc import Callable, Collection, Iterable, Iterator
from dataclasses import replace

import numpy as np

from stepcore.engine.element import Element
from stepcore.engine.model import Model
from stepcore.engine.sim import Sim
from stepcore.experiment.friction import Friction
from stepcore.experiment.sizes import Sizes
from stepcore.measure.monitors.finding import Cure, Finding, Next, Remedy, listed, named, others
from stepcore.measure.monitors.readings import FEWEST, REST, STEADY, Contact, Key, Look
from stepcore.measure.monitors.separation import Separation
from stepcore.measure.monitors.soft_rows import hardest, pair_solimp, stiffened
from stepcore.report.units import metres, newtons, percent, speed
from stepcore.scene.softness import UNKNOWN

# A contact counts as sticking if friction is below this share of μ × normal force. A pyramidal cone
# allows all of μ × normal force along its tangents, and 1/√2 of it between them.
STICKS = {"pyramidal": 0.7, "elliptic": 0.99}
# An edge of a friction pyramid pushes if its force exceeds this share of the strongest edge's.
EDGE = 1e-6
# Thresholds of findings, relative to the thickness of the thinner geom: a depth at rest, an overlap
# at the start, an overlap that joints maintain, frictionless sliding in one second.
DEEP, OVERLAP, JAMMED, SLIDES = 0.1, 0.01, 0.2, 0.1
# An initial overlap up to this many times the resting depth is the scene's resting state.
RESTS = 3.0
# A contact without friction carries a body from this share of its weight.
CARRIES = 0.1
# Two geoms visibly pass into each other from this share of the thinner one's half thickness.
PRESSED = 0.5
# The share of a threshold that a cure leaves.
LEFT = 0.1
# A depth that was asked for is reached within this factor.
REACHED = 1.05

# Returns the rows of the last solve, which are read at most once a reading.
Rows = Callable[[], np.ndarray]


class ContactMonitor:
    """A record of the contacts of one run."""

    def __init__(self, model: Model, friction: Friction, sizes: Sizes) -> None:
        self.model, self.friction, self.sizes = model, friction, sizes
        self.separation: Separation | None = None
        self.seen: dict[Key, list[Look]] = {}
        self.looks = 0
        self.levers: dict[int, float] = {}

    def begin(self, sim: Sim) -> None:
        """Record the overlaps at the start with another Sim, to keep this Sim's warm impulses."""
        if not self.model.npair:
            return
        aside = Sim(self.model, sim.settings)
        aside.qpos[:] = sim.qpos
        aside.forward()
        contacts = aside.contacts[aside.contacts["dist"] < 0]
        if len(contacts):
            movable = self.friction.movable(aside, contacts)
            self.separation = Separation(aside, contacts, movable, sim.time)

    def look(self, sim: Sim, rows: Rows) -> None:
        """Record every contact; rows: returns the rows of the last solve."""
        if not self.model.npair:
            return
        look, self.looks = self.looks, self.looks + 1
        if self.separation is not None:
            self.separation.look(sim)
        contacts = sim.contacts
        if not len(contacts):
            return
        # Diverging values may overflow.
        with np.errstate(over="ignore", invalid="ignore"):
            force, normal = contacts["force"], contacts["normal"]
            pushed = np.einsum("ci,ci->c", force, normal)
            rubbed = np.linalg.norm(force - pushed[:, None] * normal, axis=1)
            past, spin = self.friction.motion(sim, contacts)
            turning = np.linalg.norm(spin, axis=1)
            past = past - np.einsum("ci,ci->c", past, normal)[:, None] * normal
        sticks = self._sticks(sim, rows)
        for k in np.flatnonzero(pushed > 0):
            key = int(contacts["index"][k]), int(contacts["part"][k])
            most = self.friction.of(key[0]) * pushed[k]
            share = rubbed[k] / most if most > 0 else 0.0
            held = share < STICKS[sim.settings.cone] or sticks.get(key, False)
            depth = -float(contacts["dist"][k])
            rolls = float(turning[k]) * self.lever(key[0])
            seen = Look(look, depth, float(pushed[k]), float(share), bool(held), past[k], rolls)
            self.seen.setdefault(key, []).append(seen)

    def _sticks(self, sim: Sim, every: Rows) -> dict[Key, bool]:
        """Return the contacts whose friction is inside its pyramid, because every edge pushes.

        Between its edges, a pyramid yields at less friction than along an edge.
        """
        settings = sim.settings
        if settings.law != "solref" or settings.cone != "pyramidal":
            return {}
        rows = every()
        rows = rows[rows["kind"] == "contact"]
        forces: dict[Key, list[float]] = {}
        for index, part, force in zip(rows["index"], rows["part"], rows["force"], strict=True):
            forces.setdefault((int(index), int(part)), []).append(float(force))
        return {key: min(edges) > EDGE * max(edges) for key, edges in forces.items()}

    # Analysis of the readings.

    @property
    def starts(self) -> list[Contact]:
        """The overlaps at the start, deepest first."""
        return [] if self.separation is None else self.separation.overlaps()

    def slides(self) -> Iterator[Contact]:
        """Yield frictionless contacts that lasted a fifth of the run or more."""
        for (pair, part), seen in self.seen.items():
            if self.friction.of(pair) > 0 or len(seen) < max(FEWEST, 0.2 * self.looks):
                continue
            speed = float(np.mean([np.linalg.norm(at.past) for at in seen]))
            yield Contact(pair, part, speed=speed)

    def resting(self) -> Iterator[Contact]:
        """Yield contacts whose depth is constant to the end of the run."""
        first = self.looks - max(FEWEST, int(REST * self.looks))
        for (pair, part), seen in self.seen.items():
            late = [at for at in seen if at.look >= first]
            depth = np.array([at.depth for at in late])
            if len(late) < self.looks - first or depth.min() <= 0:
                continue
            if np.ptp(depth) < STEADY * depth.mean():
                force = float(np.mean([at.force for at in late]))
                yield Contact(pair, part, float(depth.mean()), force)

    def sunk(self) -> Iterator[Contact]:
        """Yield contacts that stay deep over the end of the run and have not come to rest."""
        resting = {(at.pair, at.part) for at in self.resting()}
        first = self.looks - max(FEWEST, int(REST * self.looks))
        for key, seen in self.seen.items():
            late = [at.depth for at in seen if at.look >= first]
            whole = key not in resting and len(late) == self.looks - first
            if whole and min(late) > DEEP * self.thick(key[0]):
                yield Contact(*key, max(late), settled=False)

    def deepest(self) -> list[Contact]:
        """Return each pair where it was deepest."""
        deepest: dict[int, Contact] = {}
        for (pair, part), seen in self.seen.items():
            at = max(seen, key=lambda look: look.depth)
            if pair not in deepest or at.depth > deepest[pair].depth:
                deepest[pair] = Contact(pair, part, at.depth, at.force, look=at.look)
        return list(deepest.values())

    def depth_of(self, pairs: Collection[int]) -> float | None:
        """Return the mean depth of the deepest of some pairs over the end of the run [m].

        None if none is pressed there.
        """
        first = self.looks - max(FEWEST, int(REST * self.looks))
        depths = [
            float(np.mean(late))
            for (pair, _), seen in self.seen.items()
            if pair in pairs and (late := [at.depth for at in seen if at.look >= first])
        ]
        deepest = max(depths, default=0.0)
        return deepest if deepest > 0 else None

    # Findings.

    def findings(self, depth: float | None, passed: Collection[int] = ()) -> Iterator[Finding]:
        """Yield all findings on contacts.

        depth: see `Monitor.findings`. passed: pairs that passed through each other.
        """
        resting, starts = list(self.resting()), self.starts
        jammed = self._jammed(starts, resting)
        if jammed:
            yield self._jam(list(jammed.values()))
        resting = [rest for rest in resting if rest.pair not in jammed]
        yield from self._overlaps([at for at in starts if at.pair not in jammed], resting)
        if self.model.settings.law == "solref":
            deep = [*resting, *self.sunk()]
            yield from self._depths(deep, depth)
            known = {at.pair for at in (*starts, *deep) if at.depth > DEEP * self.thick(at.pair)}
            known |= self._with_geoms_of(passed)
            yield from self._impacts([at for at in self.deepest() if at.pair not in known])
        yield from self._slides()

    def thick(self, pair: int) -> float:
        """Return the half thickness of the thinner geom of a pair [m]."""
        return self.sizes.contact(*self.model.contact_pair(pair).geoms)

    def lever(self, pair: int) -> float:
        """Return the radius on which the smaller geom of a pair rolls [m]."""
        lever = self.levers.get(pair)
        if lever is None:
            reach = min(self.sizes.reach[geom] for geom in self.model.contact_pair(pair).geoms)
            lever = self.levers[pair] = reach if math.isfinite(reach) else UNKNOWN
        return lever

    def _with_geoms_of(self, passed: Collection[int]) -> set[int]:
        """Return the pairs seen that share a geom with a pair."""
        geoms = {geom for pair in passed for geom in self.model.contact_pair(pair).geoms}
        seen = {pair for pair, _ in self.seen} if geoms else set()
        return {pair for pair in seen if geoms.intersection(self.model.contact_pair(pair).geoms)}

    def _named(self, pairs: Iterable[int]) -> tuple[Element, ...]:
        return named(self.model, "contact", pairs)

    def _geoms(self, pair: int) -> str:
        """Return the two geoms of a pair as the subject of a sentence."""
        model, geoms = self.model, self.model.contact_pair(pair).geoms
        names = [model.geom_names[geom] for geom in geoms]
        if all(names):
            return "geoms " + " and ".join(f"`{name}`" for name in names)
        return " and ".join(model.element_name("geom", geom) for geom in geoms)

    def _jammed(self, starts: list[Contact], resting: list[Contact]) -> dict[int, Contact]:
        """Return pairs of one tree that overlap throughout because joints keep the geoms there."""
        rest = {at.pair: at for at in resting}
        jammed: dict[int, Contact] = {}
        for start in starts:
            at, geoms = rest.get(start.pair), self.model.contact_pair(start.pair).geoms
            roots = {self.model.root(int(self.model.geom_body[g])) for g in geoms}
            deep = JAMMED * self.sizes.contact(*geoms)
            if at is not None and len(roots) == 1 and min(start.depth, at.depth) > deep:
                jammed.setdefault(at.pair, at)
        return jammed

    def _jam(self, jammed: list[Contact]) -> Finding:
        worst, contacts = jammed[0], self._named(at.pair for at in jammed)
        also = others([contact.name for contact in contacts[1:]], "pairs")
        problem = (
            f"{self._geoms(worst.pair)} overlap by {metres(worst.depth)}{also}, as their joints "
            f"hold them, and push each other with {newtons(worst.force)} all the time"
        )
        cure = self._apart(worst.pair)
        depth = worst.depth
        return Finding("overlap", "warning", problem, cure, contacts, depth, "m", TEST_CONTACTS)

    def _overlaps(self, starts: list[Contact], resting: list[Contact]) -> Iterator[Finding]:
        """Yield pairs that overlap at the start and do not rest at that depth."""
        rest: dict[int, float] = {}
        for at in resting:
            rest[at.pair] = max(rest.get(at.pair, 0.0), at.depth)
        deep: dict[int, Contact] = {}
        for start in starts:
            notable = OVERLAP * self.thick(start.pair)
            known = RESTS * rest.get(start.pair, 0.0)
            if start.depth > (max(notable, known) if start.movable else LEFT * notable):
                deep.setdefault(start.pair, start)
        if not deep:
            return
        worst, contacts = next(iter(deep.values())), self._named(deep)
        share = worst.depth / self.thick(worst.pair)
        thrown = self._thrown(worst)
        becomes = f" and are thrown apart at {speed(worst.speed)}" if thrown else ""
        if not worst.movable:
            becomes = " and no joint can move them apart"
        also = others([contact.name for contact in contacts[1:]], "pairs")
        problem = (
            f"{self._geoms(worst.pair)} overlap by {metres(worst.depth)} at the start, "
            f"{percent(share)} of the thinner one's half thickness{also},{becomes}".rstrip(",")
        )
        kind = "overlap at the start"
        severity = "error" if share > OVERLAP * 10 and (thrown or not worst.movable) else "warning"
        cure = self._apart(worst.pair)
        yield Finding(kind, severity, problem, cure, contacts, worst.depth, "m", TEST_CONTACTS)

    def _thrown(self, overlap: Contact) -> bool:
        """Return whether an overlap threw the geoms further apart than its depth: v²/2g > depth."""
        features = self.model.scene.features
        gravity = float(np.linalg.norm(self.model.scene.gravity)) if features.gravity else 0.0
        return overlap.speed > (2 * gravity * overlap.depth) ** 0.5

    def _apart(self, pair: int) -> str:
        """Return the cure for an overlap: other positions, or no contact between the two bodies."""
        model = self.model
        bodies = [int(model.geom_body[geom]) for geom in model.contact_pair(pair).geoms]
        tree = [model.root(body) for body in bodies]
        if tree[0] == tree[1] and tree[0]:
            a, b = (model.body_names[body] or "…" for body in bodies)
            exclude = f'<exclude body1="{a}" body2="{b}"/>'
            return f"leave them out with {exclude}, or make the geoms smaller"
        mover = model.element_name("body", bodies[1] if tree[1] else bodies[0])
        return f"move {mover} away by that much in the model or in the keyframe"

    def _depths(self, resting: list[Contact], asked: float | None) -> Iterator[Finding]:
        """Yield how deep contacts rest, with the solref that reduces the depth."""
        notable = []
        for at in resting:
            thick = self.thick(at.pair)
            ratio = at.depth / (DEEP * thick)
            if ratio > 1 or (asked is not None and at.depth > asked):
                notable.append((ratio, thick, at))
        if not notable:
            return
        notable.sort(key=lambda entry: -entry[2].depth if asked is not None else -entry[0])
        ratio, thick, worst = notable[0]
        contacts = self._named(at.pair for _, _, at in notable)
        pair = self.model.contact_pair(worst.pair)
        wanted = asked if asked is not None else LEFT * DEEP * thick
        solimp = pair_solimp(self.model, *pair.geoms)
        verb = "rests" if worst.settled else "has not come to rest and stays up to"
        problem = (
            f"{listed(contacts, 'contacts')} {verb} {metres(worst.depth)} deep, "
            f"{percent(worst.depth / thick)} of the thinner geom's half thickness, under "
            f'solref="{pair.solref[0]:g} {pair.solref[1]:g}"'
        )
        pairs = {at.pair for _, _, at in notable}
        harder = stiffened(self.model, contacts, pair.solref, solimp, worst.depth, wanted)
        # Steep friction pyramids are soft along the normal, too.
        round_ = (Cure('cone="elliptic"', settings={"cone": "elliptic"}),)
        steep = self.model.settings.cone == "pyramidal" and self.friction.of(worst.pair) > 1
        remedy = Remedy(
            (*((round_,) * steep), harder),
            lambda m: m.contacts.depth_of(pairs),
            REACHED * wanted if asked is not None else DEEP * thick,
            metres,
        )
        severity = "warning" if ratio > 1 else "remark"
        finding = Finding("depth at rest", severity, problem, "", contacts, worst.depth, "m")
        yield replace(finding, commands=TEST_CONTACTS, remedy=remedy)

    def _impacts(self, deepest: list[Contact]) -> Iterator[Finding]:
        """Yield pairs that an impact or a load pressed deep into each other for a while."""
        notable = [
            (ratio, at)
            for at in deepest
            if (ratio := at.depth / (PRESSED * self.thick(at.pair))) > 1
        ]
        if not notable:
            return
        notable.sort(key=lambda entry: -entry[0])
        worst, pairs = notable[0][1], [at.pair for _, at in notable]
        contacts, model = self._named(pairs), self.model
        solref = model.contact_pair(worst.pair).solref
        problem = (
            f"{listed(contacts, 'contacts')} is pressed {metres(worst.depth)} deep, "
            f"{percent(worst.depth / self.thick(worst.pair))} of the thinner geom's half "
            f'thickness, under solref="{solref[0]:g} {solref[1]:g}"'
        )
        dts = [model.settings.dt / part for part in (1, 2, 4)]
        ways = (tuple(hardest(model, pairs, dt) for dt in dts),)
        enough = PRESSED * self.thick(worst.pair)
        remedy = Remedy(ways, lambda m: m.contacts.pressed(pairs), enough, metres, needed=True)
        finding = Finding("depth under load", "remark", problem, "", contacts, worst.depth, "m")
        yield replace(finding, commands=TEST_CONTACTS, remedy=remedy)

    def pressed(self, pairs: Collection[int]) -> float | None:
        """Return how deep some pairs were pressed at most [m]; None if one does not touch."""
        depths = [at.depth for at in self.deepest() if at.pair in pairs]
        return max(depths) if len(depths) == len(pairs) else None

    def _slides(self) -> Iterator[Finding]:
        """Yield contacts that slide because they have no friction."""
        fast = [at for at in self.slides() if at.speed > SLIDES * self.thick(at.pair)]
        if not fast:
            yield from self._stands()
            return
        fast.sort(key=lambda slide: -slide.speed)
        contacts = self._named(slide.pair for slide in fast)
        frictionless = self.model.contact_pair(fast[0].pair).condim == 1
        cure = 'condim="3"' if frictionless else 'friction="0.8"'
        why = "condim is 1" if frictionless else "its friction is 0"
        problem = (
            f"{listed(contacts, 'contacts')} slides at {speed(fast[0].speed)} without friction, "
            f"because {why}"
        )
        cure = f"{cure} on one of the two geoms gives it friction"
        yield Finding("no friction", "remark", problem, cure, contacts, fast[0].speed, "m/s")

    def _stands(self) -> Iterator[Finding]:
        """Yield contacts that carry a free body at rest and have no friction."""
        model = self.model
        free = {int(body) for k, body in enumerate(model.jnt_body) if model.jnt_type[k] == "free"}
        carrying = [
            at
            for at in self.resting()
            if self.friction.of(at.pair) == 0 and self._carries(at, free)
        ]
        if not carrying:
            return
        carrying.sort(key=lambda at: -at.force)
        contacts = self._named(at.pair for at in carrying)
        why = "condim is 1"
        if model.contact_pair(carrying[0].pair).condim > 1:
            why = "its friction is 0"
        problem = (
            f"{listed(contacts, 'contacts')} carries {newtons(carrying[0].force)} without "
            f"friction, because {why}, so a slight push lets the body slide or topple"
        )
        cure = 'condim="3" on one of the two geoms gives it friction'
        force = carrying[0].force
        yield Finding("no friction", "remark", problem, cure, contacts, force, "N")

    def _carries(self, at: Contact, free: set[int]) -> bool:
        """Return whether a contact carries a tenth of the weight of a free tree."""
        model = self.model
        gravity = (
            float(np.linalg.norm(model.scene.gravity)) if model.scene.features.gravity else 0.0
        )
        roots = [
            model.root(int(model.geom_body[geom])) for geom in model.contact_pair(at.pair).geoms
        ]
        weights = [
            gravity * sum(m for body, m in enumerate(model.body_mass) if model.root(body) == root)
            for root in roots
            if root in free
        ]
        return roots[0] != roots[1] and any(at.force > CARRIES * weight > 0 for weight in weights)


TEST_CONTACTS = (
    Next("converge", "whether the contacts are solved"),
    Next("run", "energy and overlap over time", ("--plot", "run.png")),
)
