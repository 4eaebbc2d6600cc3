"""Register the tasks in gymnasium."""

from __future__ import annotations

import gymnasium

from stepcore.gymnasium.tasks import TASKS

MODULE = "stepcore.gymnasium.tasks"


def register_envs() -> None:
    """Register every task as "stepcore/<name>-v0", unless it is registered already."""
    for name, entry in TASKS.items():
        known = f"stepcore/{name}-v0"
        if known not in gymnasium.registry:
            gymnasium.register(
                known,
                entry_point=f"{MODULE}:make",
                vector_entry_point=f"{MODULE}:make_vec",
                max_episode_steps=entry.max_episode_steps,
                reward_threshold=entry.reward_threshold,
                kwargs={"task": name},
            )
