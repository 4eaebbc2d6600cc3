"""Findings on contacts in a run: initial overlap, creep, resting depth, frictionless sliding."""

from __future__ import annotations

import math
from collections.abc import Callable, Collection, Iterable, Iterator
from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np

from stepcore.engine.element import Element
from stepcore.engine.model import Model
from stepcore.engine.sim import Sim
from stepcore.experiment.errors import STICKS
from stepcore.experiment.friction import Friction
from stepcore.experiment.sizes import UNKNOWN, Sizes
from stepcore.measure.monitors.finding import Cure, Finding, Next, Remedy, listed, named, others
from stepcore.measure.monitors.soft_rows import pair_solimp, stiffened
from stepcore.report.units import metres, newtons, percent, speed

# The last share of a run, in which rest is judged; the largest relative variation of a quantity at
# rest; and the fewest readings from which rest or creep is judged.
REST, STEADY, FEWEST = 0.25, 0.2, 8
# An edge of a friction pyramid pushes if its force exceeds this share of the strongest edge's.
EDGE = 1e-6
# Thresholds of findings, relative to the thickness of the thinner geom: a depth at rest, an overlap
# at the start, an overlap that joints maintain, frictionless sliding in one second.
DEEP, OVERLAP, JAMMED, SLIDES = 0.1, 0.01, 0.2, 0.1
# An initial overlap up to this many times the resting depth is the scene's resting state.
RESTS = 3.0
# The share of a threshold that a cure leaves.
LEFT = 0.1
# A depth that was asked for is reached within this factor.
REACHED = 1.05

# A pair of geoms, and the index of one of its contacts.
Key = tuple[int, int]
# Returns the rows of the last solve, which are read at most once a reading.
Rows = Callable[[], np.ndarray]


class Look(NamedTuple):
    """One contact at one reading.

    look: the index of the reading.
    depth: the overlap [m].
    force: the normal force [N].
    share: friction over μ × normal force.
    held: whether friction holds the contact.
    past: the tangential velocity [m/s].
    rolls: the speed at which the surfaces turn on each other: angular velocity × lever [m/s].
    """

    look: int
    depth: float
    force: float
    share: float
    held: bool
    past: np.ndarray
    rolls: float


@dataclass(frozen=True)
class Contact:
    """The behaviour of one contact of a pair of geoms.

    depth: the overlap at the start, or at rest [m].
    force: the normal force at rest [N].
    speed: the mean tangential speed, or the speed at which the geoms left their overlap [m/s].
    movable: whether some joint can separate the geoms.
    """

    pair: int
    part: int = 0
    depth: float = 0.0
    force: float = 0.0
    speed: float = 0.0
    movable: bool = True


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

    def depth_of(self, pairs: Collection[int]) -> float | None:
        """Return the mean depth of the deepest of some pairs over the end of the run [m].

        None if none touches there.
        """
        first = self.looks - max(FEWEST, int(REST * self.looks))
        depths = [
            float(np.mean(late))
            for (pair, _), seen in self.seen.items()
            if pair in pairs and (late := [at.depth for at in seen if at.look >= first])
        ]
        return max(depths, default=None)

    # Findings.

    def findings(self, depth: float | None) -> Iterator[Finding]:
        """Yield all findings on contacts.

        depth: see `Monitor.findings`.
        """
        resting, starts = list(self.resting()), self.starts
        jammed = self._jammed(starts, resting)
        if jammed:
            yield self._jam(list(jammed.values()))
        resting = [rest for rest in resting if rest.pair not in jammed]
        yield from self._overlaps([at for at in starts if at.pair not in jammed], resting)
        if self.model.settings.law == "solref":
            yield from self._depths(resting, depth)
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
        problem = (
            f"{listed(contacts, 'contacts')} rests {metres(worst.depth)} deep, "
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

    def _slides(self) -> Iterator[Finding]:
        """Yield contacts that slide because they have no friction."""
        fast = [at for at in self.slides() if at.speed > SLIDES * self.thick(at.pair)]
        if not fast:
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


TEST_CONTACTS = (
    Next("converge", "whether the contacts are solved"),
    Next("run", "energy and overlap over time", ("--plot", "run.png")),
)


class Separation:
    """A record of how fast geoms that overlap at the start separate.

    The speed is that of the centres of mass of free trees: a leg that straightens moves its foot,
    and does not throw the robot.
    """

    def __init__(self, sim: Sim, contacts: np.ndarray, movable: list[bool], time: float) -> None:
        model = sim.model
        owner = model.geom_body
        self.pairs, self.movable = contacts["index"].tolist(), movable
        self.depth, self.normal = -contacts["dist"], np.array(contacts["normal"])
        self.bodies = [owner[contacts[name]] for name in ("geom1", "geom2")]
        # The contact point in the frame of each body.
        self.points = [
            np.einsum("cji,cj->ci", sim.xmat[body], contacts["pos"] - sim.xpos[body])
            for body in self.bodies
        ]
        roots = [np.array([model.root(int(body)) for body in side]) for side in self.bodies]
        free = [int(body) for k, body in enumerate(model.jnt_body) if model.jnt_type[k] == "free"]
        self.trees = [(root, np.isin(root, free)[:, None]) for root in roots]
        self.time, self.rose = time, self._apart(sim)[1]
        self.speed, self.left = np.zeros(len(contacts)), np.zeros(len(contacts), bool)

    def look(self, sim: Sim) -> None:
        """Record the speed of geoms that leave their overlap."""
        if self.left.all():
            return
        with np.errstate(over="ignore", invalid="ignore"):
            moved, rose = self._apart(sim)
            if sim.time > self.time:
                # Only the first time: a later one follows another impact.
                leaves = ~self.left & (moved >= self.depth)
                speed = (rose - self.rose) / (sim.time - self.time)
                self.speed, self.left = np.where(leaves, speed, self.speed), self.left | leaves
        self.time, self.rose = sim.time, rose

    def _apart(self, sim: Sim) -> tuple[np.ndarray, np.ndarray]:
        """Return the distances along the normal of the contact points, and of what carries them."""
        place, turn, centre = sim.xpos, sim.xmat, sim.subtree_com
        points = [
            place[body] + np.einsum("cij,cj->ci", turn[body], point)
            for body, point in zip(self.bodies, self.points, strict=True)
        ]
        carried = [
            np.where(free, centre[root], point)
            for point, (root, free) in zip(points, self.trees, strict=True)
        ]
        moved, rose = (
            np.einsum("ci,ci->c", self.normal, second - first)
            for first, second in (points, carried)
        )
        return moved, rose

    def overlaps(self) -> list[Contact]:
        """Return the overlaps with the speeds of separation, deepest first."""
        columns = (self.pairs, self.depth.tolist(), self.speed.tolist(), self.movable)
        overlaps = (
            Contact(pair, depth=depth, speed=speed, movable=movable)
            for pair, depth, speed, movable in zip(*columns, strict=True)
        )
        return sorted(overlaps, key=lambda overlap: -overlap.depth)


def settled(series: np.ndarray) -> float | None:
    """Return the mean of the end of a series; None if the series still varies there."""
    late = series[-max(FEWEST, int(REST * len(series))) :]
    mean = float(late.mean())
    steady = len(late) >= FEWEST and mean > 0 and float(np.ptp(late)) < STEADY * mean
    return mean if steady else None
