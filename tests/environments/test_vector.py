"""A vector environment is, bit for bit, as many single ones: gymnasium's own `SyncVectorEnv`."""

import copy
import pickle

import gymnasium
import numpy as np
import pytest
from covering import every_pair, every_value
from gymnasium.vector import AutoresetMode

import stepcore.gymnasium
from stepcore.gymnasium.tasks import TASKS

N = 11


def vector(name, n=N, **options):
    return gymnasium.make_vec(f"stepcore/{name}-v0", num_envs=n, **options)


def same(ours, theirs, what):
    """The same structure, types and bits."""
    if isinstance(theirs, tuple):
        assert len(ours) == len(theirs), what
        for index, (mine, other) in enumerate(zip(ours, theirs, strict=True)):
            same(mine, other, f"{what}, {index}")
    elif isinstance(theirs, dict):
        assert set(ours) == set(theirs), what
        for name, value in theirs.items():
            same(ours[name], value, f"{what}, {name}")
    elif theirs is None or ours is None:
        assert ours is theirs, what
    elif theirs.dtype == object:
        assert ours.dtype == object, what
        same(tuple(ours), tuple(theirs), what)
    else:
        assert ours.dtype == theirs.dtype, what
        assert np.array_equal(ours, theirs), what


@every_value(name=TASKS, mode=AutoresetMode)
def test_it_is_gymnasiums_vector_environment_of_single_ones(name, mode):
    ours = vector(name, autoreset_mode=mode, max_episode_steps=20)
    theirs = vector(
        name,
        vectorization_mode="sync",
        vector_kwargs={"autoreset_mode": mode},
        max_episode_steps=20,
    )
    assert ours.observation_space == theirs.observation_space
    assert ours.action_space == theirs.action_space
    same(ours.reset(seed=3), theirs.reset(seed=3), "reset")
    ours.action_space.seed(0)
    ended = 0
    for step in range(50):
        actions = ours.action_space.sample()
        mine, other = ours.step(actions), theirs.step(actions)
        same(mine, other, f"action {step}")
        over = other[2] | other[3]
        ended += over.sum()
        if mode is AutoresetMode.DISABLED and over.any():
            chosen = {"reset_mask": over}
            same(ours.reset(options=dict(chosen)), theirs.reset(options=chosen), f"after {step}")
    assert ended > N
    assert ours.np_random_seed == theirs.np_random_seed
    assert [rng.random() for rng in ours.np_random] == [rng.random() for rng in theirs.np_random]


@pytest.mark.parametrize("how", [{"lanes": False}, {"threads": 3}, {"settings": {"dt": 0.01}}])
def test_bits_do_not_depend_on_how_worlds_are_stepped(how):
    first, second = vector("Hopper", settings={"dt": 0.01}), None
    second = vector("Hopper", **{"settings": {"dt": 0.01}, **how})
    same(first.reset(seed=5), second.reset(seed=5), "reset")
    first.action_space.seed(1)
    for step in range(30):
        actions = first.action_space.sample()
        same(first.step(actions), second.step(actions), f"action {step}")


SETTINGS = ({}, {"precision": "f32"}, {"integrator": "implicitfast", "dt": 0.005})


@every_pair(name=["Ant", "Humanoid", "Reacher"], settings=SETTINGS)
def test_a_world_does_not_depend_on_its_neighbours(name, settings):
    """World 3 of 5 seeded with 10 is the single environment seeded with 13."""
    many = vector(name, 5, settings=settings)
    one = gymnasium.make(f"stepcore/{name}-v0", settings=settings)
    observations, _ = many.reset(seed=10)
    observation, _ = one.reset(seed=13)
    assert np.array_equal(observations[3], observation)
    many.action_space.seed(0)
    for _ in range(10):
        actions = many.action_space.sample()
        assert np.array_equal(many.step(actions)[0][3], one.step(actions[3])[0])


def test_a_masked_reset_leaves_the_others():
    ours = vector("Walker2d", autoreset_mode="Disabled")
    before, _ = ours.reset(seed=0)
    ours.action_space.seed(0)
    for _ in range(5):
        before = ours.step(ours.action_space.sample())[0]
    mask = np.arange(N) % 3 == 0
    after, infos = ours.reset(seed=list(range(N)), options={"reset_mask": mask})
    assert np.array_equal(before[~mask], after[~mask])
    assert not np.any(before[mask] == after[mask])
    assert np.array_equal(infos["_x_position"], mask)
    fresh, _ = vector("Walker2d").reset(seed=0)
    assert np.array_equal(after[mask], fresh[mask])


@every_pair(name=["HalfCheetah", "Ant"], mode=["NextStep", "SameStep"])
def test_a_world_that_fails_ends_alone(name, mode):
    ours, clean = (vector(name, autoreset_mode=mode) for _ in range(2))
    ours.reset(seed=0), clean.reset(seed=0)
    ours.action_space.seed(0)
    for step in range(8):
        if step == 2:
            ours.unwrapped.batch.qvel[4, 3] = 1e200
        actions = ours.action_space.sample()
        mine, other = ours.step(actions), clean.step(actions)
        others = np.arange(N) != 4
        for index in range(4):
            assert np.array_equal(mine[index][others], other[index][others])
        assert np.isfinite(mine[0]).all()
        assert mine[2][4] == (step == 2)
        infos = mine[4]["final_info"] if mode == "SameStep" and step == 2 else mine[4]
        if step == 2:
            assert infos["_failure"].tolist() == [not other for other in others]
            assert "step" in infos["failure"][4]
        else:
            assert "failure" not in infos


def test_a_single_world_that_fails_ends():
    """With the reading of MuJoCo's last stage as well."""
    for name in ("HalfCheetah", "Ant"):
        env = gymnasium.make(f"stepcore/{name}-v0")
        env.reset(seed=0)
        env.unwrapped.sim.qvel[3] = 1e200
        observation, reward, terminated, truncated, info = env.step(env.action_space.sample())
        assert (terminated, truncated) == (True, False)
        assert np.isfinite(observation).all()
        assert "failure" in info
        assert np.isfinite(reward) or name == "HalfCheetah"
        assert env.reset()[0].shape == observation.shape


def test_bad_calls_change_nothing():
    ours = vector("Hopper", 3, autoreset_mode="Disabled")
    with pytest.raises(gymnasium.error.ResetNeeded, match="call reset first"):
        ours.step(ours.action_space.sample())
    first, _ = ours.reset(seed=0)
    with pytest.raises(ValueError, match=r"reset_mask = .* 3 truth values"):
        ours.reset(options={"reset_mask": np.zeros(3, dtype=bool)})
    with pytest.raises(ValueError, match="seed has 2 entries: must be 3"):
        ours.reset(seed=[1, 2])
    with pytest.raises(ValueError, match="options"):
        ours.reset(options={"key": 1})
    with pytest.raises(ValueError, match=r"action has shape \(3,\): must be \(3, 3\)"):
        ours.step(np.zeros(3))
    with pytest.raises(ValueError, match="ctrl"):
        ours.step(np.full((3, 3), np.nan))
    assert np.array_equal(ours.step(np.zeros((3, 3)))[0].shape, first.shape)
    with pytest.raises(ValueError, match="one of NextStep, SameStep, Disabled"):
        vector("Hopper", 3, autoreset_mode="Sometimes")
    with pytest.raises(ValueError, match="num_envs = 0"):
        vector("Hopper", 0)
    with pytest.raises(ValueError, match="render_mode = 'human'"):
        vector("Hopper", 3, render_mode="human")


def test_a_world_that_is_over_must_be_reset_where_nothing_else_does():
    ours = vector("Hopper", 3, autoreset_mode="Disabled", max_episode_steps=2)
    ours.reset(seed=0)
    ours.step(np.zeros((3, 3)))
    ours.step(np.zeros((3, 3)))
    with pytest.raises(gymnasium.error.ResetNeeded, match=r"worlds \[0, 1, 2\] are over"):
        ours.step(np.zeros((3, 3)))


def test_gymnasiums_wrappers_go_on_top():
    ours = gymnasium.wrappers.vector.RecordEpisodeStatistics(vector("Hopper", 4))
    ours.reset(seed=0)
    returns = []
    for _ in range(60):
        infos = ours.step(ours.action_space.sample())[4]
        returns += infos["episode"]["r"][infos["_episode"]].tolist() if "episode" in infos else []
    assert returns


def test_copies_go_on_alike():
    for env in (vector("Ant", 3), gymnasium.make("stepcore/Ant-v0").unwrapped):
        env.reset(seed=0)
        env.action_space.seed(0)
        env.step(env.action_space.sample())
        copies = pickle.loads(pickle.dumps(env)), copy.deepcopy(env)
        for _ in range(3):
            action = env.action_space.sample()
            wanted = env.step(action)
            for other in copies:
                np.testing.assert_equal(other.step(action), wanted)


def test_the_package_says_what_it_has():
    assert set(stepcore.gymnasium.__all__) <= set(dir(stepcore.gymnasium))
