"""Environments draw themselves where they are asked to."""

from __future__ import annotations

import gymnasium
import numpy as np
import pytest

import stepcore.gymnasium

stepcore.gymnasium.register_envs()


def test_an_environment_draws_the_state_it_is_in():
    options = {"render_mode": "rgb_array", "width": 96, "height": 64}
    env = gymnasium.make("stepcore/HalfCheetah-v0", **options)
    env.reset(seed=0)
    first = env.render()
    assert first.shape == (64, 96, 3) and first.dtype == np.uint8 and first.std() > 5
    assert np.array_equal(env.render(), first)
    for _ in range(5):
        env.step(env.action_space.sample())
    qpos = env.unwrapped.sim.qpos.copy()
    assert not np.array_equal(env.render(), first)
    assert np.array_equal(env.unwrapped.sim.qpos, qpos)
    assert env.metadata == {"render_modes": ["rgb_array"], "render_fps": 20}
    env.close()


def test_a_vector_environment_draws_every_world_as_alone():
    options = {"render_mode": "rgb_array", "width": 64, "height": 64}
    envs = gymnasium.make_vec("stepcore/Hopper-v0", num_envs=2, **options)
    env = gymnasium.make("stepcore/Hopper-v0", **options)
    envs.reset(seed=4)
    env.reset(seed=4)
    drawn = envs.render()
    assert len(drawn) == 2 and np.array_equal(drawn[0], env.render())
    assert not np.array_equal(drawn[0], drawn[1])
    envs.close()
    env.close()


def test_a_render_shows_tendons_and_solves_nothing(monkeypatch):
    """The rope stands beside the ball, and is drawn where the state puts it."""
    text = """<mujoco><worldbody><site name="top" pos="0 .5 2"/><body pos="0 0 1">
      <joint type="slide" axis="0 0 1"/><geom size=".05" rgba="0 0 1 1"/>
      <geom size=".05" pos="0 1 0" rgba="0 0 1 1"/><site name="end" pos="0 .5 0"/></body>
      </worldbody><tendon><spatial><site site="top"/><site site="end"/></spatial></tendon>
      </mujoco>"""
    env = stepcore.gymnasium.Env(
        stepcore.loads(text), render_mode="rgb_array", width=160, height=160
    )
    env.reset(seed=0)
    monkeypatch.setattr(stepcore.Sim, "forward", lambda sim: pytest.fail("a picture solved"))
    drawn = env.render().astype(int)
    brick = (drawn[..., 0] > drawn[..., 1] + 60) & (drawn[..., 0] > drawn[..., 2] + 60)
    assert np.count_nonzero(brick.any(axis=1)) > 20
    env.close()


def test_gymnasium_makes_lists_of_pictures():
    options = {"render_mode": "rgb_array_list", "width": 64, "height": 48}
    env = gymnasium.make("stepcore/Reacher-v0", **options)
    env.reset(seed=0)
    env.step(env.action_space.sample())
    assert [picture.shape for picture in env.render()] == [(48, 64, 3)] * 2
    env.close()


def test_nothing_is_drawn_without_a_mode_and_sizes_are_checked():
    assert stepcore.gymnasium.Env(stepcore.lesson.drop()).render() is None
    assert stepcore.gymnasium.VectorEnv(stepcore.lesson.drop(), 2).render() is None
    with pytest.raises(ValueError, match="width = 1: must be a whole number from 2 to 8192"):
        stepcore.gymnasium.Env(stepcore.lesson.drop(), render_mode="rgb_array", width=1)
