"""Which settings are tried: time step × integrator × solver × sweeps × precision, pruned."""

from __future__ import annotations

import itertools
from collections.abc import Sequence
from typing import Any

from stepcore._core import Settings
from stepcore.report.units import seconds

SMOOTH_LAW = ("semi-implicit", "euler", "implicitfast", "rk4")
COULOMB_LAW = ("explicit", "semi-implicit", "midpoint", "rk4")
SWEEPS_SMOOTH = (5, 20, 100)
SWEEPS_COULOMB = (1, 5, 20)


def grid(
    shipped: Settings,
    dts: Sequence[float],
    integrators: Sequence[str] | None,
    solvers: Sequence[str] | None,
    sweeps: Sequence[int] | None,
    precisions: Sequence[str] | None,
    rows: int,
) -> list[Settings]:
    """Settings to try, the shipped ones among them; all else is as shipped.

    rows: the most rows alive at once in the reference. Without any the solver does not matter
    and stays as shipped. A single row is solved by one sweep, so there is one number of sweeps.
    For Newton sweeps only limit its iterations: it has no such axis. Unless asked for, single
    precision is tried with one number of sweeps.
    """
    smooth = shipped.law == "solref"
    if integrators is None:
        integrators = SMOOTH_LAW if smooth else COULOMB_LAW
        integrators = list(dict.fromkeys([*integrators, shipped.integrator]))
    methods = _methods(shipped, solvers, sweeps, rows)
    few = methods if precisions is not None else _one_each(methods)
    chosen = []
    for precision in precisions if precisions is not None else ("f64", "f32"):
        some = methods if precision == "f64" else few
        chosen += [(method, precision) for method in some]
    points = [shipped]
    for dt, integrator, (method, precision) in itertools.product(dts, integrators, chosen):
        changes = {"dt": dt, "integrator": integrator, "precision": precision, **method}
        points.append(shipped.replace(**changes))
    return sorted(dict.fromkeys(points), key=lambda s: -s.dt)


def _methods(
    shipped: Settings, solvers: Sequence[str] | None, sweeps: Sequence[int] | None, rows: int
) -> list[dict[str, Any]]:
    """Solvers, each with its numbers of sweeps."""
    own = {"solver": shipped.solver, "sweeps": shipped.sweeps}
    smooth = shipped.law == "solref"
    if solvers is None:
        solvers = [shipped.solver] if rows == 0 else ["newton", "pgs"] if smooth else ["pgs"]
    methods: list[dict[str, Any]] = []
    for solver in solvers:
        if solver == "newton":
            count = shipped.sweeps if shipped.solver == "newton" else 100
            methods.append({"solver": solver, "sweeps": count})
            continue
        counts = {shipped.sweeps} if shipped.solver == "pgs" else set()
        if sweeps is not None:
            counts = set(sweeps)
        elif rows == 1 and not counts:
            counts = {1}
        elif rows > 1:
            counts |= set(SWEEPS_SMOOTH if smooth else SWEEPS_COULOMB)
        methods += [{"solver": solver, "sweeps": count} for count in sorted(counts, key=_many)]
    return methods or [own]


def _many(sweeps: int | str) -> float:
    """Sweeps in their order, "auto" last."""
    return float("inf") if isinstance(sweeps, str) else sweeps


def _one_each(methods: Sequence[dict[str, Any]]) -> list[dict[str, Any]]:
    """Each solver once, with its middle number of sweeps."""
    by_solver: dict[str, list[dict[str, Any]]] = {}
    for method in methods:
        by_solver.setdefault(method["solver"], []).append(method)
    return [some[len(some) // 2] for some in by_solver.values()]


def label(settings: Settings, shipped: Settings | None = None, sweeps: bool = True) -> str:
    """Settings in a few words; with `shipped`, what differs from it in the rarer fields too."""
    parts = [settings.integrator, solver_words(settings) if sweeps else settings.solver]
    if settings.precision != "f64":
        parts.append(settings.precision)
    if shipped is not None:
        parts += rarer(settings, shipped)
    return ", ".join([*parts, f"dt {seconds(settings.dt)}"])


def solver_words(settings: Settings) -> str:
    """The solver, and for PGS its sweeps."""
    if settings.solver != "pgs":
        return str(settings.solver)
    return f"pgs {settings.sweeps} sweep" + "s" * (settings.sweeps != 1)


def rarer(settings: Settings, shipped: Settings) -> list[str]:
    """What differs in the fields that have no column of their own."""
    s, found = settings, []
    if s.solver == "newton" and s.sweeps != (shipped.sweeps if shipped.solver == "newton" else 100):
        found.append(f"{s.sweeps} iteration" + "s" * (s.sweeps != 1))
    if s.tolerance != shipped.tolerance:
        found.append(f"tolerance {s.tolerance:g}")
    if s.warm_start != shipped.warm_start:
        found.append("warm" if s.warm_start else "cold")
    if s.acceleration != shipped.acceleration:
        found.append("plain" if s.acceleration == "none" else "accelerated")
    if s.cone != shipped.cone:
        found.append(s.cone)
    return found
