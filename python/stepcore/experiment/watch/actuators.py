"""What a run's actuators did: clamped controls, saturated forces, errors at rest."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from stepcore.engine.model import Model
from stepcore.engine.sim import Sim
from stepcore.experiment.watch.contacts import FEWEST, REST

# A force this near to the end of its range is at it.
AT_END = 1e-9
# What carries this part of a force is what it pushes against.
HALF = 0.5
# At rest an error changes by less than this share of itself over the end of a run.
STEADY = 0.05


@dataclass(frozen=True)
class Clamped:
    """An actuator whose control was clamped to its range.

    share: of the run; value: the control furthest outside.
    """

    actuator: int
    share: float
    value: float


@dataclass(frozen=True)
class Saturated:
    """An actuator whose force was at the end of its range. share: of the run; end: of its end."""

    actuator: int
    share: float
    end: float


@dataclass(frozen=True)
class Servo:
    """A position servo at rest under a constant control.

    error: of its length from what the control asks for [rad or m], before the gear. force: what it
    pushes with [N·m or N]; saturated: whether that is the end of its force range. loaded: whether a
    weight is what it pushes against, and not a limit, or a thing that it holds or presses.
    """

    actuator: int
    error: float
    force: float
    saturated: bool
    loaded: bool


class ActuatorWatch:
    """The actuators of one run."""

    def __init__(self, model: Model) -> None:
        self.model = model
        self.works = model.nu > 0 and model.scene.features.actuation
        joints = model.actuator_joint
        kinds = [model.jnt_type[j] if j >= 0 else "" for j in joints]
        own = (model.actuator_actadr < 0).tolist()
        hinged = np.array(
            [kind in ("hinge", "slide") and bare for kind, bare in zip(kinds, own, strict=True)],
            bool,
        )
        # Position feedback that pulls back, on a joint of one coordinate.
        self.servos = np.flatnonzero(hinged & (model.actuator_bias[:, 1] < 0))
        self.joints = [int(joint) for joint in joints[self.servos]]
        self.at = model.jnt_qposadr[self.joints] if self.joints else self.servos
        self.ctrl: list[np.ndarray] = []
        self.force: list[np.ndarray] = []
        self.length: list[np.ndarray] = []
        self.sim: Sim | None = None

    def look(self, sim: Sim) -> None:
        """Every actuator now."""
        if self.works:
            self.sim = sim
            self.ctrl.append(np.array(sim.ctrl))
            self.force.append(np.array(sim.actuator_force))
            gear = self.model.actuator_gear[self.servos, 0]
            self.length.append(gear * np.array(sim.qpos)[self.at])

    def clamped(self) -> Iterator[Clamped]:
        """Controls outside of their range."""
        if not self.ctrl or not self.model.scene.features.clampctrl:
            return
        ctrl, bounds = np.array(self.ctrl), self.model.actuator_ctrlrange
        outside = np.maximum(bounds[:, 0] - ctrl, ctrl - bounds[:, 1])
        for k in np.flatnonzero((outside > 0).any(axis=0)):
            share = float(np.mean(outside[:, k] > 0))
            yield Clamped(int(k), share, float(ctrl[outside[:, k].argmax(), k]))

    def saturated(self) -> Iterator[Saturated]:
        """Forces at the end of their range."""
        if not self.force:
            return
        force, bounds = np.array(self.force), self.model.actuator_forcerange
        room = AT_END * np.abs(bounds)
        with np.errstate(invalid="ignore"):
            low, high = force <= bounds[:, 0] + room[:, 0], force >= bounds[:, 1] - room[:, 1]
        # One that rests at 0 is not saturated where its range begins there.
        low, high = low & (force != 0), high & (force != 0)
        for k in np.flatnonzero((low | high).any(axis=0)):
            end = bounds[k, 0] if low[:, k].sum() > high[:, k].sum() else bounds[k, 1]
            yield Saturated(int(k), float(np.mean(low[:, k] | high[:, k])), float(end))

    def at_rest(self) -> Iterator[Servo]:
        """Position servos whose control and error are constant over the end of the run."""
        count = max(FEWEST, int(REST * len(self.ctrl)))
        if len(self.ctrl) < count or not len(self.servos):
            return
        model = self.model
        ends = {one.actuator for one in self.saturated() if one.share > 0}
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
        """Whether a weight is what a servo at the end of the run pushes against.

        The weight of what hangs on its joint, or, in a tree that stands on a floor, of the tree.
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
        floats = [model.root(int(model.jnt_body[j])) for j in range(model.njnt) if _free(model, j)]
        if tree not in floats:
            return False
        touched = {
            frozenset(model.root(int(model.geom_body[geom])) for geom in pair)
            for pair in zip(sim.contacts["geom1"], sim.contacts["geom2"], strict=True)
        }
        own = [pair for pair in touched if tree in pair]
        return bool(own) and all(pair <= {tree, 0} for pair in own)


def _free(model: Model, joint: int) -> bool:
    return model.jnt_type[joint] == "free"
