"""Findings on actuators in a run: servos that lag, sag or are saturated, robots that fall over."""

from __future__ import annotations

import functools
import math
from collections.abc import Callable, Collection, Iterator, Mapping, Sequence
from typing import Any, NamedTuple

import numpy as np

from stepcore.engine.actuator import SERVO, Actuator, actuators, hold_load, passing_stiffness
from stepcore.engine.arrays import Floats
from stepcore.engine.coordinates import rotated
from stepcore.engine.element import Element
from stepcore.engine.model import Model
from stepcore.experiment.change import Change
from stepcore.experiment.moves import SINKS, TILT, driven_roots, moves_about
from stepcore.experiment.proposal import Proposal
from stepcore.measure.monitors.finding import (
    DEEP,
    FEW,
    HALF,
    LEFT,
    OTHERS,
    PARTS,
    PLOT,
    SEEN,
    Finding,
    Proposals,
    listed,
    named,
    worst,
)
from stepcore.measure.monitors.joints import length_of, unit_of, width_of
from stepcore.measure.monitors.recording import FEWEST, Recording, free_bodies
from stepcore.report.units import FORCES, TORQUES, percent, quantity, rounded, seconds
from stepcore.scene.layout import Layout

# Fraction of a run above which saturation is reported: a servo that lost a quarter of a sine's
# amplitude (fastsine.xml) was saturated for 38 % of the run. Also the fraction of the smallest
# reported sag that a fix leaves; a smaller one needs a kp that is unstable in isaacfranka.xml.
THIRD = 1 / 3


def actuator_findings(run: Recording) -> Iterator[Finding]:
    """Yield the findings on servos that sag under a load, do not follow, or are saturated."""
    model = run.model
    if not (model.nu and model.scene.features.actuation):
        return
    still, full = list(at_rest(run)), _saturated(run)
    loaded = (at for at in still if at.loaded and at.actuator.index not in full)
    sagging = worst(loaded, lambda at: abs(at.error) / _notable(model, at.actuator))
    if sagging:
        yield _sags(model, sagging)
    # A servo that presses against an object or a limit does so on purpose, and may be saturated.
    presses = {at.actuator.index for at in still if not at.loaded}
    rests = {at.actuator.index for at in still}
    behind = [at for at in following(run, rests, full) if at.fails and _reason(model, at)]
    behind.sort(key=lambda at: at.error / at.width, reverse=True)
    if behind:
        yield _behind(run, behind)
        full = {k: full[k] for k in full if k not in {at.actuator.index for at in behind}}
    servos = [of.index for of in _servos(model) if of.index in full.keys() - presses]
    ends = worst(servos, lambda k: full[k] / THIRD)
    if ends:
        elements, share = named(model, "actuator", ends), full[ends[0]]
        force = strength(model, ends[0], float(np.abs(run["actuator_force"][:, ends[0]]).max()))
        problem = (
            f"{listed(elements, 'servo')} is at the end of its forcerange ({force}) for "
            f"{percent(share)} of the run, where kv has no effect"
        )
        fix = "slow the motion or lower kp; a wider forcerange must be one that the hardware has"
        yield Finding("saturation", "warning", problem, fix, elements, share, "1", PLOT)


def _servos(model: Model) -> list[Actuator]:
    return [of for of in actuators(model) if of.direct and of.holds]


def _saturated(run: Recording) -> dict[int, float]:
    """Return the fraction of the run in which the force of each actuator is saturated."""
    # The first reading is the start, before any step. A force of 0 is not saturated.
    force = run["actuator_force"][1:]
    low, high = (np.isclose(force, end, 1e-9, 0) for end in run.model.actuator_forcerange.T)
    shares = np.mean((low | high) & (force != 0), axis=0) if len(force) else np.zeros(run.model.nu)
    return {k: float(share) for k, share in enumerate(shares) if share}


class Following(NamedTuple):
    """A servo and its target during a run. Lengths are measured before the gear.

    error: RMS distance from the target. width: RMS of the target's motion, or for a constant target
    the sag that is a warning. hertz: the dominant frequency of the target; 0 without one.
    share, lag: amplitude over the target's [1], and phase behind it [rad]. full: the fraction of
    time in saturation. load: the largest load to hold [N·m or N]. rows: the median force of
    contacts, limits and dry friction. need: the force for the requested motion.
    damping: at the joint, of the servo and the joint [N·m·s/rad or N·s/m].
    """

    actuator: Actuator
    error: float
    width: float
    hertz: float
    share: float
    lag: float
    full: float
    load: float
    rows: float
    need: float
    damping: float

    @property
    def omega(self) -> float:
        """The natural frequency [rad/s]."""
        return math.sqrt(self.actuator.stiffness / self.actuator.inertia)

    @property
    def rings(self) -> bool:
        """Whether an oscillation decays by less than a factor e in one second."""
        return self.damping / 2 / self.actuator.inertia < 1

    @property
    def saturates(self) -> bool:
        """Whether the bound of its force explains the error.

        A servo without damping swings between the ends of its force: a wider range damps nothing.
        """
        return self.full > THIRD and (self.need > self.actuator.bound or not self.rings)

    @property
    def passes(self) -> float:
        """The frequency at which the gain falls to 1/√2, at small amplitudes [Hz]."""
        x = 1 - (self.damping / self.omega / self.actuator.inertia) ** 2 / 2
        return self.omega * math.sqrt(x + math.hypot(x, 1)) / (2 * math.pi)

    @property
    def weak(self) -> bool:
        """Whether load / kp is most of the error."""
        return self.load / self.actuator.kp > HALF * self.error

    @property
    def late(self) -> bool:
        """Whether the servo follows one frequency, with a delay."""
        return self.hertz > 0 and self.lag >= 0 and not self.weak

    @property
    def fails(self) -> bool:
        """Whether the error exceeds the target's motion, or the amplitude falls by 3 dB."""
        return self.error > self.width or (self.hertz > 0 and self.share < 1 / math.sqrt(2))


def _reason(model: Model, at: Following) -> str:
    """Return why a servo does not follow, in words; "" if no reason is found."""
    of, said = at.actuator, ""
    say: Callable[[float], str] = functools.partial(strength, model, of.index)
    if at.saturates:
        more = f", and the motion needs {say(at.need)}" if at.need > of.bound else ""
        return f"its force ends at {say(of.bound)} for {percent(at.full)} of the run{more}"
    if at.weak:
        said = f"its kp {of.kp:.3g} is too small for its load of {say(at.load)}"
    elif 0 < at.passes < at.hertz:
        said = f"its bandwidth is {at.passes:.3g} Hz with kp {of.kp:.3g} and kv {of.kv:.3g}"
    elif at.rows > HALF * at.error * of.kp:
        said = f"contacts, limits or dry friction hold it with {say(at.rows)}"
    ratio = at.damping / 2 / at.omega / of.inertia
    rings = f"its kv {of.kv:.3g} damps nothing (damping ratio {ratio:.2g})" * at.rings
    return " and ".join(filter(None, (said, rings)))


def following(
    run: Recording, rests: Collection[int], full: Mapping[int, float]
) -> Iterator[Following]:
    """Yield servos with moving targets, and servos of fixed machines that do not come to rest."""
    # No step has used the controls of the first reading.
    model, run = run.model, run.part(1)
    if run.late < 0:
        return
    some = np.unique(np.linspace(0, len(run) - 1, FEWEST).astype(int)).tolist()
    forces = [np.abs([sim.qfrc_constraint, hold_load(sim)]) for sim in map(run.at, some)]
    rows, held = np.median(forces, axis=0)[0], np.max(forces, axis=0)[1]
    joints = Layout(model.scene).joints
    for of in _servos(model):
        asked = of.target(np.clip(run["ctrl"][:, of.index], *of.ctrlrange))
        # A target that moves by less than the smallest reported sag counts as constant.
        moves, length = np.ptp(asked) > _notable(model, of), of.gear * run["qpos"][:, of.qposadr]
        still = of.index in rests or int(run.roots[model.jnt_body[of.joint]]) in free_bodies(model)
        if not moves and still:
            continue
        # With a constant target, one period shows an oscillation.
        period = 2 * np.pi / math.sqrt(of.stiffness / of.inertia)
        first = 0 if moves else min(run.late, len(run) - math.ceil(period / (run.spacing or 1.0)))
        if first < 0:
            continue
        error = math.sqrt(float(np.mean((asked - length)[first:] ** 2)))
        load = float(held[of.dof]) / abs(of.gear)
        hertz, share, lag, size = _wave(run, of, asked, length) if moves else (0.0,) * 4
        need = of.inertia / of.gear**2 * (2 * np.pi * hertz) ** 2 * size + load
        width = float(np.std(asked)) if moves else FEW / SEEN * _notable(model, of)
        damping = of.damping + float(np.ravel(joints[of.joint or 0].damping)[0])
        forced, stuck = full.get(of.index, 0.0), float(rows[of.dof]) / abs(of.gear)
        yield Following(of, error, width, hertz, share, lag, forced, load, stuck, need, damping)


def _wave(
    run: Recording, of: Actuator, asked: Floats, length: Floats
) -> tuple[float, float, float, float]:
    """Return frequency [Hz], share and lag of a servo, and the target's amplitude; or zeros.

    The result is zeros if the readings do not resolve the motion: differences are below speeds.
    """
    speeds = abs(of.gear) * np.abs(run["qvel"][:, of.dof])
    made = np.abs(np.diff(length)) / (run.spacing or 1.0)
    power = np.fft.rfft(asked - asked.mean())[1:]
    sizes = np.pad(np.abs(power) ** 2, 1)
    k = int(sizes.argmax())
    # A sine between two of the frequencies appears in both, by its distance from them.
    beside = k + 1 if k + 1 < len(sizes) and sizes[k + 1] >= sizes[k - 1] else k - 1
    most = sizes[k] + sizes[beside]
    if not most or most < HALF * sizes.sum() or made.mean() < HALF * speeds.mean():
        return 0.0, 0.0, 0.0, 0.0
    away = (beside - k) * math.sqrt(sizes[beside]) / np.sqrt(sizes[[k, beside]]).sum()
    passed = complex(np.fft.rfft(length - length.mean())[k] / power[k - 1])
    hertz = float(k + away) / (len(run) * run.spacing)
    return hertz, abs(passed), -math.atan2(passed.imag, passed.real), math.sqrt(2) * asked.std()


def _behind(run: Recording, found: list[Following]) -> Finding:
    """Return a finding on servos that do not follow, with gains as fixes."""
    model, first = run.model, found[0]
    of, indices = first.actuator, [at.actuator.index for at in found]
    assert of.joint is not None
    joint, elements = of.joint, named(model, "actuator", indices)

    def say(error: float) -> str:
        return f"{length_of(model, joint, error / abs(of.gear))} RMS"

    does = f"is {say(first.error)} from its target"
    if first.late:
        late = f"{math.degrees(first.lag):.0f}° late"
        does = f"follows {first.hertz:.3g} Hz with {percent(first.share)} of the amplitude, {late}"
        does += f" ({say(first.error)} of error)"
    observation = f"{listed(elements, 'servo')} {does}"
    problem = f"{observation}, because {_reason(model, first)}"
    ways = [tuple(_gained(model, found, part, False) for part in PARTS)]
    if first.saturates:
        ways = [tuple(_gained(model, found, part, True) for part in PARTS)]

    def left(other: Recording) -> float:
        every = following(other, (), {})
        errors = {at.actuator.index: at.error / at.width for at in every}
        return first.width * max((errors.get(k, 0.0) for k in indices), default=0.0)

    proposals = Proposals(tuple(ways), left, HALF * first.width, say)
    fix = "a slower or smaller motion" if first.late else ""
    unit, value = unit_of(model, joint), first.error / abs(of.gear)
    what = "servo does not follow", "warning", problem, fix, elements, value, unit, PLOT
    return Finding(*what, proposals=proposals, observation=observation)


def _gained(model: Model, found: Sequence[Following], part: int, bound: bool) -> Proposal:
    """Return gains that should follow, with critical damping, or more if the joints have more.

    bound: whether to include the forceranges that this needs.
    """
    values, words = dict[str, Any](), list[str]()
    for at in found:
        of, gear = at.actuator, at.actuator.gear**2
        inertia, own = of.inertia / gear, (at.damping - of.damping) / gear
        least = passing_stiffness(2 * math.pi * at.hertz, inertia, own)
        kp = rounded(part**2 * max(of.kp, float(least), at.load / (LEFT * at.width)))
        kv = rounded(max(0.0, 2 * math.sqrt(kp * inertia) - own))
        values |= gained(model, of.index, kp, kv)
        words.append(f"kp {kp:g} and kv {kv:g}")
        if bound:
            force = rounded(max(part * at.need, of.bound), 2, up=True)
            values[f"actuator/#{of.index}/forcerange"] = (-force, force)
            words[-1] += f" with a forcerange of ±{force:g}"
    more = f" ({len(words) - 1} more in proportion)" if len(words) > 1 else ""
    return Proposal(words[0] + more, Change(values))


class Servo(NamedTuple):
    """A position servo at rest under a constant control.

    error: commanded length minus length [rad or m], before the gear. force: [N·m or N].
    loaded: whether the servo pushes against a weight instead of a limit or an object.
    """

    actuator: Actuator
    error: float
    force: float
    loaded: bool


def at_rest(run: Recording) -> Iterator[Servo]:
    """Yield position servos whose control and error are constant over the end of the run."""
    if run.late < 0:
        return
    for of in _servos(run.model):
        asked, error = _errors(run, of)
        mean, held = float(error.mean()), np.ptp(run["ctrl"][run.late :, of.index]) == 0
        if held and float(np.ptp(error)) < FEW * abs(mean):
            force = float(run["actuator_force"][-1, of.index])
            yield Servo(of, mean, force, _loaded(run, of, float(asked[-1]), force))


def _errors(run: Recording, of: Actuator) -> tuple[Floats, Floats]:
    """Return the target lengths of a servo at the end of the run, and its errors."""
    late = max(run.late, 0)
    asked = of.target(np.clip(run["ctrl"][late:, of.index], *of.ctrlrange))
    return asked, asked - of.gear * run["qpos"][late:, of.qposadr]


def _loaded(run: Recording, of: Actuator, asked: float, force: float) -> bool:
    """Return whether a servo pushes against a weight at the end of the run.

    The bodies that hang on the servo's joint make up the weight, or the whole tree if it rests on
    a floor.
    """
    model, sim = run.model, run.at(len(run) - 1)
    assert of.joint is not None
    low, high = model.jnt_range[of.joint]
    if not low <= asked / of.gear <= high:
        return False
    if float(hold_load(sim)[of.dof]) / of.gear * force >= HALF * force**2:
        return True
    tree = int(run.roots[model.jnt_body[of.joint]])
    if tree not in free_bodies(model):
        return False
    trees = run.roots[model.geom_body[np.stack([sim.contacts[f"geom{k}"] for k in (1, 2)])]]
    touched = trees[:, (trees == tree).any(axis=0)]
    return bool(touched.size) and bool(np.isin(touched, (tree, 0)).all())


def _notable(model: Model, of: Actuator) -> float:
    """Return the smallest sag that is reported, before the gear [rad or m]."""
    assert of.joint is not None
    widest = math.inf if unit_of(model, of.joint) == "rad" else 1.0
    return SEEN * min(width_of(model, of.joint), widest) * abs(of.gear)


def _sags(model: Model, servos: list[Servo]) -> Finding:
    """Return a finding on servos that sag under their loads, the worst first."""
    first, indices = servos[0], [servo.actuator.index for servo in servos]
    of, notable = first.actuator, _notable(model, first.actuator)
    assert of.joint is not None
    joint, elements = of.joint, named(model, "actuator", indices)
    ratios = [abs(s.error) / (_notable(model, s.actuator) * THIRD) for s in servos]
    if max(ratios) < (1 + DEEP) * min(ratios):
        ratios = [max(ratios)] * len(ratios)
    gains = [rounded(s.actuator.kp * r) for s, r in zip(servos, ratios, strict=True)]
    words = _gains(elements, gains)
    by_index = dict(zip(indices, ratios, strict=True))
    way = (
        Proposal(words, Change(stronger(model, by_index, damped=False))),
        Proposal(f"{words}, with kv in proportion", Change(stronger(model, by_index, damped=True))),
    )

    def left(other: Recording) -> float | None:
        """Return the largest error at the end of the run; None if a control changes there."""
        if np.ptp(other["ctrl"][max(other.late, 0) :, indices], axis=0).any():
            return None
        errors = (_errors(other, o)[1] for o in _servos(other.model) if o.index in indices)
        return max(float(np.abs(error).max()) for error in errors)

    def say(error: float) -> str:
        return length_of(model, joint, abs(error / of.gear))

    proposals = Proposals((way,), left, notable, say)
    problem = (
        f"{listed(elements, 'servo')} sags by {say(first.error)} under its load of "
        f"{strength(model, of.index, abs(first.force))}, which is load / kp with kp {of.kp:.4g}"
    )
    severity = "warning" if abs(first.error) > FEW / SEEN * notable else "remark"
    fix, value = "let the control carry the load", abs(first.error / of.gear)
    what = "servo sags", severity, problem, fix, elements, value, unit_of(model, joint), PLOT
    return Finding(*what, proposals=proposals)


def _gains(elements: tuple[Element, ...], gains: list[float]) -> str:
    """Return "kp 1810 (servo `j2` 995)", or "kp 91.2 of each"."""
    if len(gains) > 1 and len(set(gains)) == 1:
        return f"kp {gains[0]:g} of each"
    also = [f"{e.name} {gain:g}" for e, gain in zip(elements, gains, strict=True)][1:]
    more = f" and {len(also) - OTHERS} more in proportion" if len(also) > OTHERS else ""
    return f"kp {gains[0]:g}" + (f" ({', '.join(also[:OTHERS])}{more})" if also else "")


def stronger(model: Model, ratios: Mapping[int, float], damped: bool) -> dict[str, Any]:
    """Return the gains of servos, by path, with kp multiplied by a ratio each.

    damped: whether kv grows, too, to keep the damping ratio.
    """
    changes: dict[str, Any] = {}
    every = actuators(model)
    for k, ratio in ratios.items():
        faster = math.sqrt(ratio) if damped else 1.0
        changes |= gained(model, k, rounded(every[k].kp * ratio), rounded(every[k].kv * faster))
    return changes


def gained(model: Model, k: int, kp: float, kv: float) -> dict[str, Any]:
    """Return gains of a position servo as values of the model, by path."""
    fields = {field.name: field for field in Element.of(model, "actuator", k).fields(model)}
    path, actuator = f"actuator/#{k}", model.scene.actuators[k]
    if "kp" in fields:
        ratio = {} if actuator.dampratio is None else {f"{path}/dampratio": None}
        return {f"{path}/kp": kp, f"{path}/kv": kv} | ratio
    own = actuators(model)[k]
    return {f"{path}/gainprm": (own.gain * kp / own.kp,), f"{path}/biasprm": (own.offset, -kp, -kv)}


def strength(model: Model, actuator: int, force: float) -> str:
    """Return an actuator's force in words, as a torque if the joint turns."""
    joint = int(model.actuator_joint[actuator])
    linear = joint < 0 or model.jnt_type[joint] == "slide"
    return quantity(force, FORCES if linear else TORQUES)


# Falls.


def fall_findings(run: Recording) -> Iterator[Finding]:
    """Yield the first robot with servos and a free base that falls over: nothing balances it.

    Robots without servos are left out: motors at zero hold nothing, and learning walkers fall by
    design.
    """
    model, drives = run.model, actuators(run.model)
    if not any(drive.kind == SERVO for drive in drives) or not moves_about(model, drives):
        return
    down = {body: _down(run, body) for body in sorted(driven_roots(model, drives))}
    falls = {body: float(run.times[at.argmax()]) for body, at in down.items() if at.any()}
    if not falls:
        return
    body = min(falls, key=falls.__getitem__)
    after, of = falls[body] - float(run.times[0]), named(model, "body", [body])
    problem = (
        f"{of[0].name} falls over within {seconds(after)}, because its servos do not balance it"
    )
    fix = "give the controls or the controller that balance it (--ctrl, --control)"
    falling = [k for k in _servos(model) if run.roots[model.jnt_body[k.joint or 0]] == body]
    proposals = Proposals(
        tuple(_firmer(model, falling)),
        lambda other: float(_down(other, body).any()),
        0.0,
        lambda falls: "it fallen" if falls else "it standing",
        now=1.0,
    )
    yield Finding("fall", "warning", problem, fix, of, after, "s", proposals=proposals)


def _firmer(model: Model, servos: Sequence[Actuator]) -> Iterator[tuple[Proposal, ...]]:
    """Yield twice and four times the kp of servos, with kv constant or in proportion."""
    elements = named(model, "actuator", [of.index for of in servos])
    for damped in (False, True) if servos else ():
        fixes = list[Proposal]()
        for part in PARTS[1:]:
            gains = [rounded(part * of.kp) for of in servos]
            ratios = {of.index: float(part) for of in servos}
            words = _gains(elements, gains) + ", with kv in proportion" * damped
            fixes.append(Proposal(words, Change(stronger(model, ratios, damped=damped))))
        yield tuple(fixes)


def _down(run: Recording, body: int) -> np.ndarray:
    """Return for each reading whether a robot is no longer upright."""
    axis = rotated(run["xquat"][:, body] * (1.0, -1.0, -1.0, -1.0), np.array([0.0, 0.0, 1.0]))
    down: np.ndarray = axis @ axis[0] < np.cos(TILT)
    geoms = np.flatnonzero(run.roots[run.model.geom_body] == body)
    if len(geoms):
        lowest = run.geoms[0][:, geoms, 2] - run.model.geom_size[geoms].max(axis=1)
        height = run.centre_of_mass(body)[:, 2] - lowest.min(axis=1)
        down |= height < (1 - SINKS) * height[0]
    return down
