"""Gymnasium environments: gymnasium's MuJoCo tasks run by stepcore, and your own models.

Importing this module registers the tasks:

>>> import gymnasium, stepcore.gymnasium
>>> env = gymnasium.make("stepcore/HalfCheetah-v0")
>>> env.reset(seed=0)[0].shape
(17,)
>>> envs = gymnasium.make_vec("stepcore/HalfCheetah-v0", num_envs=16)
>>> envs.reset(seed=0)[0].shape
(16, 17)

The extra "gymnasium" installs the dependencies; see docs/gymnasium.md.
"""

from stepcore.needs import need as _need

_gymnasium = _need("gymnasium", "stepcore.gymnasium", "gymnasium")

from stepcore.gymnasium.env import Env, VectorEnv  # noqa: E402
from stepcore.gymnasium.moment import Draws, Moment, TaskState  # noqa: E402
from stepcore.gymnasium.returns import Return  # noqa: E402
from stepcore.gymnasium.task import Task  # noqa: E402
from stepcore.gymnasium.tasks import TASKS as _TASKS  # noqa: E402

__all__ = ["Draws", "Env", "Moment", "Return", "Task", "TaskState", "VectorEnv", "register_envs"]


def register_envs() -> None:
    """Register every task as "stepcore/<name>-v0", unless it is registered already."""
    for name, entry in _TASKS.items():
        name_v0 = f"stepcore/{name}-v0"
        if name_v0 not in _gymnasium.registry:
            _gymnasium.register(
                name_v0,
                entry_point="stepcore.gymnasium.tasks:make",
                vector_entry_point="stepcore.gymnasium.tasks:make_vec",
                max_episode_steps=entry.max_episode_steps,
                reward_threshold=entry.reward_threshold,
                kwargs={"task": name},
            )


register_envs()
