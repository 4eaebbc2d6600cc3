"""A linear policy of a task of gymnasium, found by random search in one batch of worlds.

    python examples/linear_policy.py stepcore/Walker2d-v0 docs/walker.onnx

Each iteration tries directions of the gains on both sides, and moves along them by their returns
(augmented random search, Mania et al. 2018, without its filter of observations). The policy is
written as an ONNX file of one matrix, without any further package.
"""

import argparse
from pathlib import Path

import gymnasium
import numpy as np

import stepcore.gymnasium  # noqa: F401  registers the tasks

DIRECTIONS, STEP, NOISE = 32, 0.05, 0.05


def returns_of(envs, gains, actions, seed):
    """Return the return of each world under its own gains, (n,)."""
    seen, _ = envs.reset(seed=[seed] * envs.num_envs)
    total, running = np.zeros(envs.num_envs), np.ones(envs.num_envs, dtype=bool)
    for _ in range(actions):
        act = np.clip(np.einsum("nk,nku->nu", np.clip(seen, -10, 10), gains), -1, 1)
        seen, rewards, over, _, _ = envs.step(act)
        total += np.where(running, rewards, 0.0)
        running &= ~over
    return total


def learn(task, iterations, actions):
    """Return gains, (observations, actions), and the returns of the last iteration."""
    envs = gymnasium.make_vec(task, 2 * DIRECTIONS)
    shape = envs.single_observation_space.shape[0], envs.single_action_space.shape[0]
    gains, rng, returns = np.zeros(shape), np.random.default_rng(0), np.zeros(2 * DIRECTIONS)
    for iteration in range(iterations):
        moves = rng.normal(size=(DIRECTIONS, *shape))
        tried = np.concatenate([gains + NOISE * moves, gains - NOISE * moves])
        returns = returns_of(envs, tried, actions, iteration)
        gained = returns[:DIRECTIONS] - returns[DIRECTIONS:]
        gains += (
            STEP * np.einsum("d,dku->ku", gained, moves) / (DIRECTIONS * (returns.std() + 1e-9))
        )
    return gains, returns


def field(number, content):
    """Return a field of a protobuf message: a message or a text, or a whole number."""
    if isinstance(content, int):
        return varint(8 * number) + varint(content)
    content = content.encode() if isinstance(content, str) else content
    return varint(8 * number + 2) + varint(len(content)) + content


def varint(value):
    """Return a whole number in base 128, the lowest digits first."""
    parts = bytearray()
    while value > 127:
        parts.append(value % 128 + 128)
        value //= 128
    return bytes([*parts, value])


def onnx_file(gains):
    """Return an ONNX model: clip(clip(observation, ±10) @ gains, ±1), for any number of rows."""

    def tensor(name, array):
        shape = b"".join(field(1, size) for size in array.shape)
        return field(5, shape + field(2, 1) + field(8, name) + field(9, array.tobytes()))

    def node(kind, inputs, output):
        return field(1, b"".join(field(1, x) for x in inputs) + field(2, output) + field(4, kind))

    def value(number, name, width):
        sizes = field(1, field(2, "batch")) + field(1, field(1, width))
        return field(number, field(1, name) + field(2, field(1, field(1, 1) + field(2, sizes))))

    bounds = {"low": -10.0, "high": 10.0, "least": -1.0, "most": 1.0}
    graph = node("Clip", ["observation", "low", "high"], "clipped")
    graph += node("MatMul", ["clipped", "gains"], "product")
    graph += node("Clip", ["product", "least", "most"], "action") + field(2, "policy")
    graph += tensor("gains", gains.astype(np.float32))
    graph += b"".join(tensor(name, np.array(x, np.float32)) for name, x in bounds.items())
    graph += value(11, "observation", gains.shape[0]) + value(12, "action", gains.shape[1])
    # IR version 8, operators of version 13.
    return field(1, 8) + field(7, graph) + field(8, field(2, 13))


def main():
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("task", help="such as stepcore/Walker2d-v0")
    parser.add_argument("out", type=Path, help="the .onnx file")
    parser.add_argument("--iterations", type=int, default=60)
    parser.add_argument("--actions", type=int, default=250, help="of an episode")
    args = parser.parse_args()
    gains, returns = learn(args.task, args.iterations, args.actions)
    args.out.write_bytes(onnx_file(gains))
    print(f"{args.out}: mean return {returns.mean():.1f} in the last iteration")


if __name__ == "__main__":
    main()
