"""Split the linearised motion at a state into elements, and compose each integrator's step.

With the mass matrix M and the elements' stiffnesses K_e and dampings D_e,
J = [[J_qq, J_qv], [−M⁻¹ΣK_e, −M⁻¹ΣD_e]]. The element "inertial forces" is the remainder (gravity,
Coriolis and centrifugal forces), so that the sum is exact. Each integrator's step is then a
function of M, J and the damping that the integrator treats implicitly.
"""

from __future__ import annotations

from collections.abc import Collection, Iterable
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from stepcore._core import SimulationError
from stepcore.engine.arrays import Floats
from stepcore.engine.element import INERTIAL, ROWS, Element, ElementSlopes
from stepcore.engine.linear_maps import (
    DAMPING_IMPLICIT,
    INTEGRATORS,
    STIFFNESS_IMPLICIT,
    implicit_kinds,
    stepped,
)
from stepcore.engine.model import Model
from stepcore.measure.diagnosis.control import (
    KIND,
    control_inputs,
    control_matrices,
    held_step,
)
from stepcore.measure.diagnosis.elements import named_slopes
from stepcore.measure.diagnosis.feedback import Feedback
from stepcore.measure.diagnosis.linear_step import (
    TINY_STEP,
    VELOCITY_LAWS,
    State,
    rates_matrix,
    sim_at,
    without_rows,
)
from stepcore.scene.layout import DOFS, Layout

# Kinds whose stiffness `discrete` treats implicitly, if it is positive.
HELD = ("spring", "tendon spring", "actuator")


@dataclass(frozen=True)
class LinearMotion:
    """The linearised motion at a state.

    mass: M, shape (nv, nv).
    rates: J, shape (2 nv, 2 nv) [1/s].
    elements: K_e and D_e of each element.
    implicit: the elements whose damping is implicit, by integrator.
    held: the elements whose stiffness is implicit under the integrators of `STIFFNESS_IMPLICIT`.
    pattern: 1 where the other integrators can treat an entry implicitly.
    after: the elements whose impulses act after the midpoint step.
    feedback: the user's control function, whose forces are held; in J they are continuous.
    inputs: the force of each control, shape (nv, nu).
    """

    mass: Floats
    rates: Floats
    elements: dict[Element, ElementSlopes]
    implicit: dict[str, frozenset[Element]]
    held: frozenset[Element] = frozenset()
    pattern: Floats | float = 1.0
    after: frozenset[Element] = frozenset()
    feedback: Feedback | None = None
    inputs: Floats | None = None

    def step(self, integrator: str, dt: float, of: Any = None, hold: int = 1) -> Any:
        """Return A of a step of dt [s], shape (2 nv, 2 nv), as `linear_step.step_map`.

        integrator, dt: the integrator and its step [s].
        of: a block by which A is multiplied, at less cost than for A itself.
        hold: the number of steps, with the controls of the first step held.
        """
        n = len(self.mass)
        none = np.zeros((n, n))
        elements = [self.elements[element] for element in self.implicit.get(integrator, ())]
        implicit = sum((element.damping for element in elements), none)
        stiff = none
        if integrator in STIFFNESS_IMPLICIT:
            stiff = sum((self.elements[element].stiffness for element in self.held), none)
        else:
            implicit = implicit * self.pattern
        after = self._accelerations(self.after) if self.after else None
        if self.feedback is None or self.inputs is None:
            block = np.eye(2 * n) if of is None else of
            return stepped(integrator, dt, self.rates, block, self.mass, implicit, stiff, after)
        free = self.rates.copy()
        free[n:] -= self._accelerations(e for e in self.elements if e.kind == KIND)
        block = np.eye(2 * n + self.feedback.order) if of is None else of
        return held_step(
            *(integrator, dt, hold, block, free, after),
            *(self.mass, implicit, stiff, self.feedback, self.inputs),
        )

    def _accelerations(self, elements: Iterable[Element]) -> Floats:
        """Return the derivative of the elements' accelerations by [dq, dv], shape (nv, 2 nv)."""
        n = len(self.mass)
        pull: Any = np.zeros((n, 2 * n))
        for element in elements:
            slopes = self.elements[element]
            pull -= np.hstack([slopes.stiffness, slopes.damping])
        result: Floats = np.linalg.solve(self.mass, pull)
        return result

    def scaled(self, elements: Collection[Element], by: float) -> LinearMotion:
        """Return the motion with stiffness and damping of some elements multiplied by a factor."""
        n, rates, parts = len(self.mass), self.rates.copy(), dict(self.elements)
        rates[n:] += (by - 1) * self._accelerations(elements)
        inputs = None if self.inputs is None else self.inputs.copy()
        for element in elements:
            if inputs is not None and element.kind == KIND:
                inputs[:, element.index] *= by
            slopes = parts[element]
            parts[element] = ElementSlopes.of(by * slopes.stiffness, by * slopes.damping)
        return replace(self, rates=rates, elements=parts, inputs=inputs)


def linear_motion(model: Model, state: State, dt: float | None) -> LinearMotion | None:
    """Return the linearised motion at a state, or None if its accelerations are not finite.

    dt: a step [s], to which `refsafe` adapts the rows; None: rows as the scene defines them.
    """
    rates = rates_matrix(model, state, dt)
    if rates is None:
        return None
    if dt is None and model.settings.law in VELOCITY_LAWS:
        model = without_rows(model)
    own: dict[str, Any] = {"dt": TINY_STEP, "refsafe": False} if dt is None else {"dt": dt}
    sim = sim_at(model, state, integrator="explicit", **own)
    try:
        elements = named_slopes(sim)
    except SimulationError:
        return None
    mass, n, inputs = np.array(sim.mass_matrix()), model.nv, None
    feedback = state.feedback
    if feedback is not None:
        inputs = control_inputs(model, state, mass)
        elements |= control_matrices(model, feedback, inputs)
        if not any(element.kind == KIND for element in elements):
            feedback = inputs = None
    rest = -mass @ rates[n:]
    rest -= sum((np.hstack([e.stiffness, e.damping]) for e in elements.values()), 0 * rest)
    elements[INERTIAL] = ElementSlopes.of(rest[:, :n], rest[:, n:])
    penalty = model.settings.law == "penalty"
    rows = {e for e in elements if e.kind in ROWS and not (penalty and e.kind == "contact")}
    implicit = _implicit(model, elements)
    held = frozenset(e for e in elements if e.kind in HELD and np.trace(elements[e].stiffness) > 0)
    return LinearMotion(
        *(mass, rates, elements, implicit, held, _pattern(model)),
        *(frozenset(rows), feedback, inputs),
    )


def _pattern(model: Model) -> Floats | float:
    """Return the nonzero entries of the mass matrix, or 1 if no other entries occur.

    An entry couples a dof and one of its ancestors.
    """
    if not model.scene.tendons:
        return 1.0
    chains: list[set[int]] = [{0}]
    for body, parent in enumerate(model.body_parent.tolist()[1:], 1):
        chains.append(chains[parent] | {body})
    widths = [DOFS[kind] for kind in model.jnt_type]
    bodies = np.repeat(model.jnt_body, widths).tolist()
    above = np.array([[a in chains[b] for b in bodies] for a in bodies], float)
    return np.maximum(above, above.T)


def _implicit(model: Model, elements: dict[Element, Any]) -> dict[str, frozenset[Element]]:
    """Return the elements whose damping is implicit, by integrator."""
    layout = Layout(model.scene)
    # The spins of free bodies without children.
    lone = {id(joint.body) for joint in layout.joints if joint.type == "free"}
    lone -= {id(body.parent) for body in layout.bodies[1:]}
    spins = {e for e in elements if e.kind == "spin" and id(layout.bodies[e.index]) in lone}
    # Centrifugal and Coriolis forces are part of the remainder.
    trees = {e for e in elements if e.kind == "spin"} | {INERTIAL}
    turning = {None: frozenset[Element](), "free bodies": spins, "trees": trees}
    implicit = {}
    for integrator in DAMPING_IMPLICIT:
        kinds = implicit_kinds(integrator, model.scene.features.eulerdamp)
        damped = frozenset(e for e in elements if e.kind in kinds)
        implicit[integrator] = damped | turning[INTEGRATORS[integrator]["turning"]]
    return implicit
