"""Computes the violation of a soft row under a load, and the solref that reduces the violation.

For a row of `solref` at rest (MuJoCo's documentation, "Computation", "Constraint model"), the force
f satisfies R f = k r, where r is the violation, R = (1 − d)/d · Â, and

    k = d / (dmax² tc² ζ²)        solref = (tc, ζ), a time constant [s] and a damping ratio
    k = d · stiffness / dmax²     solref = (−stiffness, −damping)

where d = d(r) is the impedance of solimp. So r = f Â · (1 − d)/d² · dmax² · (tc ζ)²: under a fixed
load, r / ((1 − d)/d²) is proportional to tc², or to 1/stiffness.
"""

from __future__ import annotations

import math
from collections.abc import Sequence

from stepcore.engine.element import Element
from stepcore.engine.model import Model
from stepcore.experiment.change import Change
from stepcore.experiment.proposal import Proposal
from stepcore.measure.monitors.finding import PARTS, assigned, finer, named
from stepcore.report.units import seconds
from stepcore.scene.frames import Vec

# A nearly rigid solimp.
HARD = (0.99, 0.99, 0.001, 0.5, 2.0)
WRITTEN = " ".join(f"{value:g}" for value in HARD[:3])


def impedance(solimp: Sequence[float], violation: float) -> float:
    """Return the impedance d of a row at a violation [m or rad]; MuJoCo's `solimp`."""
    first, last, width, middle, power = solimp
    first, last, middle = (_bounded(value) for value in (first, last, middle))
    x, power = min(abs(violation) / width, 1.0) if width > 0 else 1.0, max(power, 1.0)
    if power == 1 or x in (0.0, 1.0):
        y = x
    elif x <= middle:
        y = x**power / middle ** (power - 1)
    else:
        y = 1 - (1 - x) ** power / (1 - middle) ** (power - 1)
    return first + y * (last - first)


def _bounded(impedance: float) -> float:
    return min(max(impedance, 1e-4), 0.9999)


def yielding(solref: Sequence[float], solimp: Sequence[float], load: float, dt: float) -> float:
    """Return the violation at rest [m or rad] under a load.

    load: the unconstrained acceleration f Â [m/s² or rad/s²].
    dt: the time step [s]; refsafe raises the time constant to at least 2 dt. 0 without refsafe.

    >>> print(f"{1e3 * yielding((0.02, 1), (0.9, 0.95, 0.001, 0.5, 2), 9.81, 0.002):.3f} mm")
    0.367 mm
    """

    def deeper(violation: float) -> bool:
        return load * _slope(solimp, violation) * square > violation

    if solref[0] > 0:
        square = (max(solref[0], 2 * dt) * solref[1]) ** 2
    else:
        square = 1 / -solref[0] if solref[0] < 0 else math.inf

    # One of the two sides grows with the violation and the other falls.
    low, high = -12.0, 12.0
    for _ in range(80):
        middle = (low + high) / 2
        low, high = (middle, high) if deeper(10**middle) else (low, middle)
    return 10**high


def _stiffer(
    solref: Sequence[float], solimp: Vec, now: float, wanted: float, dt: float, other: Vec
) -> tuple[float, float]:
    """Return the solref that reduces a row's violation from `now` to `wanted` under the same load.

    dt: see `yielding`. other: the new solimp.
    """
    softer = (wanted / now) * _slope(solimp, now) / _slope(other, wanted)
    if solref[0] > 0:
        first, second = max(solref[0], 2 * dt) * math.sqrt(softer), solref[1]
    else:
        first, second = solref[0] / softer, solref[1] / math.sqrt(softer)
    return float(f"{first:.3g}"), float(f"{second:.3g}")


def _slope(solimp: Sequence[float], violation: float) -> float:
    d = impedance(solimp, violation)
    return (1 - d) / d**2 * _bounded(solimp[1]) ** 2


def stiffened(
    model: Model,
    elements: Sequence[Element],
    solref: Sequence[float],
    solimp: Vec,
    now: float,
    wanted: float,
) -> tuple[Proposal, ...]:
    """Return the solref, with solimp and dt if needed, that should result in a wanted violation.

    The closed form uses the load of the worst row alone, so stiffer values follow; weldballs.xml
    needs the last.

    elements: the rows, all of which get the same values.
    solref, solimp, now: of the worst row, with its violation [m or rad]. wanted: [m or rad].
    """
    settings = model.settings
    dt = settings.dt if settings.refsafe else 0.0
    names = {of.name for element in elements for of in element.fields(model)}
    suffix = "limit" if "solreflimit" in names else ""
    fixes: dict[str, Proposal] = {}
    for part in PARTS:
        new, hard = _stiffer(solref, solimp, now, wanted / part, dt, solimp), False
        if 0 < new[0] < 2 * dt:
            new, hard = _stiffer(solref, solimp, now, wanted / part, dt, HARD), True
        values: dict[str, Vec] = {f"solref{suffix}": new}
        words = f'solref{suffix}="{new[0]:g} {new[1]:g}"'
        if hard:
            values[f"solimp{suffix}"] = HARD
            words += f' with solimp{suffix}="{WRITTEN}"'
        words += " on both geoms" * (elements[0].kind == "contact")
        change = Change(assigned(model, elements, values))
        if 0 < new[0] < 2 * dt:
            # A longer step would soften the row: refsafe raises its time constant to 2 dt.
            short = finer(settings, new[0] / 2)
            change, words = change.also(Change(dt=short)), f"{words} at a dt of {seconds(short)}"
        fixes.setdefault(words, Proposal(words, change))
    return tuple(fixes.values())


def hardest(model: Model, pairs: Sequence[int], dt: float) -> Proposal:
    """Return the hardest solref that refsafe allows for some pairs at a time step [s]."""
    contacts, constant = named(model, "contact", pairs), float(f"{2 * dt:.3g}")
    words = f'solref="{constant:g} 1" with solimp="{WRITTEN}" on these geoms and what they touch'
    change = Change(assigned(model, contacts, {"solref": (constant, 1.0), "solimp": HARD}))
    if dt == model.settings.dt:
        return Proposal(words, change)
    return Proposal(f"{words} at a dt of {seconds(dt)}", change.also(Change(dt=dt)))
