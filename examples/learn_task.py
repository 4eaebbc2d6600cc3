"""PPO on any registered task; the policy as an ONNX file: python examples/learn_task.py --help"""

import argparse

import gymnasium
import numpy as np
from ppo import learn

import stepcore.gymnasium  # noqa: F401  (registers the tasks)


def main():
    parser = argparse.ArgumentParser(description=__doc__.partition(":")[0])
    parser.add_argument("task", nargs="?", default="stepcore/InvertedPendulum-v0")
    parser.add_argument("--minutes", type=float, default=1.0, help="wall time of learning")
    parser.add_argument("--worlds", type=int, default=64)
    parser.add_argument("--checkpoint", help="a .npz file of an earlier run to continue from")
    parser.add_argument("--save", help="a .npz file for the checkpoint")
    parser.add_argument("--onnx", help="a .onnx file for the policy; needs onnx")
    given = parser.parse_args()
    envs = gymnasium.make_vec(
        given.task, given.worlds, autoreset_mode="SameStep", dtype=np.float32
    ).unwrapped
    for ppo, line in learn(envs, given.minutes, checkpoint=given.checkpoint):  # noqa: B007
        print(" ".join(f"{name} {value:.3g}" for name, value in line.items()), flush=True)
    if given.save:
        ppo.save(given.save)
    if given.onnx:
        ppo.export(given.onnx)


if __name__ == "__main__":
    main()
