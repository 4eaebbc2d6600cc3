"""Findings on motions: nothing to touch, large contact forces, no damping, coupling."""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence

import numpy as np

from stepcore.engine.actuator import Actuator, actuators
from stepcore.engine.model import Model
from stepcore.experiment.change import Change
from stepcore.experiment.proposal import Proposal
from stepcore.measure.monitors.finding import (
    DEEP,
    FEW,
    HALF,
    LEFT,
    PLOT,
    Finding,
    Proposals,
    listed,
    named,
    worst,
)
from stepcore.measure.monitors.joints import length_of, unit_of, width_of
from stepcore.measure.monitors.recording import FEWEST, Recording, free_bodies
from stepcore.measure.monitors.servos import strength
from stepcore.report.units import (
    FORCES,
    TORQUES,
    metres,
    newtons,
    percent,
    quantity,
    rounded,
    times,
)
from stepcore.scene.elements import Geom
from stepcore.scene.layout import Layout

# The force of a contact over the weight of the body that it holds. Objects in about 90 files are
# pressed with up to 7.5 times their weight; a strong gripper holds 50 g with 235 N, 480 times.
CRUSHED = 1000.0


def motion_findings(run: Recording) -> Iterator[Finding]:
    """Yield the findings on free bodies and on passive joints."""
    yield from _untouched(run)
    yield from _crushed(run)
    yield from _undamped(run)
    yield from _coupled(run)


# Free bodies.


def _fallen(run: Recording, root: int) -> float:
    """Return the distance that a tree has fallen along gravity [m]."""
    height = run.height(root)
    return float(height[0] - height[-1])


def _untouched(run: Recording) -> Iterator[Finding]:
    """Yield free bodies that fall freely because they can touch nothing of the scene."""
    model = run.model
    if model.is_heap:
        return
    span = float(run.times[-1] - run.times[0])
    free = HALF * run.gravity * span**2 / 2
    sizes = run.sizes.bodies
    falling = worst(free_bodies(model), lambda b: _fallen(run, b) / max(free, sizes[b]))
    trees = run.roots[model.geom_body[model.pair_geoms]]
    touching = set(trees[trees[:, 0] != trees[:, 1]].ravel().tolist())
    falling = [body for body in falling if body not in touching and _apart(run, body)[0]]
    if not falling:
        return
    body, fall = falling[0], _fallen(run, falling[0])
    (why, fix), elements = _apart(run, body), named(model, "body", falling)
    problem = f"{listed(elements, 'body')} falls by {metres(fall)} and can touch nothing: {why}"

    def left(other: Recording) -> float:
        return max(_fallen(other, body), 0.0)

    ways = () if fix is None else ((fix,),)
    proposals = Proposals(ways, left, HALF * fall, lambda fall: f"a fall of {metres(fall)}")
    what = "nothing to touch", "warning", problem, "", elements, fall, "m", PLOT
    yield Finding(*what, proposals=proposals)


def _apart(run: Recording, root: int) -> tuple[str, Proposal | None]:
    """Return why no geom of a tree collides with other trees, and a change that enables it.

    The reason is empty if the scene has no other geom.
    """
    model, layout = run.model, Layout(run.model.scene)
    mine = run.roots[model.geom_body] == root
    own = [(k, layout.geoms[k]) for k in np.flatnonzero(mine).tolist()]
    rest = [layout.geoms[k] for k in np.flatnonzero(~mine).tolist()]
    if not rest:
        return "", None
    if not model.scene.features.contact:
        return "contacts are disabled by a flag", None
    if not own:
        return "it has no geom", None
    if any(_meets(geom, other) for _, geom in own for other in rest):
        return "its pairs are excluded", None
    bits = 0
    for geom in rest:
        bits |= geom.contype | geom.conaffinity
    said = ", ".join(sorted({f"{geom.contype} and {geom.conaffinity}" for _, geom in own}))
    why = f"contype and conaffinity of its geoms ({said}) match those of no other geom"
    if not bits:
        return why, None
    fields = ("contype", "conaffinity")
    values = {f"geom/#{k}/{field}": bits for k, _ in own for field in fields}
    words = f'contype="{bits}" and conaffinity="{bits}" on its geoms'
    return why, Proposal(words, Change(values))


def _meets(geom: Geom, other: Geom) -> bool:
    """Return whether the bits of two geoms let them collide."""
    return bool(geom.contype & other.conaffinity or other.contype & geom.conaffinity)


def pressing(run: Recording) -> dict[tuple[int, int], float]:
    """Return the normal force on free bodies that is reached for a twentieth of a run [N].

    The keys are pair and root; bodies with actuators are left out.
    """
    model, forces = run.model, dict[tuple[int, int], float]()
    driven = {int(run.roots[model.jnt_body[of.joint]]) for of in _of_joints(model)}
    objects = free_bodies(model) - driven
    often = max(1, math.ceil(FEW * len(run)))
    for pair in np.unique(run.contacts.pair).tolist() if objects and model.npair else ():
        mine, bodies = run.contacts.pair == pair, list(model.contact_pair(pair).geoms)
        each = np.bincount(run.contacts.reading[mine], run.contacts.force[mine], len(run))
        for root in objects.intersection(run.roots[model.geom_body[bodies]].tolist()):
            # A short impact does not count.
            forces[pair, root] = float(np.sort(each)[-often])
    return forces


def _of_joints(model: Model) -> list[Actuator]:
    return [of for of in actuators(model) if of.joint is not None]


def _crushed(run: Recording) -> Iterator[Finding]:
    """Yield contacts that hold a free body with far more than its weight."""
    model, forces = run.model, pressing(run)

    def over(at: tuple[int, int]) -> float:
        weight = run.weight(at[1])
        return forces[at] / (CRUSHED * weight) if weight else 0.0

    hard = worst(forces, over)
    if hard:
        (pair, root), contacts = hard[0], named(model, "contact", (pair for pair, _ in hard))
        problem = (
            f"{listed(contacts, 'contact')} presses {model.element_name('body', root)} with "
            f"{newtons(forces[hard[0]])}, {times(CRUSHED * over(hard[0]))} its weight"
        )
        presser = _presser(run, pair, root)
        fix = "move what overlaps apart"
        if presser is not None:
            force = strength(model, presser, abs(float(run["actuator_force"][-1, presser])))
            actuator = model.element_name("actuator", presser)
            fix = f"a smaller forcerange or control of {actuator}, which pushes with {force}"
        value = forces[hard[0]]
        yield Finding("contact force", "warning", problem, fix, contacts, value, "N", PLOT)


def _presser(run: Recording, pair: int, root: int) -> int | None:
    """Return the strongest of the actuators that move the bodies which press a body."""
    model, chain = run.model, set[int]()
    for body in model.geom_body[list(model.contact_pair(pair).geoms)].tolist():
        while body and run.roots[body] != root:
            chain.add(body)
            body = int(model.body_parent[body])
    force = np.abs(run["actuator_force"][-1])
    mine = [of.index for of in _of_joints(model) if int(model.jnt_body[of.joint]) in chain]
    return max((k for k in mine if force[k]), key=lambda k: float(force[k]), default=None)


# Joints.


def _commanded(run: Recording) -> np.ndarray:
    """Return which controls change; the first reading is left out, as no step has used it."""
    ctrl = run["ctrl"][1:]
    changes: np.ndarray = np.ptp(ctrl, axis=0) > 0 if len(ctrl) else np.zeros(run.model.nu, bool)
    return changes


def _undamped(run: Recording) -> Iterator[Finding]:
    """Yield hinges of a machine that swing to the end of the run because nothing damps them.

    Joints with an actuator are left out: servos without damping are reported as not following.
    """
    model, late = run.model, run.late
    # Without a machine, the swinging bodies are the scene itself.
    if not model.nu or late < 2 * FEWEST or _commanded(run).any():
        return
    driven = {at.joint for at in actuators(model)}
    speeds, wide = dict[int, float](), dict[int, float]()
    for k, of in enumerate(Layout(model.scene).joints):
        rubs = np.any(of.damping) or of.frictionloss or k in driven
        if model.jnt_type[k] == "hinge" and not rubs and _fixed(run, k):
            speeds[k] = _speed(run, k, 0, len(run) - late)
            wide[k] = float(np.ptp(run["qpos"][late:, model.jnt_qposadr[k]]))
    keeps = {k: _speed(run, k, late, len(run)) / v for k, v in speeds.items() if v}
    swings = worst(keeps, lambda k: wide[k] / (FEW * width_of(model, k)) if keeps[k] > HALF else 0)
    if not swings:
        return
    joint, elements = swings[0], named(model, "joint", swings)
    problem = (
        f"{listed(elements, 'joint')} still swings by {length_of(model, joint, wide[joint])} at "
        f"the end, at {percent(keeps[joint])} of its speed at the beginning: it has no damping"
    )
    # exp(−d t/2I) falls to a tenth in a quarter of the run.
    decay = 8 * math.log(1 / LEFT) / float(run.times[-1] - run.times[0])
    inertias = {k: 1 / float(model.dof_invweight0[model.jnt_dofadr[k]]) for k in swings}
    values = {f"joint/#{k}/damping": rounded(decay * inertias[k]) for k in swings}
    words = f'damping="{rounded(decay * inertias[joint]):g}"'
    more = f" ({len(swings) - 1} more in proportion)" * (len(swings) > 1)

    def left(other: Recording) -> float:
        return max(_speed(other, k, other.late, len(other)) / speeds[k] for k in swings)

    way = (Proposal(words + more, Change(values)),)
    proposals = Proposals((way,), left, DEEP, lambda share: f"{percent(share)} of the speed")
    what = "no damping", "remark", problem, "", elements, wide[joint], "rad", PLOT
    yield Finding(*what, proposals=proposals)


def _speed(run: Recording, joint: int, first: int, last: int) -> float:
    """Return the RMS of a joint's velocity over some readings [rad/s or m/s]."""
    speeds = run["qvel"][first:last, run.model.jnt_dofadr[joint]]
    return float(np.sqrt(np.mean(speeds**2)))


def _coupled(run: Recording) -> Iterator[Finding]:
    """Yield the joint without a command that another joint's acceleration moves most."""
    model = run.model
    moved = _commanded(run)
    leads = {int(model.actuator_joint[of.index]) for of in _of_joints(model) if moved[of.index]}
    ways = {
        k: float(np.ptp(run["qpos"][:, model.jnt_qposadr[k]]))
        for k, kind in enumerate(model.jnt_type)
        if leads and kind in ("hinge", "slide") and k not in leads and _fixed(run, k)
    }
    widest = {"slide": 1.0, "hinge": math.pi}
    widths = {k: min(width_of(model, k), widest[model.jnt_type[k]]) for k in ways}
    for joint in worst(ways, lambda k: ways[k] / (DEEP * widths[k])):
        lead, force = _leader(run, joint, sorted(leads))
        if lead is not None:
            elements = named(model, "joint", [joint, lead])
            units = TORQUES if unit_of(model, joint) == "rad" else FORCES
            problem = (
                f"{elements[0].name} moves by {length_of(model, joint, ways[joint])} without a "
                f"command: the acceleration of {elements[1].name} drives it with up to "
                f"{quantity(force, units)}, more than anything else that changes"
            )
            fix = f"accelerate {elements[1].name} less, or hold {elements[0].name} more stiffly"
            unit = "N·m" if units is TORQUES else "N"
            yield Finding("coupling", "remark", problem, fix, elements, force, unit, PLOT)
            return


def _fixed(run: Recording, joint: int) -> bool:
    """Return whether a joint is neither part of a moving base nor carried by one."""
    model, body = run.model, int(run.model.jnt_body[joint])
    base = int(run.roots[body])
    planar = body == base and np.count_nonzero(model.jnt_body == body) > 1
    return base not in free_bodies(model) and not planar


def _leader(run: Recording, joint: int, leads: Sequence[int]) -> tuple[int | None, float]:
    """Return the joint whose acceleration drives another, with its largest force [N·m or N].

    The force is −M_ij q̈_j. It counts if it is larger (RMS) than the force of contacts,
    limits and equalities on the joint, and than the change of its gravity and Coriolis forces.
    """
    dof, dofs = int(run.model.jnt_dofadr[joint]), run.model.jnt_dofadr[leads]
    some = np.unique(np.linspace(0, len(run) - 1, FEWEST**2).astype(int)).tolist()
    drives, rest = [], []
    for sim in map(run.at, some):
        drives.append(-sim.mass_matrix()[dof, dofs] * sim.qacc[dofs])
        rest.append((float(sim.bias[dof]), float(sim.qfrc_constraint[dof])))
    forces = np.array(drives)
    sizes = np.sqrt(np.mean(forces**2, axis=0))
    most, bias, rows = int(sizes.argmax()), *np.transpose(rest)
    if sizes[most] <= max(float(np.std(bias)), math.sqrt(float(np.mean(rows**2)))):
        return None, 0.0
    return leads[most], float(np.abs(forces[:, most]).max())
