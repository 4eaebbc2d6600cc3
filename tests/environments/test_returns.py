"""`Return`: the return of a task against loops of its environment, in `trade`, and bad input."""

import json

import gymnasium
import numpy as np
import pytest

import stepcore as sc
from stepcore.cli import main
from stepcore.experiment import Quantity
from stepcore.gymnasium import Return, Task

GAINS = np.random.default_rng(3).normal(size=(120, 17)) / 4
FAR = 1e6


class Linear:
    """Clipped linear actions; a module's class, so that it can be sent to processes."""

    def __init__(self, inputs, outputs):
        self.gains = GAINS[:inputs, :outputs]

    def __call__(self, observations):
        return np.clip(observations @ self.gains, -1, 1)


def linear(name):
    env = gymnasium.make(f"stepcore/{name}-v0")
    return Linear(env.observation_space.shape[0], env.action_space.shape[0])


def balance(observations):
    return observations @ [[1.0], [10.0], [1.0], [2.0]]


@pytest.mark.parametrize("name", ["Hopper", "Swimmer", "InvertedDoublePendulum", "Ant"])
def test_a_return_is_that_of_the_environment(name):
    policy = linear(name)
    quantity = Return(f"stepcore/{name}-v0", policy, horizon=1.0, seed=5)
    returns, failure = quantity.play(quantity.model.settings, range(4), FAR)
    for start, number in enumerate(returns):
        env = gymnasium.make(f"stepcore/{name}-v0")
        observation, _ = env.reset(seed=5 + start)
        total, over = 0.0, False
        for _ in range(quantity.actions):
            action = policy(observation[None])[0]
            observation, reward, over, _, _ = env.step(action)
            total += reward
            if over:
                break
        assert number == pytest.approx(total, rel=1e-12)
    assert not failure


def test_shorter_steps_keep_the_period_and_the_resets():
    quantity = Return("stepcore/InvertedPendulum-v0", balance, horizon=0.4)
    fine = quantity.model.settings.replace(dt=quantity.model.settings.dt / 4)
    returns, _ = quantity.play(fine, range(3), FAR)
    assert returns.tolist() == [10, 10, 10]  # one a period of 40 ms


def test_episodes_end_at_the_limit_of_gymnasium():
    assert Return("stepcore/Reacher-v0", linear("Reacher"), horizon=60).actions == 50


def test_a_run_that_flies_away_has_failed():
    quantity = Return("stepcore/HalfCheetah-v0", linear("HalfCheetah"), horizon=1.0)
    coarse = quantity.model.settings.replace(dt=0.05, integrator="semi-implicit")
    returns, failure = quantity.play(coarse, range(4), 100.0)
    assert np.isnan(returns).all() and failure.startswith("start ")


def test_trade_answers_whether_the_step_matters_for_a_policy(tmp_path):
    quantity = Return("stepcore/Swimmer-v0", linear("Swimmer"), horizon=0.4)
    result = sc.trade(quantity.model, quantity=quantity, error="50%", starts=64, most=64)
    numbers, _ = quantity.play(result.chosen.settings, range(64), FAR)
    assert result.chosen.numbers == pytest.approx(numbers, rel=1e-12)
    assert result.proof is not None and result.predictable == np.inf
    file = tmp_path / "pilot.py"
    file.write_text(
        "import numpy as np\ngains = np.random.default_rng(3).normal(size=(120, 17)) / 4\n"
        "def swim(rows):\n    return np.clip(rows @ gains[:8, :2], -1, 1)\n"
    )
    task = ["trade", "--task", "stepcore/Swimmer-v0", "--quantity", "return", "--error", "50%"]
    task += ["--control", f"{file}:swim", "--horizon", "0.4", "--starts", "64", "--most", "64"]
    assert main([*task, "--json", str(tmp_path / "out.json")]) == 0
    data = json.loads((tmp_path / "out.json").read_text())
    assert data["reference"]["mean"] == pytest.approx(result.reference.mean, rel=1e-9)


class Own(Task):
    """A slider that is rewarded for its speed."""

    frame_skip = 2

    def model(self):
        return sc.loads(
            '<mujoco><option timestep="0.02"/><worldbody><body><joint type="slide" axis="1 0 0"/>'
            '<geom size=".1" mass="1"/></body></worldbody></mujoco>'
        ).compile()

    def start(self, model, rng):
        return [0.0], rng.uniform(1, 2, size=1)

    def reward(self, now):
        return now.qvel[..., 0] * now.dt


def test_a_task_of_your_own():
    quantity = Return(Own(), lambda rows: np.zeros((len(rows), 0)), horizon=0.4)
    returns, _ = quantity.play(quantity.model.settings, range(3), FAR)
    expected = [np.random.default_rng(k) for k in range(3)]
    assert returns == pytest.approx([0.4 * rng.uniform(1, 2) for rng in expected], rel=1e-9)


def uneven(rows):
    return np.where(np.arange(len(rows))[:, None] == 2, np.nan, 0.0)


@pytest.mark.parametrize(
    ("policy", "words"),
    [
        (lambda rows: np.zeros(3), r"must be \(64, 1\)"),
        (lambda rows: 1 / 0, "ZeroDivisionError"),
        (uneven, "start 2"),
    ],
)
def test_bad_policies_are_refused(policy, words):
    quantity = Return("stepcore/InvertedPendulum-v0", policy, horizon=0.1)
    with pytest.raises(ValueError, match=words):
        sc.trade(quantity.model, quantity=quantity, starts=64, most=64)


def test_bad_input_is_refused():
    with pytest.raises(ValueError, match='nearest: "stepcore/Ant-v0"'):
        Return("stepcore/Antt-v0", balance)
    quantity = Return("stepcore/InvertedPendulum-v0", balance, horizon=0.1)
    for wrong, words in (
        ({"quantity": quantity, "horizon": 1.0}, "horizon"),
        ({"quantity": quantity, "engine": "mujoco"}, "engine"),
        ({"quantity": quantity, "statistic": "worst"}, "statistic"),
        ({"quantity": [quantity, Quantity("energy")], "error": [1, 1]}, "only quantity"),
    ):
        with pytest.raises(ValueError, match=words):
            sc.trade(quantity.model, **wrong)


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        (["--task", "stepcore/Ant-v0"], "--control"),
        (["--task", "stepcore/Ant-v0", "lesson:drop", "--control", "a.py:f"], "FILE"),
        (["--task", "stepcore/Ant-v0", "--quantity", "energy"], "must be return"),
        (["--error", "1mm"], "FILE, or --task"),
    ],
)
def test_the_command_refuses(arguments, words, capsys):
    assert main(["trade", *arguments]) == 2
    assert words in capsys.readouterr().err
