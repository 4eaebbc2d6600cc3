"""Run every table of the lesson on an engine, and compare each figure with its reference."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import dataclass
from typing import Any

from stepcore.lesson import measure
from stepcore.scene.scene import Scene


@dataclass(frozen=True)
class Row:
    """One figure of the lesson, and its reference.

    section: the title of the table. name: the name of the figure.
    value, reference: in `unit`; a figure with reference None is not checked.
    tolerance: the largest difference of value and reference that is accepted, in `unit`.
    """

    section: str
    name: str
    value: float | str
    reference: float | str | None
    tolerance: float
    unit: str = ""

    @property
    def ok(self) -> bool:
        """Whether value and reference agree within the tolerance."""
        if self.reference is None or isinstance(self.value, str):
            return self.reference is None or self.value == self.reference
        return abs(self.value - float(self.reference)) <= self.tolerance

    def to_dict(self) -> dict[str, Any]:
        """Return the figure as plain data, with "ok"."""
        names = ("section", "name", "value", "reference", "tolerance", "unit", "ok")
        return {name: getattr(self, name) for name in names}


Make = Callable[[Scene], Any]


def maker(engine: str) -> Make:
    """Return a function that makes a Sim of a scene, at key "start".

    engine: "rust" for the engine's `Sim`, or "numpy" for the `Loop` in plain numpy.
    """

    def rust(scene: Scene) -> Any:
        from stepcore.engine.sim import Sim, unwatched

        return unwatched(Sim(scene.compile()))

    def numpy(scene: Scene) -> Any:
        from stepcore.lesson.loop import Loop

        return Loop(scene)

    engines = {"rust": rust, "numpy": numpy}
    if engine not in engines:
        raise ValueError(f"engine = '{engine}': must be one of {', '.join(engines)}")

    def make(scene: Scene) -> Any:
        sim = engines[engine](scene)
        sim.reset(key="start")
        return sim

    return make


def run(engine: str = "rust", sections: Sequence[int] | None = None) -> list[Row]:
    """Compute the figures of the lesson.

    engine: "rust" or "numpy". The numpy loop supports only bodies on slides, so section 5, the
        grasp, needs "rust".
    sections: the numbers of the sections; by default all that the engine supports.
    """
    make = maker(engine)
    if sections is None:
        sections = (1, 2, 3, 4, 5) if engine == "rust" else (1, 2, 3, 4)
    tables = {1: integrators, 2: penalty, 3: constraint, 4: two_contacts, 5: grasp}
    return [row for section in sections for row in tables[section](make)]


def integrators(make: Make) -> Iterator[Row]:
    """Yield section 1: final over initial energy of a mass on a spring, 20 s at dt 10 ms."""
    title = "1. integrators: energy of a mass on a spring after 20 s"
    for name, reference, tolerance in (
        ("explicit", 439286205.05, 0.05),
        ("semi-implicit", 1.0498255165763, 1e-12),
        ("midpoint", 1.0, 1e-12),
        ("rk4", 0.99997225733, 1e-11),
    ):
        yield Row(title, name, measure.spring_energy(make, name), reference, tolerance)
    drift = measure.spring_invariant(make)
    yield Row(title, "semi-implicit: drift of its invariant", drift, 0.0, 1e-13)


PENALTY = (
    # k [N/m], deepest [mm], verdict by height, energy in flight, energy with spring, rebound [m]
    (1e3, 74.873, "stable", 1.000, 1.000, 0.140),
    (1e4, 21.812, "stable", 1.000, 1.021, 0.154),
    (1e5, 6.756, "stable", 1.000, 1.279, 0.188),
    (1e6, 4.110, "stable", 7.75, 8.75, 2.318),
    (1e7, 4.110, "exploded", 1166.0, 1166.0, 130.07),
)


def penalty(make: Make) -> Iterator[Row]:
    """Yield section 2: contact as a penalty spring, from soft to unstable."""
    title = "2. contact as a force"
    for k, deepest, verdict, flight, counted, rebound in PENALTY:
        at, got = f"k {k:.0e}: ", measure.bounce(make, k)
        loose = flight > 2  # the reference has fewer digits here
        yield Row(title, at + "deepest", got.deepest * 1e3, deepest, 5.1e-4, "mm")
        yield Row(title, at + "verdict by height", got.verdict_by_height, verdict, 0)
        by_energy = "gains energy" if flight > 1.001 else "stable"
        yield Row(title, at + "verdict by energy", got.verdict_by_energy, by_energy, 0)
        error = 0.5 if flight > 100 else 0.0051 if loose else 5.1e-4
        yield Row(title, at + "energy in flight", got.flight, flight, error)
        yield Row(title, at + "with the spring's energy", got.counted, counted, error)
        error = 0.0051 if rebound > 100 else 5.1e-4
        yield Row(title, at + "highest rebound", got.rebound, rebound, error, "m")
    k, limit = measure.stiff_enough(1e-4)
    yield Row(title, "k for 0.1 mm of overlap", k, 5.886e8, 1e5, "N/m")
    yield Row(title, "its largest stable dt", limit * 1e6, 82.4, 0.05, "us")
    yield Row(title, "2 ms over that", 2e-3 / limit, 24.3, 0.05)
    depth = measure.impact_depth(make, k)
    yield Row(title, "its overlap at dt 1 us", depth * 1e3, 0.1, 1e-4, "mm")


def constraint(make: Make) -> Iterator[Row]:
    """Yield section 3: resting height of a ball under the law `lesson`, for several settings."""
    title = "3. contact as a constraint: resting height after 2 s"
    for name, time, changes, reference, tolerance in (
        ("dt 2 ms", 2, {}, -98.1, 1e-6),
        ("dt 10 ms", 2, {"dt": 0.01}, -2452.5, 1e-4),
        ("dt 20 ms", 2, {"dt": 0.02}, -9810.0, 1e-4),
        ("dt 50 ms, after 4 s", 4, {"dt": 0.05}, -61312.5, 1e-3),
        ("dt 50 ms, after 2 s", 2, {"dt": 0.05}, -61308.0, 0.5),
        ("softness 5", 2, {"softness": 5.0}, -981.0, 1e-5),
        ("softness 0", 2, {"softness": 0.0}, 10.2, 1e-6),
        ("beta 1", 2, {"beta": 1.0}, -19.62, 1e-6),
        ("beta 1, dt 50 ms", 2, {"beta": 1.0, "dt": 0.05}, -12262.5, 1e-3),
    ):
        value = measure.rest(make, time, **changes) * 1e6
        yield Row(title, name, value, reference, tolerance, "um")


STACK = (
    ("relaxed", 0.5, (392.400, 161.164, 34.380, 5.115, 0.152)),
    ("lesson", 0.5, (392.400, 237.505, 196.929, 196.201, 196.200)),
    ("lesson", 0.0, (196.200, 65.400, 6.329, 0.192, 0.000)),
)
SWEEPS = (1, 2, 5, 10, 20)


def two_contacts(make: Make) -> Iterator[Row]:
    """Yield section 4: depth and error of stacked balls by the number of sweeps."""
    title = "4. two contacts: depth of the lower one after 2 s"
    for law, softness, depths in STACK:
        for sweeps, reference in zip(SWEEPS, depths, strict=True):
            name = f"{law}, softness {softness:g}, {sweeps} sweep{'s' * (sweeps > 1)}"
            value = measure.stack_depths(make, 2, sweeps, law, softness)[0] * 1e6
            # Without softness and after one sweep, rounding decides whether a row acts.
            edge = softness == 0 and sweeps == 1
            yield Row(title, name, value, reference, 11.8 if edge else 5.1e-4, "um")
    upper = measure.stack_depths(make, 2, 20, "lesson", 0.5)[1] * 1e6
    yield Row(title, "lesson, 20 sweeps: upper contact", upper, 98.1, 5.1e-4, "um")
    late = measure.stack_depths(make, 20, 1, "relaxed", 0.5)[0] * 1e6
    yield Row(title, "relaxed, 1 sweep, after 20 s", late, 392.4, 5.1e-4, "um")
    title = "4. two contacts: error left by one more sweep"
    for name, masses, after, reference in measure.STACKS:
        yield Row(title, name, measure.contraction(make, masses, after), reference, 1e-5)
    title = "4. sweeps for an error of 1e-6"
    for name, masses, after, count in measure.COUNTS:
        value = measure.sweeps_for(make, masses, after, 1e-6)
        yield Row(title, name, value, count, 1e-4 * count + 1)


def grasp(make: Make) -> Iterator[Row]:
    """Yield section 5: a cube between two fingers, with the wrist at its limit."""
    title = "5. a grasp: slip of the cube after 10 000 steps"
    rows, held = measure.hold(make, 10000)
    yield Row(title, "rows: pushes, slidings, limits", rows, "2 2 1", 0)
    yield Row(title, "solved to 1e-13 m/s, warm", held * 1e9, 0.0, 1.0, "nm")
    _, held = measure.hold(make, 10000, sweeps=5, tolerance=0.0, warm_start=False)
    yield Row(title, "5 sweeps, cold", held * 1e9, None, 0.0, "nm")


def report(rows: Iterable[Row], full: bool = False) -> str:
    """Return the figures as text: first the number that agree, then those that disagree.

    rows: the figures. full: whether to print every figure with its reference, one table per
    section.
    """
    rows = list(rows)
    titles = list(dict.fromkeys(row.section for row in rows))
    parts = {title: [row for row in rows if row.section == title] for title in titles}
    lines = [f"{_agreeing(rows)} figures agree with the reference.", ""]
    if not full:
        lines += [f"{title}: {_agreeing(own)}" for title, own in parts.items()]
    for title, own in parts.items():
        chosen = [row for row in own if full or not row.ok]
        if chosen:
            title = title if full else f"{title}: what does not agree"
            head = f"  {'':<38} {'value':>18} {'reference':>18}"
            lines += [*([""] if lines[-1] else []), title, head, *map(_line, chosen)]
    return "\n".join(lines) + (
        "" if full else "\n\n--all (in Python report(rows, full=True)) prints them."
    )


def _agreeing(rows: Iterable[Row]) -> str:
    checked = [row for row in rows if row.reference is not None]
    return f"{sum(row.ok for row in checked)} of {len(checked)}"


def _line(row: Row) -> str:
    mark = "" if row.ok else "   <-- off"
    reference = "" if row.reference is None else _shown(row.reference)
    value = f"{_shown(row.value):>18} {reference:>18}"
    return f"  {row.name:<38} {value} {row.unit}{mark}".rstrip()


def _shown(value: float | str) -> str:
    return value if isinstance(value, str) else f"{value:.10g}"


__all__ = ["Row", "maker", "report", "run"]
