"""The full grid of settings: time step × integrator × solver × sweeps × precision."""

from __future__ import annotations

import itertools
from collections.abc import Sequence
from typing import Any

import numpy as np

from stepcore._core import Settings
from stepcore.engine.model import Model
from stepcore.experiment.joint_gains import joint_gains
from stepcore.experiment.other_models import STAGED

SMOOTH_LAW = ("semi-implicit", "euler", "implicitfast", "rk4")
COULOMB_LAW = ("explicit", "semi-implicit", "midpoint", "rk4")
# Beside these, where springs, tendons or servos are stiff.
STIFF = ("discrete",)
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
    stiff: bool = False,
) -> list[Settings]:
    """Settings to try, the shipped ones among them; all else is as shipped.

    rows: the most rows alive at once in the reference. Without any the solver does not matter
    and stays as shipped. A single row is solved by one sweep, so there is one number of sweeps.
    For Newton sweeps only limit its iterations: it has no such axis. stiff: whether anything of
    the scene is (`is_stiff`). Unless asked for, single precision is tried with one number of
    sweeps.
    """
    if integrators is None:
        integrators = integrators_for(shipped, stiff)
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


def integrators_for(shipped: Settings, stiff: bool) -> list[str]:
    """The integrators to try, the shipped one among them."""
    names = SMOOTH_LAW if shipped.law == "solref" else COULOMB_LAW
    all_names = dict.fromkeys([*names, *(STIFF if stiff else ()), shipped.integrator])
    return [name for name in all_names if not (shipped.sleep and name in STAGED)]


def is_stiff(model: Model) -> bool:
    """Whether a spring, a tendon or a servo of the model pulls back."""
    if any(gain.stiffness > 0 for gain in joint_gains(model)):
        return True
    return any(np.any(tendon.stiffness) for tendon in model.scene.tendons)


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
