"""Check of a user's control function, and the function's name in sentences."""

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
    from stepcore.engine.model import Model
    from stepcore.engine.world import World

# A function of (time, sim) that returns the controls.
Control = Callable[[float, Any], ArrayLike]
SomeWorld = TypeVar("SomeWorld", bound="World")


class ControlError(ValueError):
    """A control function failed for a reason that no settings can avoid."""

    @classmethod
    def not_repeatable(cls, function: Callable[..., Any], occasion: str) -> ControlError:
        """Return the error of a function with other results in a repeated run."""
        return cls(
            f"{control_name(function)} returned other controls when {occasion}: it is random, or "
            "remembers earlier calls. Runs with it cannot be compared; give a callable object that "
            "keeps its memory in its attributes, of which each run gets a copy"
        )


def evaluate_control(function: Callable[[float, SomeWorld], ArrayLike], sim: SomeWorld) -> Floats:
    """Return the result of a control function at the present state of a Sim, shape (nu,).

    Raises ControlError for anything but nu real numbers, for non-finite numbers at the beginning of
    a run, for a function that steps or resets its Sim, and for a ValueError raised by the function:
    the settings cannot cause these errors. Raises ValueError for non-finite numbers later in the
    run, where the motion may have diverged.
    """
    time, nu = sim.time, sim.model.nu
    if is_batched(function):
        world: Any = _OneWorld(sim)
        return batch_controls(function, world)[0]
    try:
        value = function(time, sim)
    except SimulationError:
        raise
    except ValueError as error:
        text = f"{type(error).__name__}: {checks.one_line(error)}"
        text = f"{control_name(function)} raised {text} (at time {time:g} s)"
        raise ControlError(text) from error
    if sim.time != time:
        # The recorded times would not match the motion.
        raise ControlError(
            f"{control_name(function)} must not step, reset or restore the Sim (time went from "
            f"{time:g} s to {sim.time:g} s)"
        )
    try:
        table = numbers("ctrl", value)
    except ValueError:
        raise ControlError(_refused(function, sim, checks.shown(value))) from None
    if table.shape != (nu,) and not (nu == 1 and table.size == 1):
        shape = f"an array of shape {table.shape}" if np.ndim(value) else checks.shown(value)
        raise ControlError(_refused(function, sim, shape))
    table = table.reshape(nu)
    if bad := not_finite(sim, table):
        (k,) = bad
        entry = "NaN" if np.isnan(table[k]) else f"{table[k]:g}"
        text = _refused(function, sim, f"{entry} for {sim.model.element_name('actuator', k)}")
        raise (ControlError if time == 0 else ValueError)(text)
    return table


def batched(function: Control) -> Control:
    """Mark a control function of many worlds, which is called once per period for all of them.

    Use it as a decorator. The function takes (time, worlds), where ``worlds.qpos`` has the shape
    (n, nq), as of a `Batch`, and returns the controls, (n, nu). A measurement then runs its starts
    together, in batches of any size, so that the controls of a world must depend on that world
    alone. Where single runs are made, n is 1.

    >>> import stepcore as sc
    >>> @sc.batched
    ... def balance(time, worlds):
    ...     return 5.0 * worlds.qpos[:, 1:] + worlds.qvel[:, 1:]
    >>> motion = sc.Motion(control=balance, control_dt=0.02)
    """
    function.batched = True  # type: ignore[attr-defined]
    return function


def is_batched(function: Callable[..., Any] | None) -> bool:
    """Return whether a control function takes many worlds; see `batched`."""
    return bool(getattr(inspect.unwrap(function), "batched", False)) if function else False


class _OneWorld:
    """A Sim as the only world of a batch: its arrays have a leading axis of length 1."""

    def __init__(self, sim: World) -> None:
        self._sim = sim

    def __getattr__(self, name: str) -> Any:
        value = getattr(self._sim, name)
        return value[None] if isinstance(value, np.ndarray) else value


def batch_controls(function: Callable[[float, SomeWorld], ArrayLike], worlds: SomeWorld) -> Floats:
    """Return the result of a function of many worlds, (n, nu); errors as of `evaluate_control`."""
    time, shape = worlds.time, (len(worlds.qpos), worlds.model.nu)
    try:
        table = numbers("ctrl", function(time, worlds))
    except SimulationError:
        raise
    except ValueError as error:
        text = f"{type(error).__name__}: {checks.one_line(error)}"
        raise ControlError(
            f"{control_name(function)} raised {text} (at time {time:g} s)"
        ) from error
    if table.shape != shape:
        limit = f"must return controls of {shape[0]} worlds, shape {shape}"
        text = f"{control_name(function)} returned an array of shape {table.shape}"
        raise ControlError(f"{text} at time {time:g} s: {limit}")
    if not np.isfinite(table).all():
        raise ControlError(f"{control_name(function)} returned numbers that are not finite")
    return table


def _refused(function: Callable[..., Any], sim: World, returned: str) -> str:
    """Return the error text for a control function that returned this value."""
    nu, single = sim.model.nu, ", in single precision" * (sim.settings.precision == "f32")
    limit = f"must return {nu} finite number{'s' * (nu != 1)}, one for each actuator{single}"
    return f"{control_name(function)} returned {returned} at time {sim.time:g} s: {limit}"


def not_finite(sim: World | Model, table: Floats) -> tuple[int, ...]:
    """Return the first index of a table at which no number is finite in the settings' precision.

    () if all are.
    """
    with np.errstate(over="ignore"):
        single = sim.settings.precision == "f32"
        finite = np.isfinite(table.astype(np.float32) if single else table)
    return () if finite.all() else tuple(int(k) for k in np.argwhere(~finite)[0])


def new_control(function: Control) -> Control:
    """Return the function for one run; a callable object is copied.

    The state that the object keeps between calls then belongs to that run. A plain function is
    returned unchanged.
    """
    try:
        return copy.deepcopy(function)
    except Exception:  # copying a user-defined object can raise any error
        return function


def control_option(function: Callable[..., Any]) -> str:
    """Return the value of the option --control: "file.py:function", or a placeholder."""
    name = getattr(function, "__qualname__", "")
    file = getattr(getattr(function, "__code__", None), "co_filename", "")
    if isinstance(path := getattr(function, "path", None), str):
        # A policy.
        return path
    if not name.isidentifier():
        return "FILE.py:FUNCTION"
    return f"{file if Path(file).is_file() else 'FILE.py'}:{name}"


def control_name(function: Callable[..., Any]) -> str:
    """Return the name of a control function for sentences, with its file.

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
