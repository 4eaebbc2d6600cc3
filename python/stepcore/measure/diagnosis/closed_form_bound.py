"""A bound on dt from the elements' own frequencies, without a step: what `load` can afford.

ω² of a spring on its dof is at least that of the element alone, k·w with w the dof's entry of
M⁻¹'s diagonal at qpos0, and all springs together have at most the sum of theirs (the trace of
M⁻¹K). Rows in direct form, or without `refsafe`, are as stiff as their solref says, whatever the
mass.
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass

from stepcore.engine.model import Model
from stepcore.measure.diagnosis.element_forces import ElementForces, Key
from stepcore.measure.diagnosis.oscillator import oscillator
from stepcore.measure.diagnosis.solref import may_limit, softened_beyond, solref_of
from stepcore.scene.layout import DOFS, Layout

# The most pairs of geoms that are looked at.
MOST_PAIRS = 1000


@dataclass(frozen=True)
class Bound:
    """dt [s]: a step that is stable whatever the elements do together; alone: a step beyond which
    the stiffest one is not stable, key: which."""

    dt: float
    alone: float
    key: Key | None


@dataclass(frozen=True)
class _Element:
    """ω² [1/s²] and damping rates [1/s]. tree: the body at the root; -1 for a row, which asks for
    an acceleration whatever else acts."""

    key: Key
    tree: int
    square: float
    explicit: float
    implicit: float = 0.0


def closed_form(model: Model, integrator: str | None = None) -> Bound:
    """The bound under an integrator (default: the model's own)."""
    integrator = integrator or model.settings.integrator
    layout, elements = Layout(model.scene), ElementForces(model)
    joints = [*_springs(elements, integrator), *_servos(elements, integrator)]
    safe = alone = math.inf
    stiffest = None
    for one in [*joints, *_rows(elements, layout), *_penalties(model)]:
        limit = oscillator(math.sqrt(one.square), one.explicit, one.implicit, integrator)
        if limit < alone:
            alone, stiffest = limit, one.key
        if one.tree < 0:
            safe = min(safe, limit)
    for tree in {one.tree for one in joints}:
        own = [one for one in joints if one.tree == tree]
        square, explicit = sum(one.square for one in own), sum(one.explicit for one in own)
        safe = min(safe, oscillator(math.sqrt(square), explicit, 0.0, integrator))
    return Bound(safe, alone, stiffest)


def _springs(elements: ElementForces, integrator: str) -> Iterator[_Element]:
    model = elements.model
    for j in range(model.njnt):
        weight, tree = _weight(model, j), _root(model, int(model.jnt_body[j]))
        rate = elements.damping[j] * weight
        hidden = damper_is_implicit(model, integrator)
        if elements.stiffness[j] > 0:
            key = Key("spring", (j,), elements.joints[j])
            yield _Element(key, tree, elements.stiffness[j] * weight, 0.0, rate * hidden)
        if rate > 0 and not hidden:
            yield _Element(Key("damper", (j,), elements.joints[j]), tree, 0.0, rate)


def _servos(elements: ElementForces, integrator: str) -> Iterator[_Element]:
    model = elements.model
    for i in elements.servos:
        joint = int(model.actuator_joint[i])
        weight, tree = _weight(model, joint), _root(model, int(model.jnt_body[joint]))
        stiffness, damping = gains(model, i)
        rate = damping * weight
        own = elements.damping[joint] * weight * damper_is_implicit(model, integrator)
        hidden = integrator == "implicitfast"
        if stiffness > 0 or rate > 0:
            key = Key("servo", (i,), elements.actuators[i])
            # A servo that pushes away from its target grows physically, at any dt.
            square = max(stiffness, 0.0) * weight
            yield _Element(key, tree, square, rate * (not hidden), own + rate * hidden)


def gains(model: Model, actuator: int) -> tuple[float, float]:
    """Stiffness and damping that a servo gives its joint [N·m/rad, N·m·s/rad; N/m, N·s/m]."""
    square = float(model.actuator_gear[actuator, 0]) ** 2
    _, length, velocity = model.actuator_bias[actuator].tolist()
    return -square * length, -square * velocity


def _rows(elements: ElementForces, layout: Layout) -> Iterator[_Element]:
    """Limits, connects, friction losses and contacts that nothing softens with dt."""
    model = elements.model
    features = model.scene.features
    if not features.constraint:
        return
    keys = [key for key in elements.rows.values() if _exists(layout, key)]
    refsafe = model.settings.refsafe
    hard = [may_limit(geom.solref, refsafe) for geom in layout.geoms]
    pairs = model.core.pairs() if any(hard) else []
    found = [(a, b) for a, b in pairs if hard[a] or hard[b]][:MOST_PAIRS]
    keys += [Key("contact", (a, b), _pair(model, a, b)) for a, b in found]
    for key in keys:
        solref = solref_of(model, layout, key)
        if solref is None:
            continue
        if solref[0] > 0:
            square, rate = 1 / (solref[0] * solref[1]) ** 2, 2 / solref[0]
            if softened_beyond(model, layout, key) < oscillator(
                math.sqrt(square), rate, 0.0, model.settings.integrator
            ):
                continue
        else:
            square, rate = -solref[0], -solref[1]
        if key.kind == "friction loss":
            square = 0.0
        yield _Element(key, -1, max(square, 0.0), max(rate, 0.0))


def _penalties(model: Model) -> Iterator[_Element]:
    """The spring of a contact under the law `penalty`, on the masses of both bodies."""
    s = model.settings
    for a, b in model.core.pairs()[:MOST_PAIRS] if s.law == "penalty" else ():
        bodies = [int(model.geom_body[geom]) for geom in (a, b)]
        square = s.penalty_stiffness * float(model.body_invweight0[bodies, 0].sum())
        rate = 2 * s.penalty_damping_ratio * math.sqrt(square)
        yield _Element(Key("contact", (a, b), _pair(model, a, b)), -1, square, rate)


def _exists(layout: Layout, key: Key) -> bool:
    features = layout.scene.features
    index = key.index[0]
    if key.kind == "limit":
        return features.limit and layout.joints[index].range is not None
    if key.kind == "friction loss":
        return features.frictionloss and layout.joints[index].frictionloss > 0
    return features.equality and layout.scene.equalities[index].active


def _pair(model: Model, a: int, b: int) -> str:
    return "/".join(model.geom_names[geom] or f"#{geom}" for geom in (a, b))


def damper_is_implicit(model: Model, integrator: str) -> bool:
    """Whether an integrator treats joint damping implicitly."""
    if integrator == "euler":
        return model.scene.features.eulerdamp
    return integrator == "implicitfast"


def _weight(model: Model, joint: int) -> float:
    """The largest entry of M⁻¹'s diagonal at qpos0 among the joint's dofs."""
    start = int(model.jnt_dofadr[joint])
    return float(model.dof_invweight0[start : start + DOFS[model.jnt_type[joint]]].max())


def _root(model: Model, body: int) -> int:
    while model.body_parent[body] > 0:
        body = int(model.body_parent[body])
    return body
