"""A quadruped learns to walk at commanded speeds: PPO in numpy, worlds in one batch.

    python examples/learn_to_walk.py                                  # gymnasium's ant
    python examples/learn_to_walk.py unitree_go2/scene.xml            # any MJCF quadruped

Where others use the machine, OPENBLAS_NUM_THREADS=1 keeps numpy's threads out of their way.

The model has a free trunk and a motor for each leg joint; a keyframe, if it has one, is how it
stands. Actions are angles about that pose, which springs (--kp, --kd) follow at every step. A line
of the curve has wall time, actions, the share of the time spent in the environment, the reward a
second, falls a second and world, and by how much speeds miss their commands [m/s].
"""

import argparse
import json
from pathlib import Path

import numpy as np
from gymnasium.spaces import Box
from ppo import learn

import stepcore as sc
from stepcore.gymnasium import Task, VectorEnv

SETTINGS = {"dt": 0.005, "cone": "pyramidal", "impratio": 1.0, "precision": "f32"}


def to_body(quat, vector):
    """A vector of the world in axes of the body with this orientation, w x y z."""
    w, u = quat[..., :1], -quat[..., 1:]
    twice = 2 * np.cross(u, vector)
    return vector + w * twice + np.cross(u, twice)


class Walk(Task):
    """Walk forward at a commanded speed [m/s], straight and level."""

    frame_skip = 4

    def __init__(self, path, kp, kd, reach):
        self.compiled = model = sc.load(path).compile()
        self.kp, self.kd, self.reach = kp, kd, reach
        actuators = model.scene.actuators
        joints = [model.index("joint", actuator.joint.name) for actuator in actuators]
        self.q, self.v = model.jnt_qposadr[joints], model.jnt_dofadr[joints]
        self.gear = np.array([actuator.gear[0] for actuator in actuators])
        middle = np.array(model.qpos0)
        middle[self.q] = model.jnt_range[joints].mean(axis=1)
        self.home = np.array(model.keys[0].qpos) if model.keys else middle
        self.feet = self.lowest(model)

    def lowest(self, model):
        """The lowest geom of each last body, as the robot stands."""
        sim = sc.Sim(model)
        sim.qpos[:] = self.home
        leaves = set(range(1, model.nbody)) - set(model.body_parent.tolist())
        geoms = [np.flatnonzero(model.geom_body == leaf) for leaf in sorted(leaves)]
        return [int(own[np.argmin(sim.geom_xpos[own, 2])]) for own in geoms if len(own)]

    def model(self):
        return self.compiled

    def action_space(self, model):
        return Box(-1, 1, (model.nu,), np.float32)

    def start(self, model, rng, worlds):
        qpos = np.tile(self.home, (len(worlds), 1))
        qpos[:, self.q] += rng.uniform(-0.1, 0.1, size=model.nu)
        return qpos, rng.uniform(-0.1, 0.1, size=model.nv)

    def begin(self, now):
        now.state.command = now.rng.uniform(0.3, 1.0)
        now.state.target = np.zeros((*now.shape, len(self.q)))

    def control(self, now):
        now.state.target = self.home[self.q] + self.reach * np.clip(now.action, -3, 3)
        return np.zeros((*now.shape, len(self.q)))

    def before_step(self, now, step):
        torque = (
            self.kp * (now.state.target - now.qpos[..., self.q]) - self.kd * now.qvel[..., self.v]
        )
        now.world.ctrl[...] = torque / self.gear

    def observe(self, now):
        quat, turning = now.qpos[..., 3:7], now.qvel[..., 3:6]
        down = to_body(quat, np.array([0.0, 0.0, -1.0]))
        speed = to_body(quat, now.qvel[..., :3])
        angles, rates = now.qpos[..., self.q] - self.home[self.q], now.qvel[..., self.v]
        command = now.state.command[..., None]
        parts = [command, down, speed, 0.3 * turning, angles, 0.05 * rates, now.action]
        return np.concatenate(parts, axis=-1)

    def reward(self, now):
        quat, turning = now.qpos[..., 3:7], now.qvel[..., 3:6]
        speed, down = to_body(quat, now.qvel[..., :3]), to_body(quat, np.array([0.0, 0.0, -1.0]))
        command = now.state.command
        # A slope towards the command everywhere: standing still is no place to stay.
        gained = 0.5 + 2.0 * (1.0 - np.minimum(np.abs(speed[..., 0] - command) / command, 2.0))
        strayed = np.square(speed[..., 1]) + 0.5 * np.square(turning[..., 2])
        level = np.sum(np.square(down[..., :2]), axis=-1) + np.square(speed[..., 2])
        shaken = np.sum(np.square(turning[..., :2]), axis=-1)
        jerk = np.sum(np.square(now.action - now.before.action), axis=-1)
        # Feet that move do so above the ground: else shuffling is as good as walking.
        feet, last = now.geom_xpos[..., self.feet, :], now.before.geom_xpos[..., self.feet, :]
        moved = np.linalg.norm((feet - last)[..., :2], axis=-1) / now.dt
        dragged = np.sum(moved * np.clip(1 - feet[..., 2] / (0.25 * self.home[2]), 0, 1), axis=-1)
        return (gained - strayed - level - 0.05 * shaken - 0.01 * jerk - 0.6 * dragged) * now.dt

    def terminated(self, now):
        down = to_body(now.qpos[..., 3:7], np.array([0.0, 0.0, -1.0]))
        return (down[..., 2] > -0.5) | (now.qpos[..., 2] < 0.4 * self.home[2])

    def info(self, now):
        return {
            "missed": np.abs(
                to_body(now.qpos[..., 3:7], now.qvel[..., :3])[..., 0] - now.state.command
            )
        }


def walked(envs, ppo, seconds=10.0):
    """Let the policy walk; return commanded and mean speeds [m/s], and how many worlds fell."""
    seen, _ = envs.reset(seed=1)
    commands, begin = np.array(envs.get_attr("command")), envs.batch.qpos[:, :2].copy()
    fell = np.zeros(len(commands), dtype=bool)
    for _ in range(round(seconds / envs.dt)):
        seen, _, over, _, _ = envs.step(ppo.actor(seen))
        fell |= over
    way = np.linalg.norm(envs.batch.qpos[:, :2] - begin, axis=1)
    return commands, way / seconds, fell


def draw(lines, path):
    """The curve as a picture: by how much speeds miss their commands."""
    import matplotlib.pyplot as plt

    figure, axes = plt.subplots(figsize=(6.4, 3.2), layout="constrained")
    axes.plot([line["minutes"] for line in lines], [line["missed"] for line in lines])
    axes.set_xlabel("wall time [min]")
    axes.set_ylabel("speed missed [m/s]")
    axes.set_ylim(bottom=0)
    figure.savefig(path, dpi=120)


def main():
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("model", nargs="?", default="gymnasium:ant", help="an MJCF file")
    parser.add_argument("--minutes", type=float, default=5.0, help="wall time of learning")
    parser.add_argument("--kp", type=float, default=35.0, help="stiffness of the springs [N·m/rad]")
    parser.add_argument("--kd", type=float, default=0.5, help="damping of the springs [N·m·s/rad]")
    parser.add_argument("--reach", type=float, default=0.4, help="angle of an action of 1 [rad]")
    parser.add_argument("--worlds", type=int, default=512)
    parser.add_argument("--curve", help="a .json file for the curve")
    parser.add_argument("--plot", help="a picture of the curve; needs matplotlib")
    parser.add_argument("--checkpoint", help="a .npz file: written at each line, read if it exists")
    parser.add_argument("--onnx", help="a .onnx file for the policy; needs onnx")
    given = parser.parse_args()
    task = Walk(given.model, given.kp, given.kd, given.reach)
    how = {"settings": SETTINGS, "dtype": np.float32, "autoreset_mode": "SameStep"}
    envs = VectorEnv(task, given.worlds, **how, max_episode_steps=round(20.0 / 0.02))
    lines, ppo = [], None
    before = given.checkpoint if given.checkpoint and Path(given.checkpoint).exists() else None
    for ppo, line in learn(envs, given.minutes, checkpoint=before):
        lines.append(line)
        print(" ".join(f"{name} {value:.3g}" for name, value in line.items()), flush=True)
        if given.curve:
            Path(given.curve).write_text(json.dumps(lines, indent=1))
        if given.checkpoint:
            ppo.save(given.checkpoint)
    if given.onnx:
        ppo.export(given.onnx)
    if given.plot:
        draw(lines, given.plot)
    commands, speeds, fell = walked(envs, ppo)
    off = np.median(np.abs(speeds - commands)[~fell])
    print(f"walked 10 s: {fell.sum()} of {len(fell)} fell; speeds {off:.3f} m/s from the commands")


if __name__ == "__main__":
    main()
