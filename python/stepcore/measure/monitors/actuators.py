"""Findings on actuators in a run: clamped controls, saturated forces, servos that sag."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np

from stepcore.engine.element import Element
from stepcore.engine.model import Model
from stepcore.engine.sim import Sim
from stepcore.measure.monitors.contacts import FEWEST, REST
from stepcore.measure.monitors.finding import PLOT, Finding, named
from stepcore.report.units import FORCES, TORQUES, metres, percent, plural, quantity, radians

# Relative distance from the end of the force range within which a force is at the end.
AT_END = 1e-9
# A servo pushes against a weight if the weight's load has at least this share of the servo's force.
HALF = 0.5
# At rest, a servo's error changes by less than this share over the end of a run.
STEADY = 0.05
# Shares of a run above which clamping and saturation are reported.
CLAMPED, SATURATED = 0.05, 0.5
# Largest sag, in rad or relative to a slide's range; and the share of this that a cure leaves.
SAGS, LEFT = 0.1, 0.1


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
        ctrl, length = np.array(self.ctrl[-count:]), np.array(self.length[-count:])
        if model.scene.features.clampctrl:
            ctrl = np.clip(ctrl, *model.actuator_ctrlrange.T)
        for column, k in enumerate(self.servos):
            gain, bias = model.actuator_gain[k], model.actuator_bias[k]
            asked = (gain * ctrl[:, k] + bias[0]) / -bias[1]
            error = asked - length[:, column]
            mean = float(error.mean())
            if np.ptp(ctrl[:, k]) == 0 and float(np.ptp(error)) < STEADY * abs(mean):
                force = float(self.force[-1][k])
                low, high = model.actuator_forcerange[k]
                full = int(k) in ends and not low * (1 - 1e-6) < force < high * (1 - 1e-6)
                loaded = self._loaded(column, float(asked[-1]), force)
                yield Servo(int(k), mean, force, full, loaded)

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
        for servo in self.at_rest():
            # A servo that presses against an object or a limit does so on purpose, and may be
            # saturated.
            finding = self._sags(servo) if servo.loaded else None
            if finding is not None or not servo.loaded:
                explained.add(servo.actuator)
            if finding is not None:
                yield finding
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

    def _sags(self, servo: Servo) -> Finding | None:
        """Return a finding on a servo that sags under its load, or None."""
        model, k = self.model, servo.actuator
        joint = int(model.actuator_joint[k])
        angular = model.jnt_type[joint] == "hinge"
        low, high = (float(bound) for bound in model.jnt_range[joint])
        gear = abs(float(model.actuator_gear[k, 0])) or 1.0
        error = abs(servo.error) / gear
        notable = SAGS if angular else SAGS * min(high - low, 1.0)
        if error <= notable:
            return None
        actuator, length = named(model, "actuator", [k]), radians if angular else metres
        force, kp = strength(model, k, abs(servo.force)), -float(model.actuator_bias[k, 1])
        if servo.saturated:
            kind, severity = "servo too weak", "error"
            problem = (
                f"cannot hold its load: it rests {length(error)} from where its control asks it to "
                f"be, at the end of its forcerange ({force})"
            )
            cure = "widen the forcerange, raise the gear, or lighten the load"
        else:
            kind, severity = "servo sags", "warning"
            problem = (
                f"sags by {length(error)} under its load of {force}, which is load / kp with kp "
                f"{kp:.4g}"
            )
            enough, leaves = kp * error / (LEFT * notable), length(LEFT * notable)
            cure = f"kp {enough:.3g} leaves {leaves}, or let the control carry the load"
        problem = f"{actuator[0].name} {problem}"
        unit = "rad" if angular else "m"
        return Finding(kind, severity, problem, cure, actuator, error, unit, PLOT)


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
