"""PPO in numpy, for a vector environment of stepcore: small, and quick enough for a robot's legs.

Schulman et al., "Proximal policy optimization algorithms" (2017), with the step size of Rudin et
al., "Learning to walk in minutes using massively parallel deep reinforcement learning" (2022),
which keeps the KL divergence of an update near 0.01.
"""

import itertools
import time
from collections import defaultdict

import numpy as np

STEPS, EPOCHS, BATCHES = 24, 5, 4
GAMMA, LAMBDA, CLIP, ENTROPY, KL = 0.99, 0.95, 0.2, 0.005, 0.01


class Network:
    """Layers of tanh, then a linear one; trained by Adam."""

    def __init__(self, sizes, rng, last):
        pairs = list(itertools.pairwise(sizes))
        scales = [*np.sqrt(1.0 / np.array(sizes[:-2])), last]
        self.weights = [
            rng.normal(size=p).astype(np.float32) * np.float32(s)
            for p, s in zip(pairs, scales, strict=True)
        ]
        self.weights += [np.zeros(p[1], np.float32) for p in pairs]
        self.moments = [(np.zeros_like(w), np.zeros_like(w)) for w in self.weights]
        self.depth, self.count = len(pairs), 0

    def __call__(self, x):
        self.layers = [x]
        for k in range(self.depth):
            x = x @ self.weights[k] + self.weights[self.depth + k]
            x = np.tanh(x) if k + 1 < self.depth else x
            self.layers.append(x)
        return x

    def slopes(self, out):
        """Derivatives by the weights, given those by the output of the last call."""
        found = [None] * (2 * self.depth)
        for k in reversed(range(self.depth)):
            found[k], found[self.depth + k] = self.layers[k].T @ out, out.sum(axis=0)
            if k:
                out = (out @ self.weights[k].T) * (1 - np.square(self.layers[k]))
        return found

    def descend(self, slopes, rate):
        size = np.sqrt(sum(float(np.sum(np.square(slope))) for slope in slopes))
        self.count += 1
        unbias = np.float32(rate * np.sqrt(1 - 0.999**self.count) / (1 - 0.9**self.count))
        for w, slope, (m, v) in zip(self.weights, slopes, self.moments, strict=True):
            slope = slope * np.float32(min(1.0, 1.0 / (size + 1e-8)))
            m += 0.1 * (slope - m)
            v += 0.001 * (np.square(slope) - v)
            w -= unbias * m / (np.sqrt(v) + 1e-8)


class PPO:
    """A policy with normal actions about `actor`, and what states are worth, `critic`."""

    def __init__(self, inputs, actions, rng):
        self.rng, self.rate = rng, 1e-3
        self.actor = Network([inputs, 128, 64, actions], rng, 0.01)
        self.critic = Network([inputs, 128, 64, 1], rng, 0.1)
        self.spread = np.full(actions, -0.4, np.float32)
        self.actor.weights.append(self.spread)
        self.actor.moments.append((np.zeros_like(self.spread), np.zeros_like(self.spread)))

    def likelihood(self, mean, action):
        """Logarithm of an action's likelihood, but for a constant, and its normalised deviation."""
        z = (action - mean) * np.exp(-self.spread)
        return -0.5 * np.sum(np.square(z), axis=-1) - np.sum(self.spread), z

    def act(self, seen):
        """Draw actions; return them with their mean, their likelihood and the states' worth."""
        mean = self.actor(seen)
        noise = self.rng.standard_normal(mean.shape, dtype=np.float32)
        action = mean + np.exp(self.spread) * noise
        return action, mean, self.likelihood(mean, action)[0], self.critic(seen)[:, 0]

    def update(self, seen, action, old_mean, old, gain, returned):
        """Learn from what was seen and done: `gain`, how much better than expected it went."""
        gain = (gain - gain.mean()) / (gain.std() + 1e-8)
        old_spread = self.spread.copy()
        for _ in range(EPOCHS):
            for rows in np.array_split(self.rng.permutation(len(seen)), BATCHES):
                mean = self.actor(seen[rows])
                now, z = self.likelihood(mean, action[rows])
                ratio, worth = np.exp(now - old[rows]), gain[rows]
                held = np.where(worth > 0, ratio < 1 + CLIP, ratio > 1 - CLIP)
                pull = (-worth * ratio * held / len(rows))[:, None]
                slopes = self.actor.slopes(pull * z * np.exp(-self.spread))
                slopes.append(np.sum(pull * (np.square(z) - 1), axis=0) - ENTROPY)
                shift = np.square(old_mean[rows] - mean) * np.exp(-2 * self.spread)
                wide = np.exp(2 * (old_spread - self.spread))
                kl = np.mean(np.sum(self.spread - old_spread + (wide + shift - 1) / 2, axis=-1))
                factor = 1 / 1.5 if kl > 2 * KL else 1.5 if kl < KL / 2 else 1.0
                self.rate = float(np.clip(self.rate * factor, 1e-5, 2e-3))
                self.actor.descend(slopes, self.rate)
                missed = self.critic(seen[rows])[:, 0] - returned[rows]
                self.critic.descend(self.critic.slopes((missed / len(rows))[:, None]), self.rate)

    def arrays(self):
        """Everything that learning changes, by name."""
        named = {"rate": np.array(self.rate)}
        for name, network in (("actor", self.actor), ("critic", self.critic)):
            named |= {f"{name} {k}": w for k, w in enumerate(network.weights)}
            named |= {f"{name} moments {k}": np.stack(m) for k, m in enumerate(network.moments)}
            named[f"{name} count"] = np.array(network.count)
        return named

    def save(self, path):
        """Write a checkpoint, .npz."""
        np.savez(path, **self.arrays())

    def load(self, path):
        """Continue from a checkpoint of a policy of this size."""
        with np.load(path) as kept:
            self.rate = float(kept["rate"])
            for name, network in (("actor", self.actor), ("critic", self.critic)):
                for k, w in enumerate(network.weights):
                    w[...] = kept[f"{name} {k}"]
                    for moment, saved in zip(
                        network.moments[k], kept[f"{name} moments {k}"], strict=True
                    ):
                        moment[...] = saved
                network.count = int(kept[f"{name} count"])

    def export(self, path):
        """Write the mean action as an ONNX file, with the package onnx."""
        from onnx import TensorProto, checker, helper, numpy_helper, save

        actor, nodes, constants, last = self.actor, [], [], "observation"
        for k in range(actor.depth):
            for name, w in (("W", actor.weights[k]), ("b", actor.weights[actor.depth + k])):
                constants.append(numpy_helper.from_array(w, f"{name}{k}"))
            linear = "action" if k + 1 == actor.depth else f"linear{k}"
            nodes.append(helper.make_node("Gemm", [last, f"W{k}", f"b{k}"], [linear]))
            last = f"tanh{k}"
            if linear != "action":
                nodes.append(helper.make_node("Tanh", [linear], [last]))
        widths = {"observation": len(actor.weights[0]), "action": len(self.spread)}
        ends = [
            helper.make_tensor_value_info(name, TensorProto.FLOAT, ["n", width])
            for name, width in widths.items()
        ]
        graph = helper.make_graph(nodes, "policy", ends[:1], ends[1:], constants)
        # Opset 13 and its format 8 are read by every onnxruntime since 2021.
        model = helper.make_model(graph, opset_imports=[helper.make_opsetid("", 13)], ir_version=8)
        checker.check_model(model)
        save(model, path)


def play(envs, ppo, seen, terms):
    """Take STEPS actions in every world.

    terms: lists by name, to which the means of numbers in the information are added.

    Returns what was seen and done, what is seen then, the time that playing took, and for an action
    the mean reward and the share of worlds that fell.
    """
    names = ("seen", "action", "mean", "old", "value", "reward", "over")
    kept, spent, earned, fell = {name: [] for name in names}, 0.0, 0.0, 0.0
    for _ in range(STEPS):
        action, mean, old, value = ppo.act(seen)
        began = time.perf_counter()
        after, reward, over, cut, infos = envs.step(action)
        spent += time.perf_counter() - began
        reward, done = reward.astype(np.float32), over | cut
        earned += float(reward.mean()) / STEPS
        fell += float(over.mean()) / STEPS
        if cut.any():
            # What a time limit cut off is worth what the critic says.
            reward[cut] += GAMMA * ppo.critic(np.stack(infos["final_obs"][cut]))[:, 0]
        row = (seen, action, mean, old, value, reward, done)
        for name, item in zip(names, row, strict=True):
            kept[name].append(item)
        for name, values in infos.items():
            if np.shape(values) == done.shape and values.dtype.kind == "f" and not done.all():
                terms[name].append(float(values[~done].mean()))
        seen = after
    return {name: np.stack(items) for name, items in kept.items()}, seen, spent, earned, fell


def gains(data, following):
    """Generalised advantages; following: what the last states are worth."""
    gain, ahead = np.zeros_like(data["value"]), 0.0
    for k in reversed(range(STEPS)):
        on = 1.0 - data["over"][k]
        surprise = data["reward"][k] + GAMMA * on * following - data["value"][k]
        ahead = surprise + GAMMA * LAMBDA * on * ahead
        gain[k], following = ahead, data["value"][k]
    return gain.ravel()


def learn(envs, minutes, seed=0, checkpoint=None):
    """Learn for so many minutes of wall time; yield the policy and a line of the curve at times.

    envs: of worlds that begin anew in the same step. The line has the mean of each number in their
        info, by its name.
    checkpoint: a file of `PPO.save` to continue from.
    """
    rng, began = np.random.default_rng(seed), time.perf_counter()
    seen = envs.reset(seed=seed)[0]
    ppo = PPO(seen.shape[1], envs.single_action_space.shape[0], rng)
    if checkpoint:
        ppo.load(checkpoint)
    terms, playing, count = defaultdict(list), 0.0, 0
    while (spent := time.perf_counter() - began) < 60 * minutes:
        data, seen, took, earned, fell = play(envs, ppo, seen, terms)
        gain = gains(data, ppo.critic(seen)[:, 0])
        flat = {name: items.reshape(len(gain), *items.shape[2:]) for name, items in data.items()}
        parts = (flat[name] for name in ("seen", "action", "mean", "old"))
        ppo.update(*parts, gain, gain + flat["value"])
        playing, count = playing + took, count + 1
        if count % 10 == 0 or time.perf_counter() - began >= 60 * minutes:
            yield (
                ppo,
                {
                    "minutes": spent / 60,
                    "actions": count * len(gain),
                    "playing": playing / spent,
                    "reward": earned / envs.dt,
                    "falls": fell / envs.dt,
                    **{name: float(np.mean(kept[-10 * STEPS :])) for name, kept in terms.items()},
                },
            )
