"""What `Sim.linearize` costs, beside plain steps, and beside MuJoCo's `mjd_transitionFD`.

    python benches/linearize.py                    # models of gymnasium and dm_control
    python benches/linearize.py --robots FOLDER    # and the scenes of these robots

First table: processor time, the best of 9 turns. "steps" is how many plain steps a linearisation
costs; central differences of second order take two steps a direction, and the time to set up.

Second table: linearisations a second, by state and controls, of WORLDS worlds of a `Batch` and of
as many `MjData` at the same states, on the ground; centred differences of 1e-6, medians of PAIRS
turns that alternate, wall time. Both linearise the same step, of integrator euler: MuJoCo's own
`mjd_transitionFD` refuses RK4. "off" is the largest difference of A and B, of the largest entry, in
the median world. The worst ratio is first.
"""

from __future__ import annotations

import argparse
import os
import time
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

import mujoco
import numpy as np
from robot_files import folder_of, wheels

import stepcore as sc
from stepcore.report.table import Table

TURNS, STEPS, WORLDS, PAIRS = 9, 400, 32, 7
NAMES = (
    *("gymnasium/hopper", "gymnasium/half_cheetah", "gymnasium/ant", "gymnasium/humanoid"),
    *("gymnasium/walker2d", "dm_control/cheetah", "dm_control/hopper", "dm_control/walker"),
    *("dm_control/cartpole", "dm_control/humanoid", "dm_control/reacher"),
)


def best(run: Callable[[], object]) -> float:
    """Least processor time of a call [µs]."""
    samples = []
    for _ in range(TURNS):
        start = time.process_time()
        run()
        samples.append(time.process_time() - start)
    return 1e6 * min(samples)


def line(name: str, sim: sc.Sim) -> dict[str, object]:
    """One scene, on the ground."""
    sim.step(200)
    state = sim.state()

    def steps() -> None:
        sim.restore(state)
        sim.step(STEPS)

    step = best(steps) / STEPS
    sim.restore(state)
    whole = best(sim.linearize)
    ways = 2 * sim.model.nv + sim.model.nu
    return {
        "scene": name,
        "directions": ways,
        "µs a step": step,
        "µs to linearize": whole,
        "steps": whole / step,
        "differences": 2.0 * ways,
    }


class Differences:
    """Worlds of MuJoCo, along a motion from the first keyframe under small random controls."""

    def __init__(self, path: Path) -> None:
        self.model = model = mujoco.MjModel.from_xml_path(str(path))
        model.opt.integrator = mujoco.mjtIntegrator.mjINT_EULER
        model.opt.solver = mujoco.mjtSolver.mjSOL_NEWTON
        model.opt.iterations, model.opt.tolerance = 100, 1e-12
        size = 2 * model.nv + model.na
        self.A, self.B = np.zeros((WORLDS, size, size)), np.zeros((WORLDS, size, model.nu))
        self.worlds, rng = [], np.random.default_rng(0)
        for _ in range(WORLDS):
            data = mujoco.MjData(model)
            if model.nkey:
                mujoco.mj_resetDataKeyframe(model, data, 0)
            data.ctrl[:] += rng.normal(0, 0.1, model.nu)
            mujoco.mj_step(model, data, rng.integers(100, 200))
            self.worlds.append(data)

    def one(self, world: int) -> None:
        mujoco.mjd_transitionFD(
            self.model, self.worlds[world], 1e-6, 1, self.A[world], self.B[world], None, None
        )


def off(ours: sc.Linearizations, theirs: Differences) -> float:
    each = [
        max(
            np.abs(own[world] - other[world]).max(initial=0.0)
            / np.abs(other[world]).max(initial=1e-12)
            for own, other in ((ours.A, theirs.A), (ours.B, theirs.B))
        )
        for world in range(WORLDS)
    ]
    return float(np.median(each))


def rates(name: str, path: Path, threads: int) -> dict[str, object]:
    """Both sides' linearisations a second on so many threads."""
    theirs = Differences(path)
    solved = {"solver": "newton", "sweeps": 100, "tolerance": 1e-12}
    batch = sc.Batch(sc.load(path), WORLDS, integrator="euler", threads=threads, **solved)
    for key in ("qpos", "qvel", "act", "ctrl"):
        setattr(batch, key, np.array([getattr(data, key) for data in theirs.worlds]))
    times = np.zeros((PAIRS, 2))
    with ThreadPoolExecutor(threads) as pool:
        for pair in times:
            start = time.perf_counter()
            ours = batch.linearize()
            pair[0] = time.perf_counter() - start
            start = time.perf_counter()
            list(pool.map(theirs.one, range(WORLDS)))
            pair[1] = time.perf_counter() - start
    own, other = WORLDS / np.median(times, axis=0)
    return {
        "model": name,
        "threads": threads,
        "contacts": float(np.mean([data.ncon for data in theirs.worlds])),
        "off": off(ours, theirs),
        "stepcore a second": float(own),
        "MuJoCo a second": float(other),
        "ratio": float(np.median(times[:, 1] / times[:, 0])),
    }


def compared(robots: Path | None) -> list[dict[str, object]]:
    files = {f"{robot.collection}/{robot.name}": robot.path for robot in wheels()}
    names = [name for name in NAMES if name in files]
    if robots is not None:
        scenes = [robot for robot in folder_of("robots", robots) if robot.path.stem == "scene"]
        files |= {robot.name: robot.path for robot in scenes}
        names += [robot.name for robot in scenes]
    lines = []
    for name in names:
        for threads in sorted({1, os.cpu_count() or 1}):
            try:
                lines.append(rates(name, files[name], threads))
            except (ValueError, RuntimeError) as error:
                print(f"not measured: {name}: {str(error).splitlines()[0]}")
                break
    return sorted(lines, key=lambda line: line["ratio"])  # type: ignore[arg-type,return-value]


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--robots", type=Path, help="a folder of robots, each with a scene.xml")
    given = parser.parse_args()
    names = ("inverted_pendulum", "hopper", "half_cheetah", "ant")
    print(Table([line(name, sc.Sim(sc.load(f"gymnasium:{name}"))) for name in names]))
    print(Table(compared(given.robots)))


if __name__ == "__main__":
    main()
