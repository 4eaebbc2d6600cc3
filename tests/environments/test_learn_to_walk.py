"""The example that learns to walk: its slopes are right, it improves, and it runs."""

import importlib
import sys
from pathlib import Path

import numpy as np
import pytest

import stepcore as sc
from stepcore.gymnasium import Task, VectorEnv

EXAMPLES = Path(__file__).parents[2] / "examples"


@pytest.fixture
def example(monkeypatch):
    monkeypatch.syspath_prepend(str(EXAMPLES))
    yield importlib.import_module
    for name in ("ppo", "learn_to_walk"):
        sys.modules.pop(name, None)


def test_slopes_are_those_of_differences(example):
    network = example("ppo").Network([3, 5, 4, 2], np.random.default_rng(0), 0.5)
    network.weights = [w.astype(np.float64) for w in network.weights]
    rng = np.random.default_rng(1)
    seen, towards = rng.normal(size=(7, 3)), rng.normal(size=(7, 2))
    network(seen)
    for w, slope in zip(network.weights, network.slopes(towards), strict=True):
        for place in np.ndindex(w.shape):
            ends = []
            for move in (1e-6, -1e-6):
                w[place] += move
                ends.append(np.sum(network(seen) * towards))
                w[place] -= move
            assert slope[place] == pytest.approx((ends[0] - ends[1]) / 2e-6, abs=1e-7)


def test_advantages_are_sums_of_surprises(example):
    ppo = example("ppo")
    rng = np.random.default_rng(0)
    data = {name: rng.normal(size=(ppo.STEPS, 3)) for name in ("reward", "value")}
    data["over"] = rng.random((ppo.STEPS, 3)) < 0.2
    last = rng.normal(size=3)
    found = ppo.gains(data, last).reshape(ppo.STEPS, 3)
    values = np.vstack([data["value"], last])
    for world in range(3):
        for k in range(ppo.STEPS):
            total, weight = 0.0, 1.0
            for j in range(k, ppo.STEPS):
                on = 1.0 - data["over"][j, world]
                after = ppo.GAMMA * on * values[j + 1, world]
                total += weight * (data["reward"][j, world] + after - values[j, world])
                weight *= ppo.GAMMA * ppo.LAMBDA * on
            assert found[k, world] == pytest.approx(total)


class Push(Task):
    """A slider follows a speed: the reward is highest at one action."""

    frame_skip = 2

    def model(self):
        scene = sc.Scene(gravity=(0, 0, 0))
        body = scene.add_body("slider")
        scene.add_joint(body, "slide", axis=(1, 0, 0), name="x", damping=10.0)
        scene.add_geom(body, "sphere", 0.1, mass=0.1)
        scene.add_actuator("x", "motor", ctrlrange=(-9, 9))
        return scene.compile()

    def reward(self, now):
        return -np.abs(now.action[..., 0] - 1.0)

    def info(self, now):
        return {"missed": np.abs(now.action[..., 0] - 1.0)}


def test_it_learns(example):
    envs = VectorEnv(Push(), 64, dtype=np.float32, autoreset_mode="SameStep", max_episode_steps=50)
    lines = []
    for ppo, line in example("ppo").learn(envs, 10.0):  # noqa: B007
        lines.append(line["missed"])
        if len(lines) == 4:
            break
    assert lines[0] > 0.5 and lines[-1] < 0.7 * lines[0]
    assert abs(float(ppo.actor(envs.reset()[0]).mean()) - 1.0) < 0.4


def test_a_task_without_info_learns_and_a_checkpoint_continues(example, tmp_path):
    ppo, task = example("ppo"), Push()
    task.info = lambda now: {}
    envs = VectorEnv(task, 8, dtype=np.float32, autoreset_mode="SameStep", max_episode_steps=50)
    learner, line = next(ppo.learn(envs, 10.0))
    assert "missed" not in line
    learner.save(tmp_path / "policy.npz")
    other = ppo.PPO(2, 1, np.random.default_rng(1))
    other.load(tmp_path / "policy.npz")
    for name, array in learner.arrays().items():
        np.testing.assert_array_equal(other.arrays()[name], array)


def test_an_exported_policy_is_the_mean_action(example, tmp_path):
    pytest.importorskip("onnx")
    pytest.importorskip("onnxruntime")
    ppo = example("ppo").PPO(4, 1, np.random.default_rng(0))
    ppo.export(tmp_path / "policy.onnx")
    sim = sc.Sim(sc.load("gymnasium:inverted_pendulum"))
    sim.qpos[:], sim.qvel[:] = (0.1, 0.2), (0.3, -0.4)
    seen = np.concatenate([sim.qpos, sim.qvel]).astype(np.float32)
    control = sc.policy(tmp_path / "policy.onnx")
    assert control(0.0, sim) == pytest.approx(ppo.actor(seen[None])[0], rel=1e-5)


def test_the_example_runs(example, monkeypatch, capsys, tmp_path):
    monkeypatch.setattr(
        sys, "argv", ["", "--minutes", "0.01", "--worlds", "8", "--curve", str(tmp_path / "c.json")]
    )
    example("learn_to_walk").main()
    assert "walked 10 s:" in capsys.readouterr().out and (tmp_path / "c.json").exists()
