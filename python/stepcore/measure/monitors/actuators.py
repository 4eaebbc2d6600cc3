"""Findings on actuators in a run: clamped controls, saturated forces, servos that sag."""

from __future__ import annotations

import math
from collections.abc import Collection, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from stepcore.engine.element import Element, SceneField
from stepcore.engine.model import Model
from stepcore.engine.sim import Sim
from stepcore.measure.monitors.finding import OTHERS, PLOT, Cure, Finding, Remedy, listed, named
from stepcore.measure.monitors.readings import FEWEST, REST
from stepcore.report.units import (
    FORCES,
    TORQUES,
    metres,
    percent,
    plural,
    quantity,
    radians,
    rounded,
)

# Relative distance from the end of the force range within which a force is at the end.
AT_END = 1e-9
# A servo pushes against a weight if the weight's load has at least this share of the servo's force.
HALF = 0.5
# At rest, a servo's error changes by less than this share over the end of a run.
STEADY = 0.05
# Shares of a run above which clamping and saturation are reported.
CLAMPED, SATURATED = 0.05, 0.5
# Gains within this factor are given as one.
ALIKE = 1.1
# Actuators of one joint cancel if they push this many times more than what is left, or needed.
OPPOSED = 5.0
# Least sag that is told and that will be noticed, relative to the joint's range (a hinge's, at most
# 3 rad): 30 mrad move the hand of an arm of 0.8 m by 24 mm. And the share that a cure should leave.
SAGS, OBVIOUS, WIDEST, LEFT = 0.01, 0.033, 3.0, 1 / 3


@dataclass(frozen=True)
class AtEnd:
    """An actuator that was at or beyond the end of a range for a share of the run.

    value: the control furthest outside the range, or the end of the force range.
    """

    actuator: int
    share: float
    value: float


@dataclass(frozen=True)
class Servo:
    """A position servo at rest under a constant control.

    error: commanded length minus length [rad or m], before the gear.
    force: the servo's force [N·m or N].
    saturated: whether the force is at the end of the force range.
    loaded: whether the servo pushes against a weight rather than a limit or an object it grips or
        presses.
    """

    actuator: int
    error: float
    force: float
    saturated: bool
    loaded: bool


class ActuatorMonitor:
    """A record of the actuators of one run."""

    def __init__(self, model: Model) -> None:
        self.model = model
        self.works = model.nu > 0 and model.scene.features.actuation
        # Position feedback with a restoring sign, on a joint of one coordinate.
        servos = [k for k in on_one_dof(model) if model.actuator_bias[k, 1] < 0]
        self.servos = np.array(servos, dtype=int)
        self.joints = [int(joint) for joint in model.actuator_joint[self.servos]]
        self.at = model.jnt_qposadr[self.joints] if self.joints else self.servos
        self.ctrl: list[np.ndarray] = []
        self.force: list[np.ndarray] = []
        self.length: list[np.ndarray] = []
        self.sim: Sim | None = None

    def look(self, sim: Sim) -> None:
        """Record every actuator."""
        if self.works:
            self.sim = sim
            self.ctrl.append(np.array(sim.ctrl))
            self.force.append(np.array(sim.actuator_force))
            gear = self.model.actuator_gear[self.servos, 0]
            self.length.append(gear * np.array(sim.qpos)[self.at])

    def clamped(self) -> Iterator[AtEnd]:
        """Yield controls outside their range."""
        if not self.ctrl or not self.model.scene.features.clampctrl:
            return
        ctrl, bounds = np.array(self.ctrl), self.model.actuator_ctrlrange
        outside = np.maximum(bounds[:, 0] - ctrl, ctrl - bounds[:, 1])
        for k in np.flatnonzero((outside > 0).any(axis=0)):
            share = float(np.mean(outside[:, k] > 0))
            yield AtEnd(int(k), share, float(ctrl[outside[:, k].argmax(), k]))

    def saturated(self) -> Iterator[AtEnd]:
        """Yield forces at the end of their range."""
        if not self.force:
            return
        force, bounds = np.array(self.force), self.model.actuator_forcerange
        room = AT_END * np.abs(bounds)
        with np.errstate(invalid="ignore"):
            low, high = force <= bounds[:, 0] + room[:, 0], force >= bounds[:, 1] - room[:, 1]
        # A force of 0 is not saturated, even if the range begins at 0.
        low, high = low & (force != 0), high & (force != 0)
        for k in np.flatnonzero((low | high).any(axis=0)):
            end = bounds[k, 0] if low[:, k].sum() > high[:, k].sum() else bounds[k, 1]
            yield AtEnd(int(k), float(np.mean(low[:, k] | high[:, k])), float(end))

    def at_rest(self) -> Iterator[Servo]:
        """Yield position servos whose control and error are constant over the end of the run."""
        count = max(FEWEST, int(REST * len(self.ctrl)))
        if len(self.ctrl) < count or not len(self.servos):
            return
        model = self.model
        ends = {saturated.actuator for saturated in self.saturated() if saturated.share > 0}
        length = np.array(self.length[-count:])
        for column, k in enumerate(self.servos):
            asked, ctrl = self._asked(column, count)
            error = asked - length[:, column]
            mean = float(error.mean())
            if np.ptp(ctrl) == 0 and float(np.ptp(error)) < STEADY * abs(mean):
                force = float(self.force[-1][k])
                low, high = model.actuator_forcerange[k]
                full = int(k) in ends and not low * (1 - 1e-6) < force < high * (1 - 1e-6)
                loaded = self._loaded(column, float(asked[-1]), force)
                yield Servo(int(k), mean, force, full, loaded)

    def _asked(self, column: int, count: int) -> tuple[np.ndarray, np.ndarray]:
        """Return the lengths that the last controls of a servo ask for, and these controls."""
        model, k = self.model, int(self.servos[column])
        ctrl = np.array(self.ctrl[-count:])[:, k]
        if model.scene.features.clampctrl:
            ctrl = np.clip(ctrl, *model.actuator_ctrlrange[k])
        asked: np.ndarray = (model.actuator_gain[k] * ctrl + model.actuator_bias[k, 0]) / (
            -model.actuator_bias[k, 1]
        )
        return asked, ctrl

    def _loaded(self, column: int, asked: float, force: float) -> bool:
        """Return whether a servo pushes against a weight at the end of the run.

        The weight is that of the bodies that hang on the servo's joint, or, in a tree that rests on
        a floor, that of the tree.
        """
        model, joint, sim = self.model, self.joints[column], self.sim
        gear = float(model.actuator_gear[self.servos[column], 0])
        low, high = model.jnt_range[joint]
        if sim is None or not gear or not low <= asked / gear <= high:
            return False
        dof = int(model.jnt_dofadr[joint])
        weight = float(sim.bias[dof] - sim.passive[dof]) / gear
        if weight * force >= HALF * force**2:
            return True
        tree = model.root(int(model.jnt_body[joint]))
        free = (j for j, kind in enumerate(model.jnt_type) if kind == "free")
        if tree not in [model.root(int(model.jnt_body[j])) for j in free]:
            return False
        touched = {
            frozenset(model.root(int(model.geom_body[geom])) for geom in pair)
            for pair in zip(sim.contacts["geom1"], sim.contacts["geom2"], strict=True)
        }
        touches = [pair for pair in touched if tree in pair]
        return bool(touches) and all(pair <= {tree, 0} for pair in touches)

    def findings(self) -> Iterator[Finding]:
        """Yield all findings on actuators."""
        model, explained = self.model, set()
        sagging: list[tuple[float, Servo]] = []
        for servo in self.at_rest():
            # A servo that presses against an object or a limit does so on purpose, and may be
            # saturated.
            ratio = abs(servo.error) / self._notable(servo.actuator) if servo.loaded else 0.0
            if ratio > 1 and servo.saturated:
                yield self._weak(servo)
            elif ratio > 1:
                sagging.append((ratio, servo))
            if ratio > 1 or not servo.loaded:
                explained.add(servo.actuator)
        if sagging:
            sagging.sort(key=lambda entry: -entry[0])
            yield self._sags([servo for _, servo in sagging])
        yield from self._opposed()
        for clamped in self.clamped():
            if clamped.share < CLAMPED:
                continue
            actuator = named(model, "actuator", [clamped.actuator])
            low, high = model.actuator_ctrlrange[clamped.actuator]
            problem = (
                f"the control of {actuator[0].name} is clamped for {percent(clamped.share)} of the "
                f"run, {clamped.value:.4g} to its ctrlrange of {low:.4g} to {high:.4g}"
            )
            cure = "widen the ctrlrange, or scale the control"
            kind = "clamped control"
            yield Finding(kind, "warning", problem, cure, actuator, clamped.share, "1", PLOT)
        servos = set(self.servos.tolist()) - explained
        full = [s for s in self.saturated() if s.share >= SATURATED and s.actuator in servos]
        if full:
            yield self._saturated(sorted(full, key=lambda saturated: -saturated.share))

    def _opposed(self) -> Iterator[Finding]:
        """Yield actuators on one joint that cancel each other at the end of the run.

        Actuators that can only pull, such as muscles, need an opponent.
        """
        model, count = self.model, max(FEWEST, int(REST * len(self.force)))
        if len(self.force) < count:
            return
        series = np.array(self.force[-count:]) * model.actuator_gear[:, 0]
        force = series.mean(axis=0)
        # Against a motion, a velocity servo is a damper.
        steady = np.ptp(series, axis=0) <= STEADY * np.abs(force)
        low, high = model.actuator_forcerange.T
        ctrl = model.actuator_ctrlrange
        servos = model.actuator_bias[:, 1] < 0
        one_way = (low >= 0) | (high <= 0) | (~servos & ((ctrl[:, 0] >= 0) | (ctrl[:, 1] <= 0)))
        by_joint: dict[int, list[int]] = {}
        for k in on_one_dof(model):
            if steady[k] and not one_way[k]:
                by_joint.setdefault(int(model.actuator_joint[k]), []).append(k)
        for joint, indices in by_joint.items():
            forces = force[indices]
            most, total = float(np.abs(forces).max()), abs(float(forces.sum()))
            weight = self._weight(joint)
            if len(indices) < 2 or not most > OPPOSED * max(total, weight):
                continue
            pair = [indices[int(forces.argmax())], indices[int(forces.argmin())]]
            actuators = named(model, "actuator", pair)
            strong = strength(model, pair[0], most)
            name = model.element_name("joint", joint)
            problem = (
                f"{actuators[0].name} and {actuators[1].name} push {name} against each other with "
                f"{strong}; {strength(model, pair[0], total)} of that moves it"
            )
            cure = "give both one target, or leave one out"
            if not servos[pair].all():
                cure = "leave one out: a servo resists what a motor on its joint does"
            yield Finding("opposed actuators", "warning", problem, cure, actuators, most, "", PLOT)

    def _weight(self, joint: int) -> float:
        """Return the load of a joint at the end of the run [N·m or N]."""
        dof = int(self.model.jnt_dofadr[joint])
        return 0.0 if self.sim is None else abs(float(self.sim.bias[dof] - self.sim.passive[dof]))

    def _saturated(self, full: list[AtEnd]) -> Finding:
        """Return one finding on all saturated servos, the longest saturated first."""
        model = self.model
        actuators = named(model, "actuator", [saturated.actuator for saturated in full])
        ends = dict.fromkeys(strength(model, at.actuator, abs(at.value)) for at in full)
        largest = max(full, key=lambda saturated: abs(saturated.value))
        force = f"up to {strength(model, largest.actuator, abs(largest.value))}"
        force = next(iter(ends)) if len(ends) == 1 else force
        shares = list(dict.fromkeys(percent(saturated.share) for saturated in reversed(full)))
        share = f"{shares[0].removesuffix(' %')} to {shares[-1]}" if shares[1:] else shares[0]
        ranges = "are at the ends of their forceranges"
        if len(full) == 1:
            ranges = "is at the end of its forcerange"
        problem = (
            f"{_all(actuators)} {ranges} ({force}) for {share} of the run, where kv has no effect"
        )
        cure = "slow the motion or lower kp; a wider forcerange must be one that the hardware has"
        value = full[0].share
        return Finding("saturation", "warning", problem, cure, actuators, value, "1", PLOT)

    def _notable(self, actuator: int) -> float:
        """Return the least sag that is told, before the gear [rad or m]."""
        joint = int(self.model.actuator_joint[actuator])
        low, high = (float(bound) for bound in self.model.jnt_range[joint])
        gear = abs(float(self.model.actuator_gear[actuator, 0])) or 1.0
        widest = WIDEST if self.model.jnt_type[joint] == "hinge" else 1.0
        return SAGS * min(high - low, widest) * gear

    def _length(self, actuator: int, error: float) -> tuple[float, str]:
        """Return the error of a servo at its joint, and in words."""
        joint = int(self.model.actuator_joint[actuator])
        value = abs(error) / (abs(float(self.model.actuator_gear[actuator, 0])) or 1.0)
        return value, (radians if self.model.jnt_type[joint] == "hinge" else metres)(value)

    def _weak(self, servo: Servo) -> Finding:
        """Return a finding on a servo whose force range is too small for its load."""
        actuator = named(self.model, "actuator", [servo.actuator])
        error, length = self._length(servo.actuator, servo.error)
        force = strength(self.model, servo.actuator, abs(servo.force))
        problem = (
            f"{actuator[0].name} cannot hold its load: it rests {length} from where its control "
            f"asks it to be, at the end of its forcerange ({force})"
        )
        cure = "widen the forcerange, raise the gear, or lighten the load"
        unit = self._unit(servo.actuator)
        return Finding("servo too weak", "error", problem, cure, actuator, error, unit, PLOT)

    def _unit(self, actuator: int) -> str:
        joint = int(self.model.actuator_joint[actuator])
        return "rad" if self.model.jnt_type[joint] == "hinge" else "m"

    def _sags(self, servos: list[Servo]) -> Finding:
        """Return a finding on servos that sag under their loads, the worst first."""
        model, worst = self.model, servos[0]
        k, indices = worst.actuator, [servo.actuator for servo in servos]
        actuators, notable = named(model, "actuator", indices), self._notable(k)
        (error, length), kp = self._length(k, worst.error), -float(model.actuator_bias[k, 1])
        force = strength(model, k, abs(worst.force))
        ratios = {s.actuator: abs(s.error) / (self._notable(s.actuator) * LEFT) for s in servos}
        if max(ratios.values()) < ALIKE * min(ratios.values()):
            ratios = dict.fromkeys(ratios, max(ratios.values()))
        gains = [rounded(-model.actuator_bias[k, 1] * ratio) for k, ratio in ratios.items()]
        # "kp 1810 (servo `j2` 995)"
        also = [f"{of.name} {gain:g}" for of, gain in zip(actuators, gains, strict=True)][1:]
        more = f" and {len(also) - OTHERS} more in proportion" if len(also) > OTHERS else ""
        words = f"kp {gains[0]:g}" + (f" ({', '.join(also[:OTHERS])}{more})" if also else "")
        if also and len(set(gains)) == 1:
            words = f"kp {gains[0]:g} of each"
        remedy = Remedy(
            (
                (
                    Cure(words, stronger(model, ratios, damped=False)),
                    Cure(f"{words}, with kv in proportion", stronger(model, ratios, damped=True)),
                ),
            ),
            lambda m: m.actuators.sag_of(indices),
            notable,
            lambda left: self._length(k, left)[1],
        )
        problem = (
            f"{listed(actuators, 'servos')} sags by {length} under its load of {force}, which is "
            f"load / kp with kp {kp:.4g}"
        )
        severity = "warning" if abs(worst.error) > OBVIOUS / SAGS * notable else "remark"
        cure, unit = "let the control carry the load", self._unit(k)
        finding = Finding("servo sags", severity, problem, cure, actuators, error, unit, PLOT)
        return replace(finding, remedy=remedy)

    def sag_of(self, actuators: Collection[int]) -> float | None:
        """Return the largest error of some servos over the end of the run, before the gear.

        None if a control changes there.
        """
        count = max(FEWEST, int(REST * len(self.ctrl)))
        worst = 0.0
        for column, k in enumerate(self.servos.tolist()):
            if k in actuators:
                asked, ctrl = self._asked(column, count)
                if np.ptp(ctrl):
                    return None
                error = asked - np.array(self.length[-count:])[:, column]
                worst = max(worst, float(np.abs(error).max()))
        return worst


def stronger(
    model: Model, ratios: Mapping[int, float], damped: bool
) -> tuple[tuple[SceneField, Any], ...]:
    """Return the gains of servos with kp multiplied by a ratio each.

    damped: whether kv grows, too, so that the damping ratio is kept.
    """
    changes: list[tuple[SceneField, Any]] = []
    for k, ratio in ratios.items():
        fields = {field.name: field for field in Element.of(model, "actuator", k).fields(model)}
        faster = math.sqrt(ratio) if damped else 1.0
        if "kp" in fields:
            changes.append((fields["kp"], rounded(fields["kp"].value * ratio)))
            if fields["kv"].value > 0:
                changes.append((fields["kv"], rounded(fields["kv"].value * faster)))
        elif "biasprm" in fields:
            for name, factors in (("gainprm", [ratio]), ("biasprm", [1.0, ratio, faster])):
                terms = np.atleast_1d(np.asarray(fields[name].value, float))
                terms[: len(factors)] *= factors[: len(terms)]
                scaled = tuple(map(rounded, terms.tolist()))
                changes.append((fields[name], scaled if len(scaled) > 1 else scaled[0]))
    return tuple(changes)


def on_one_dof(model: Model) -> list[int]:
    """Return the actuators on a hinge or a slide that have no activation."""
    both = zip(model.actuator_joint, model.actuator_actadr, strict=True)
    return [
        k
        for k, (joint, act) in enumerate(both)
        if joint >= 0 and act < 0 and model.jnt_type[joint] in ("hinge", "slide")
    ]


def strength(model: Model, actuator: int, force: float) -> str:
    """Return an actuator's force in words, as a torque if the joint turns."""
    joint = int(model.actuator_joint[actuator])
    linear = joint < 0 or model.jnt_type[joint] == "slide"
    return quantity(force, FORCES if linear else TORQUES)


def _all(actuators: Sequence[Element]) -> str:
    """Return the names of actuators in words: "servos `a`, `b` and `c`"."""
    if len(actuators) == 1:
        return actuators[0].name
    *labels, last = (actuator.label for actuator in actuators)
    return f"{plural(actuators[0].noun)} {', '.join(labels)} and {last}"
