"""`PositionTable`: recorded positions of joints, which position servos follow."""

from __future__ import annotations

from dataclasses import dataclass, fields
from typing import Any

import numpy as np

from stepcore import checks
from stepcore.engine.model import Model
from stepcore.engine.sim import Sim
from stepcore.experiment.control_table import ControlTable, control_table

# Joints with one coordinate; other joints of a recorded run are not followed.
SINGLE = ("hinge", "slide")


@dataclass(frozen=True, eq=False)
class PositionTable(ControlTable):
    """Positions of hinges and slides in rows; see `ControlTable`.

    The controls are those with which every servo is without force in the recorded position.
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

    def _complete(self, model: Model, held: np.ndarray) -> np.ndarray:
        """Return the controls with which the servos are without force in each pose."""
        gain, bias = model.actuator_gain, model.actuator_bias
        servos = [
            k
            for k, actuator in enumerate(model.scene.actuators)
            if actuator.law.gaintype == "fixed" and gain[k] and bias[k, 1] < 0
        ]
        if not servos:
            raise ValueError(f"{self.source}: no actuator is a position servo, which could follow")
        home = model.keys[0].qpos if model.keys else model.qpos0
        sim, rows = Sim(model), np.tile(held, (len(self.rows), 1))
        for row, pose in zip(rows, self.poses(model, home), strict=True):
            sim.qpos = pose
            sim.forward()
            length = sim.actuator_length[servos]
            row[servos] = -(bias[servos, 0] + bias[servos, 1] * length) / gain[servos]
        return rows
