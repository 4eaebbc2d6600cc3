"""`Motion`: what a scene does while it is measured: how long, from where, under which controls."""

from __future__ import annotations

import inspect
import os
import pickle
from collections.abc import Callable, Mapping
from dataclasses import dataclass, fields, replace
from typing import Any, TypedDict

from numpy.typing import ArrayLike

from stepcore import checks
from stepcore.engine.control import Control
from stepcore.engine.sim import Sim
from stepcore.engine.trajectory import Trajectory
from stepcore.experiment.control_table import SINES, ControlTable, control_table
from stepcore.signatures import F, keyword, refuse_unknown, spell_out


@dataclass(frozen=True)
class LostControl:
    """Stands for a control function that could not be pickled; calling it is a ValueError."""

    name: str

    def __call__(self, time: float, sim: Sim) -> ArrayLike:
        raise ValueError(
            f"control `{self.name}` could not be pickled: make the Motion with it again"
        )


def picklable(control: Control) -> Control:
    """The function itself, or what stands for one that cannot be pickled: results still can that
    were made with a lambda or a function of a notebook."""
    try:
        pickle.dumps(control)
    except Exception:  # what a function's own pickling raises is of any type
        return LostControl(getattr(control, "__qualname__", "control"))
    return control


# Rows of controls, or where they are: see `Motion`.
Controls = ArrayLike | ControlTable | Mapping[str, Any] | str | os.PathLike[str] | Any


def _is_array(ctrl: object) -> bool:
    """Whether controls are plain rows, which are kept as they are given."""
    kinds = (str, os.PathLike, Mapping, Trajectory, ControlTable)
    named = isinstance(ctrl, kinds) or hasattr(ctrl, "columns")
    return not named and getattr(getattr(ctrl, "dtype", None), "names", None) is None


class MotionFields(TypedDict, total=False):
    """The fields of `Motion`, as keyword arguments of a measurement."""

    horizon: float | None
    starts: int | None
    seed: int
    key: str | int | None
    control: Control | None
    ctrl: Controls | None
    control_dt: float | None


@dataclass(frozen=True, eq=False)
class Motion:
    """The motion of a measurement. Every measurement takes one, or its fields as arguments.

    horizon: simulated time [s]; by default the measurement chooses it.
    starts: the number of initial states: the keyframe, and random states near it. By default the
        measurement chooses it.
    seed: random seed of the starts, and of the controls if none are given.
    key: the keyframe to start from, by name or index; by default the first one, or the pose of the
        scene at rest.
    ctrl: controls, shape (n, nu), one row for each control period; the last row is held. Or a table
        with the name of an actuator above each column, or of the joint that it drives: the path of
        a .csv or .npz file, a recorded run (`Trajectory`), a DataFrame, or a dict such as
        ``{"hip": 1.0, "knee": [0.0, 0.5]}``. An actuator without a column keeps the keyframe's
        control. With a column "time" [s], each row is held from its own time on, counted from the
        first row. A file without names (.csv, .npy) is as an array. "sines" is what measurements
        run by default.
    control: in place of `ctrl`, a function of (time, sim) that returns the controls. It is called
        once per control period, possibly from several threads, and must depend on nothing else; a
        callable object may remember what is in its attributes, of which each run gets a copy.
        Without `ctrl` and `control` every actuator follows a sum of a few random sines within its
        range.
    control_dt: the control period [s], a multiple of every time step. By default `control` and the
        rows of `ctrl` have the scene's own time step, as in a loop that sets ctrl and steps;
        without them the measurement chooses the period. Where time steps are compared, the period
        stays what it is: it is part of the physics.

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

    def __post_init__(self) -> None:
        for name in ("horizon", "control_dt"):
            if getattr(self, name) is not None:
                checks.seconds(name, getattr(self, name))
        if self.starts is not None:
            object.__setattr__(self, "starts", checks.count("starts", self.starts))
        object.__setattr__(self, "seed", checks.count("seed", self.seed, least=0))
        if self.control is not None:
            checks.function("time", "sim")("motion", "control", self.control)
            if self.ctrl is not None:
                raise ValueError("control and ctrl are both given: a motion has one of them")
        if self.ctrl is not None and not self.follows_sines and not _is_array(self.ctrl):
            object.__setattr__(self, "ctrl", control_table(self.ctrl))

    @property
    def follows_sines(self) -> bool:
        """Whether `ctrl` asks for the controls that measurements run by default."""
        return isinstance(self.ctrl, str) and self.ctrl == SINES

    def period(self, dt: float) -> float | None:
        """The control period [s] of a scene with time step `dt` [s]; None where nothing sets it.

        Controls that never change have none.
        """
        if self.control_dt is not None or self.control is not None:
            return self.control_dt or dt
        if self.ctrl is None or self.follows_sines:
            return None
        try:
            table = control_table(self.ctrl)
        except ValueError:
            # Whoever makes the controls of a model refuses them.
            return None
        return table.period(dt) if table.changes else None

    @classmethod
    def of(
        cls,
        motion: Motion | None,
        given: Mapping[str, Any],
        measurement: Callable[..., Any],
    ) -> Motion:
        """The motion that a measurement was called with: an object, or its fields.

        given: the keyword arguments that are not the measurement's own. The fields of Motion that
        it uses stand in its signature (`takes_motion`).

        Raises TypeError for an argument that is neither, naming the nearest; ValueError where an
        object and fields are both given, or a field is set that the measurement does not use.
        """
        refuse_unknown(measurement, given)
        if motion is None:
            return cls(**given)._without_sines()
        if not isinstance(motion, Motion):
            raise ValueError(f"motion = {checks.shown(motion)}: must be a stepcore.Motion")
        if given:
            raise ValueError(
                f"motion and {min(given)} are both given: write {min(given)} into the Motion"
            )
        name, takes = measurement.__name__, inspect.signature(measurement).parameters
        for word in (field.name for field in fields(cls) if field.name not in takes):
            if getattr(motion, word) is not getattr(cls, word):
                raise ValueError(f"motion: {name} does not use {word}; leave it out of the Motion")
        return motion._without_sines()

    def _without_sines(self) -> Motion:
        """The same motion; measurements run sines where nothing else is given."""
        return replace(self, ctrl=None) if self.follows_sines else self

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
        ]
        return f"Motion({', '.join(parts)})"


def takes_motion(*, without: tuple[str, ...] = ()) -> Callable[[F], F]:
    """Decorator of a measurement: each field of `Motion` is a keyword argument of it.

    without: the fields that it does not use.
    """

    def spelled_out(measurement: F) -> F:
        own = [field for field in fields(Motion) if field.name not in without]
        return spell_out(measurement, [keyword(f.name, f.default, f.type) for f in own])

    return spelled_out
