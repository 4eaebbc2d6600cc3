"""Findings on contacts in a run: initial overlap, creep, resting depth, frictionless sliding."""

from __future__ import annotations

import math
from collections.abc import Iterable, Iterator
from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np

from stepcore.engine.element import Element
from stepcore.engine.model import Model
from stepcore.engine.sim import Sim
from stepcore.experiment.errors import STICKS
from stepcore.experiment.friction import Friction
from stepcore.experiment.sizes import Sizes
from stepcore.measure.monitors.finding import Finding, Next, listed, named, others
from stepcore.measure.monitors.soft_rows import advised, pair_solimp
from stepcore.report.units import metres, newtons, percent, speed

# The last share of a run, in which rest is judged; the largest relative variation of a quantity at
# rest; and the fewest readings from which rest or creep is judged.
REST, STEADY, FEWEST = 0.25, 0.2, 8
# Creep: largest relative deviation from the mean velocity; length of the window in time constants;
# and least load, as a share of the largest friction.
UNSTEADY, WINDOW, RUBS = 0.5, 10.0, 0.05
# An edge of a friction pyramid pushes if its force exceeds this share of the strongest edge's.
EDGE = 1e-6
# Thresholds of findings, relative to the thickness of the thinner geom: creep in one second, a
# depth at rest, an overlap at the start, an overlap that joints maintain, frictionless sliding in
# one second.
CREEP, DEEP, OVERLAP, JAMMED, SLIDES = 0.01, 0.1, 0.01, 0.2, 0.1
# An initial overlap up to this many times the resting depth is the scene's resting state.
RESTS = 3.0
# The share of a threshold that a cure leaves.
LEFT = 0.1
# Largest impratio that is advised: beyond it, the rows differ too much in scale to be solved.
IMPRATIO = 1e4

# A pair of geoms, and the index of one of its contacts.
Key = tuple[int, int]


class Look(NamedTuple):
    """One contact at one reading.

    look: the index of the reading.
    depth: the overlap [m].
    force: the normal force [N].
    share: friction over μ × normal force.
    held: whether friction holds the contact.
    past: the tangential velocity [m/s].
    """

    look: int
    depth: float
    force: float
    share: float
    held: bool
    past: np.ndarray


@dataclass(frozen=True)
class Contact:
    """The behaviour of one contact of a pair of geoms.

    depth: the overlap at the start, or at rest [m].
    force: the normal force at rest [N].
    speed: the mean tangential speed, or the speed at which the geoms left their overlap [m/s].
    share: friction over μ × normal force.
    held: the time for which friction held the contact [s].
    movable: whether some joint can separate the geoms.
    """

    pair: int
    part: int = 0
    depth: float = 0.0
    force: float = 0.0
    speed: float = 0.0
    share: float = 0.0
    held: float = 0.0
    movable: bool = True


class ContactMonitor:
    """A record of the contacts of one run."""

    def __init__(self, model: Model, friction: Friction, sizes: Sizes) -> None:
        self.model, self.friction, self.sizes = model, friction, sizes
        self.separation: Separation | None = None
        self.seen: dict[Key, list[Look]] = {}
        self.looks = 0

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

    def look(self, sim: Sim) -> None:
        """Record every contact."""
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
            past = self.friction.passing(sim, contacts)
            past = past - np.einsum("ci,ci->c", past, normal)[:, None] * normal
        sticks = self._sticks(sim)
        for k in np.flatnonzero(pushed > 0):
            key = int(contacts["index"][k]), int(contacts["part"][k])
            most = self.friction.of(key[0]) * pushed[k]
            share = rubbed[k] / most if most > 0 else 0.0
            held = share < STICKS[sim.settings.cone] or sticks.get(key, False)
            depth = -float(contacts["dist"][k])
            seen = Look(look, depth, float(pushed[k]), float(share), bool(held), past[k])
            self.seen.setdefault(key, []).append(seen)

    def _sticks(self, sim: Sim) -> dict[Key, bool]:
        """Return the contacts whose friction is inside its pyramid, because every edge pushes.

        Between its edges, a pyramid yields at less friction than along an edge.
        """
        settings = sim.settings
        if settings.law != "solref" or settings.cone != "pyramidal":
            return {}
        rows = sim.rows
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

    def creeps(self, times: list[float]) -> Iterator[Contact]:
        """Yield contacts that move steadily for a while although friction holds.

        Soft friction is a damper: the initial speed of a contact decays within the time constant,
        and under a load a speed remains. Of all windows of `WINDOW` time constants (and at least a
        tenth of the run), the fastest steady speed counts.

        times: the times of the readings [s].
        """
        spacing = (times[-1] - times[0]) / max(1, len(times) - 1) if len(times) > 1 else 0.0
        for (pair, part), seen in self.seen.items():
            if self.friction.of(pair) <= 0 or not spacing:
                continue
            constant = self.model.contact_pair(pair).solref[0]
            least = WINDOW * constant / spacing if constant > 0 else 0.0
            count = math.ceil(max(FEWEST, least, 0.1 * self.looks))
            creeps = [
                creep
                for held in _spells(seen)
                for first in range(0, len(held) - count + 1, max(1, count // 2))
                if (creep := _steady(pair, part, held[first : first + count], times))
            ]
            if creeps:
                yield max(creeps, key=lambda creep: creep.speed)

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

    # Findings.

    def findings(self, times: list[float], depth: float | None) -> Iterator[Finding]:
        """Yield all findings on contacts.

        times: the times of the readings [s].
        depth: see `Monitor.findings`.
        """
        resting, starts = list(self.resting()), self.starts
        jammed = self._jammed(starts, resting)
        if jammed:
            yield self._jam(list(jammed.values()))
        resting = [rest for rest in resting if rest.pair not in jammed]
        yield from self._overlaps([at for at in starts if at.pair not in jammed], resting)
        if self.model.settings.law == "solref":
            yield from self._creeps(times)
            yield from self._depths(resting, depth)
        yield from self._slides()

    def _thick(self, pair: int) -> float:
        return self.sizes.contact(*self.model.contact_pair(pair).geoms)

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
            notable = OVERLAP * self._thick(start.pair)
            known = RESTS * rest.get(start.pair, 0.0)
            if start.depth > (max(notable, known) if start.movable else LEFT * notable):
                deep.setdefault(start.pair, start)
        if not deep:
            return
        worst, contacts = next(iter(deep.values())), self._named(deep)
        share = worst.depth / self._thick(worst.pair)
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

    def _creeps(self, times: list[float]) -> Iterator[Finding]:
        """Yield contacts that move although friction holds."""
        settings = self.model.settings
        creeps = [
            (ratio, creep)
            for creep in self.creeps(times)
            if (ratio := creep.speed / (CREEP * self._thick(creep.pair))) > 1
        ]
        if not creeps or settings.stiction:
            return
        creeps.sort(key=lambda entry: -entry[0])
        ratio, worst = creeps[0]
        contacts = self._named(creep.pair for _, creep in creeps)
        impratio = _round_up(settings.impratio * ratio / LEFT)
        cure = 'stiction=True or law="rigid" (solver pgs, integrator semi-implicit) leaves none'
        changes: dict[str, Any] = {}
        commands: tuple[Next, ...] = ()
        if impratio <= IMPRATIO:
            changes = {"cone": "elliptic", "impratio": impratio}
            sets = ("--set", "cone=elliptic", "--set", f"impratio={impratio:g}")
            commands = (Next("run", "whether the creep is gone", sets),)
            less = speed(worst.speed * settings.impratio / impratio)
            cure = f'cone="elliptic" with impratio="{impratio:g}" leaves {less} or less, and {cure}'
        problem = (
            f"{listed(contacts, 'contacts')} creeps at {speed(worst.speed)} although its friction "
            f"holds ({percent(worst.share)} of what it could be)"
        )
        value, unit = worst.speed, "m/s"
        yield Finding("creep", "warning", problem, cure, contacts, value, unit, commands, changes)

    def _depths(self, resting: list[Contact], asked: float | None) -> Iterator[Finding]:
        """Yield how deep contacts rest, with the solref that reduces the depth."""
        notable = []
        for at in resting:
            thick = self._thick(at.pair)
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
        cure = advised("", pair.solref, solimp, worst.depth, wanted, self.model.settings)
        kind = "depth at rest"
        severity = "warning" if ratio > 1 else "remark"
        yield Finding(kind, severity, problem, cure, contacts, worst.depth, "m", TEST_CONTACTS)

    def _slides(self) -> Iterator[Finding]:
        """Yield contacts that slide because they have no friction."""
        fast = [at for at in self.slides() if at.speed > SLIDES * self._thick(at.pair)]
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
    """A record of how fast geoms that overlap at the start separate."""

    def __init__(self, sim: Sim, contacts: np.ndarray, movable: list[bool], time: float) -> None:
        owner = sim.model.geom_body
        self.pairs, self.movable = contacts["index"].tolist(), movable
        self.depth, self.normal = -contacts["dist"], np.array(contacts["normal"])
        self.bodies = [owner[contacts[name]] for name in ("geom1", "geom2")]
        # The contact point in the frame of each body.
        self.points = [
            np.einsum("cji,cj->ci", sim.xmat[body], contacts["pos"] - sim.xpos[body])
            for body in self.bodies
        ]
        self.time, self.moved = time, np.zeros(len(contacts))
        self.speed = np.zeros(len(contacts))

    def look(self, sim: Sim) -> None:
        """Record the speed of geoms that leave their overlap."""
        place, turn = sim.xpos, sim.xmat
        with np.errstate(over="ignore", invalid="ignore"):
            first, second = (
                place[body] + np.einsum("cij,cj->ci", turn[body], point)
                for body, point in zip(self.bodies, self.points, strict=True)
            )
            moved = np.einsum("ci,ci->c", self.normal, second - first)
            if sim.time > self.time:
                leaves = (self.moved < self.depth) & (moved >= self.depth)
                speed = (moved - self.moved) / (sim.time - self.time)
                self.speed = np.where(leaves, np.maximum(self.speed, speed), self.speed)
        self.time, self.moved = sim.time, moved

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


def _spells(seen: list[Look]) -> Iterator[list[Look]]:
    """Yield successive readings in which friction held."""
    spell: list[Look] = []
    for at in seen:
        if spell and (not at.held or at.look != spell[-1].look + 1):
            yield spell
            spell = []
        if at.held:
            spell.append(at)
    if spell:
        yield spell


def _steady(pair: int, part: int, held: list[Look], times: list[float]) -> Contact | None:
    """Return the creep in a window; None if the speed changes, or without enough friction."""
    past = np.array([at.past for at in held])
    drift, share = past.mean(axis=0), float(np.mean([at.share for at in held]))
    mean = float(np.linalg.norm(drift))
    if share < RUBS or np.linalg.norm(past - drift, axis=1).max() > UNSTEADY * mean:
        return None
    held_for = times[held[-1].look] - times[held[0].look]
    return Contact(pair, part, speed=mean, share=share, held=held_for)


def _round_up(value: float) -> float:
    """Return the next 1, 2 or 5 times a power of ten, at or above the value."""
    power = 10.0 ** math.floor(math.log10(value))
    return next(power * step for step in (1, 2, 5, 10) if power * step >= value * (1 - 1e-9))
