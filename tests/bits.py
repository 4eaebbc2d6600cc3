"""The bits that a step gives, on every machine: hashes of the states that the zoo's scenes reach.

`python tests/bits.py` writes them to bits.json: after a change of numerics, which CHANGELOG.md
then names, and for a new scene. tests/laws/test_bits.py compares; so is every wheel compared before
it is published.
"""

import hashlib
import json
from pathlib import Path

import numpy as np
import zoo

import stepcore as sc

RECORD = Path(__file__).with_name("bits.json")
STEPS = 40
# The heaps' scenes take longer, and their rows are those of small ones.
HEAPS = {"marbles": 12, "capsules27": 12}
WAYS = {
    "newton": {"solver": "newton", "sweeps": 50},
    "pgs": {
        "solver": "pgs",
        "sweeps": 15,
        "tolerance": 0.0,
        "cone": "elliptic",
        "integrator": "implicitfast",
    },
}


def state_of(name, way, precision):
    """qpos and qvel after some steps from the scene's pose, with speeds that are exact numbers."""
    sim = sc.Sim(sc.loads(zoo.ZOO[name].text), precision=precision, **WAYS[way])
    rng = np.random.default_rng(29)
    sim.qvel[:] = rng.integers(-64, 65, len(sim.qvel)) / 64
    sim.ctrl[:] = rng.integers(-64, 65, len(sim.ctrl)) / 64
    sim.step(HEAPS.get(name, STEPS))
    return np.concatenate([sim.qpos, sim.qvel])


def digests(name):
    """What bits.json has of a scene."""
    result = {}
    for way in WAYS:
        for precision in ("f64", "f32"):
            # One zero is as good as the other.
            state = state_of(name, way, precision) + 0.0
            digest = hashlib.sha256(state.astype("<f8").tobytes()).hexdigest()
            result[f"{way} {precision}"] = digest[:12]
    return result


def record():
    return json.loads(RECORD.read_text(encoding="utf-8"))


def write():
    lines = [f"{json.dumps(name)}: {json.dumps(digests(name))}" for name in sorted(zoo.ZOO)]
    RECORD.write_text("{\n" + ",\n".join(lines) + "\n}\n", encoding="utf-8")


if __name__ == "__main__":
    write()
