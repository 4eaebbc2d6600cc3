"""`Motion`: the horizon, the starts and the controls of a measurement."""

from __future__ import annotations

import inspect
import os
import pickle
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, fields
from functools import partial
from typing import Any, TypedDict

from numpy.typing import ArrayLike

from stepcore import checks
from stepcore.engine.control import Control
from stepcore.engine.model import Model
from stepcore.engine.sim import Sim
from stepcore.experiment.change import powered
from stepcore.experiment.control_table import ControlTable, PositionTable, control_table
from stepcore.experiment.default_motion import KINDS
from stepcore.report import units
from stepcore.signatures import F, keyword, refuse_unknown, spell_out


def _lost(name: str, time: float, sim: Sim) -> ArrayLike:
    raise ValueError(f"control `{name}` could not be pickled: make the Motion with it again")


def picklable(control: Control) -> Control:
    """Return the control function, or one that raises ValueError if it cannot be pickled.

    Results of a lambda or a notebook's function can therefore still be pickled.
    """
    try:
        pickle.dumps(control)
    except Exception:  # pickling a user's object can raise any exception
        return partial(_lost, getattr(control, "__qualname__", "control"))
    return control


# Rows of controls, or a source of rows; see `Motion`.
Controls = ArrayLike | ControlTable | Mapping[str, Any] | str | os.PathLike[str] | Any
# The interpolation of rows between their times.
INTERPOLATIONS = ("held", "linear")


class MotionFields(TypedDict, total=False):
    """The fields of `Motion`, as keyword arguments of a measurement."""

    horizon: float | str | None
    starts: int | None
    seed: int
    key: str | int | None
    control: Control | None
    ctrl: Controls | None
    control_dt: float | str | None
    interpolation: str
    kind: str | None
    follow: Controls | None


@dataclass(frozen=True, eq=False)
class Motion:
    """The motion of a measurement. Measurements take a Motion, or its fields as arguments.

    horizon: simulated time [s], or a text such as "500ms"; by default the measurement chooses it.
    starts: the number of initial states: the keyframe, and random states near it. By default the
        measurement chooses the number.
    seed: the random seed of the starts, and of the default controls.
    key: the keyframe to start from, by name or index; by default the first one, or the pose of the
        scene at rest.
    ctrl: the controls. Either an array of shape (n, nu) with one row for each control period; the
        last row stays to the end. Or a `Log`, or a source of one: the path of a .csv, .npz,
        .parquet or .mcap file, a recorded run (`Trajectory`), a DataFrame, or a dict such as
        ``{"hip": 1.0, "knee": [0.0, 0.5]}``. An actuator without a column keeps the keyframe's
        control. Torques are played by motors, which are made where a model has no actuators. Each
        row takes effect at its time, at any rate: a step gets the mean of the controls over the
        step, whatever its length. Without a `key`, the motion starts at the positions and
        velocities of the log's first row, as far as it has them. The Motion keeps the log.
    control: a function of (time, sim) that returns the controls, instead of `ctrl`. The function
        is called once per control period, possibly from several threads, and must depend on
        nothing but its arguments. A callable object may keep state in its attributes; each run gets
        a copy of the object.
    control_dt: the control period [s], a multiple of every time step. With `control`, or rows
        without times, the default is the scene's time step, as in a loop that sets ctrl and steps.
        The period is part of the physics, so runs with different time steps have the same period.
        Rows with times take effect at these by default; with control_dt, the row in effect at the
        beginning of each period is held.
    interpolation: "held" (each row until the next) or "linear", for rows with times.
    kind: the controls without `ctrl` and `control`. None chooses them from the model; see
        `stepcore.experiment.default_motion` for the rules. "move": servos and motors move joints
        point to point, within their forces and limits; "hold": they hold the start. (A URDF has no
        actuators: for these two, joints whose effort it bounds get motors, or all with a range.)
        "sines": every control is a sum of random sines within its range; "random": new random
        controls in every control period; "fall": all controls are 0. A measurement also takes the
        kind instead of a Motion: ``trade(model, "hold")``.
    follow: recorded positions of joints, followed instead of `ctrl`: a `Log`, or a source of one.
        The motion starts at the first row. Each position servo gets the control at which its force
        is zero in the recorded position; motors are replaced by position servos, and a model
        without actuators gets motors. Between rows positions are interpolated.

    Raises ValueError for a value outside its limits.

    >>> Motion(horizon=2.0, starts=4)
    Motion(horizon=2.0, starts=4)
    """

    horizon: float | None = None
    starts: int | None = None
    seed: int = 0
    key: str | int | None = None
    control: Control | None = None
    ctrl: Controls | None = None
    control_dt: float | None = None
    interpolation: str = "held"
    kind: str | None = None
    follow: Controls | None = None

    def __post_init__(self) -> None:
        for name in ("horizon", "control_dt"):
            if getattr(self, name) is not None:
                object.__setattr__(self, name, units.time(name, getattr(self, name)))
        if self.starts is not None:
            object.__setattr__(self, "starts", checks.count("starts", self.starts))
        object.__setattr__(self, "seed", checks.count("seed", self.seed, least=0))
        checks.one_of(*INTERPOLATIONS)("motion", "interpolation", self.interpolation)
        if self.control is not None:
            checks.function("time", "sim")("motion", "control", self.control)
        if self.kind is not None:
            checks.one_of(*KINDS)("motion", "kind", self.kind)
        drives = {name: getattr(self, name) for name in ("kind", "follow", "control", "ctrl")}
        if self.follow is not None and isinstance(self.ctrl, PositionTable):
            del drives["ctrl"]
        ways = [name for name, value in drives.items() if value is not None]
        if len(ways) > 1:
            raise ValueError(f"{ways[0]} and {ways[1]} are both given: a motion has one of them")
        if isinstance(self.ctrl, str) and self.ctrl in KINDS:
            raise ValueError(
                f'ctrl = {self.ctrl!r}: write kind="{self.ctrl}" (--motion {self.ctrl})'
            )
        if self.follow is not None and not isinstance(self.ctrl, PositionTable):
            object.__setattr__(self, "ctrl", PositionTable(self.follow))
        elif self.ctrl is not None:
            object.__setattr__(self, "ctrl", control_table(self.ctrl))

    @property
    def is_users(self) -> bool:
        """Whether the user gave the controls; otherwise stepcore makes them."""
        return self.ctrl is not None or self.control is not None

    @property
    def from_log(self) -> bool:
        """Whether the motion starts at the first row of the user's log, not at a keyframe."""
        return self.table is not None and (self.key is None or self.follow is not None)

    @property
    def duration(self) -> float:
        """The duration of the user's rows [s]; 0 without rows that have times."""
        return 0.0 if self.table is None else self.table.duration

    @property
    def table(self) -> ControlTable | None:
        """The user's rows, or recorded positions; None without."""
        return self.ctrl if isinstance(self.ctrl, ControlTable) else None

    def driven(self, model: Model, kind: str | None = None) -> Model:
        """Return the model that the motion drives: with motors for its log, or to move its joints.

        kind: the default for a motion without a kind and without controls.
        """
        if self.table is not None:
            return self.table.driven(model)
        moves = self.control is None and (self.kind or kind) in ("move", "hold")
        return powered(model) if moves else model

    def period(self, dt: float) -> float | None:
        """Return the control period [s], or None if this motion does not determine a period.

        Constant controls do not determine a period.

        dt: the scene's time step [s].
        """
        if self.control_dt is not None or self.control is not None:
            return self.control_dt or dt
        if self.table is None or not self.table.varies:
            return None
        linear = self.table.times is not None and self.interpolation == "linear"
        return None if linear else self.table.period(dt)

    @classmethod
    def of(
        cls,
        motion: Motion | str | None,
        keywords: Mapping[str, Any],
        measurement: Callable[..., Any],
    ) -> Motion:
        """Return the motion of a call of a measurement, from a Motion or from its fields.

        motion: the Motion, a kind of motion, or None.
        keywords: the arguments that the measurement itself does not define.
        measurement: the function that was called. Its signature has the fields of Motion that the
            measurement uses (`takes_motion`).

        Raises TypeError for an unknown argument, with the nearest name. Raises ValueError if a
        Motion and fields are both given, or if a field is set that the measurement does not use.
        """
        refuse_unknown(measurement, keywords)
        if isinstance(motion, str):
            keywords, motion = {"kind": motion, **keywords}, None
        if motion is None:
            return cls(**keywords)
        if not isinstance(motion, Motion):
            raise ValueError(f"motion = {checks.shown(motion)}: must be a stepcore.Motion")
        if keywords:
            raise ValueError(
                f"motion and {min(keywords)} are both given: write {min(keywords)} into the Motion"
            )
        name, takes = measurement.__name__, inspect.signature(measurement).parameters
        for word in (field.name for field in fields(cls) if field.name not in takes):
            if getattr(motion, word) is not getattr(cls, word):
                raise ValueError(f"motion: {name} does not use {word}; leave it out of the Motion")
        return motion

    def __getstate__(self) -> dict[str, Any]:
        state = dict(self.__dict__)
        if self.control is not None:
            state["control"] = picklable(self.control)
        return state

    def __repr__(self) -> str:
        parts = [
            f"{field.name}={checks.shown(getattr(self, field.name), 40)}"
            for field in fields(self)
            if getattr(self, field.name) is not field.default
            and not (field.name == "ctrl" and self.follow is not None)
        ]
        return f"Motion({', '.join(parts)})"


def takes_motion(
    *, without: tuple[str, ...] = (), more: Sequence[inspect.Parameter] = ()
) -> Callable[[F], F]:
    """Return a decorator that adds the fields of `Motion` to a measurement's keyword arguments.

    without: the names of fields that the measurement does not use.
    more: further keyword arguments that are in its ``**fields``.
    """

    def spelled_out(measurement: F) -> F:
        used = [field for field in fields(Motion) if field.name not in without]
        return spell_out(measurement, [*more, *(keyword(f.name, f.default, f.type) for f in used)])

    return spelled_out
