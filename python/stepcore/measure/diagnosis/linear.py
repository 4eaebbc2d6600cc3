"""The linearised step: the largest stable dt of a held pose, and the elements that limit it.

An eigenvalue μ of a linearised step grows at the rate Re log(μ)/dt. It belongs to the rate s of the
motion itself that is nearest to log(μ)/dt; these are the eigenvalues of J, of which the explicit
integrator's step is 1 + dt·J exactly. The step is stable if no μ grows faster than its s allows:

- a motion that grows by itself (Re s > 0, such as an inverted pendulum): 1.5 times as fast;
- a motion that decays (damping ratio above `DAMPED`): not at all, |μ| ≤ 1;
- a motion that does neither: e-fold in the horizon, and at most `PER_RADIAN` of its frequency.
  Explicit integrators make every such motion grow a little at every dt.
"""

from __future__ import annotations

import dataclasses
import functools
import math
from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from stepcore._core import SimulationError
from stepcore.engine.arrays import Floats
from stepcore.engine.element import EQUALITIES, FRICTION_LOSSES, ROWS, Element
from stepcore.engine.model import Model
from stepcore.engine.pitfalls import unwarned
from stepcore.engine.sim import Sim, unwatched
from stepcore.engine.stiffness import slack_lengths
from stepcore.executors import checkpoint
from stepcore.experiment.change import Change
from stepcore.experiment.pairs import LONGEST, SHORTEST, Motions, Pair
from stepcore.scene.frames import Vec

DAMPED, FASTER, PER_RADIAN = 1e-3, 1.5, 0.05
# Rounding may cause |μ| − 1 of this size, and |log μ| of its root, because an error ε moves a
# double eigenvalue of 1 by √ε.
ROUNDING = 1e-8
# The step at which the rates of the motion itself are computed [s].
TINY = SHORTEST / 10
# The relative resolution of a limit of the linearised step.
FINE = 5e-4
# The number of steps until a row softened by refsafe is at rest again.
SETTLING = 30
# The elements that a diagnosis names. All other forces count with the inertial forces.
NAMED = ("spring", "damper", "actuator", "tendon spring", "tendon damper", "spin", *ROWS)
# Laws whose rows act on velocities: the rows have the stiffness 1/dt² in every scene.
VELOCITY_LAWS = ("lesson", "relaxed", "rigid")
# The most states along a motion, and the most dofs of all these states.
STATES, DOFS = 6, 200


@dataclass(frozen=True, eq=False)
class State:
    """A state of the motion, at which the step is linearised.

    label: its place in the motion. time: [s]. qpos, qvel, ctrl, act: as in a Sim.
    rows: the elements whose rows act there, and under the law `penalty` the contacts that overlap.
    """

    label: str
    time: float
    qpos: Floats
    qvel: Floats
    ctrl: Floats
    act: Floats
    rows: tuple[Element, ...] = ()

    @classmethod
    def of(cls, label: str, time: float, arrays: Iterable[Any]) -> State:
        qpos, qvel, ctrl, act = (np.array(array) for array in arrays)
        return cls(label, time, qpos, qvel, ctrl, act)

    @classmethod
    def first(cls, motions: Motions) -> State:
        """Return the start of a motion, under its first controls."""
        start, ctrl = motions.starts[0], motions.first_ctrl()
        sim = unwatched(Sim(motions.of(Change())))
        start.put(sim)
        return cls.of("the start", 0.0, (sim.qpos, sim.qvel, ctrl, sim.act))

    def sim(self, model: Model) -> Sim:
        """Return a Sim of a model in this state."""
        sim = unwatched(Sim(unwarned(model)))
        sim.qpos[:], sim.qvel[:], sim.ctrl[:] = self.qpos, self.qvel, self.ctrl
        sim.act[:] = self.act
        return sim


def acting(sim: Sim) -> list[tuple[str, int]]:
    """Return kind and index of the elements whose rows act at the present state.

    Equalities and friction losses always act; limits and contacts act if they push.
    """
    rows = sim.rows
    acts = (rows["impulse"] != 0) | np.isin(rows["kind"], (*EQUALITIES, *FRICTION_LOSSES))
    ids = list(zip(rows["kind"][acts].tolist(), rows["index"][acts].tolist(), strict=True))
    if sim.settings.law == "penalty" and sim.overlap > 0:
        ids += [("contact", k) for k in sim.contacts["index"][sim.contacts["dist"] < 0].tolist()]
    return list(dict.fromkeys(ids))


def acting_elements(sim: Sim) -> tuple[Element, ...]:
    return tuple(Element.of(sim.model, kind, index) for kind, index in acting(sim))


def visited(motions: Motions, fine: Pair, start: State) -> list[State]:
    """Return states of the converged motion: the start, its end, and one for each set of rows.

    A taut tendon that has slack counts as a row. The last state of each set is returned. A large
    model has fewer states, because its linearised step takes long.
    """
    ran = fine.ran
    if ran is None:
        raise ValueError(f"the scene cannot be diagnosed: {fine.failure}")
    model, seen, rows = motions.of(Change()), list[int](), list[list[tuple[str, int]]]()
    sets, slack = dict[frozenset[tuple[str, int]], int](), slack_lengths(model)
    sim = unwatched(Sim(model))
    for k in np.flatnonzero(np.isfinite(ran["qvel"]).all(axis=-1)).tolist():
        for name in ("qpos", "qvel", "ctrl", "act"):
            getattr(sim, name)[:] = ran[name][k] if k else getattr(start, name)
        try:
            sim.forward()
        except SimulationError:
            # A run that blew up may contain a state whose accelerations overflow.
            continue
        seen.append(k)
        rows.append(acting(sim))
        taut = {
            ("taut", k) for k, (low, high) in slack.items() if not low < sim.tendon(k).length < high
        }
        sets[frozenset(rows[-1]) | taut] = len(rows) - 1
    if not seen:
        raise ValueError("the scene cannot be linearised: its accelerations are not finite")
    most = max(2, min(STATES, DOFS // max(1, model.nv)))
    spaced = np.linspace(0, len(seen) - 1, most).round().astype(int).tolist()
    largest = [sets[ids] for ids in sorted(sets, key=len, reverse=True)]
    order = [0, len(seen) - 1, *largest, *spaced]

    def state(n: int) -> State:
        k = seen[n]
        time = float(ran.times[k])
        arrays = (ran[name][k] for name in ("qpos", "qvel", "ctrl", "act"))
        at = State.of(f"t = {time:.3g} s", time, arrays) if k else start
        return dataclasses.replace(at, rows=tuple(Element.of(model, *one) for one in rows[n]))

    return [state(n) for n in sorted(list(dict.fromkeys(order))[:most])]


def step_matrix(model: Model, state: State, integrator: str, dt: float) -> Floats | None:
    """Return A of one step, (2 nv, 2 nv); None if it is not finite. Activations are constant."""
    checkpoint()
    n = 2 * model.nv
    if float(np.abs(state.qvel).max(initial=0.0)) * dt > 1 / SHORTEST:
        # The angles of a state that blew up have no precision left, and this would take minutes.
        return None
    try:
        sim = state.sim(model.with_settings(integrator=integrator, dt=dt))
        matrix = sim.linearize().A[:n, :n]
    except (SimulationError, ValueError, ArithmeticError, np.linalg.LinAlgError):
        return None
    return matrix if np.isfinite(matrix).all() else None


def parts(matrix: Floats) -> list[np.ndarray]:
    """Return the indices of the parts of a matrix between which all entries are 0.

    Robots that do not touch are such parts: the eigenvalues of 100 humanoids take 0.4 s, not 28 s.

    >>> [own.tolist() for own in parts(np.array([[1, 0, 2], [0, 3, 0], [0, 0, 1]]))]
    [[0, 2], [1]]
    """
    joined, free, found = (matrix != 0) | (matrix != 0).T, np.ones(len(matrix), bool), []
    for first in range(len(matrix)):
        if free[first]:
            own = now = np.arange(len(matrix)) == first
            while now.any():
                free &= ~now
                now = joined[now].any(axis=0) & free
                own = own | now
            found.append(np.flatnonzero(own))
    return found


def eigenvalues(matrix: Floats | None) -> Floats | None:
    """Return the eigenvalues of a matrix, (n,), complex; None if they cannot be computed."""
    if matrix is None:
        return None
    try:
        with np.errstate(all="ignore"):
            values = [np.linalg.eigvals(matrix[np.ix_(own, own)]) for own in parts(matrix)]
    except np.linalg.LinAlgError:
        return None
    joined = np.concatenate([np.zeros(0, complex), *values])
    return joined if np.isfinite(joined).all() else None


@functools.lru_cache(maxsize=8)
def without_rows(model: Model) -> Model:
    """Return the model without contacts, limits, friction losses and equalities."""
    return Change(without=["constraint"]).of(model)


def allowed_growth(rates: Floats, horizon: float) -> Floats:
    """Return the allowed growth [1/s] in a step, for a motion with these rates [1/s]."""
    size = np.abs(rates)
    neutral = np.minimum(1 / horizon, PER_RADIAN * np.maximum(size, 1 / horizon))
    grows = np.maximum(FASTER * np.maximum(rates.real, 0.0), neutral)
    return np.where(rates.real < -DAMPED * size, 0.0, grows)


def solref_of(model: Model, element: Element) -> Vec | None:
    """Return the solref of an element, or None if its law gives it no row with a solref."""
    if element.kind not in ROWS or model.settings.law != "solref":
        return None
    if element.kind == "contact":
        return model.contact_pair(element.index).solref
    fields = (field for field in element.fields(model) if field.name.startswith("solref"))
    return next((field.value for field in fields), None)


def softened_from(model: Model, element: Element) -> float:
    """Return the dt [s] above which `refsafe` softens an element; inf if none."""
    solref = solref_of(model, element)
    safe = solref is not None and model.settings.refsafe and solref[0] > 0
    return solref[0] / 2 if safe and solref is not None else math.inf


class Held:
    """The linearised step of a model at one state, as if the motion were held there.

    model: the model. state: the state. horizon: the time of an e-fold neutral growth [s].
    rates: the rates of the motion itself [1/s].

    Raises ValueError if the accelerations are not finite.
    """

    def __init__(self, model: Model, state: State, horizon: float) -> None:
        # A state without rows is linearised without them, however long the step.
        bare = not state.rows and model.settings.law != "penalty"
        self.model = without_rows(model) if bare else model
        self.state, self.horizon = state, horizon
        self.softened = min((softened_from(model, e) for e in state.rows), default=math.inf)
        free = self.model.with_settings(refsafe=False)
        if model.settings.law in VELOCITY_LAWS:
            free = without_rows(model)
        matrix = step_matrix(free, state, "explicit", TINY)
        values = eigenvalues(matrix)
        if matrix is None or values is None:
            raise ValueError("the scene cannot be linearised: its accelerations are not finite")
        self.flow = (matrix - np.eye(len(matrix))) / TINY
        self.rates = (values - 1) / TINY

    def at(self, integrator: str, dt: float) -> tuple[State, Floats]:
        """Return the state and the motion's rates [1/s] for a step.

        Rows that `refsafe` softens with dt come to rest at another state, after some steps, and
        have other rates.
        """
        if dt <= self.softened:
            return self.state, self.rates
        sim = self.state.sim(self.model.with_settings(integrator=integrator, dt=dt))
        try:
            sim.step(SETTLING)
            sim.forward()
        except SimulationError:
            return self.state, self.rates
        qpos, qvel, act = np.array(sim.qpos), np.array(sim.qvel), np.array(sim.act)
        state = dataclasses.replace(self.state, qpos=qpos, qvel=qvel, act=act)
        matrix = step_matrix(self.model, state, "explicit", dt)
        if matrix is None:
            return state, self.rates
        n, flow = self.model.nv, self.flow.copy()
        # Velocities change by exactly dt times the acceleration; positions rotate, with an error.
        flow[n:] = (matrix - np.eye(2 * n))[n:] / dt
        values = eigenvalues(flow)
        return state, self.rates if values is None else values

    def worst(self, integrator: str, dt: float) -> tuple[float, complex]:
        """Return the largest growth beyond the allowed one [1/s], and its μ."""
        state, rates = self.at(integrator, dt)
        values = eigenvalues(step_matrix(self.model, state, integrator, dt))
        if values is None:
            return math.inf, 0j
        with np.errstate(all="ignore"):
            log = np.log(np.where(values == 0, 1e-300, values)) / dt
        nearest = np.abs(log[:, None] - rates[None, :]).argmin(axis=1)
        allowed = allowed_growth(rates, self.horizon)[nearest]
        excess = log.real - np.maximum(allowed, ROUNDING / dt)
        excess[np.abs(log) * dt < math.sqrt(ROUNDING)] = -np.inf
        k = int(excess.argmax())
        return float(excess[k]), complex(values[k])

    def stable(self, integrator: str, dt: float) -> bool:
        """Return whether no growth of the step exceeds the allowed one."""
        return self.worst(integrator, dt)[0] <= 0

    def limit(self, integrator: str, near: float, fine: float = FINE) -> float:
        """Return the largest stable dt [s]: inf up to `LONGEST`, 0 down to `SHORTEST`.

        near: the step at which the search starts [s].
        """
        if not self.state.rows and integrator == "midpoint":
            # The midpoint rule is stable for every linear motion.
            return math.inf
        return largest(lambda dt: self.stable(integrator, dt), near, fine)


def largest(stable: Callable[[float], bool], near: float, fine: float) -> float:
    """Return the dt up to which steps are stable, by doubling from `near` and bisection."""
    good = min(near, LONGEST / 2)
    while not stable(good):
        good /= 2
        if good < SHORTEST:
            return 0.0
    while stable(2 * good):
        good *= 2
        if good >= LONGEST:
            return math.inf
    return bisected(stable, good, 2 * good, fine)


def bisected(holds: Callable[[float], bool], good: float, bad: float, fine: float) -> float:
    """Return the stable number nearest to `bad`, to the relative resolution `fine`."""
    while max(good / bad, bad / good) > 1 + fine:
        middle = math.sqrt(good * bad)
        good, bad = (middle, bad) if holds(middle) else (good, middle)
    return good


def shares(held: Held, integrator: str, dt: float) -> dict[Element, float]:
    """Return the share by which each element moves the worst eigenvalue of a step, largest first.

    To first order the force of an element moves μ by w·M⁻¹(K x + D v), with the left eigenvector w
    and the right one (x, v) of μ: the acceleration by the element, projected onto w.
    """
    matrix = step_matrix(held.model, held.state, integrator, dt)
    if matrix is None:
        return {}
    _, worst = held.worst(integrator, dt)
    values, vectors = np.linalg.eig(matrix)
    k, n = int(np.abs(values - worst).argmin()), held.model.nv
    left_values, lefts = np.linalg.eig(matrix.T)
    left = lefts[:, int(np.abs(left_values - values[k]).argmin())]
    x, v = vectors[:n, k], vectors[n:, k]
    sim = held.state.sim(held.model.with_settings(integrator=integrator, dt=dt))
    sim.forward()
    try:
        felt = np.linalg.solve(np.array(sim.mass_matrix()), left[n:])
    except np.linalg.LinAlgError:
        return {}
    moved = {
        element: float(abs(felt[slopes.dofs] @ slopes.change(x, v)))
        for element, slopes in sim.element_slopes().items()
        if element.kind in NAMED
    }
    total = sum(moved.values())
    order = sorted(moved, key=lambda element: -moved[element])
    return {element: moved[element] / total for element in order if moved[element] > 0}


def every_element(model: Model, states: Sequence[State]) -> Iterator[Element]:
    """Yield the named elements that act at some state."""
    yielded = set[Element]()
    for state in states:
        sim = state.sim(model)
        try:
            sim.forward()
            acting_here = [*sim.element_slopes(), *state.rows]
        except (SimulationError, ValueError):
            continue
        for element in acting_here:
            if element.kind in NAMED and element not in yielded:
                yielded.add(element)
                yield element
