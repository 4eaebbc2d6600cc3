"""A bound on dt from the elements' own frequencies, without a step: cheap enough for `load`.

ω² of a spring on its dof is at least that of the element on its own, k·w with w the dof's entry of
M⁻¹'s diagonal at qpos0; all springs together have at most the sum of theirs (the trace of M⁻¹K).
Rows in direct form, or without `refsafe`, are as stiff as their solref says, whatever the mass.
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass

from stepcore.engine.element import Element
from stepcore.engine.linear_maps import STIFFNESS_IMPLICIT
from stepcore.engine.model import Model
from stepcore.experiment.joint_gains import implicit_kinds, joint_dofs, joint_gains
from stepcore.measure.diagnosis.oscillator import oscillator_dt
from stepcore.measure.diagnosis.solref import may_limit_dt, softened_from, solref_of
from stepcore.scene.layout import Layout

# The most pairs of geoms that are looked at.
MOST_PAIRS = 1000


@dataclass(frozen=True)
class _Oscillator:
    """ω² [1/s²] and damping rates [1/s] of an element as an integrator treats them.

    tree: the body at the root of its tree; -1 for a row, whose acceleration is the same whatever
    else acts.
    """

    tree: int
    square: float
    explicit: float
    implicit: float = 0.0


def closed_form_bound(model: Model, integrator: str | None = None) -> float:
    """A step [s] that is stable whatever the elements do together; numbers out of range are stiff.

    integrator: by default the model's own.
    """
    integrator = integrator or model.settings.integrator
    joints = [*_joints(model, integrator), *_tendons(model, integrator)]
    safe = math.inf
    for row in [*_rows(model), *_penalties(model)]:
        omega = math.sqrt(row.square)
        safe = min(safe, oscillator_dt(omega, row.explicit, row.implicit, integrator))
    for tree in {one.tree for one in joints}:
        own = [one for one in joints if one.tree == tree]
        square, explicit = sum(one.square for one in own), sum(one.explicit for one in own)
        safe = min(safe, oscillator_dt(math.sqrt(square), explicit, 0.0, integrator))
    return safe


def _joints(model: Model, integrator: str) -> Iterator[_Oscillator]:
    """Springs, dampers and servos; what is treated implicitly helps the others of its joint."""
    hidden = implicit_kinds(model, integrator)
    gains = list(joint_gains(model))
    implicit_stiffness = integrator in STIFFNESS_IMPLICIT
    dampers = {gain.joint: gain.damping for gain in gains if gain.kind == "damper"}
    for gain in gains:
        weight, tree = _weight(model, gain.joint), root_of(model, int(model.jnt_body[gain.joint]))
        # A servo that pushes away from its target grows physically, at any dt.
        square, rate = max(gain.stiffness, 0.0) * weight, gain.damping * weight
        own = dampers[gain.joint] * weight * ("damper" in hidden)
        implicit = gain.kind in hidden
        if implicit_stiffness:
            # Servos and springs hold at any dt.
            square = 0.0
        if square > 0 or (
            rate > 0 and not (implicit_stiffness or (gain.kind == "damper" and implicit))
        ):
            yield _Oscillator(tree, square, rate * (not implicit), own + rate * implicit)


def _tendons(model: Model, integrator: str) -> Iterator[_Oscillator]:
    """Springs and dampers of tendons, in each tree that they pass; J M⁻¹ Jᵀ is their weight."""
    if integrator in STIFFNESS_IMPLICIT:
        return
    features = model.scene.features
    late = "tendon damper" in implicit_kinds(model, integrator)
    layout = Layout(model.scene)
    for weight, tendon in zip(model.tendon_invweight0.tolist(), model.scene.tendons, strict=True):
        square = features.spring * max(tendon.stiffness, 0.0) * weight
        rate = features.damper * tendon.damping * weight
        bodies = [element.body for element in tendon.elements()]
        trees = {root_of(model, layout.body(tendon, body)) for body in bodies} - {0}
        for tree in trees if square > 0 or (rate > 0 and not late) else ():
            yield _Oscillator(tree, square, rate * (not late), rate * late)


def _rows(model: Model) -> Iterator[_Oscillator]:
    """Limits, equalities, friction losses and contacts that nothing softens with dt."""
    layout = Layout(model.scene)
    for element in _row_elements(model, layout):
        solref = solref_of(model, element)
        if solref is None:
            continue
        if solref[0] > 0:
            inverse = solref[0] * solref[1]
            square = 1 / inverse / inverse if inverse > 0 else math.inf
            rate = 2 / solref[0]
            limit = oscillator_dt(math.sqrt(square), rate, 0.0, model.settings.integrator)
            if softened_from(model, element) < limit:
                continue
        else:
            square, rate = -solref[0], -solref[1]
        if element.kind in ("friction loss", "tendon friction loss"):
            square = 0.0
        yield _Oscillator(-1, max(square, 0.0), max(rate, 0.0))


def _row_elements(model: Model, layout: Layout) -> Iterator[Element]:
    """The elements that have rows, contacts only where their solref may limit dt."""
    features, settings = model.scene.features, model.settings
    if not features.constraint:
        return
    for j, joint in enumerate(layout.joints):
        if features.limit and joint.range is not None:
            yield Element.of(model, "limit", j)
        if features.frictionloss and joint.frictionloss > 0:
            yield Element.of(model, "friction loss", j)
    for t, tendon in enumerate(model.scene.tendons):
        if features.limit and tendon.range is not None:
            yield Element.of(model, "tendon limit", t)
        if features.frictionloss and tendon.frictionloss > 0:
            yield Element.of(model, "tendon friction loss", t)
    for e, equality in enumerate(model.scene.equalities):
        if features.equality and equality.active:
            yield Element.of(model, equality.row_kind, e)
    if settings.law == "solref":
        # A heap's contacts are judged while they are there.
        solrefs = enumerate([] if model.is_heap else model.pair_solref.tolist())
        hard = [pair for pair, solref in solrefs if may_limit_dt(solref, settings.refsafe)]
        for pair in hard[:MOST_PAIRS]:
            yield Element.of(model, "contact", pair)


def _pair_weights(model: Model) -> list[float]:
    """The largest sum of mean inverse masses that two bodies of a heap can have [1/kg]."""
    weights = sorted((float(w) for w in model.body_invweight0[:, 0]), reverse=True)
    return [sum(weights[:2])]


def _penalties(model: Model) -> Iterator[_Oscillator]:
    """The spring of a contact under the law `penalty`, on the masses of both bodies."""
    s = model.settings
    if s.law != "penalty":
        return
    weights = model.pair_invweight0[:MOST_PAIRS] if not model.is_heap else _pair_weights(model)
    for weight in weights:
        square = s.penalty_stiffness * float(weight)
        rate = 2 * s.penalty_damping_ratio * math.sqrt(square)
        yield _Oscillator(-1, square, rate)


def _weight(model: Model, joint: int) -> float:
    """The largest entry of M⁻¹'s diagonal at qpos0 among the joint's dofs."""
    return float(model.dof_invweight0[joint_dofs(model, joint)].max())


def root_of(model: Model, body: int) -> int:
    """The body at the root of a body's tree."""
    while model.body_parent[body] > 0:
        body = int(model.body_parent[body])
    return body
