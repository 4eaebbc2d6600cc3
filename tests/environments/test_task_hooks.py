"""What a task does besides observing and rewarding: controls, memory, events, values, origins."""

import pickle

import gymnasium
import numpy as np
import pytest

import stepcore as sc
from stepcore.gymnasium import Env, Task, VectorEnv

CART = """<mujoco><option timestep="0.01"/><worldbody>
<body name="cart"><joint name="x" type="slide" axis="1 0 0" damping="0.5"/>
<geom name="hull" size="0.1" mass="1"/><site name="tip" pos="0 0 0.2"/>
<body name="pole"><joint name="angle" type="hinge" axis="0 1 0"/>
<geom type="capsule" fromto="0 0 0 0 0 0.6" size="0.03" mass="0.2"/></body></body></worldbody>
<actuator><motor joint="x" ctrlrange="-3 3"/></actuator>
<sensor><jointvel joint="angle"/></sensor></mujoco>"""
N = 5


class Commanded(Task):
    """Follow a speed that changes, by a motor that is late, while somebody pushes."""

    frame_skip = 4

    def __init__(self, values=True):
        self.values = values

    def model(self):
        return sc.loads(CART).compile()

    def start(self, model, rng, worlds):
        qpos = rng.uniform(-0.1, 0.1, size=model.nq)
        qpos[..., 0] += 2.0 * (worlds > 100)
        return qpos, rng.normal(size=model.nv)

    def randomize(self, model, rng, worlds):
        if not self.values:
            return {}
        return {
            "body/pole/mass": rng.uniform(0.1, 0.3),
            "joint/x/damping": rng.uniform(0.1, 1.0),
        }

    def begin(self, now):
        now.state.command = now.rng.uniform(-1, 1)
        now.state.last = np.zeros((*now.shape, 1))
        now.state.age = np.zeros(now.shape, dtype=int)
        now.state.pushed = np.zeros(now.shape)

    def control(self, now):
        late = now.state.last.copy()
        now.state.last = now.action
        return 3.0 * np.tanh(late[..., :1])

    def before_step(self, now, step):
        if step == 2:
            push = now.rng.normal(0.5)
            now.state.pushed = push
            now.world.xfrc_applied[..., 1, 0] = push
        if step == 3:
            now.world.xfrc_applied[..., 1, 0] = 0.0

    def after_action(self, now):
        now.state.age += 1
        renewed = now.rng.uniform(-1, 1)
        now.state.command = np.where(now.state.age % 7 == 0, renewed, now.state.command)

    def observe(self, now):
        parts = [now.qpos, now.qvel, now.state.last, now.sensordata, now.actuator_force]
        parts += [now.state.command[..., None], now.site_xpos[..., 0, :]]
        return np.concatenate(parts, axis=-1)

    def reward(self, now):
        change = np.sum(np.square(now.action - now.before.action), axis=-1)
        return -np.abs(now.qvel[..., 0] - now.state.command) - 0.1 * change

    def terminated(self, now):
        return np.abs(now.qpos[..., 1]) > 0.3

    def info(self, now):
        return {"command": now.state.command, "pushed": now.state.pushed, "age": now.state.age}

    def reset_info(self, now):
        return {"command": now.state.command}


@pytest.mark.parametrize("values", [False, True])
@pytest.mark.parametrize("mode", ["SameStep", "NextStep"])
def test_one_world_is_one_of_many(values, mode):
    """Every hook, bit for bit: memory, delays, pushes, values of the model, streams of numbers."""
    many = VectorEnv(
        Commanded(values), N, autoreset_mode=mode, max_episode_steps=11, dtype=np.float32
    )
    ones = [Env(Commanded(values), dtype=np.float32) for _ in range(N)]
    observations, told = many.reset(seed=7)
    for world, one in enumerate(ones):
        observation, own = one.reset(seed=7 + world)
        assert np.array_equal(observation, observations[world])
        assert observation.dtype == observations.dtype == np.float32
        assert own["command"] == told["command"][world]
    assert len(set(told["command"].tolist())) == N
    rng, over, ended = np.random.default_rng(0), [False] * N, 0
    for _ in range(50):
        actions = rng.normal(size=(N, 1)).astype(np.float32)
        observations, rewards, done, cut, infos = many.step(actions)
        for world, one in enumerate(ones):
            if over[world]:
                observation, _ = one.reset()
                over[world] = False
                assert np.array_equal(observation, observations[world])
                continue
            observation, value, finished, _, own = one.step(actions[world])
            assert (value, finished) == (rewards[world], done[world])
            now_over = bool(finished or cut[world])
            ended += now_over
            if mode == "NextStep":
                over[world] = now_over
                assert own["pushed"] == infos["pushed"][world]
            elif now_over:
                assert np.array_equal(infos["final_obs"][world], observation)
                assert own["age"] == infos["final_info"]["age"][world]
                observation, _ = one.reset()
            assert np.array_equal(observation, observations[world])
    assert ended > N


def test_values_of_the_model_are_those_of_the_world():
    many = VectorEnv(Commanded(), N, max_episode_steps=5, autoreset_mode="SameStep")
    many.reset(seed=0)
    masses = many.batch.param["body/pole/mass"]
    assert len(set(masses.tolist())) == N and (masses >= 0.1).all() and (masses < 0.3).all()
    for _ in range(5):
        many.step(np.zeros((N, 1)))
    assert not np.isin(many.batch.param["body/pole/mass"], masses).any()
    one = Env(Commanded())
    one.reset(seed=0)
    assert one.sim.model.body_mass[-1] == masses[0]


def test_a_control_is_late_and_scaled():
    env = Env(Commanded(values=False))
    env.reset(seed=0)
    assert env.step(np.array([1.0]))[0][6] == 0.0
    observation = env.step(np.array([0.5]))[0]
    assert observation[4] == 0.5 and observation[6] == pytest.approx(3 * np.tanh(1.0))


class Scaled(Task):
    """An action of another size than the controls."""

    def model(self):
        return sc.loads(CART).compile()

    def action_space(self, model):
        return gymnasium.spaces.Box(-1, 1, (2,), np.float32)

    def control(self, now):
        return now.action[..., :1] - now.action[..., 1:]


def test_an_action_may_have_another_size():
    many = VectorEnv(Scaled(), 2)
    many.reset(seed=0)
    many.step(np.array([[1.0, 0.25], [0.0, 0.5]], dtype=np.float32))
    assert many.batch.ctrl.tolist() == [[0.75], [-0.5]]
    with pytest.raises(ValueError, match=r"action has shape \(2, 1\): must be \(2, 2\)"):
        many.step(np.zeros((2, 1)))


@pytest.mark.parametrize(
    ("hook", "function", "error", "text"),
    [
        ("control", lambda self, now: now.action[..., :0], ValueError, "control returned shape"),
        ("control", lambda self, now: now.before.qpos, AttributeError, "keep it in now.state"),
        ("reward", lambda self, now: now.state.commnd, AttributeError, 'state has no "commnd"'),
        ("after_action", lambda self, now: setattr(now.state, "age", 0.5), ValueError, "int64"),
        ("start", lambda self, m, r, w: (np.zeros(3), np.zeros(2)), ValueError, "reset gave qpos"),
        ("randomize", lambda self, m, r, w: {"body/pol/mass": r.uniform()}, ValueError, "pole"),
    ],
)
def test_bad_hooks_are_refused(hook, function, error, text):
    with pytest.raises(error, match=text):
        VectorEnv(type("Bad", (Commanded,), {hook: function})(), 3).reset(seed=0)


def test_attributes_are_read_and_set_as_in_gymnasium():
    many = VectorEnv(Commanded(values=False), 3)
    commands = many.reset(seed=0)[1]["command"]
    assert many.get_attr("command") == tuple(commands)
    assert many.call("dt") == (0.04,) * 3 and many.get_attr("frame_skip") == (4,) * 3
    assert many.call("np_random") == many.np_random
    assert many.get_attr("action_space") == (many.single_action_space,) * 3
    assert many.call("has", "control") == (True,) * 3
    many.set_attr("command", [0.1, 0.2, 0.3])
    many.set_attr("values", True)
    assert many.get_attr("command") == (0.1, 0.2, 0.3) and many.call("values") == (True,) * 3
    with pytest.raises(AttributeError, match='no "comand"; nearest: "command"'):
        many.get_attr("comand")
    with pytest.raises(ValueError, match="values has 2 entries: must be 3"):
        many.set_attr("command", [0.1, 0.2])
    with pytest.raises(ValueError, match="the same in all worlds"):
        many.set_attr("values", [True, False, True])
    wrapped = gymnasium.make_vec("stepcore/HalfCheetah-v0", num_envs=2)
    assert wrapped.get_attr("ctrl_cost_weight") == (0.1, 0.1)


def test_observations_of_float32_and_one_array_for_all_calls():
    envs = gymnasium.make_vec("stepcore/HalfCheetah-v0", num_envs=2, dtype="float32", copy=False)
    space = envs.single_observation_space
    assert space.dtype == np.float32 and envs.observation_space.dtype == np.float32
    observations, _ = envs.reset(seed=0)
    shared = np.from_dlpack(observations)
    assert np.shares_memory(shared, observations) and observations.dtype == np.float32
    again = envs.step(envs.action_space.sample())[0]
    assert again is observations and np.array_equal(shared, again)
    wide = gymnasium.make_vec("stepcore/HalfCheetah-v0", num_envs=2)
    assert np.array_equal(wide.reset(seed=0)[0].astype(np.float32), envs.reset(seed=0)[0])
    with pytest.raises(ValueError, match="dtype = 'int32': must be"):
        gymnasium.make("stepcore/HalfCheetah-v0", dtype="int32")


def test_torch_sees_worlds_and_observations_without_a_copy():
    torch = pytest.importorskip("torch")
    envs = VectorEnv(Commanded(values=False), 3, dtype=np.float32, copy=False)
    seen = torch.from_dlpack(envs.reset(seed=0)[0])
    qpos = torch.from_dlpack(envs.batch.qpos)
    envs.step(torch.zeros(3, 1))
    last = envs.step(torch.ones(3, 1))[0]
    assert seen.dtype == torch.float32 and seen.tolist() == last.tolist()
    assert qpos.tolist() == envs.batch.qpos.tolist()


class Terrain(Task):
    """Balls on one height field, each at an origin of its own."""

    frame_skip = 5
    origins = np.array([[-3.0, -1.0], [-1.0, -1.0], [1.0, 1.0], [3.0, 1.0]])

    def model(self):
        rows, columns = np.mgrid[0:1:9j, 0:1:17j]
        scene = sc.Scene()
        hills = scene.add_hfield("hills", columns + 0 * rows, size=(4.0, 2.0, 0.5, 0.1))
        scene.add_geom("world", "hfield", hfield=hills)
        ball = scene.add_body("ball", pos=(0, 0, 1))
        scene.add_joint(ball, "free")
        scene.add_geom(ball, "sphere", 0.1, mass=1.0)
        return scene.compile()

    def start(self, model, rng, worlds):
        qpos = np.tile(model.qpos0, (len(worlds), 1))
        qpos[:, :2] = self.origins[worlds % len(self.origins)] + rng.uniform(-0.2, 0.2, size=2)
        return qpos, np.zeros(model.nv)

    def begin(self, now):
        now.state.origin = self.origins[now.worlds % len(self.origins)]

    def observe(self, now):
        return np.concatenate([now.qpos[..., :2] - now.state.origin, now.qpos[..., 2:3]], axis=-1)


def test_terrain_differs_by_world():
    """One height field rises along x: a ball comes to rest higher where its origin is farther."""
    envs = VectorEnv(Terrain(), 8)
    first, _ = envs.reset(seed=0)
    assert (np.abs(first[:, :2]) < 0.2).all() and len(np.unique(first[:, 0])) == 8
    for _ in range(80):
        last = envs.step(np.zeros((8, 0)))[0]
    heights = last[:, 2].reshape(2, 4)
    assert (np.diff(heights, axis=1) > 0.05).all()


def test_environments_with_memory_are_copied():
    many = VectorEnv(Commanded(), 3, max_episode_steps=6)
    many.reset(seed=0)
    many.step(np.ones((3, 1)))
    other = pickle.loads(pickle.dumps(many))
    for _ in range(9):
        ours, theirs = many.step(np.ones((3, 1))), other.step(np.ones((3, 1)))
        assert all(np.array_equal(a, b) for a, b in zip(ours[:4], theirs[:4], strict=True))
