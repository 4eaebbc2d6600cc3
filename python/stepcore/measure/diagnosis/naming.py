"""The elements that limit a step: softening them raises the limit most."""

from __future__ import annotations

import functools
import math
from collections.abc import Callable, Collection, Iterable, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from stepcore._core import SimulationError
from stepcore.engine.element import FRICTION_LOSSES, OVERRIDE, ROWS, Element, SceneField
from stepcore.engine.model import Model
from stepcore.experiment.change import Change
from stepcore.experiment.judge import Judge
from stepcore.experiment.pairs import LONGEST, SHORTEST, Loop
from stepcore.measure.diagnosis.limits import FAILS
from stepcore.measure.diagnosis.linear import (
    NAMED,
    Held,
    bisected,
    shares,
    softened_from,
)
from stepcore.scene.layout import Layout

# The factor that multiplies the strength of a softened element.
SOFT = 0.1
# The least share (see `shares`) of an element that may be named.
SHARE = 0.02
# An element limits dt by itself if softening it raises the limit by the factor ALONE. Otherwise,
# elements whose gains are equal to within the factor EQUAL are softened together.
ALONE, EQUAL = 1.4, 1.25
# The fields that make an element strong; the kind of a row decides which solref it has.
STRENGTH = ("stiffness", "damping", "kp", "kv", "solref", "solreflimit", "solreffriction")


# The further coefficients of springs and dampers: the part that has them, and their name.
POLYNOMIALS = {
    f"{owner}{kind}": (part, f"{name}poly")
    for owner, part in (("", "joint"), ("tendon ", "tendon"))
    for kind, name in (("spring", "stiffness"), ("damper", "damping"))
}


@dataclass(frozen=True)
class Knob:
    """A number of the scene that makes an element stronger or weaker.

    element: the element. field: the field with the number. name: such as "kp" or "stiffness".
    part: its place in a row of parameters, such as biasprm; -1 for a field of one number.
    """

    element: Element
    field: SceneField
    name: str
    part: int = -1

    @property
    def path(self) -> str:
        return path_of(self.field)

    @property
    def value(self) -> float:
        """The present number, without its sign."""
        value = self.field.value
        if self.part >= 0:
            return abs(float(value[self.part]))
        return float(np.ravel(0.0 if value is None else value)[0])


def path_of(field: SceneField) -> str:
    return f"{field.kind}/#{field.index}/{field.name}"


@functools.lru_cache(maxsize=1024)
def knobs(model: Model, element: Element) -> tuple[Knob, ...]:
    """Return the numbers that make an element strong, in the order kp, kv."""
    fields = [field for field in element.fields(model) if field.kind != OVERRIDE]
    numbers = [
        Knob(element, field, field.name)
        for field in fields
        if field.name in STRENGTH and field.value is not None and np.any(field.value)
        if model.settings.law == "solref" or not field.name.startswith("solref")
    ]
    bias = next((field for field in fields if field.name == "biasprm"), None)
    if bias is not None and bias.value is not None:
        parts = [(part, name) for part, name in ((1, "kp"), (2, "kv")) if len(bias.value) > part]
        numbers += [Knob(element, bias, name, part) for part, name in parts if bias.value[part]]
    return tuple(numbers)


def scaled(model: Model, knob: Knob, x: float) -> dict[str, Any]:
    """Return the values of the scene with a knob times x; a solref becomes slower by 1/x."""
    field, value = knob.field, knob.field.value
    if knob.part >= 0:
        row = [float(v) for v in value]
        row[knob.part] *= x
        values = {knob.path: tuple(row)}
        gain = next((f for f in knob.element.fields(model) if f.name == "gainprm"), None)
        if knob.part == 1 and gain is not None and gain.value is not None:
            row[0] *= x
            values = {knob.path: tuple(row)}
            values[path_of(gain)] = tuple(float(x * v) for v in np.ravel(gain.value))
        return values
    if field.name.startswith("solref"):
        first, second = (float(v) for v in value)
        new = (first / x, second) if first > 0 else (first * x * x, second * x)
        return {knob.path: new}
    new_value = np.multiply(value, x)
    return {knob.path: float(new_value) if new_value.ndim == 0 else tuple(new_value.tolist())}


def softened(model: Model, elements: Sequence[Element], x: float = SOFT) -> Change:
    """Return the change that weakens elements."""
    values = dict[str, Any]()
    for element in elements:
        for knob in knobs(model, element):
            weaker = scaled(model, knob, x)
            if knob.part >= 0 and knob.path in values:
                # kp and kv are in one row.
                row = list(values[knob.path])
                row[knob.part] = weaker[knob.path][knob.part]
                weaker[knob.path] = tuple(row)
            values |= weaker
        if element.kind in POLYNOMIALS:
            kind, name = POLYNOMIALS[element.kind]
            further = SceneField.of(Layout(model.scene), kind, element.index, name)
            if np.any(further.value):
                values[path_of(further)] = tuple((x * np.asarray(further.value)).tolist())
    settings = dict[str, Any]()
    if model.settings.law == "penalty" and any(e.kind == "contact" for e in elements):
        settings["penalty_stiffness"] = x * model.settings.penalty_stiffness
    return Change(values, **settings)


def linear_limiters(model: Model, held: Held, integrator: str, limit: float) -> tuple[Element, ...]:
    """Return the elements that limit the linearised step at a state, by softening them.

    limit: the limit of this state [s].
    """
    beyond = min(max(limit, SHORTEST), LONGEST)
    by_element = shares(held, integrator, 1.05 * beyond)
    if not by_element:
        return ()
    rises = dict[tuple[Element, ...], float]()

    def rise(group: tuple[Element, ...]) -> float:
        if group not in rises:
            rises[group] = _rise(model, held, integrator, beyond, group)
        return rises[group]

    likely = [element for element, share in by_element.items() if share > SHARE]
    best = max(likely, key=lambda element: rise((element,)))
    group = equals(model, best, by_element)
    if rise((best,)) < ALONE and len(group) > 1 and rise(group) >= ALONE:
        return group
    if rise((best,)) > 1.02:
        return (best,)
    # No element that can be softened limits it: a spin, or the motion itself.
    first = likely[0]
    return (first,) if softened(model, [first]) == Change() else ()


def _rise(
    model: Model, held: Held, integrator: str, limit: float, group: Sequence[Element]
) -> float:
    """Return the factor by which softening a group raises the limit of a state, up to 1/SOFT."""
    change = softened(model, group)
    if change == Change():
        return 1.0
    try:
        softer = Held(change.of(model), held.state, held.horizon)
    except (ValueError, ArithmeticError):
        return 1.0
    if not softer.stable(integrator, FAILS * limit):
        return 1.0
    top = limit / SOFT
    if softer.stable(integrator, top):
        return 1 / SOFT
    return bisected(lambda dt: softer.stable(integrator, dt), FAILS * limit, top, 0.03) / limit


def equals(model: Model, first: Element, elements: Iterable[Element]) -> tuple[Element, ...]:
    """Return the elements with the kind and the gains of `first`, itself among them."""
    alike = [knob.value for knob in knobs(model, first)]
    if not alike:
        return (first,)

    def equal(element: Element) -> bool:
        gains = [knob.value for knob in knobs(model, element)]
        pairs = zip(gains, alike, strict=False)
        return (
            element.kind == first.kind
            and len(gains) == len(alike)
            and all(max(a / b, b / a) <= EQUAL for a, b in pairs)
        )

    return tuple(sorted(element for element in elements if equal(element)))


def run_limiters(
    judge: Judge,
    elements: Sequence[Element],
    integrator: str,
    limit: float,
    nu: int = 0,
    linear: tuple[Element, ...] = (),
) -> tuple[Element, ...]:
    """Return the elements whose softening raises the limit of the runs, by halving each kind.

    elements: the candidates, the likeliest first. limit: the limit [s]. nu: the number of controls
    of a user's function, which are frozen to their values in the converged motion. linear: the
    elements that limit the linearised step, which are tried first.
    """
    motions, change = judge.motions, Change(integrator=integrator)
    controls = [Element.of(motions.model, "control", k) for k in range(nu)]
    kinds: dict[str, list[Element]] = {}
    for element in (*controls, *elements):
        if element.kind == "control" or softened(motions.of(Change()), [element]) != Change():
            kinds.setdefault(element.kind, []).append(element)
    for factor in (ALONE, FAILS):
        dt = factor * limit
        if dt > LONGEST or judge.outcome(change, dt).holds:
            continue

        def holds(group: Sequence[Element], dt: float = dt) -> bool:
            frozen = tuple(element.index for element in group if element.kind == "control")
            rest = [element for element in group if element.kind != "control"]
            softer = change.also(softened(motions.of(Change()), rest))
            outcome = judge.outcome(softer, dt, Loop(frozen=frozen) if frozen else None)
            # After the motion, a frozen control goes on pushing.
            late = frozen and judge.outcome(change, dt).time < motions.horizon < outcome.time
            return outcome.holds or bool(late)

        if linear and holds(linear):
            return linear
        for group in kinds.values():
            if holds(group):
                # Within a kind, the linearised step identifies the element best.
                likeliest = set(linear) <= set(group) and linear
                return likeliest or tuple(sorted(_fewest(holds, group)))
    return linear


def _fewest(holds: Callable[[Sequence[Element]], bool], group: list[Element]) -> list[Element]:
    """Return the fewest elements of a group that suffice, by halving: `holds` is true of them."""
    if len(group) < 2:
        return group
    half = len(group) // 2
    for part in (group[:half], group[half:]):
        if holds(part):
            return _fewest(holds, part)
    return group


@dataclass(frozen=True)
class Figures:
    """The frequency and damping of an element by itself, with the mass matrix of a state.

    element: the element. omega: √ of the largest eigenvalue of M⁻¹K [rad/s]; 0 without stiffness.
    ratio: its damping ratio along that direction; NaN without stiffness. rate: the largest
    eigenvalue of M⁻¹D [1/s]. softened: the dt above which `refsafe` softens it [s]; inf if none.
    state: the index of the state.
    """

    element: Element
    omega: float
    ratio: float
    rate: float
    softened: float
    state: int

    @property
    def name(self) -> str:
        return self.element.name


def figures(held: Held, state: int = 0, done: Collection[Element] = ()) -> dict[Element, Figures]:
    """Return the figures of the elements that act at a state, except those in `done`."""
    sim = held.state.sim(held.model)
    try:
        sim.forward()
        half = np.linalg.inv(np.linalg.cholesky(np.array(sim.mass_matrix())))
    except (SimulationError, np.linalg.LinAlgError):
        return {}
    by_element = {}
    for element, slopes in sim.element_slopes().items():
        if element in done or element.kind not in NAMED:
            continue
        dofs = slopes.dofs
        # Over the dofs of the element alone, half·m·halfᵀ has the same nonzero eigenvalues.
        root = np.linalg.qr(half[:, dofs]).R
        with np.errstate(all="ignore"):
            stiff, damp = root @ slopes.blocks @ root.T
        finite = np.isfinite(stiff).all() and np.isfinite(damp).all()
        if not finite or not len(dofs):
            continue
        values, vectors = np.linalg.eigh((stiff + stiff.T) / 2)
        rate = max(float(np.linalg.eigvalsh((damp + damp.T) / 2)[-1]), 0.0)
        omega, ratio = math.sqrt(max(float(values[-1]), 0.0)), math.nan
        if element.kind == "spin":
            # A gyroscopic torque turns the velocity, at the rate of the nutation.
            omega = float(np.abs(np.linalg.eigvals(damp)).max())
        elif element.kind in FRICTION_LOSSES:
            # Its stiffness is only rounding.
            omega = 0.0
        elif omega > 0:
            ratio = float(vectors[:, -1] @ damp @ vectors[:, -1]) / (2 * omega)
            if ratio < 0 and element.kind in ROWS:
                # The row cancels forces of other dampers, which is no damping of the row.
                ratio = math.nan
        if omega > 0 or rate > 0:
            soft = softened_from(held.model, element)
            by_element[element] = Figures(element, omega, ratio, rate, soft, state)
    return by_element
