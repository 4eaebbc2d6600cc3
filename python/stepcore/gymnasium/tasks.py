"""gymnasium's MuJoCo tasks, version 5, and their table."""

from __future__ import annotations

import inspect
import os
from abc import abstractmethod
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any, ClassVar, NamedTuple, TypeVar

import numpy as np
from numpy.typing import NDArray

from stepcore import checks
from stepcore.engine.arrays import Floats
from stepcore.engine.model import Model
from stepcore.gymnasium.env import Env, VectorEnv
from stepcore.gymnasium.moment import Moment, once, state_vector
from stepcore.gymnasium.task import Outcome, Task, TaskFields
from stepcore.loading import find_asset, find_scene

E = TypeVar("E", Env, VectorEnv)


class Entry(NamedTuple):
    """gymnasium's registered limits of a task."""

    max_episode_steps: int
    reward_threshold: float | None


# The entries by name of the task's class.
TASKS = {
    "Ant": Entry(1000, 6000.0),
    "HalfCheetah": Entry(1000, 4800.0),
    "Hopper": Entry(1000, 3800.0),
    "Humanoid": Entry(1000, None),
    "HumanoidStandup": Entry(1000, None),
    "InvertedDoublePendulum": Entry(1000, 9100.0),
    "InvertedPendulum": Entry(1000, 950.0),
    "Pusher": Entry(100, 0.0),
    "Reacher": Entry(50, -3.75),
    "Swimmer": Entry(1000, 360.0),
    "Walker2d": Entry(1000, None),
}


def make(task: str, **options: Any) -> Env:
    """Make one world of a task, for `gymnasium.make`.

    options: the options of the task and of `Env`.
    """
    return _made(Env, task, options)


# gymnasium reads the render modes here, and adds modes that return lists of pictures.
make.metadata = Env.metadata  # type: ignore[attr-defined]


def make_vec(task: str, num_envs: int, **options: Any) -> VectorEnv:
    """Make many worlds of a task, for `gymnasium.make_vec`.

    options: the options of the task and of `VectorEnv`.
    """
    return _made(VectorEnv, task, options, num_envs)


def _made(kind: Callable[..., E], task: str, options: dict[str, Any], *n: int) -> E:
    allowed = inspect.signature(kind).parameters.keys() - TaskFields.__annotations__.keys()
    keywords = {name: options.pop(name) for name in allowed & options.keys()}
    return kind(globals()[task](**options), *n, **keywords)


# All files of gymnasium are in the folder of this one.
KNOWN_FILE = "mujoco/assets/half_cheetah"


@dataclass(frozen=True, kw_only=True)
class MujocoTask(Task):
    """One of gymnasium's MuJoCo tasks; the fields are arguments of `gymnasium.make`.

    xml_file: a file among gymnasium's models, or a path that begins with ".", "~" or "/".
    """

    xml_file: str = ""
    frame_skip: int = 5

    def model(self) -> Model:
        return find_scene(model_path(self.xml_file)).compile()

    @abstractmethod
    def parts(self, now: Moment) -> dict[str, Floats]:
        """Return the terms of the reward by name, for `info`."""

    def total(self, parts: dict[str, Floats]) -> Floats:
        """Return the reward."""
        return sum(parts.values())  # type: ignore[return-value]

    def outcome(self, now: Moment) -> Outcome:
        parts = self.parts(now)
        return self.total(parts), self.terminated(now), {**self.info(now), **parts}


@dataclass(frozen=True, kw_only=True)
class NoisyTask(MujocoTask):
    """A task that begins near the initial state of its model.

    The random numbers are the same as in gymnasium, in the same order.
    """

    # Whether the noise of the first velocities is normal; else it is uniform.
    normal: ClassVar[bool] = False

    reset_noise_scale: float = 0.1

    def start(self, model: Model, rng: np.random.Generator) -> tuple[Floats, Floats]:
        scale = self.reset_noise_scale
        qpos = model.qpos0 + rng.uniform(low=-scale, high=scale, size=model.nq)
        if self.normal:
            return qpos, scale * rng.standard_normal(model.nv)
        return qpos, rng.uniform(low=-scale, high=scale, size=model.nv)


@dataclass(frozen=True, kw_only=True)
class ForwardTask(NoisyTask):
    """Move forward along x."""

    # The coordinates of the position, with which qpos begins.
    axes: ClassVar[str] = "x"

    forward_reward_weight: float = 1.0
    ctrl_cost_weight: float = 0.1
    exclude_current_positions_from_observation: bool = True

    def observe(self, now: Moment) -> Floats:
        excluded = len(self.axes) * self.exclude_current_positions_from_observation
        return observed(now, excluded, now.qvel)

    @once
    def main_velocity(self, now: Moment, axis: int) -> Floats:
        """Return the velocity along an axis, shape ()."""
        return velocity(now, "qpos", (..., axis))

    def parts(self, now: Moment) -> dict[str, Floats]:
        return {
            "reward_forward": self.forward_reward_weight * self.main_velocity(now, 0),
            "reward_ctrl": -self.ctrl_cost_weight * squares(now.action),
        }

    def info(self, now: Moment) -> dict[str, Floats]:
        speeds = {f"{x}_velocity": self.main_velocity(now, k) for k, x in enumerate(self.axes)}
        return {**self.reset_info(now), **speeds}

    def reset_info(self, now: Moment) -> dict[str, Floats]:
        place = {f"{x}_position": now.qpos[..., k] for k, x in enumerate(self.axes)}
        if len(self.axes) > 1:
            place["distance_from_origin"] = distance(now.qpos[..., : len(self.axes)])
        return place


@dataclass(frozen=True, kw_only=True)
class StandingTask(ForwardTask):
    """Move forward without falling."""

    healthy_reward: float = 1.0
    terminate_when_unhealthy: bool = True

    @abstractmethod
    def healthy(self, now: Moment) -> NDArray[np.bool_]:
        """Return whether the robot is upright, shape ()."""

    def parts(self, now: Moment) -> dict[str, Floats]:
        survive: Any = self.healthy(now) * self.healthy_reward
        return {**super().parts(now), "reward_survive": survive}

    def terminated(self, now: Moment) -> NDArray[np.bool_]:
        return ~self.healthy(now) & self.terminate_when_unhealthy


def model_path(xml_file: str) -> str:
    """Return the path of a model by gymnasium's rule."""
    if not isinstance(xml_file, str):
        raise ValueError(f"xml_file = {checks.shown(xml_file)}: must be a text")
    path = Path(os.path.expanduser(xml_file))
    if not xml_file.startswith((".", "~", "/")):
        path = find_asset("gymnasium", KNOWN_FILE).parent / xml_file
    if not path.exists():
        files = sorted(file.name for file in path.parent.glob("*.xml"))
        near = checks.nearest(path.name, files)
        raise ValueError(f"xml_file = {checks.shown(xml_file)}: there is no such file{near}")
    return str(path)


def squares(values: NDArray[Any]) -> Any:
    """Return the sum of squares over the last axis."""
    return np.add.reduce(np.square(values), axis=-1)


def distance(x: Floats) -> Floats:
    """Return the length of vectors, shape (…, k)."""
    return np.sqrt(squares(x))


def velocity(now: Moment, name: str, index: Any) -> Floats:
    """Return the mean rate of entries of an array since the last action."""
    after, before = getattr(now, name)[index], getattr(now.before, name)[index]
    return (after - before) / now.dt


def observed(now: Moment, excluded: int, qvel: Floats) -> Floats:
    """Return qpos without its first entries, and the velocities."""
    return np.concatenate([now.qpos[..., excluded:], qvel], axis=-1)


# An episode is over when the pole leans more than this [rad].
LEANING = 0.2


@dataclass(frozen=True, kw_only=True)
class InvertedPendulum(NoisyTask):
    """gymnasium's InvertedPendulum-v5, with the same options."""

    xml_file: str = "inverted_pendulum.xml"
    frame_skip: int = 2
    reset_noise_scale: float = 0.01

    def parts(self, now: Moment) -> dict[str, Floats]:
        return {"reward_survive": (~self.terminated(now)).astype(np.int64)}

    @once
    def terminated(self, now: Moment) -> NDArray[np.bool_]:
        # The state is always finite: a world that fails keeps its last finite state.
        return np.abs(now.qpos[..., 1]) > LEANING


# Observed velocities [m/s or rad/s] and forces are clipped to this on either side.
LARGEST = 10.0


def clipped(values: Floats) -> Floats:
    """Clip observed values; on short arrays `numpy.clip` takes longer."""
    return np.minimum(np.maximum(values, -LARGEST), LARGEST)


@dataclass(frozen=True, kw_only=True)
class InvertedDoublePendulum(NoisyTask):
    """gymnasium's InvertedDoublePendulum-v5, with the same options."""

    normal: ClassVar[bool] = True
    late: ClassVar[tuple[str, ...]] = ("site_xpos", "constraint_force")  # type: ignore[misc]

    xml_file: str = "inverted_double_pendulum.xml"
    healthy_reward: float = 10.0

    def observe(self, now: Moment) -> Floats:
        angles = now.qpos[..., 1:]
        parts = [now.qpos[..., :1], np.sin(angles), np.cos(angles)]
        forces = (now.qvel, now.constraint_force[..., :1])
        parts += [clipped(values) for values in forces]
        return np.concatenate(parts, axis=-1)

    def parts(self, now: Moment) -> dict[str, Floats]:
        x, z = now.site_xpos[..., 0, 0], now.site_xpos[..., 0, 2]
        first, second = now.qvel[..., 1], now.qvel[..., 2]
        return {
            "reward_survive": ~self.terminated(now) * self.healthy_reward,
            "distance_penalty": -(0.01 * np.square(x) + np.square(z - 2)),
            "velocity_penalty": -(1e-3 * np.square(first) + 5e-3 * np.square(second)),
        }

    @once
    def terminated(self, now: Moment) -> NDArray[np.bool_]:
        return now.site_xpos[..., 0, 2] <= 1


# The least initial distance of the cylinder from its goal [m].
NEAREST = 0.17
# Joints of the arm.
ARM = 7


@dataclass(frozen=True, kw_only=True)
class Pusher(MujocoTask):
    """gymnasium's Pusher-v5, with the same options."""

    late: ClassVar[tuple[str, ...]] = ("xpos",)  # type: ignore[misc]

    xml_file: str = "pusher_v5.xml"
    reward_near_weight: float = 0.5
    reward_dist_weight: float = 1.0
    reward_control_weight: float = 0.1

    @once
    def place(self, now: Moment, body: str) -> Floats:
        """Return the position of a body [m], shape (3,)."""
        return now.xpos[..., now.model.index("body", body), :]

    def observe(self, now: Moment) -> Floats:
        bodies = [self.place(now, name) for name in ("tips_arm", "object", "goal")]
        return np.concatenate([now.qpos[..., :ARM], now.qvel[..., :ARM], *bodies], axis=-1)

    def parts(self, now: Moment) -> dict[str, Floats]:
        thing = self.place(now, "object")
        far, near = (thing - self.place(now, name) for name in ("goal", "tips_arm"))
        return {
            "reward_dist": -distance(far) * self.reward_dist_weight,
            "reward_ctrl": -squares(now.action) * self.reward_control_weight,
            "reward_near": -distance(near) * self.reward_near_weight,
        }

    def start(self, model: Model, rng: np.random.Generator) -> tuple[Floats, Floats]:
        place = np.zeros(2)
        while not np.linalg.norm(place) > NEAREST:
            place = np.array([rng.uniform(low=-0.3, high=0), rng.uniform(low=-0.2, high=0.2)])
        qpos = np.array(model.qpos0)
        qpos[-4:-2], qpos[-2:] = place, 0
        qvel = rng.uniform(low=-0.005, high=0.005, size=model.nv)
        qvel[-4:] = 0
        return qpos, qvel


# The radius of the disc that contains the target [m].
FARTHEST = 0.2


@dataclass(frozen=True, kw_only=True)
class Reacher(MujocoTask):
    """gymnasium's Reacher-v5, with the same options."""

    late: ClassVar[tuple[str, ...]] = ("xpos",)  # type: ignore[misc]

    xml_file: str = "reacher.xml"
    frame_skip: int = 2
    reward_dist_weight: float = 1.0
    reward_control_weight: float = 1.0

    @once
    def way(self, now: Moment) -> Floats:
        """Return the vector from the target to the fingertip [m], shape (3,)."""
        tip, target = (now.model.index("body", name) for name in ("fingertip", "target"))
        return now.xpos[..., tip, :] - now.xpos[..., target, :]

    def observe(self, now: Moment) -> Floats:
        angles, rest = now.qpos[..., :2], now.qpos[..., 2:]
        parts = [np.cos(angles), np.sin(angles), rest, now.qvel[..., :2], self.way(now)[..., :2]]
        return np.concatenate(parts, axis=-1)

    def parts(self, now: Moment) -> dict[str, Floats]:
        return {
            "reward_dist": -distance(self.way(now)) * self.reward_dist_weight,
            "reward_ctrl": -squares(now.action) * self.reward_control_weight,
        }

    def start(self, model: Model, rng: np.random.Generator) -> tuple[Floats, Floats]:
        qpos = rng.uniform(low=-0.1, high=0.1, size=model.nq) + model.qpos0
        goal = rng.uniform(low=-FARTHEST, high=FARTHEST, size=2)
        while not np.linalg.norm(goal) < FARTHEST:
            goal = rng.uniform(low=-FARTHEST, high=FARTHEST, size=2)
        qpos[-2:] = goal
        qvel = rng.uniform(low=-0.005, high=0.005, size=model.nv)
        qvel[-2:] = 0
        return qpos, qvel


@dataclass(frozen=True, kw_only=True)
class HalfCheetah(ForwardTask):
    """gymnasium's HalfCheetah-v5, with the same options."""

    normal: ClassVar[bool] = True

    xml_file: str = "half_cheetah.xml"


@dataclass(frozen=True, kw_only=True)
class Swimmer(ForwardTask):
    """gymnasium's Swimmer-v5, with the same options."""

    axes: ClassVar[str] = "xy"

    xml_file: str = "swimmer.xml"
    frame_skip: int = 4
    ctrl_cost_weight: float = 1e-4


@dataclass(frozen=True, kw_only=True)
class Upright(StandingTask):
    """A walker whose qpos begins with x, height z and the angle of the torso."""

    frame_skip: int = 4
    ctrl_cost_weight: float = 1e-3
    healthy_z_range: tuple[float, float] = (0.0, np.inf)
    healthy_angle_range: tuple[float, float] = (-1.0, 1.0)
    reset_noise_scale: float = 5e-3

    def observe(self, now: Moment) -> Floats:
        excluded = int(self.exclude_current_positions_from_observation)
        return observed(now, excluded, clipped(now.qvel))

    @once
    def healthy(self, now: Moment) -> NDArray[np.bool_]:
        height = within(now.qpos[..., 1], self.healthy_z_range)
        return height & within(now.qpos[..., 2], self.healthy_angle_range)

    def reset_info(self, now: Moment) -> dict[str, Floats]:
        height = now.qpos[..., 1] - now.model.qpos0[1]
        return {**super().reset_info(now), "z_distance_from_origin": height}


def within(value: Floats, interval: tuple[float, float]) -> NDArray[np.bool_]:
    """Return whether values are within an open interval."""
    low, high = interval
    return (low < value) & (value < high)


@dataclass(frozen=True, kw_only=True)
class Hopper(Upright):
    """gymnasium's Hopper-v5, with the same options."""

    xml_file: str = "hopper.xml"
    healthy_state_range: tuple[float, float] = (-100.0, 100.0)
    healthy_z_range: tuple[float, float] = (0.7, np.inf)
    healthy_angle_range: tuple[float, float] = (-0.2, 0.2)

    @once
    def healthy(self, now: Moment) -> NDArray[np.bool_]:
        state = within(state_vector(now)[..., 2:], self.healthy_state_range)
        return super().healthy(now) & np.logical_and.reduce(state, axis=-1)


@dataclass(frozen=True, kw_only=True)
class Walker2d(Upright):
    """gymnasium's Walker2d-v5, with the same options."""

    xml_file: str = "walker2d_v5.xml"
    healthy_z_range: tuple[float, float] = (0.8, 2.0)
    healthy_angle_range: tuple[float, float] = (-1.0, 1.0)


@dataclass(frozen=True, kw_only=True)
class Ant(StandingTask):
    """gymnasium's Ant-v5, with the same options."""

    axes: ClassVar[str] = "xy"
    normal: ClassVar[bool] = True
    late: ClassVar[tuple[str, ...]] = ("xpos", "cfrc_ext")  # type: ignore[misc]

    xml_file: str = "ant.xml"
    ctrl_cost_weight: float = 0.5
    contact_cost_weight: float = 5e-4
    main_body: int | str = 1
    healthy_z_range: tuple[float, float] = (0.2, 1.0)
    contact_force_range: tuple[float, float] = (-1.0, 1.0)
    include_cfrc_ext_in_observation: bool = True

    @once
    def contact_forces(self, now: Moment) -> Floats:
        """Return the clipped forces on all bodies, the world first, shape (6 nbody,)."""
        return np.clip(now.cfrc_ext.reshape(*now.shape, -1), *self.contact_force_range)

    def observe(self, now: Moment) -> Floats:
        state = super().observe(now)
        if not self.include_cfrc_ext_in_observation:
            return state
        return np.concatenate([state, self.contact_forces(now)[..., 6:]], axis=-1)

    @once
    def healthy(self, now: Moment) -> NDArray[np.bool_]:
        low, high = self.healthy_z_range
        height = now.qpos[..., 2]
        return (low <= height) & (height <= high)

    @once
    def main_velocity(self, now: Moment, axis: int) -> Floats:
        return velocity(now, "xpos", (..., now.model.index("body", self.main_body), axis))

    def parts(self, now: Moment) -> dict[str, Floats]:
        parts = super().parts(now)
        # gymnasium adds the terms in this order.
        survive = parts.pop("reward_survive")
        contact = -self.contact_cost_weight * squares(self.contact_forces(now))
        return {**parts, "reward_contact": contact, "reward_survive": survive}


@dataclass(frozen=True, kw_only=True)
class Human(NoisyTask):
    """A task that observes qpos, qvel, and inertias, velocities and forces of all bodies."""

    late: ClassVar[tuple[str, ...]] = (  # type: ignore[misc]
        *("subtree_com", "cinert", "cvel", "actuator_force", "cfrc_ext"),
        *("ten_length", "ten_velocity"),
    )

    ctrl_cost_weight: float = 0.1
    reset_noise_scale: float = 1e-2
    exclude_current_positions_from_observation: bool = True
    include_cinert_in_observation: bool = True
    include_cvel_in_observation: bool = True
    include_qfrc_actuator_in_observation: bool = True
    include_cfrc_ext_in_observation: bool = True

    def observe(self, now: Moment) -> Floats:
        parts = [observed(now, 2 * self.exclude_current_positions_from_observation, now.qvel)]
        for name in ("cinert", "cvel", "qfrc_actuator", "cfrc_ext"):
            if not getattr(self, f"include_{name}_in_observation"):
                continue
            if name == "qfrc_actuator":
                # No actuator acts on the six dofs of the free joint.
                parts.append(_actuator_forces(now)[..., 6:])
            else:
                parts.append(_of_bodies(now, getattr(now, name)))
        return np.concatenate(parts, axis=-1)

    def controls(self, now: Moment) -> Floats:
        """Return the controls in double precision, as MuJoCo keeps them, shape (nu,)."""
        return now.action.astype(np.float64)

    @once
    def contact_forces(self, now: Moment) -> Floats:
        """Return the forces on all bodies, shape (6 (nbody - 1),)."""
        return _of_bodies(now, now.cfrc_ext)

    def reset_info(self, now: Moment) -> dict[str, Floats]:
        return {
            "x_position": now.qpos[..., 0],
            "y_position": now.qpos[..., 1],
            "tendon_length": now.ten_length,
            "tendon_velocity": now.ten_velocity,
        }


def _of_bodies(now: Moment, values: Floats) -> Floats:
    return values[..., 1:, :].reshape(*now.shape, -1)


def _actuator_forces(now: Moment) -> Floats:
    """Return actuator forces by dof, shape (nv,); each actuator drives a joint of one dof."""
    model = now.model
    dofs = model.jnt_dofadr[model.actuator_joint]
    forces = np.zeros((*now.shape, model.nv))
    np.add.at(forces.T, dofs, (model.actuator_gear[:, 0] * now.actuator_force).T)
    return forces


@dataclass(frozen=True, kw_only=True)
class Humanoid(Human, StandingTask):
    """gymnasium's Humanoid-v5, with the same options."""

    axes: ClassVar[str] = "xy"

    xml_file: str = "humanoid.xml"
    forward_reward_weight: float = 1.25
    contact_cost_weight: float = 5e-7
    contact_cost_range: tuple[float, float] = (-np.inf, 10.0)
    healthy_reward: float = 5.0
    healthy_z_range: tuple[float, float] = (1.0, 2.0)

    @once
    def healthy(self, now: Moment) -> NDArray[np.bool_]:
        return within(now.qpos[..., 2], self.healthy_z_range)

    @once
    def main_velocity(self, now: Moment, axis: int) -> Floats:
        # The robot is all that hangs on the world, so they have the same centre of mass.
        return velocity(now, "subtree_com", (..., 0, axis))

    def parts(self, now: Moment) -> dict[str, Floats]:
        contact = self.contact_cost_weight * squares(self.contact_forces(now))
        return {
            "reward_survive": self.healthy(now) * self.healthy_reward,
            "reward_forward": self.forward_reward_weight * self.main_velocity(now, 0),
            "reward_ctrl": -self.ctrl_cost_weight * squares(self.controls(now)),
            "reward_contact": -np.clip(contact, *self.contact_cost_range),
        }

    def reset_info(self, now: Moment) -> dict[str, Floats]:
        return {
            **super().reset_info(now),
            "distance_from_origin": distance(now.qpos[..., :2]),
        }


@dataclass(frozen=True, kw_only=True)
class HumanoidStandup(Human):
    """gymnasium's HumanoidStandup-v5, with the same options."""

    xml_file: str = "humanoidstandup.xml"
    uph_cost_weight: float = 1.0
    impact_cost_weight: float = 5e-7
    impact_cost_range: tuple[float, float] = (-np.inf, 10.0)

    def parts(self, now: Moment) -> dict[str, Floats]:
        impact = self.impact_cost_weight * squares(self.contact_forces(now))
        return {
            # Divided by the engine's step and without uph_cost_weight, as in gymnasium.
            "reward_linup": now.qpos[..., 2] / now.model.settings.dt,
            "reward_quadctrl": -self.ctrl_cost_weight * squares(self.controls(now)),
            "reward_impact": -np.clip(impact, *self.impact_cost_range),
        }

    def total(self, parts: dict[str, Floats]) -> Floats:
        return super().total(parts) + 1.0

    def info(self, now: Moment) -> dict[str, Floats]:
        return self.reset_info(now)

    def reset_info(self, now: Moment) -> dict[str, Floats]:
        return {
            **super().reset_info(now),
            "z_distance_from_origin": now.qpos[..., 2] - now.model.qpos0[2],
        }
