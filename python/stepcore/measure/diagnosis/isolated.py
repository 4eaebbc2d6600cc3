"""Compute frequency, damping and largest stable dt of each element on its own, in closed form.

An element on its own is an oscillator x'' = −ω² x − c x': its stiffness on the mass that it moves,
with its own damping. All damping along its direction that the integrator treats implicitly is
added, because it stabilises the oscillator (under `explicit`, all damping). If an element's damping
limits dt, the row of that damper in the table shows the limit.

With h = dt, s the roots of s² + c s + ω², and c = c_explicit + c_implicit by the integrator's
treatment of damping, a step is stable if

    explicit                |1 + h s| ≤ 1
    semi-implicit           ω² h² + 2 c h < 4
    euler, implicitfast,
    implicit, discrete      ω² h² + 2 (c_explicit − c_implicit) h < 4, ω² of a stiffness that is not
                            implicit: with ω² and c implicit `discrete` is stable at any h
    rk4                     |1 + z + z²/2 + z³/6 + z⁴/24| ≤ 1, z = h s
    midpoint                always; a row of `solref`, which acts after it: h < 2/c and h < 2c/ω²

The third with c_explicit = 0 and c = 2ζω is h < (2ζ + 2√(ζ² + 1))/ω. The conditions are those of
Jury (1964) for the characteristic polynomial of the maps in `engine.linear_maps`.
"""

from __future__ import annotations

import cmath
import math
from collections.abc import Iterator
from dataclasses import dataclass
from functools import lru_cache

import numpy as np

from stepcore.engine.arrays import Floats
from stepcore.engine.element import FRICTION_LOSSES, INERTIAL, ROWS, Element
from stepcore.engine.linear_maps import (
    INTEGRATORS,
    STIFFNESS_IMPLICIT,
    amplification,
    implicit_kinds,
)
from stepcore.engine.model import Model
from stepcore.measure.diagnosis.control import KIND, control_dt
from stepcore.measure.diagnosis.elements import may_limit_dt, softened_dt, solrefs_of
from stepcore.measure.diagnosis.growth import DAMPED, eigenvalues, largest_stable, neutral_growth
from stepcore.measure.diagnosis.limits import LONGEST, SHORTEST
from stepcore.measure.diagnosis.linear_motion import LinearMotion
from stepcore.scene.layout import DOFS, Layout

# Larger rates [1/s] are clipped to this value, and rates below its inverse to 0, so that no square
# overflows. Limits there are far from any practical step.
FASTEST = 1e120


def oscillator_dt(
    omega: float, explicit: float, implicit: float, integrator: str, horizon: float = 1.0
) -> float:
    """Return the largest stable dt [s] of an oscillator; inf if every dt is stable.

    omega: natural frequency ω [rad/s].
    explicit, implicit: the damping rates c that the integrator treats explicitly and implicitly
        [1/s].
    integrator: the integrator.
    horizon: see `nutation_dt` [s].
    """
    omega, explicit, implicit = _in_range(omega), _in_range(explicit), _in_range(implicit)
    damping = explicit + implicit
    if integrator == "midpoint" or (omega <= 0 and damping <= 0):
        return math.inf
    if integrator == "explicit":
        if damping <= 2 * DAMPED * omega:
            return nutation_dt(omega, integrator, False, horizon)
        return min(-2 * (s.real / abs(s)) / abs(s) for s in _roots(omega, damping))
    if integrator == "rk4":
        return min(_rk4(s) for s in _roots(omega, damping))
    if integrator == "semi-implicit":
        explicit, implicit = damping, 0.0
    return _jury(omega, explicit - implicit)


def row_dt_under_midpoint(omega: float, damping: float) -> float:
    """Return the largest stable dt [s] of a `solref` row under midpoint.

    The row acts after the implicit step: v⁺ = v + Δ, q⁺ = q + h (v + Δ/2), Δ = −h (c v + ω² q).
    """
    omega, damping = _in_range(omega), _in_range(damping)
    limit = 2 / damping if damping > 0 else math.inf
    return min(limit, 2 * damping / omega**2) if omega > 0 else limit


def nutation_dt(omega: float, integrator: str, implicit: bool, horizon: float) -> float:
    """Return the largest dt [s] of an undamped first-order motion v' = iωv, such as a nutation.

    Explicit integrators make such a motion grow by ω² dt/2 at every dt. The limit is the dt at
    which this growth reaches the one that `growth.neutral_growth` allows in the horizon [s].
    """
    omega = _in_range(omega)
    if omega <= 0 or integrator == "midpoint" or implicit:
        return math.inf
    if integrator == "rk4":
        return 2 * math.sqrt(2) / omega
    return 2 * float(neutral_growth(omega, horizon)) / omega**2


def _roots(omega: float, damping: float) -> tuple[complex, ...]:
    """Return the nonzero roots of s² + c s + ω²."""
    root = cmath.sqrt(damping**2 / 4 - omega**2)
    large = -damping / 2 - root
    # The product of both roots is ω²; this form avoids cancellation.
    small = omega * (omega / large) if large != 0 else 0j
    return tuple(s for s in (large, small) if abs(s) > 1 / FASTEST)


def _jury(omega: float, damping: float) -> float:
    """Return the positive root of ω² h² + 2 c h = 4."""
    if omega <= 0:
        return 2 / damping if damping > 0 else math.inf
    # This form avoids cancellation for either sign of c.
    root = math.sqrt(damping**2 + 4 * omega**2)
    return 4 / (damping + root) if damping > 0 else (root - damping) / omega**2


def _rk4(s: complex) -> float:
    size = abs(s)
    return _rk4_along(s / size) / size


@lru_cache(maxsize=256)
def _rk4_along(way: complex) -> float:
    """Return the limit of a rate of size 1; rates of equal damping ratio share the result."""

    def stable(h: float) -> bool:
        return bool(abs(amplification("rk4", h * way)) <= 1 + 1e-9)

    return largest_stable(stable, 1e-2, 4.0)


def _in_range(rate: float) -> float:
    """Return a rate [1/s] whose square is finite; 0 for a rate below 0 and for nan."""
    return min(rate, FASTEST) if rate > 1 / FASTEST else 0.0


# A smaller part of the largest eigenvalue is rounding of a difference.
NOTHING = 1e-6


@dataclass(frozen=True)
class ElementLimits:
    """One element on its own, at the state at which it is stiffest.

    element: the element.
    omega: natural frequency [rad/s], 0 without stiffness.
    ratio: damping ratio with all damping along its direction, nan without stiffness.
    rate: the element's own damping over the mass that it moves [1/s].
    limits: its largest stable dt by integrator [s], inf beyond `LONGEST`, 0 below `SHORTEST`.
    softened: the dt above which `refsafe` softens the element [s]; inf if it never does.
    state: the index of the state.
    """

    element: Element
    omega: float
    ratio: float
    rate: float
    limits: dict[str, float]
    softened: float
    state: int

    @property
    def name(self) -> str:
        """The element's name."""
        return self.element.name

    @property
    def stiffness(self) -> float:
        """The larger of frequency and damping rate [1/s], by which elements are ordered."""
        return max(self.omega, self.rate)

    @property
    def acts(self) -> bool:
        """Whether the element pulls at all; for a spin, whether it limits any integrator."""
        if self.element.kind == "spin":
            return any(math.isfinite(limit) for limit in self.limits.values())
        return self.stiffness > 0


class IsolatedElements:
    """The elements of a linearised motion, each on its own with the mass matrix.

    motion: the linearised motion.
    horizon: see `growth` [s].
    state: the index of the state.
    """

    def __init__(self, motion: LinearMotion, horizon: float, state: int) -> None:
        self.motion, self.horizon, self.state = motion, horizon, state
        self.root = np.linalg.inv(np.linalg.cholesky(motion.mass))
        none, elements = np.zeros_like(motion.mass), motion.elements
        self.damping = sum((e.damping for k, e in elements.items() if k != INERTIAL), none)
        self.implicit = {
            name: sum((elements[element].damping for element in treated), none)
            for name, treated in motion.implicit.items()
        }

    def limits(self, element: Element, softened: float) -> ElementLimits:
        """Return the limits of one element.

        element: the element.
        softened: the dt above which `refsafe` softens the element [s].
        """
        matrices = self.motion.elements[element]
        if element.kind == "spin":
            return self._spin(element, self._per_mass(matrices.damping), softened)
        square, mode = self._stiffest(matrices.stiffness)
        rate, direction = self._stiffest(matrices.damping)
        omega = math.sqrt(square)
        limits = {}
        for name in INTEGRATORS:
            dt = self._limit(name, element, omega, mode) if omega > 0 else math.inf
            if rate > 0:
                dt = min(dt, self._limit(name, element, 0.0, direction))
            # Above this dt the softened row sets no new limit.
            limits[name] = _as_tried(dt) if dt <= softened else math.inf
        ratio = float(mode @ self.damping @ mode) / (2 * omega) if omega > 0 else math.nan
        return ElementLimits(element, omega, ratio, rate, limits, softened, self.state)

    def _spin(self, element: Element, turning: Floats, softened: float) -> ElementLimits:
        values = eigenvalues(turning)
        omega = 0.0 if values is None else float(np.abs(values.imag).max(initial=0.0))
        limits = {}
        for name in INTEGRATORS:
            implicit = element in self.motion.implicit.get(name, ())
            dt = nutation_dt(omega, name, implicit, self.horizon)
            limits[name] = _as_tried(dt)
        return ElementLimits(element, omega, 0.0, 0.0, limits, softened, self.state)

    def _limit(self, name: str, element: Element, omega: float, direction: Floats) -> float:
        """Return the largest stable dt [s] of an oscillation along a direction of unit mass."""

        def along(damping: Floats) -> float:
            return max(float(direction @ damping @ direction), 0.0)

        own = along(self.motion.elements[element].damping)
        if element.kind == KIND:
            hidden = along(self.implicit[name]) if name in self.implicit else 0.0
            return control_dt(omega, own, hidden, name, self.horizon, LONGEST)
        if name == "midpoint" and element.kind in ROWS:
            return row_dt_under_midpoint(omega, own)
        if name == "explicit" and omega > 0:
            # Damping from any element stabilises an oscillation here.
            return oscillator_dt(omega, along(self.damping), 0.0, name, self.horizon)
        implicit = along(self.implicit[name]) if name in self.implicit else 0.0
        explicit = 0.0 if element in self.motion.implicit.get(name, ()) else own
        if name in STIFFNESS_IMPLICIT and element in self.motion.held and explicit == 0.0:
            return math.inf
        return oscillator_dt(omega, explicit, implicit, name, self.horizon)

    def _per_mass(self, matrix: Floats) -> Floats:
        """Return L⁻¹ X L⁻ᵀ with M = L Lᵀ."""
        return self.root @ matrix @ self.root.T

    def _stiffest(self, matrix: Floats) -> tuple[float, Floats]:
        """Return the largest eigenvalue of M⁻¹X, X made symmetric, and its unit-mass direction."""
        value, vector = _largest(self._per_mass(matrix))
        return value, self.root.T @ vector


def _as_tried(dt: float) -> float:
    """Return a limit [s] within the range tried: inf above `LONGEST`, 0 below `SHORTEST`."""
    return math.inf if dt > LONGEST else dt if dt >= SHORTEST else 0.0


def _largest(matrix: Floats) -> tuple[float, Floats]:
    """Return the largest eigenvalue of the symmetric part, and its vector."""
    values, vectors = np.linalg.eigh((matrix + matrix.T) / 2)
    if len(values) == 0:
        return 0.0, np.zeros(0)
    size = float(np.abs(values).max())
    value = float(values[-1])
    return (value if value > NOTHING * size and value > 0 else 0.0), vectors[:, -1]


# The most pairs of geoms that are checked.
MOST_PAIRS = 1000


def closed_form_bound(model: Model) -> float:
    """Return a step [s] that is stable for any interaction of the elements.

    A spring on its dof has ω² = k·w, with w the dof's diagonal entry of M⁻¹ at qpos0. This ω² is at
    least that of the element on its own. All springs of a tree combined have at most the sum of
    these ω² (the trace of M⁻¹K). Rows in direct form, or without `refsafe`, have the stiffness of
    their solref for any mass. Numbers out of range count as stiff. Nothing is linearised, so the
    bound is cheap enough for `load`.
    """
    trees: dict[int, tuple[float, float]] = {}
    for tree, square, rate in (*_joints(model), *_tendons(model)):
        squares, rates = trees.get(tree, (0.0, 0.0))
        trees[tree] = squares + square, rates + rate
    integrator = model.settings.integrator
    oscillators = (*_rows(model), *_penalties(model), *trees.values())
    limits = (oscillator_dt(math.sqrt(w2), rate, 0.0, integrator) for w2, rate in oscillators)
    return min(limits, default=math.inf)


@dataclass(frozen=True)
class JointGain:
    """The stiffness and damping that one element gives each dof of its joint.

    kind: "spring", "damper" or "actuator".
    index: the index of the joint (spring, damper) or of the actuator.
    joint: the index of the joint.
    stiffness: [N·m/rad or N/m].
    damping: [N·m·s/rad or N·s/m].
    """

    kind: str
    index: int
    joint: int
    stiffness: float
    damping: float


def joint_gains(model: Model) -> Iterator[JointGain]:
    """Yield the gains of every spring and damper, then of every actuator, including zeros.

    Polynomial springs and dampers count with their first coefficient, a servo with its feedback.
    """
    features = model.scene.features
    for j, joint in enumerate(Layout(model.scene).joints):
        record = joint.record()
        yield JointGain("spring", j, j, features.spring * float(record["stiffness"][0]), 0.0)
        yield JointGain("damper", j, j, 0.0, features.damper * float(record["damping"][0]))
    for i in range(model.nu if features.actuation else 0):
        square = float(model.actuator_gear[i, 0]) ** 2
        _, length, velocity = model.actuator_bias[i].tolist()
        joint_index = int(model.actuator_joint[i])
        if joint_index < 0 or model.jnt_type[joint_index] not in ("hinge", "slide"):
            continue
        yield JointGain("actuator", i, joint_index, -square * length, -square * velocity)


def joint_dofs(model: Model, joint: int) -> slice:
    """Return the dofs of a joint."""
    start = int(model.jnt_dofadr[joint])
    return slice(start, start + DOFS[model.jnt_type[joint]])


def _joints(model: Model) -> Iterator[tuple[int, float, float]]:
    """Yield tree, ω² [1/s²] and explicit damping rate [1/s] of springs, dampers and servos."""
    integrator = model.settings.integrator
    hidden = implicit_kinds(integrator, model.scene.features.eulerdamp)
    for gain in joint_gains(model):
        weight = float(model.dof_invweight0[joint_dofs(model, gain.joint)].max())
        # A servo that pushes away from its target grows physically, at any dt.
        square = 0.0 if integrator in STIFFNESS_IMPLICIT else max(gain.stiffness, 0.0) * weight
        rate = 0.0 if gain.kind in hidden else gain.damping * weight
        if square > 0 or rate > 0:
            yield model.root(int(model.jnt_body[gain.joint])), square, rate


def _tendons(model: Model) -> Iterator[tuple[int, float, float]]:
    """Yield tree, ω² [1/s²] and damping rate [1/s] of each tendon in each tree that it passes.

    The weight of a tendon is J M⁻¹ Jᵀ.
    """
    integrator, features = model.settings.integrator, model.scene.features
    if integrator in STIFFNESS_IMPLICIT:
        return
    late = "tendon damper" in implicit_kinds(integrator, model.scene.features.eulerdamp)
    layout = Layout(model.scene)
    for weight, tendon in zip(model.tendon_invweight0.tolist(), model.scene.tendons, strict=True):
        square = features.spring * max(tendon.stiffness, 0.0) * weight
        rate = 0.0 if late else features.damper * tendon.damping * weight
        bodies = [element.body for element in tendon.elements()]
        for tree in {model.root(layout.needed(tendon, body)) for body in bodies} - {0}:
            yield tree, square, rate


def _rows(model: Model) -> Iterator[tuple[float, float]]:
    """Yield ω² [1/s²] and damping rate [1/s] of the rows that dt never softens.

    The rows are those of limits, equalities, friction losses and contacts.
    """
    settings, rows = model.settings, [*solrefs_of(model.scene, model.settings.law)]
    if settings.law == "solref" and model.scene.features.constraint and not model.is_heap:
        # A heap's contacts are judged while they exist.
        solrefs = model.pair_solref.tolist()
        hard = [solref for solref in solrefs if may_limit_dt(solref, settings.refsafe)]
        rows += [("contact", solref) for solref in hard[:MOST_PAIRS]]
    for kind, (first, second) in rows:
        square, rate = -first, -second
        if first > 0:
            inverse, rate = first * second, 2 / first
            square = 1 / inverse / inverse if inverse > 0 else math.inf
            limit = oscillator_dt(math.sqrt(square), rate, 0.0, settings.integrator)
            if softened_dt((first, second), settings.refsafe) < limit:
                continue
        yield 0.0 if kind in FRICTION_LOSSES else max(square, 0.0), max(rate, 0.0)


def _penalties(model: Model) -> Iterator[tuple[float, float]]:
    """Yield ω² [1/s²] and damping rate [1/s] of contact springs under the law `penalty`.

    A spring acts on the masses of both bodies.
    """
    s = model.settings
    if s.law != "penalty":
        return
    if model.is_heap:
        # The largest sum of mean inverse masses that two bodies can have [1/kg].
        weights = [float(np.sort(model.body_invweight0[:, 0])[-2:].sum())]
    else:
        weights = model.pair_invweight0[:MOST_PAIRS].tolist()
    for weight in weights:
        square = s.penalty_stiffness * weight
        yield square, 2 * s.penalty_damping_ratio * math.sqrt(square)
