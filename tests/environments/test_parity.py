"""gymnasium's MuJoCo tasks against gymnasium itself, version 5, over 200 random actions
(1,000 with `-m long`).

MuJoCo's solver stops when an iteration gains little, at some steps 1e-7 from its solution. So
theirs iterates to the end here (tolerance 0), and the two humanoids, whose 50 sweeps of PGS end
far from it, use Newton on both sides. Nothing else of theirs is changed.

Step by step, each action is taken from their state. Free, both go on by themselves: where the
motion is chaotic only for as long as rounding stays small.
"""

import gymnasium
import numpy as np
import pytest

import stepcore.gymnasium
from stepcore.gymnasium.tasks import TASKS

HUMANS = ("Humanoid", "HumanoidStandup")
# How many random actions rounding stays below 1e-9; 1,000 for the others.
CHAOTIC = {"Ant": 60, "HalfCheetah": 25, "HumanoidStandup": 200}
ACTIONS = [200, pytest.param(1000, marks=pytest.mark.long)]


def pair(name, **options):
    """Our environment and theirs."""
    ours = {"settings": {"solver": "newton"}} if name in HUMANS else {}
    env = gymnasium.make(f"stepcore/{name}-v0", **ours, **options)
    other = gymnasium.make(f"{name}-v5", **options)
    option = other.unwrapped.model.opt
    option.tolerance, option.ls_tolerance, option.ls_iterations = 0.0, 1e-10, 200
    if name in HUMANS:
        option.solver, option.iterations = 2, 100
    return env, other


def same(ours, theirs, what):
    """Numbers are the same to 1e-9, of themselves where they are above 1."""
    ours, theirs = np.asarray(ours, dtype=float), np.asarray(theirs, dtype=float)
    assert ours.shape == theirs.shape, what
    assert np.all(np.abs(ours - theirs) <= 1e-9 * np.maximum(1, np.abs(theirs))), what


def same_result(ours, theirs, what):
    """Observations, rewards, flags and information, in the form of a step or of a reset."""
    assert len(ours) == len(theirs)
    for mine, other in zip(ours[:-1], theirs[:-1], strict=True):
        same(mine, other, what)
    assert set(ours[-1]) == set(theirs[-1]), what
    for name, value in theirs[-1].items():
        same(ours[-1][name], value, f"{what}: {name}")


def compare(env, other, actions, *, from_theirs):
    same_result(env.reset(seed=1), other.reset(seed=1), "reset")
    env.action_space.seed(2)
    for step in range(actions):
        if from_theirs:
            sim, data = env.unwrapped.sim, other.unwrapped.data
            sim.qpos, sim.qvel = data.qpos, data.qvel
        action = env.action_space.sample()
        theirs = other.step(action)
        same_result(env.step(action), theirs, f"action {step}")
        if theirs[2] or theirs[3]:
            same_result(env.reset(), other.reset(), f"reset after action {step}")


@pytest.mark.parametrize("actions", ACTIONS)
@pytest.mark.parametrize("name", TASKS)
def test_every_step_is_theirs(name, actions):
    compare(*pair(name), actions, from_theirs=True)


@pytest.mark.parametrize("actions", ACTIONS)
@pytest.mark.parametrize("name", TASKS)
def test_free_runs_are_theirs(name, actions):
    compare(*pair(name), min(actions, CHAOTIC.get(name, actions)), from_theirs=False)


@pytest.mark.parametrize("name", TASKS)
def test_spaces_and_limits_are_theirs(name):
    env, other = pair(name)
    assert env.observation_space == other.observation_space
    assert env.action_space == other.action_space
    assert env.spec.max_episode_steps == other.spec.max_episode_steps
    assert env.spec.reward_threshold == other.spec.reward_threshold
    assert env.unwrapped.dt == other.unwrapped.dt


FORWARD = {"forward_reward_weight": 2.5, "ctrl_cost_weight": 0.3}
ALL = {"exclude_current_positions_from_observation": False}
NO_OBSERVATIONS = {
    f"include_{name}_in_observation": False
    for name in ("cinert", "cvel", "qfrc_actuator", "cfrc_ext")
}
OPTIONS = [
    ("Ant", {**FORWARD, **ALL, "contact_cost_weight": 0.2, "contact_force_range": (-5, 7)}),
    ("Ant", {"main_body": "aux_1", "healthy_reward": 3, "terminate_when_unhealthy": False}),
    ("Ant", {"include_cfrc_ext_in_observation": False, "healthy_z_range": (0.6, 0.8)}),
    ("Ant", {"contact_force_range": (0.3, 0.8)}),
    ("HalfCheetah", {**FORWARD, **ALL, "reset_noise_scale": 0.3, "frame_skip": 3}),
    ("Hopper", {**FORWARD, **ALL, "healthy_angle_range": (-0.05, 0.05)}),
    ("Hopper", {"healthy_reward": 2.0, "healthy_state_range": (-1, 1), "healthy_z_range": (0, 9)}),
    ("Hopper", {"terminate_when_unhealthy": False, "reset_noise_scale": 0.05}),
    ("Walker2d", {**FORWARD, **ALL, "healthy_z_range": (1.2, 1.3), "healthy_reward": 0.5}),
    ("Walker2d", {"healthy_angle_range": (-0.1, 0.1), "xml_file": "walker2d.xml"}),
    ("Swimmer", {**FORWARD, **ALL, "reset_noise_scale": 0.5, "frame_skip": 1}),
    ("Humanoid", {**FORWARD, **ALL, "contact_cost_weight": 0.1, "contact_cost_range": (1, 5)}),
    ("Humanoid", {**NO_OBSERVATIONS, "healthy_z_range": (1.3, 1.5), "healthy_reward": 1}),
    ("Humanoid", {"terminate_when_unhealthy": False, "reset_noise_scale": 0.1}),
    ("HumanoidStandup", {**ALL, "uph_cost_weight": 2, "ctrl_cost_weight": 0.5}),
    ("HumanoidStandup", {**NO_OBSERVATIONS, "impact_cost_range": (0.1, 2)}),
    ("HumanoidStandup", {"impact_cost_weight": 1e-3, "reset_noise_scale": 0.05}),
    ("InvertedPendulum", {"reset_noise_scale": 0.1, "frame_skip": 5}),
    ("InvertedDoublePendulum", {"healthy_reward": 3.0, "reset_noise_scale": 0.3}),
    ("Reacher", {"reward_dist_weight": 2.0, "reward_control_weight": 3.0}),
    ("Pusher", {"reward_near_weight": 2.0, "reward_dist_weight": 3, "reward_control_weight": 4}),
]


@pytest.mark.parametrize(("name", "options"), OPTIONS)
def test_options_are_theirs(name, options):
    compare(*pair(name, **options), 25, from_theirs=True)


def test_the_models_that_gymnasium_ships_solve_less():
    """As they are, without tolerance 0: at most steps to 1e-9 too, at some to 1e-5."""
    env, other = gymnasium.make("stepcore/Ant-v0"), gymnasium.make("Ant-v5")
    env.reset(seed=0), other.reset(seed=0)
    env.action_space.seed(0)
    errors = []
    for _ in range(300):
        sim, data = env.unwrapped.sim, other.unwrapped.data
        sim.qpos, sim.qvel = data.qpos, data.qvel
        action = env.action_space.sample()
        ours, theirs = env.step(action), other.step(action)
        errors.append(np.abs(ours[0] - theirs[0]).max())
        if theirs[2]:
            env.reset(), other.reset()
    assert np.median(errors) < 1e-12
    assert max(errors) < 1e-5


def test_a_misspelt_option_and_an_unknown_file_are_refused():
    with pytest.raises(TypeError, match="forward_reward_weigth"):
        gymnasium.make("stepcore/Ant-v0", forward_reward_weigth=1)
    with pytest.raises(ValueError, match=r'xml_file = \'anr.xml\'.*nearest: "ant.xml"'):
        gymnasium.make("stepcore/Ant-v0", xml_file="anr.xml")


def test_importing_registers_once():
    stepcore.gymnasium.register_envs()
    assert gymnasium.make("stepcore.gymnasium:stepcore/Reacher-v0").spec.max_episode_steps == 50
