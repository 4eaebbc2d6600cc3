"""A user's control function: the check of what it returns, and its name in words."""

from __future__ import annotations

import copy
import functools
import inspect
from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING, Any, TypeVar

import numpy as np
from numpy.typing import ArrayLike

from stepcore import checks
from stepcore._core import SimulationError
from stepcore.engine.arrays import Floats, numbers

if TYPE_CHECKING:
    from stepcore.engine.world import World

# A function of (time, sim) that returns the controls.
Control = Callable[[float, Any], ArrayLike]
SomeWorld = TypeVar("SomeWorld", bound="World")


class ControlError(ValueError):
    """A control function that no settings can run: what it returned, raised or did."""


def controls(function: Callable[[float, SomeWorld], ArrayLike], sim: SomeWorld) -> Floats:
    """What a control function returns at the present state of a Sim, shape (nu,).

    Raises ControlError for anything but nu real numbers, for numbers that are not finite where a
    run begins, for a function that steps or resets its Sim, and for a ValueError of its own: these
    are no fault of the settings. Raises ValueError for numbers that are not finite later, where the
    motion may have diverged.
    """
    name, time, nu = control_name(function), sim.time, sim.model.nu
    try:
        value = function(time, sim)
    except SimulationError:
        raise
    except ValueError as error:
        text = f"{type(error).__name__}: {checks.one_line(error)}"
        raise ControlError(f"{name} raised {text} (at time {time:g} s)") from error
    if sim.time != time:
        # A recording of such a run would be one of something else.
        raise ControlError(
            f"{name} must not step, reset or restore the Sim (time went from {time:g} s to "
            f"{sim.time:g} s)"
        )
    single = sim.settings.precision == "f32"
    limit = f"must return {nu} finite number{'s' * (nu != 1)}, one for each actuator"
    if single:
        limit = f"{limit}, in single precision"
    try:
        table = numbers("ctrl", value)
    except ValueError:
        text = f"{name} returned {checks.shown(value)} at time {time:g} s: {limit}"
        raise ControlError(text) from None
    if table.shape != (nu,) and not (nu == 1 and table.size == 1):
        shape = f"an array of shape {table.shape}" if np.ndim(value) else checks.shown(value)
        raise ControlError(f"{name} returned {shape} at time {time:g} s: {limit}")
    table = table.reshape(nu)
    with np.errstate(over="ignore"):
        finite = np.isfinite(table.astype(np.float32) if single else table)
    if not finite.all():
        k = int(np.flatnonzero(~finite)[0])
        actuator = sim.model.element_name("actuator", k)
        what = "NaN" if np.isnan(table[k]) else f"{table[k]:g}"
        text = f"{name} returned {what} for {actuator} at time {time:g} s: {limit}"
        raise (ControlError if time == 0 else ValueError)(text)
    return table


def fresh(function: Control) -> Control:
    """The function for one run: an object that can be called is copied as it is now.

    What it remembers of earlier calls then belongs to that run. A plain function is returned.
    """
    try:
        return copy.deepcopy(function)
    except Exception:  # what an object's own copying raises is of any type
        return function


def control_name(function: Callable[..., Any]) -> str:
    """A control function in words, with its file.

    >>> control_name(lambda time, sim: [])  # doctest: +ELLIPSIS
    'the control function `<lambda>, line ...`'
    """
    inner: Any = function
    while isinstance(inner, functools.partial):
        inner = inner.func
    inner = inspect.unwrap(inner)
    inner = getattr(inner, "__func__", inner)
    code = getattr(inner, "__code__", None)
    if code is None:
        return f"the control function `{getattr(inner, '__qualname__', type(inner).__name__)}`"
    name = getattr(inner, "__qualname__", code.co_name).rpartition("<locals>.")[2]
    if name == "<lambda>":
        name += f", line {code.co_firstlineno}"
    file = Path(code.co_filename).name
    return f"the control function `{name}`" + (f" of {file}" if not file.startswith("<") else "")
