"""Environments of one's own model: functions that are written once, for one world and for many."""

import gymnasium
import numpy as np
import pytest
from gymnasium.spaces import Box

import stepcore as sc
from stepcore.gymnasium import Env, Task, VectorEnv

CART = """<mujoco><option timestep="0.01"/><worldbody>
<body name="cart"><joint name="x" type="slide" axis="1 0 0" damping="0.5"/>
<geom size="0.1" mass="1"/><site name="tip" pos="0 0 0.2"/>
<body name="pole"><joint name="angle" type="hinge" axis="0 1 0"/>
<geom type="capsule" fromto="0 0 0 0 0 0.6" size="0.03" mass="0.2"/></body></body></worldbody>
<actuator><motor joint="x" ctrlrange="-3 3"/></actuator>
<sensor><jointvel joint="angle"/></sensor></mujoco>"""


def observe(now):
    return np.concatenate([now.site_xpos[..., 0, :], now.qvel, now.sensordata], axis=-1)


def reward(now):
    speed = (now.site_xpos[..., 0, 0] - now.before.site_xpos[..., 0, 0]) / now.dt
    return speed - 0.1 * np.sum(np.square(now.action), axis=-1)


def terminated(now):
    return np.abs(now.qpos[..., 1]) > 0.3


def info(now):
    return {"x": now.qpos[..., 0], "force": now.actuator_force}


def reset(model, rng):
    return rng.uniform(-0.1, 0.1, model.nq), rng.normal(size=model.nv)


FUNCTIONS = {
    "observe": observe,
    "reward": reward,
    "terminated": terminated,
    "info": info,
    "reset": reset,
    "frame_skip": 4,
}


def test_the_same_functions_serve_one_world_and_many():
    scene, n = sc.loads(CART), 5
    many = VectorEnv(scene, n, **FUNCTIONS, autoreset_mode="SameStep", max_episode_steps=12)
    ones = [Env(scene, **FUNCTIONS) for _ in range(n)]
    observations, _ = many.reset(seed=7)
    for world, one in enumerate(ones):
        assert np.array_equal(one.reset(seed=7 + world)[0], observations[world])
    many.action_space.seed(0)
    ended = 0
    for step in range(40):
        actions = many.action_space.sample()
        observations, rewards, over, cut, infos = many.step(actions)
        for world, one in enumerate(ones):
            observation, value, done, _, told = one.step(actions[world])
            assert (value, done) == (rewards[world], over[world]), step
            if done or cut[world]:
                ended += 1
                assert np.array_equal(infos["final_obs"][world], observation)
                assert infos["final_info"]["x"][world] == told["x"]
                observation, _ = one.reset()
            else:
                assert np.array_equal(infos["force"][world], told["force"])
            assert np.array_equal(observations[world], observation)
    assert ended > n


def test_what_it_tells_is_what_the_world_has():
    """Poses are of the present state, sensors of the last step."""
    env = Env(sc.loads(CART), **FUNCTIONS)
    env.reset(seed=1)
    before = env.sim.site_xpos[0, 0]
    observation, value, _, _, told = env.step(np.array([0.5], dtype=np.float32))
    assert env.dt == 0.04
    assert np.array_equal(observation[:3], env.sim.site_xpos[0])
    assert observation[-1] == env.sim.sensordata[0]
    assert value == pytest.approx((env.sim.site_xpos[0, 0] - before) / 0.04 - 0.025, rel=1e-7)
    assert told["force"].tolist() == [0.5]
    env.sim.step()
    assert told["x"] != env.sim.qpos[0]


def test_defaults():
    """qpos and qvel, no reward, no end, from the model's first state."""
    env = Env(sc.loads(CART))
    observation, told = env.reset(seed=0)
    assert observation.tolist() == [0] * 4
    assert told == {}
    assert env.action_space == Box(-3, 3, (1,), np.float32)
    observation, value, over, cut, told = env.step(np.array([1.0]))
    assert observation.tolist() == [*env.sim.qpos, *env.sim.qvel]
    assert (value, over, cut, told) == (0, False, False, {})


def test_own_spaces_and_settings():
    action, seen = Box(-1, 1, (1,), np.float64), Box(-9, 9, (4,), np.float64)
    env = Env(sc.loads(CART), action_space=action, observation_space=seen, settings={"dt": 0.02})
    assert (env.action_space, env.observation_space, env.dt) == (action, seen, 0.02)
    single = Box(-9, 9, (4,), np.float32)
    many = VectorEnv(sc.loads(CART), 3, settings=sc.Settings(dt=0.005), observation_space=single)
    assert many.dt == 0.005
    assert many.observation_space.shape == (3, 4)
    assert many.reset(seed=0)[0].dtype == np.float32
    assert many.step(np.zeros((3, 1)))[0].dtype == np.float32


class Leaning(Task):
    """A task of one's own with an option."""

    frame_skip = 2

    def __init__(self, weight):
        self.weight = weight

    def model(self):
        return sc.loads(CART).compile()

    def reward(self, now):
        return -self.weight * np.abs(now.qpos[..., 1])


def test_a_task_is_a_class_with_options():
    env, many = Env(Leaning(3.0)), VectorEnv(Leaning(3.0), 2)
    env.reset(seed=0), many.reset(seed=0)
    value = env.step(np.array([1.0]))[1]
    assert value < 0
    assert many.step(np.array([[1.0], [1.0]]))[1].tolist() == [value, value]
    with pytest.raises(ValueError, match="reward: must be the task's own"):
        Env(Leaning(3.0), reward=reward)


@pytest.mark.parametrize(
    ("functions", "text"),
    [
        ({"observe": lambda now: now.qpos[0]}, r"observe returned shape \(2,\): must be \(3, k\)"),
        ({"reward": lambda now: now.qpos}, r"reward returned shape \(3, 2\): must be \(3,\)"),
        ({"reward": lambda now: "good"}, "reward returned 'good': must be numbers"),
        ({"terminated": lambda now: False}, r"terminated returned shape \(\): must be \(3,\)"),
        ({"info": lambda now: {"x": 1.0}}, r'info\["x"\] returned shape'),
        ({"reward": 3}, "reward = 3: must be a function"),
        ({"frame_skip": 0}, "frame_skip = 0"),
        ({"action_space": Box(-1, 1, (2,))}, r"action_space has shape \(2,\): must be \(1,\)"),
        ({"observation_space": Box(-1, 1, (2,))}, r"observation_space has shape \(2,\)"),
        ({"settings": {"dt": -1}}, "dt = -1"),
        ({"render_mode": "human"}, "render_mode = 'human'"),
    ],
)
def test_bad_arguments_are_refused(functions, text):
    with pytest.raises(ValueError, match=text):
        VectorEnv(sc.loads(CART), 3, **functions)


def test_an_unknown_array_and_a_bad_reset_are_refused():
    with pytest.raises(AttributeError, match="xpso"):
        Env(sc.loads(CART), reward=lambda now: now.xpso[..., 0])
    env = Env(sc.loads(CART), reset=lambda model, rng: (np.zeros(3), np.zeros(2)))
    with pytest.raises(ValueError, match=r"reset gave qpos of shape \(3,\): must be \(2,\)"):
        env.reset()
    with pytest.raises(gymnasium.error.ResetNeeded):
        Env(sc.loads(CART)).step(np.zeros(1))


def test_an_array_asked_for_late_is_refused_where_it_is_not_known():
    asked = []

    def later(now):
        return now.before.xpos[..., 1, 0] if asked else np.zeros(now.shape)

    env = Env(sc.loads(CART), reward=later)
    env.reset(seed=0)
    asked.append(True)
    with pytest.raises(AttributeError, match="xpos was not read when the environment was created"):
        env.step(np.zeros(1))
