"""Adapters for stable-baselines3 and rsl_rl, with the libraries where they are installed."""

import sys

import gymnasium
import numpy as np
import pytest

import stepcore as sc
from stepcore.gymnasium import Task, VectorEnv, adapters


class Push(Task):
    """A slider follows a speed: the reward is highest at an action of 1."""

    frame_skip = 2

    def model(self):
        scene = sc.Scene(gravity=(0, 0, 0))
        body = scene.add_body("slider")
        scene.add_joint(body, "slide", axis=(1, 0, 0), name="x", damping=10.0)
        scene.add_geom(body, "sphere", 0.1, mass=0.1)
        scene.add_actuator("x", "motor", ctrlrange=(-2, 2))
        return scene.compile()

    def reward(self, now):
        return -np.abs(now.action[..., 0] - 1.0)

    def info(self, now):
        return {"missed": np.abs(now.action[..., 0] - 1.0)}


def envs(n=4, **options):
    options = {"max_episode_steps": 5, "autoreset_mode": "SameStep"} | options
    return VectorEnv(Push(), n, **options)


def test_a_vector_environment_that_resets_later_is_refused():
    pytest.importorskip("stable_baselines3")
    with pytest.raises(ValueError, match=r"autoreset_mode = 'NextStep': must be SameStep"):
        adapters.stable_baselines3(envs(autoreset_mode="NextStep"))


def test_a_missing_library_is_named_with_the_command_that_installs_it(monkeypatch):
    monkeypatch.setitem(sys.modules, "stable_baselines3.common.vec_env", None)
    with pytest.raises(ImportError, match="pip install stable-baselines3"):
        adapters.stable_baselines3(envs())


def test_stable_baselines3_gets_the_steps_of_the_environment():
    """Observations, rewards and ends are the environment's own; the last observation is kept."""
    library = pytest.importorskip("stable_baselines3")
    adapted, own = adapters.stable_baselines3(envs()), envs()
    adapted.seed(3)
    np.testing.assert_array_equal(adapted.reset(), own.reset(seed=3)[0].astype(np.float32))
    actions = np.linspace(-1, 1, 4, dtype=np.float32)[:, None]
    for k in range(1, 6):
        seen, rewards, done, infos = adapted.step(actions)
        expected, earned, _, _, last = own.step(actions)
        np.testing.assert_array_equal(seen, expected.astype(np.float32))
        np.testing.assert_array_equal(rewards, earned.astype(np.float32))
        assert done.all() == (k == 5)
    assert infos[2]["TimeLimit.truncated"] and infos[2]["missed"] == last["final_info"]["missed"][2]
    np.testing.assert_allclose(infos[2]["terminal_observation"], last["final_obs"][2], rtol=1e-6)
    assert adapted.get_attr("dt", [1]) == [own.dt]
    learner = library.PPO("MlpPolicy", adapted, n_steps=8, batch_size=16, device="cpu")
    assert learner.learn(64).num_timesteps == 64


CONFIG = {
    "num_steps_per_env": 8,
    "save_interval": 100,
    "obs_groups": {"actor": ["policy"], "critic": ["policy", "privileged"]},
    "algorithm": {"class_name": "PPO", "num_mini_batches": 2, "num_learning_epochs": 2},
    "actor": {
        "class_name": "MLPModel",
        "hidden_dims": [8],
        "activation": "tanh",
        "distribution_cfg": {"class_name": "GaussianDistribution", "init_std": 0.5},
    },
    "critic": {"class_name": "MLPModel", "hidden_dims": [8], "activation": "tanh"},
}


@pytest.mark.filterwarnings("ignore")
def test_rsl_rl_learns_with_privileged_columns_and_named_terms():
    torch, runners = pytest.importorskip("torch"), pytest.importorskip("rsl_rl.runners")
    adapted = adapters.rsl_rl(envs(), {"policy": slice(0, 1), "privileged": [1]})
    seen = adapted.get_observations()
    assert seen["policy"].shape == seen["privileged"].shape == (4, 1)
    for k in range(1, 6):
        _, rewards, done, extras = adapted.step(torch.full((4, 1), 0.25))
        assert torch.equal(rewards, torch.full((4,), -0.75))
        assert bool(done.all()) == bool(extras["time_outs"].all()) == (k == 5)
    adapted.step(torch.full((4, 1), 0.25))
    adapted.episode_length_buf = torch.tensor([4, 0, 0, 0])
    _, _, done, extras = adapted.step(torch.full((4, 1), 0.25))
    assert done.tolist() == [1, 0, 0, 0] and extras["log"] == {"/missed": 0.75}
    runner = runners.OnPolicyRunner(adapted, CONFIG, log_dir=None)
    runner.learn(2)
    with pytest.raises(ValueError, match="max_episode_steps = None"):
        adapters.rsl_rl(envs(max_episode_steps=None))
    same_step = {"autoreset_mode": gymnasium.vector.AutoresetMode.SAME_STEP}
    with pytest.raises(ValueError, match="must be a VectorEnv of stepcore"):
        adapters.rsl_rl(gymnasium.make_vec("CartPole-v1", 2, "sync", vector_kwargs=same_step))
