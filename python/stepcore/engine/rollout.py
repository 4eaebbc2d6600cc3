"""`Rollout`: the states of a batch under given controls, and the recording loop."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from stepcore.engine.arrays import Floats
from stepcore.engine.control import finite_controls
from stepcore.engine.trajectory import RECORDED

if TYPE_CHECKING:
    from stepcore.engine.world import World

# Counts of a single Sim's solve, its error bar; and momentum, which is a pair of arrays.
ONLY_OF_ONE_WORLD = ("sweeps_done", "row_updates", "momentum", "error", "body_error")
NAMES = tuple(name for name in RECORDED if name not in ONLY_OF_ONE_WORLD)


class Rollout(NamedTuple):
    """The states of a batch after every step.

    qpos: shape (n, steps, nq).
    qvel: shape (n, steps, nv).
    act: shape (n, steps, na).
    recorded: further recorded quantities by name, each of shape (n, steps, …).
    """

    qpos: Floats
    qvel: Floats
    act: Floats
    recorded: Mapping[str, NDArray[Any]] = {}


def recorded_rollout(
    batch: World,
    roll: Callable[[Floats], object],
    ctrl: Floats,
    names: Sequence[str],
    told: Callable[[int], object] | None,
) -> Rollout:
    """Step one by one with `roll`, and read the recorded arrays after each step.

    Non-finite controls raise ValueError before the first step.
    """
    steps = ctrl.shape[1]
    parts: dict[str, list[NDArray[Any]]] = {name: [] for name in ("qpos", "qvel", "act", *names)}
    finite = finite_controls(batch, ctrl)
    if not finite.all():
        world, step, actuator = np.argwhere(~finite)[0]
        number = ctrl[world, step, actuator]
        shown = "NaN" if np.isnan(number) else f"{number:g}"
        where = f"ctrl[{world}, {step}, {actuator}]"
        raise ValueError(f"{where} = {shown}: must be finite; nothing was stepped")
    for step in range(steps):
        roll(ctrl[:, step : step + 1])
        for name, values in parts.items():
            values.append(np.array(getattr(batch, name)))
        if told is not None:
            told(1)
    empty = {name: np.asarray(getattr(batch, name))[:, None][:, :0] for name in parts if not steps}
    whole = {name: np.stack(values, axis=1) for name, values in parts.items() if steps} | empty
    recorded = {name: whole[name] for name in names}
    return Rollout(whole["qpos"], whole["qvel"], whole["act"], recorded)
