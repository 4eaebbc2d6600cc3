"""`Return`: the return of a task as a quantity of interest, for `stepcore.trade`."""

from __future__ import annotations

import copy
import math
import os
from collections.abc import Callable, Sequence
from typing import Any

import numpy as np
from gymnasium.utils import seeding
from numpy.typing import ArrayLike

from stepcore import checks
from stepcore._core import Settings
from stepcore.engine.batch import Batch, unwatched
from stepcore.engine.control import ControlError
from stepcore.engine.model import Model
from stepcore.executors import checkpoint
from stepcore.experiment.motion import Motion
from stepcore.experiment.policy import Policy, policy
from stepcore.experiment.quantity import Quantity
from stepcore.gymnasium import tasks
from stepcore.gymnasium.env_core import EnvCore
from stepcore.gymnasium.task import Task
from stepcore.report import units
from stepcore.report.units import seconds

# The default horizon [s], if episodes are not shorter: gymnasium's last up to 50 s.
HORIZON = 5.0
FLIES = "a body flies away"


class Return(Quantity):
    """The sum of the rewards of an episode of a task under a policy.

    Each start is a reset of the task, seeded by its index, and a run ends where the task terminates
    or truncates it. The task's observation, reward and period are the same for every time step.

    task: a `Task`, or the name of one: "stepcore/Ant-v0".
    policy: a function of the observations of many worlds, (n, k), that returns their actions,
        (n, nu), and depends on nothing else; or the path of an .onnx or TorchScript file.
    horizon: the duration of an episode [s], or a text such as "2s"; by default 5 s, and never more
        than gymnasium's limit.
    seed: of the first reset.

    Raises ValueError for an unknown task, with the nearest name.

    >>> import stepcore as sc
    >>> from stepcore.gymnasium import Return
    >>> def balance(observations):
    ...     return observations @ [[1.0], [10.0], [1.0], [2.0]]
    >>> quantity = Return("stepcore/InvertedPendulum-v0", balance, horizon=0.4)
    >>> result = sc.trade(quantity.model, quantity=quantity, starts=64, most=64)
    >>> result.shipped.mean
    10.0
    """

    plays = True

    def __init__(
        self,
        task: Task | str,
        policy: Callable[[Any], ArrayLike] | str | os.PathLike[str],
        *,
        horizon: float | str | None = None,
        seed: int = 0,
    ) -> None:
        function: Any = policy
        if isinstance(policy, (Policy, str, os.PathLike)):
            function = _Network(policy)
        super().__init__("return", function)
        limit, self_ = math.inf, self.__dict__
        if isinstance(task, str):
            entry, task = _named(task)
            limit = entry.max_episode_steps
        if not isinstance(task, Task):
            raise checks.refuse("Return", "task", task, 'a Task, or a name: "stepcore/Ant-v0"')
        length = HORIZON if horizon is None else units.time("horizon", horizon)
        self_["task"], self_["seed"] = task, checks.count("seed", seed, least=0)
        self_["model"] = task.model()
        self_["period"] = self.model.settings.dt * task.frame_skip
        self_["actions"] = int(min(limit, max(1, round(length / self.period))))

    task: Task
    model: Model
    period: float
    actions: int
    seed: int

    @property
    def motion(self) -> Motion:
        """The horizon and the period of the episodes; with random controls, to count work."""
        return Motion(horizon=self.actions * self.period, control_dt=self.period, seed=self.seed)

    @property
    def words(self) -> str:  # type: ignore[override]
        """The episodes in words."""
        policy = getattr(self.function, "__qualname__", type(self.function).__name__)
        return (
            f"{seconds(self.actions * self.period)} of episodes of {type(self.task).__name__} "
            f"under the policy {checks.cut(policy)}, from its resets"
        )

    def play(
        self, settings: Settings, starts: Sequence[int], farthest: float
    ) -> tuple[np.ndarray, str]:
        """Return the return of an episode from each start, NaN if it failed, and a failure.

        farthest: the distance of a body from its start beyond which a run has failed [m].

        Raises ValueError for a policy that returns anything but finite actions.
        """
        task, count = copy.copy(self.task), len(starts)
        vars(task).update(frame_skip=round(self.period / settings.dt), model=lambda: self.model)
        core = EnvCore("Return", task, settings, None, None, 0, 0, n=count, how={"threads": 1})
        assert isinstance(core.world, Batch)
        world = unwatched(core.world)
        rngs = [seeding.np_random(self.seed + start)[0] for start in starts]
        now, returns, failure = core.begin(np.arange(count), rngs), np.zeros(count), ""
        running, first = np.ones(count, dtype=bool), np.array(world.xpos)
        for _ in range(self.actions):
            checkpoint()
            with np.errstate(over="ignore", invalid="ignore"):
                observations = task.observe(now)
            now, errors = core.act(self._actions(observations, core.model.nu, starts, running))
            failed = ~(np.abs(world.xpos - first).max(axis=(1, 2)) < farthest)
            failed[list(errors)] = True
            for k in np.flatnonzero(failed & running).tolist():
                returns[k] = np.nan
                failure = failure or f"start {starts[k]}: {errors.get(k, FLIES)}"
            running &= ~failed
            with np.errstate(over="ignore", invalid="ignore"):
                reward, terminated, _ = task.outcome(now)
            returns += np.where(running, reward, 0.0)
            running &= ~np.asarray(terminated, dtype=bool)
            if not running.any():
                break
            core.keep(now)
        return returns, failure

    def _actions(
        self, observations: np.ndarray, size: int, starts: Sequence[int], running: np.ndarray
    ) -> np.ndarray:
        """Return the actions of a policy, (n, nu); zeros where an episode is over."""
        assert self.function is not None
        try:
            actions = np.asarray(self.function(observations), dtype=float)
        except Exception as error:
            text = f"{type(error).__name__}: {checks.one_line(error)}"
            raise ControlError(f"policy: raised {text}") from error
        if actions.shape != (len(observations), size):
            limit = f"({len(observations)}, {size})"
            raise ControlError(f"policy: returned shape {actions.shape}: must be {limit}")
        actions = np.where(running[:, None], actions, 0.0)
        if not np.isfinite(actions).all():
            start = starts[int(np.flatnonzero(~np.isfinite(actions).all(axis=1))[0])]
            raise ControlError(f"policy: an action is not finite in the run from start {start}")
        return actions


class _Network:
    """A network as a function of observations, (n, k)."""

    def __init__(self, control: Any) -> None:
        self.control: Any = control if isinstance(control, Policy) else policy(control)
        self.__qualname__ = self.control.__qualname__

    def __call__(self, observations: np.ndarray) -> Any:
        return self.control.network()(np.asarray(observations, dtype=np.float32))


def _named(name: str) -> tuple[tasks.Entry, Task]:
    """Return a registered task; ValueError for an unknown one, with the nearest name."""
    names = {f"stepcore/{task}-v0": task for task in tasks.TASKS}
    if name not in names:
        near = checks.nearest(name, names)
        raise ValueError(f"task: there is no task {checks.quoted(name)}{near}")
    return tasks.TASKS[names[name]], getattr(tasks, names[name])()
