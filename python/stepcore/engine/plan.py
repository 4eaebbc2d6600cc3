"""`Plan`: the work of a step, the work that it omits, and the reasons, as text, data and a plot.

Work is omitted when the scene is compiled; the reasons come from the engine (`model/plan.rs`).
Operations are counted in the step itself: the cost of an entry is the number of operations that
removing the entry saves.
"""

from __future__ import annotations

import heapq
import os
from collections import Counter
from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import dataclass, field, replace
from time import perf_counter
from typing import TYPE_CHECKING, Any, ClassVar

import numpy as np

from stepcore import checks
from stepcore._core import Settings
from stepcore.engine.element import NAMES
from stepcore.engine.features import RemovableFeatures, Removal, without
from stepcore.engine.sim import Sim, unwatched
from stepcore.report.result import Result
from stepcore.report.table import Table
from stepcore.report.units import seconds
from stepcore.scene.layout import Layout

if TYPE_CHECKING:
    from stepcore.engine.model import Model

LEGEND = (
    "flops: floating-point operations of the entry's own stage, or those saved by removing the "
    "entry. They do not add up, because some work serves several entries."
)
LESS = " A negative number: without the entry the solver takes more iterations."


@dataclass(frozen=True)
class PlanEntry:
    """One entry of a plan: work that a step does or omits.

    stage: "files", "place", "detect", "solve" or "commit".
    kind: "file", "term", "pair" or "row".
    name: the name of the work.
    names, count: the elements concerned, and their number.
    used: whether the step does the work.
    why: the reason for the omission, or a remark.
    rows: the number of rows at the state.
    stages: the stages of `Sim.stage_flops` that the entry represents, if any.
    flops, micros: operations and time [µs] per step; None if not measured.
    """

    stage: str
    kind: str
    name: str
    names: tuple[str, ...] = ()
    used: bool = True
    why: str = ""
    count: int = 0
    rows: int | None = None
    stages: tuple[str, ...] = ()
    flops: float | None = None
    micros: float | None = None


@dataclass(eq=False, repr=False)
class Plan(Result):
    """The work that a step does and omits; the result of `stepcore.plan`.

    entries: all entries.
    flops: operations of a complete step at the state `at`.
    stages: operations by stage.
    micros: time of a complete step [µs]; None if it was not measured.

    >>> from stepcore import lesson, plan
    >>> plan(lesson.drop())
    <Plan of tower: 7 used, 10 left out>
    """

    kind = "plan"
    units: ClassVar = {"flops": "1", "micros": "µs"}

    settings: Settings
    entries: list[PlanEntry]
    flops: float
    stages: dict[str, float] = field(default_factory=dict)
    micros: float | None = None
    at: str = "the initial pose"
    # Size of the mesh and height-field files that are read, and of all such files [bytes].
    read_bytes: int = 0
    asset_bytes: int = 0

    @property
    def title(self) -> str:
        return f"{self.name}: what a step does and what it leaves out"

    @property
    def setup(self) -> str:
        s = self.settings
        return f"{s.integrator}, {s.solver}, law {s.law}, {s.cone} cone, dt {seconds(s.dt)}."

    @property
    def rows(self) -> list[PlanEntry]:
        """All entries, by stage."""
        return self.entries

    @property
    def used(self) -> list[PlanEntry]:
        """Entries of the work that a step does."""
        return [entry for entry in self.entries if entry.used]

    @property
    def left_out(self) -> list[PlanEntry]:
        """Entries of the work that a step omits, with the reasons."""
        return [entry for entry in self.entries if not entry.used]

    @property
    def sentences(self) -> list[str]:
        """The cost of a step, the costliest entries, the pairs tested and the data read."""
        time = "" if self.micros is None else f" and {self.micros:.3g} µs"
        sentences = [f"A step at {self.at} takes {self.flops:.0f} floating-point operations{time}."]
        costs = [(entry.flops, entry.name) for entry in self.used if entry.flops]
        if costs and self.flops > 0:
            named = [f"{name} ({flops:.0f})" for flops, name in heapq.nlargest(3, costs)]
            sentences.append(f"Most of it: {'; '.join(named)}.")
        pairs = [entry for entry in self.entries if entry.kind == "pair"]
        if pairs:
            tested = sum(entry.count for entry in pairs if entry.used)
            every = sum(entry.count for entry in pairs)
            sentences.append(f"It tests {tested} of {every} pairs of geoms.")
        if self.asset_bytes:
            read, in_total = self.read_bytes / 1e6, self.asset_bytes / 1e6
            sentences.append(
                f"Of {in_total:.3g} MB of meshes and height fields it needs {read:.3g} MB."
            )
        return sentences

    @property
    def table(self) -> Table:
        """All entries; see `PlanEntry`."""
        return Table(map(vars, self.entries))

    def tables(self, full: bool) -> list[Table]:
        """Return tables of used and omitted work; `full`: all entries and elements."""
        printed = len(self.entries) if full else 9
        does = _table(self.used, "Computed in a step", printed, lambda entry: entry.flops or 0.0)
        less = LESS * any(str(row.get("flops")).startswith("-") for row in does)
        does.legend = f"{does.legend} {LEGEND}{less}".strip()
        omits = _table(self.left_out, "Left out of a step", printed, lambda entry: entry.count)
        tables = [does, omits]
        if full:
            elements = [
                {"used": "yes" if entry.used else "no", "what": entry.name, "element": name}
                for entry in self.entries
                for name in entry.names
            ]
            tables.append(Table(elements, heading="The elements of each entry"))
        return tables

    def details(self) -> dict[str, Any]:
        """Return the data of the complete step."""
        return {name: getattr(self, name) for name in ("at", "flops", "stages", "micros")}

    def __repr__(self) -> str:
        return f"<Plan of {self.name}: {len(self.used)} used, {len(self.left_out)} left out>"


def _table(
    entries: list[PlanEntry], heading: str, printed: int, size: Callable[[PlanEntry], float]
) -> Table:
    """Return a table of the largest entries in stage order, or of all if there are few."""
    shown = entries
    if len(entries) > printed + 1:
        largest = set(map(id, sorted(entries, key=size, reverse=True)[:printed]))
        shown = [entry for entry in entries if id(entry) in largest]
    numbers = ("n", "rows", "flops", "µs")
    rows = [_cells(entry) for entry in shown]
    columns = [c for c in (rows or [{}])[0] if c not in numbers or any(row[c] for row in rows)]
    left = len(entries) - len(shown)
    legend = f"Not shown: {left} smaller ones (--all; in Python text(full=True))." if left else ""
    return Table(rows, columns, dict.fromkeys(numbers, ""), heading=heading, legend=legend)


def _cells(entry: PlanEntry) -> dict[str, str]:
    names = entry.names[:NAMES]
    if entry.kind == "file":
        names = tuple(os.path.basename(name) for name in names)
    elements = ", ".join(names)
    if elements and entry.count > len(names):
        elements += f" and {entry.count - len(names)} more"
    return {
        "stage": entry.stage,
        "what": entry.name,
        "n": str(entry.count),
        "rows": "" if entry.rows is None else str(entry.rows),
        "flops": "" if entry.flops is None else f"{entry.flops:.0f}",
        "µs": "" if entry.micros is None else f"{entry.micros:.2f}",
        "which" if entry.used else "why": entry.why
        + (f" ({elements})" if elements and entry.why else elements),
    }


STAGES = ("files", "place", "detect", "solve", "commit")


def planned(model: Model, sim: Sim | None, time: bool) -> Plan:
    """Create the plan of a model; see `stepcore.plan`."""
    cost = StepCost(model, sim, time)
    priced = [cost.priced(*each) for each in entries(model, cost.settings, cost.rows())]
    source = model.scene._source
    return Plan(
        name=model.scene.name or "scene",
        settings=cost.settings,
        entries=sorted(priced, key=lambda entry: STAGES.index(entry.stage)),
        flops=cost.flops,
        stages=cost.stages,
        micros=cost.micros,
        at=cost.at,
        read_bytes=source.read_bytes if source else 0,
        asset_bytes=source.asset_bytes if source else 0,
    )


# The stages of `Sim.stage_flops` that an entry represents, by the beginning of its name.
OWN_STAGES = {
    "poses of bodies": ("place/kinematics",),
    "mass matrix and its factors": ("place/inertia", "place/factor"),
    "bias force": ("place/bias",),
    "velocity before constraints": ("place/guess",),
    "impulses": ("solve/impulses",),
    "integrator": ("commit",),
}
# The kind of `Removal`, or the feature of the scene, that removes an entry; same keys.
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
        yield from (entry for entry in part() if entry[0].count)


class _Listing:
    def __init__(self, model: Model, settings: Settings, rows: Counter[str]) -> None:
        self.model, self.scene, self.settings, self.row_count = model, model.scene, settings, rows
        self.features = RemovableFeatures(model)
        self.plan = self.features.plan
        self.geom_names = model.called("geom")
        self.tree_names = [model.called("body")[first] for first, *_ in self.plan["trees"]]
        self.removals = {removal.kind: removal for removal in self.features.terms()}

    def files(self) -> Iterator[Listed]:
        """Yield files that were read, and files and elements that were not."""
        source = self.scene._source
        read = [file for file in (source.files if source else ()) if file != "<string>"]
        unread = source.unread if source else ()
        ignored = [line.rsplit(" (", 1)[0] for line in self.scene.ignored]
        why = "only for drawing or sensing, or unused by every equation"
        yield _entry("files", "files read", read, kind="file")
        yield _entry("files", "files not read", unread, "used for drawing only", kind="file")
        without = self.scene.without
        yield _entry("files", "left out on purpose", without, "left out by without=", kind="file")
        yield _entry("files", "elements of the file", ignored, why, kind="file")

    def engine(self) -> Iterator[Listed]:
        """Yield the entries of the engine's plan, with names."""
        records = self.model.core.entries(self.settings)
        # Contacts with friction, by the number of their rows.
        ways = sum(_has_friction(entry[2]) for entry in records)
        for stage, kind, name, owner, elements, count, used, why, rows in records:
            names = tuple(self._names(owner, elements))
            number = self.row_count[rows] if rows is not None else None
            stages = _first(OWN_STAGES, name) or () if used else ()
            entry = PlanEntry(stage, kind, name, names, used, why, count, number, stages)
            yield entry, self._removal(name, kind, elements, ways) if used else None

    def _names(self, owner: str, elements: Sequence[int]) -> list[str]:
        if owner == "pair":
            return self._pair_names(self.features.pairs[i] for i in elements)
        if owner == "island":
            islands: dict[int, list[str]] = {}
            for island, name in zip(self.plan["islands"], self.tree_names, strict=True):
                islands.setdefault(island, []).append(name)
            return ["+".join(islands[island]) for island in elements]
        names = self.tree_names if owner == "tree" else self.model.called(owner)
        return [names[i] for i in elements]

    def _pair_names(self, pairs: Iterable[Sequence[int]]) -> list[str]:
        return [f"{self.geom_names[a]}/{self.geom_names[b]}" for a, b in pairs]

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
        every = list(zip(self.model.called("site"), Layout(self.scene).sites, strict=True))
        left = [name for name, site in every if id(site) not in passed]
        yield _entry("place", "poses of sites", [n for n, site in every if id(site) in passed])
        yield _entry("place", "poses of sites", left, "no force acts there: computed when read")

    def unmet(self) -> Iterator[Listed]:
        """Yield the pairs that were not made candidates, by reason."""
        for why, count, examples in self.plan["unmet"]:
            entry, _ = _entry("detect", "pairs", self._pair_names(examples), why, kind="pair")
            yield replace(entry, count=count), None

    def surfaces(self) -> Iterator[Listed]:
        """Yield moving and adhesive surfaces."""
        number = {id(self.scene.geoms[i]): k for k, i in enumerate(self.features.geom)}
        pairs = [pair for pair in self.scene.pairs if pair.adhesion > 0]
        sticky = self._pair_names((number[id(p.geom1)], number[id(p.geom2)]) for p in pairs)
        for name, kind, feature, more in (
            ("surfaces that move (by geom)", "moving surfaces", "belt", []),
            ("adhesion (by geom)", "adhesion", "adhesion", sticky),
        ):
            having = self.features.split(feature)
            used, unused = ([self.geom_names[i] for i in some] for some in having)
            entry, _ = _entry("solve", name, used + more)
            yield entry, self.removals.get(kind)
            yield _entry("solve", name, unused, "they collide with nothing")

    def _excluding(self, indices: Sequence[int]) -> Removal | None:
        """Return the removal of these pairs; None if their bodies have further pairs."""
        owner, body = self.model.geom_body.tolist(), self.features.body
        pairs = [self.features.pairs[i] for i in indices]
        bodies = {tuple(sorted((owner[a], owner[b]))) for a, b in pairs}
        body_pairs = self.features.body_pairs()
        if sum(len(body_pairs[pair]) for pair in bodies) != len(indices):
            return None
        return Removal("pairs", "", (("exclude", tuple((body[a], body[b]) for a, b in bodies)),))


def _has_friction(name: str) -> bool:
    return name.startswith("contacts, ") and not name.startswith("contacts, normal")


def _first(table: dict[str, Any], name: str) -> Any:
    return next((value for key, value in table.items() if name.startswith(key)), None)


def _entry(
    stage: str, name: str, names: Iterable[str], why: str = "", kind: str = "term"
) -> Listed:
    """Return an entry of these elements; why: the reason for its omission."""
    names = tuple(names)
    return PlanEntry(stage, kind, name, names, not why, why, len(names)), None


# The number of steps of a timing; timings are interleaved with timings of the complete model.
TIMED_STEPS = 20


class StepCost:
    """The work of a step at a state, and the savings of removals. time: whether µs are measured."""

    def __init__(self, model: Model, sim: Sim | None, time: bool) -> None:
        checks.flag("plan", "time", time)
        self.model, self.time = model, time
        self.whole = unwatched(Sim(model))
        self.at = "the initial pose"
        if sim is not None:
            if not isinstance(sim, Sim) or sim.model.core is not model.core:
                raise checks.refuse("plan", "sim", sim, "a Sim of this model")
            self.whole = unwatched(Sim(model, sim.settings))
            self.at = f"t = {sim.time:g} s"
        elif model.keys:
            self.whole.reset(key=0)
            name = model.key_names[0]
            self.at = f"keyframe `{name}`" if name else "the first keyframe"
        self.state = self.whole.state() if sim is None else sim.state()
        self.settings = self.whole.settings
        self.whole.restore(self.state)
        self.flops = float(self.whole.count_flops())
        self.stages = {stage: float(n) for stage, n in self.whole.stage_flops().items()}
        self.micros = self._timed(self.whole)[0] if time else None

    def rows(self) -> Counter[str]:
        """Count the rows at the state by kind."""
        self.whole.restore(self.state)
        self.whole.forward()
        return Counter(str(kind) for kind in self.whole.rows["kind"])

    def priced(self, entry: PlanEntry, removal: Removal | None) -> PlanEntry:
        """Return the entry with the work of its stages, or the work that its removal saves."""
        if entry.stages:
            return replace(entry, flops=sum(self.stages[stage] for stage in entry.stages))
        if removal is None or not entry.used:
            return entry
        scene = self.model.scene.with_settings(self.settings)
        sim = unwatched(Sim(without(scene, [removal]).compile()))
        self._place(sim)
        entry = replace(entry, flops=self.flops - sim.count_flops())
        if not self.time:
            return entry
        complete, reduced = self._timed(self.whole, sim)
        return replace(entry, micros=complete - reduced)

    def _place(self, sim: Sim) -> None:
        """Set a variant, whose rows may differ, to the state."""
        self.whole.restore(self.state)
        for name in ("qpos", "qvel", "ctrl", "qfrc_applied", "xfrc_applied"):
            getattr(sim, name)[:] = getattr(self.whole, name)

    def _timed(self, *sims: Sim) -> list[float]:
        """Measure µs per step from the state, as the median of interleaved rounds."""
        spent: list[list[float]] = [[] for _ in sims]
        for _ in range(15):
            for sim, times in zip(sims, spent, strict=True):
                self._place(sim)
                begin = perf_counter()
                sim.step(TIMED_STEPS)
                times.append((perf_counter() - begin) / TIMED_STEPS)
        self.whole.restore(self.state)
        return [1e6 * float(np.median(times)) for times in spent]
