"""A user's control function: called with a check of what it returns, and its name in words."""

from __future__ import annotations

import copy
import functools
import inspect
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from stepcore import checks
from stepcore._core import SimulationError
from stepcore.engine.arrays import Floats, numbers
from stepcore.engine.sim import Sim
from stepcore.report.units import counted

# As in `Sim.run`: of (time, sim), the controls.
Control = Callable[[float, Sim], ArrayLike]


class ControlError(ValueError):
    """A control function that no settings can run: what it returned, or what it raised."""


def controls(function: Control, sim: Sim) -> Floats:
    """What a control function returns at the present state of a Sim, shape (nu,).

    Raises ControlError for anything but nu real numbers, for numbers that are not finite where a
    run begins, and for a ValueError of the function's own: these are no fault of the settings.
    Raises ValueError for numbers that are not finite later, where the motion may have diverged.
    """
    name, time, nu = control_name(function), sim.time, sim.model.nu
    try:
        value = function(time, sim)
    except SimulationError:
        raise
    except ValueError as error:
        text = f"{type(error).__name__}: {checks.one_line(error)}"
        raise ControlError(f"{name} raised {text} (at time {time:g} s)") from error
    limit = f"must return {counted(nu, 'finite number')}, one for each actuator"
    try:
        table = numbers("ctrl", value)
    except ValueError:
        text = f"{name} returned {checks.shown(value)} at time {time:g} s: {limit}"
        raise ControlError(text) from None
    if table.shape != (nu,) and not (nu == 1 and table.size == 1):
        shape = f"an array of shape {table.shape}" if np.ndim(value) else checks.shown(value)
        raise ControlError(f"{name} returned {shape} at time {time:g} s: {limit}")
    table = table.reshape(nu)
    if not np.isfinite(table).all():
        k = int(np.flatnonzero(~np.isfinite(table))[0])
        motor = sim.model.element_name("actuator", k)
        what = "NaN" if np.isnan(table[k]) else f"{table[k]:g}"
        text = f"{name} returned {what} for {motor} at time {time:g} s: {limit}"
        raise (ControlError if time == 0 else ValueError)(text)
    return table


def fresh(function: Control) -> Control:
    """The function for a run of its own: an object that can be called is copied as it is now.

    What it remembers of earlier calls then belongs to its run. A plain function is returned.
    """
    try:
        return copy.deepcopy(function)
    except Exception:  # what an object's own copying raises is of any type
        return function


def control_name(function: Control) -> str:
    """A control function in words, with the file that it is from.

    >>> def walk(time, sim): ...
    >>> control_name(walk).startswith("the control function `walk`")
    True
    """
    own: Any = function
    while isinstance(own, functools.partial):
        own = own.func
    own = inspect.unwrap(own)
    own = getattr(own, "__func__", own)
    code = getattr(own, "__code__", None)
    if code is None:
        return f"the control function `{getattr(own, '__qualname__', type(own).__name__)}`"
    name = getattr(own, "__qualname__", code.co_name).rpartition("<locals>.")[2]
    if name == "<lambda>":
        name += f", line {code.co_firstlineno}"
    file = Path(code.co_filename).name
    return f"the control function `{name}`" + (f" of {file}" if not file.startswith("<") else "")
