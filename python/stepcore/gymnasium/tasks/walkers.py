"""Tasks that move forward: swimmer, cheetah, hopper, walker, ant and humanoid; and standing up."""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar

import numpy as np
from numpy.typing import NDArray

from stepcore.engine.arrays import Floats
from stepcore.gymnasium.snapshot import Moment, state_vector
from stepcore.gymnasium.tasks.mujoco_task import (
    ForwardTask,
    NoisyTask,
    StandingTask,
    distance,
    observed,
    squares,
    velocity,
)


@dataclass(frozen=True, kw_only=True)
class HalfCheetah(ForwardTask):
    """The options are those of gymnasium's HalfCheetah-v5."""

    normal: ClassVar[bool] = True

    xml_file: str = "half_cheetah.xml"


@dataclass(frozen=True, kw_only=True)
class Swimmer(ForwardTask):
    """The options are those of gymnasium's Swimmer-v5."""

    axes: ClassVar[str] = "xy"

    xml_file: str = "swimmer.xml"
    frame_skip: int = 4
    ctrl_cost_weight: float = 1e-4


# Observed velocities are clipped to this on either side [m/s or rad/s].
FASTEST = 10.0


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
        return observed(now, excluded, np.clip(now.qvel, -FASTEST, FASTEST))

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
    """The options are those of gymnasium's Hopper-v5."""

    xml_file: str = "hopper.xml"
    healthy_state_range: tuple[float, float] = (-100.0, 100.0)
    healthy_z_range: tuple[float, float] = (0.7, np.inf)
    healthy_angle_range: tuple[float, float] = (-0.2, 0.2)

    def healthy(self, now: Moment) -> NDArray[np.bool_]:
        state = within(state_vector(now)[..., 2:], self.healthy_state_range)
        return super().healthy(now) & np.all(state, axis=-1)


@dataclass(frozen=True, kw_only=True)
class Walker2d(Upright):
    """The options are those of gymnasium's Walker2d-v5."""

    xml_file: str = "walker2d_v5.xml"
    healthy_z_range: tuple[float, float] = (0.8, 2.0)
    healthy_angle_range: tuple[float, float] = (-1.0, 1.0)


@dataclass(frozen=True, kw_only=True)
class Ant(StandingTask):
    """The options are those of gymnasium's Ant-v5."""

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

    def contact_forces(self, now: Moment) -> Floats:
        """Return the clipped forces on all bodies but the world, shape (6 (nbody - 1),)."""
        return np.clip(_of_bodies(now, now.cfrc_ext), *self.contact_force_range)

    def observe(self, now: Moment) -> Floats:
        state = super().observe(now)
        if not self.include_cfrc_ext_in_observation:
            return state
        return np.concatenate([state, self.contact_forces(now)], axis=-1)

    def healthy(self, now: Moment) -> NDArray[np.bool_]:
        low, high = self.healthy_z_range
        height = now.qpos[..., 2]
        finite = np.all(np.isfinite(state_vector(now)), axis=-1)
        return finite & (low <= height) & (height <= high)

    def main_velocity(self, now: Moment, axis: int) -> Floats:
        return velocity(now, "xpos", (..., now.model.index("body", self.main_body), axis))

    def parts(self, now: Moment) -> dict[str, Floats]:
        parts = super().parts(now)
        # gymnasium adds them in this order.
        survive = parts.pop("reward_survive")
        contact = -self.contact_cost_weight * squares(self.contact_forces(now))
        return {**parts, "reward_contact": contact, "reward_survive": survive}


# Dofs of the free joint, on which no actuator acts.
FREE = 6


@dataclass(frozen=True, kw_only=True)
class Human(NoisyTask):
    """Observes inertias, velocities and forces of all bodies beside qpos and qvel."""

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
        if self.include_cinert_in_observation:
            parts.append(_of_bodies(now, now.cinert))
        if self.include_cvel_in_observation:
            parts.append(_of_bodies(now, now.cvel))
        if self.include_qfrc_actuator_in_observation:
            parts.append(_actuator_forces(now)[..., FREE:])
        if self.include_cfrc_ext_in_observation:
            parts.append(_of_bodies(now, now.cfrc_ext))
        return np.concatenate(parts, axis=-1)

    def controls(self, now: Moment) -> Floats:
        """Return the controls in double precision, as MuJoCo keeps them, shape (nu,)."""
        return now.action.astype(np.float64)

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
    """Return the rows of all bodies but the world as one vector."""
    return values[..., 1:, :].reshape(*now.shape, -1)


def _actuator_forces(now: Moment) -> Floats:
    """Return actuator forces by dof, shape (nv,); each actuator drives a joint of one dof."""
    model = now.model
    dofs = model.jnt_dofadr[model.actuator_joint]
    forces = np.zeros((*now.shape, model.nv))
    for actuator, dof in enumerate(dofs.tolist()):
        forces[..., dof] += model.actuator_gear[actuator, 0] * now.actuator_force[..., actuator]
    return forces


# The tree of the world is all there is: its centre of mass is that of the robot.
CENTRE = (..., 0)


@dataclass(frozen=True, kw_only=True)
class Humanoid(Human, StandingTask):
    """The options are those of gymnasium's Humanoid-v5."""

    axes: ClassVar[str] = "xy"

    xml_file: str = "humanoid.xml"
    forward_reward_weight: float = 1.25
    contact_cost_weight: float = 5e-7
    contact_cost_range: tuple[float, float] = (-np.inf, 10.0)
    healthy_reward: float = 5.0
    healthy_z_range: tuple[float, float] = (1.0, 2.0)

    def healthy(self, now: Moment) -> NDArray[np.bool_]:
        return within(now.qpos[..., 2], self.healthy_z_range)

    def main_velocity(self, now: Moment, axis: int) -> Floats:
        return velocity(now, "subtree_com", (*CENTRE, axis))

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
    """The options are those of gymnasium's HumanoidStandup-v5."""

    xml_file: str = "humanoidstandup.xml"
    uph_cost_weight: float = 1.0
    impact_cost_weight: float = 5e-7
    impact_cost_range: tuple[float, float] = (-np.inf, 10.0)

    def parts(self, now: Moment) -> dict[str, Floats]:
        impact = self.impact_cost_weight * squares(self.contact_forces(now))
        return {
            # Over the engine's step, and without uph_cost_weight, as gymnasium has it.
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
