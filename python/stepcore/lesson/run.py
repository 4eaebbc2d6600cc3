"""Run every table of the lesson on an engine, and compare each figure with its reference."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Iterator, Sequence
from typing import Any, NamedTuple

from stepcore.engine.sim import Sim, unwatched
from stepcore.lesson import measure, scenes
from stepcore.lesson.loop import Loop
from stepcore.lesson.scenes import HEIGHT, G
from stepcore.scene.scene import Scene


class Row(NamedTuple):
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
        return self._asdict() | {"ok": self.ok}


Make = Callable[[Scene], Any]


def maker(engine: str) -> Make:
    """Return a function that makes a Sim of a scene, at key "start".

    engine: "rust" for the engine's `Sim`, or "numpy" for the `Loop` in plain numpy.
    """
    if engine not in ("rust", "numpy"):
        raise ValueError(f"engine = '{engine}': must be one of rust, numpy")

    def make(scene: Scene) -> Any:
        sim: Any = Loop(scene) if engine == "numpy" else unwatched(Sim(scene.compile()))
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
        # By height, the lesson's verdict, a ball below 10 m is stable; by energy one that has none
        # more than at the start.
        high = "stable" if got.rebound <= 10 else "exploded"
        strong, wanted = ("stable" if e <= 1.001 else "gains energy" for e in (got.flight, flight))
        # The reference has fewer digits where energies are large.
        error = 0.5 if flight > 100 else 0.0051 if flight > 2 else 5.1e-4
        far = 0.0051 if rebound > 100 else 5.1e-4
        yield Row(title, at + "deepest", got.deepest * 1e3, deepest, 5.1e-4, "mm")
        yield Row(title, at + "verdict by height", high, verdict, 0)
        yield Row(title, at + "verdict by energy", strong, wanted, 0)
        yield Row(title, at + "energy in flight", got.flight, flight, error)
        yield Row(title, at + "with the spring's energy", got.counted, counted, error)
        yield Row(title, at + "highest rebound", got.rebound, rebound, far, "m")
    # The spring stops 1 kg within d = 0.1 mm by k d²/2 = m g h; semi-implicit Euler needs dt < 2/ω.
    k = 2 * G * HEIGHT / 1e-4**2
    limit = 2 / math.sqrt(k)
    yield Row(title, "k for 0.1 mm of overlap", k, 5.886e8, 1e5, "N/m")
    yield Row(title, "its largest stable dt", limit * 1e6, 82.4, 0.05, "us")
    yield Row(title, "2 ms over that", 2e-3 / limit, 24.3, 0.05)
    depth = measure.impact_depth(make, k)
    yield Row(title, "its overlap at dt 1 us", depth * 1e3, 0.1, 1e-4, "mm")


def constraint(make: Make) -> Iterator[Row]:
    """Yield section 3: resting height of a ball under the law `lesson`, for several settings."""
    title = "3. contact as a constraint: resting height after 2 s"
    cases: tuple[tuple[str, float, dict[str, Any], float, float], ...] = (
        ("dt 2 ms", 2, {}, -98.1, 1e-6),
        ("dt 10 ms", 2, {"dt": 0.01}, -2452.5, 1e-4),
        ("dt 20 ms", 2, {"dt": 0.02}, -9810.0, 1e-4),
        ("dt 50 ms, after 4 s", 4, {"dt": 0.05}, -61312.5, 1e-3),
        ("dt 50 ms, after 2 s", 2, {"dt": 0.05}, -61308.0, 0.5),
        ("softness 5", 2, {"softness": 5.0}, -981.0, 1e-5),
        ("softness 0", 2, {"softness": 0.0}, 10.2, 1e-6),
        ("beta 1", 2, {"beta": 1.0}, -19.62, 1e-6),
        ("beta 1, dt 50 ms", 2, {"beta": 1.0, "dt": 0.05}, -12262.5, 1e-3),
    )
    for name, time, changes, reference, tolerance in cases:
        height = float(measure.run_for(make, scenes.drop(**changes), time).qpos[0])
        yield Row(title, name, height * 1e6, reference, tolerance, "um")


# Law, softness, and depths by the number of sweeps [um].
STACK = (
    ("relaxed", 0.5, {1: 392.400, 2: 161.164, 5: 34.380, 10: 5.115, 20: 0.152}),
    ("lesson", 0.5, {1: 392.400, 2: 237.505, 5: 196.929, 10: 196.201, 20: 196.200}),
    ("lesson", 0.0, {1: 196.200, 2: 65.400, 5: 6.329, 10: 0.192, 20: 0.000}),
)
# Name, masses from the floor up [kg], sweeps before the measurement, and the contraction per sweep
# (of n equal balls cos²(π/2n)), or the sweeps for an error of 1e-6.
STACKS: tuple[tuple[str, tuple[float, ...], int, float], ...] = (
    ("two equal balls", (1.0, 1.0), 10, 0.5),
    ("10 kg on 1 kg", (1.0, 10.0), 50, 10 / 11),
    ("1 kg on 10 kg", (10.0, 1.0), 2, 1 / 11),
    ("ten equal balls", (1.0,) * 10, 300, math.cos(math.pi / 20) ** 2),
)
COUNTS: tuple[tuple[str, tuple[float, ...], int, int], ...] = (
    ("10 equal balls", (1.0,) * 10, 300, 558),
    ("100 equal balls", (1.0,) * 100, 5000, 55990),
    ("1000 kg on nine of 1 kg", (1.0,) * 9 + (1000.0,), 2000, 124715),
)


def two_contacts(make: Make) -> Iterator[Row]:
    """Yield section 4: depth and error of stacked balls by the number of sweeps."""
    title = "4. two contacts: depth of the lower one after 2 s"
    for law, softness, depths in STACK:
        for sweeps, reference in depths.items():
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
    for name, masses, after, left in STACKS:
        yield Row(title, name, measure.contraction(make, masses, after), left, 1e-5)
    title = "4. sweeps for an error of 1e-6"
    for name, masses, after, count in COUNTS:
        value = measure.sweeps_for(make, masses, after, 1e-6)
        yield Row(title, name, value, count, 1e-4 * count + 1)


def grasp(make: Make) -> Iterator[Row]:
    """Yield section 5: a cube between two fingers, with the wrist at its limit."""
    title = "5. a grasp: slip of the cube after 10 000 steps"
    rows, slip = measure.hold(make, 10000)
    yield Row(title, "rows: pushes, slidings, limits", rows, "2 2 1", 0)
    yield Row(title, "solved to 1e-13 m/s, warm", slip * 1e9, 0.0, 1.0, "nm")
    _, slip = measure.hold(make, 10000, sweeps=5, tolerance=0.0, warm_start=False)
    yield Row(title, "5 sweeps, cold", slip * 1e9, None, 0.0, "nm")


def report(rows: Iterable[Row], full: bool = False) -> str:
    """Return the figures as text: first the number that agree, then those that disagree.

    rows: the figures. full: whether to print every figure with its reference, one table per
    section.
    """
    rows = list(rows)
    parts: dict[str, list[Row]] = {}
    for row in rows:
        parts.setdefault(row.section, []).append(row)
    lines = [f"{_agreeing(rows)} figures agree with the reference.", ""]
    if not full:
        lines += [f"{title}: {_agreeing(part_rows)}" for title, part_rows in parts.items()]
    for title, part_rows in parts.items():
        chosen = [row for row in part_rows if full or not row.ok]
        if chosen:
            title = title if full else f"{title}: what does not agree"
            head = f"  {'':<38} {'value':>18} {'reference':>18}"
            lines += [*([""] if lines[-1] else []), title, head, *map(_line, chosen)]
    if not full:
        lines += ["", "--all (in Python report(rows, full=True)) prints them."]
    return "\n".join(lines)


def _agreeing(rows: Iterable[Row]) -> str:
    checked = [row for row in rows if row.reference is not None]
    return f"{sum(row.ok for row in checked)} of {len(checked)}"


def _line(row: Row) -> str:
    figures = ("" if x is None else x if isinstance(x, str) else f"{x:.10g}" for x in row[2:4])
    value, reference = (f"{figure:>18}" for figure in figures)
    mark = "" if row.ok else "   <-- off"
    return f"  {row.name:<38} {value} {reference} {row.unit}{mark}".rstrip()


__all__ = ["Row", "maker", "report", "run"]
