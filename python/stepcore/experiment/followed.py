"""`PositionTable`: recorded positions of joints, which servos and motors follow."""

from __future__ import annotations

from dataclasses import dataclass, fields
from typing import Any

import numpy as np

from stepcore import checks
from stepcore.engine.model import Model
from stepcore.engine.sim import Sim
from stepcore.engine.start import Start
from stepcore.experiment.control_log import ControlLog
from stepcore.experiment.control_table import ControlTable, control_table
from stepcore.experiment.drives import MOTOR, SERVO, Drives
from stepcore.experiment.moves import holding
from stepcore.experiment.point_to_point import JointGains

# Joints with one coordinate; other joints of a recorded run are not followed.
SINGLE = ("hinge", "slide")


@dataclass(frozen=True, eq=False)
class PositionTable(ControlTable):
    """Positions of hinges and slides in rows; see `ControlTable`.

    Servos get the controls with which they are without force in the recorded position, and motors
    are driven by a PD control toward it, with the gains of the default motion "hold".
    """

    @classmethod
    def of(cls, source: Any) -> PositionTable:
        """Return the table of a user's argument `follow`; see `Motion`."""
        if isinstance(source, PositionTable):
            return source
        table = control_table(source, "qpos")
        return cls(**{field.name: getattr(table, field.name) for field in fields(table)})

    @property
    def interpolated(self) -> bool:
        return self.times is not None

    def period(self, dt: float) -> float | None:
        return None if self.interpolated else dt

    def begin(self, model: Model, qpos: np.ndarray) -> np.ndarray:
        """Return the pose of the first row; qpos: that of the keyframe."""
        return self.poses(model, qpos)[0]

    def poses(self, model: Model, qpos: np.ndarray) -> np.ndarray:
        """Return a pose for each row, shape (n, nq); qpos: of the joints without a column."""
        rows = self.rows[:, None] if self.rows.ndim == 1 and model.nq == 1 else self.rows
        if self.columns is None:
            if rows.ndim != 2 or rows.shape[1] != model.nq:
                limit = f"(n, {model.nq}), or have columns by joint"
                raise ValueError(f"{self.source} has shape {rows.shape}: must be {limit}")
            return rows
        poses: np.ndarray = np.tile(np.array(qpos, float), (len(rows), 1))
        names = model.called("joint")
        for name, column in zip(self.columns, rows.T, strict=True):
            joint = name.partition(".")[0]
            if name in names and model.jnt_type[names.index(name)] in SINGLE:
                poses[:, model.jnt_qposadr[names.index(name)]] = column
            elif joint not in names:
                near = checks.nearest(name, names)
                raise ValueError(f"{self.source}: no joint is named {checks.quoted(name)}{near}")
        return poses

    def control(
        self, model: Model, start: Start, held: np.ndarray, period: float
    ) -> Following | None:
        """Return the control of motors on the recorded joints, or None without such motors.

        start: the first pose, which the gains and the load are made for. held: the controls of the
        keyframe, (nu,). period: the control period [s].
        """
        drives, poses = Drives(model), self.poses(model, start.qpos)
        moves = np.ptp(poses, axis=0) > 0
        if not drives.of(MOTOR) or not (moves.any() and self.times is not None):
            return None
        rest, gains = holding(model, start, held, period)
        if gains is None:
            return None
        rows = self._complete(model, rest)
        times = self.times - self.times[0]
        loads = gains.load + _heavier(model, poses, gains)
        tables = (rows, poses[:, gains.at], loads)
        log, path, load = (ControlLog(times, table, linear=True) for table in tables)
        return Following(log, path, load, gains, period)

    def _complete(self, model: Any, held: np.ndarray) -> np.ndarray:
        """Return the controls with which the servos are without force in each pose."""
        servos = Drives(model).of(SERVO)
        if not servos and not Drives(model).of(MOTOR):
            what = "position servo or motor, which could follow"
            raise ValueError(f"{self.source}: no actuator is a {what}")
        gain, bias = model.actuator_gain, model.actuator_bias
        home = model.keys[0].qpos if model.keys else model.qpos0
        sim, rows = Sim(model), np.tile(held, (len(self.rows), 1))
        for row, pose in zip(rows, self.poses(model, home), strict=True):
            sim.qpos = pose
            sim.forward()
            length = sim.actuator_length[servos]
            row[servos] = -(bias[servos, 0] + bias[servos, 1] * length) / gain[servos]
        return rows


def _heavier(model: Model, poses: np.ndarray, gains: JointGains) -> np.ndarray:
    """Return by how much the load of each motor exceeds that of the first pose, (n, motors)."""
    sim, loads = Sim(model), []
    for pose in poses:
        sim.qpos = pose
        sim.forward()
        loads.append((np.array(sim.bias) - np.array(sim.passive))[gains.dofs])
    # Several motors on a joint share its load.
    shared = np.array([list(gains.dofs).count(dof) for dof in gains.dofs])
    heavier: np.ndarray = (np.array(loads) - loads[0]) / shared
    return heavier


@dataclass(frozen=True, eq=False)
class Following:
    """A control function: servos get their recorded controls, motors a PD control on the path.

    log: the controls of servos. path: the positions of the motors' joints, (n, motors).
    load: the force that the motors need to rest at each row, (n, motors). gains: of the motors.
    period: the control period [s]. begin: the time of the start [s].
    """

    log: ControlLog
    path: ControlLog
    load: ControlLog
    gains: JointGains
    period: float
    begin: float = 0.0

    def __call__(self, time: float, sim: Sim) -> np.ndarray:
        now, gains = max(0.0, time - self.begin), self.gains
        ctrl: np.ndarray = self.log.steps(now, self.period, 1)[0]
        before, after = self.path.steps(max(0.0, now - self.period / 2), self.period, 2)
        # The mean over a period that has its middle at the present time.
        speed = (after - before) / self.period
        force = self.load.steps(now, self.period, 1)[0]
        force += gains.kp * (before - sim.qpos[gains.at])
        force += gains.kd * (speed - sim.qvel[gains.dofs])
        ctrl[list(gains.actuators)] = np.clip(force / gains.unit, gains.low, gains.high)
        return ctrl
