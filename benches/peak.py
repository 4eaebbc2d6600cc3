"""What share of a core's floating-point peak and bandwidth a step of many worlds reaches.

    python benches/peak.py
    python benches/peak.py --only cheetah --no-save

The peak is measured beside each scene: what a matrix product of numpy's reaches on one thread, in
double or single precision, and for the bandwidth what a copy of an array does that no cache holds
(bytes read and bytes written). Operations of a step are counted by the engine (`Sim.count_flops`: a
sine is 20, a comparison 0), the mean of some worlds; so is its memory (`Batch.nbytes`), which a
step reads and writes once at least. One thread, computing time, medians; worlds are spread along a
motion under random controls. The second line of a scene says where its operations are, by stage.

Operations are those of the method in general form: what compiled code leaves out, such as products
with the zeros of an axis, is counted, so that a share may even exceed 1 (the chain's does). A share
far below 1 is no idle core: operations that wait for the last one's result, divisions and roots
(which take ten times a product), comparisons and selects (which count as 0), and lanes whose world
has no part in a row, all lower it. "gain" is how much less a world takes than alone: of 8
lanes.
"""

from __future__ import annotations

import os

# Before numpy is imported: a peak of one core.
os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")
os.environ.setdefault("MKL_NUM_THREADS", "1")

from collections.abc import Callable
from time import thread_time

import numpy as np
import record
import scenes

import stepcore as sc

CASES: dict[str, Callable[[], sc.Scene]] = {
    "ball drop": lambda: sc.loads(scenes.ball()),
    "spring": lambda: sc.loads(scenes.spring()),
    "two-ball stack": lambda: sc.loads(scenes.stack()),
    "chain of 20 hinges": lambda: sc.loads(scenes.chain()),
    "half_cheetah": lambda: sc.load("gymnasium:half_cheetah"),
    "hopper": lambda: sc.load("gymnasium:hopper"),
    "walker2d": lambda: sc.load("gymnasium:walker2d"),
    "ant": lambda: sc.load("gymnasium:ant"),
    "humanoid": lambda: sc.load("gymnasium:humanoid"),
}
WAYS = {"alone": (False, "f64"), "lanes": (True, "f64"), "lanes, f32": (True, "f32")}
WORLDS, SPREAD, COUNTED = 1024, 100, 8
MATRIX, COPIED = 512, 1 << 23


class Core:
    """What this core can do: operations and bytes a second, the most of the times measured."""

    def __init__(self) -> None:
        rng = np.random.default_rng(0)
        self.factors = {
            name: rng.standard_normal((2, MATRIX, MATRIX)).astype(kind)
            for name, kind in (("f64", np.float64), ("f32", np.float32))
        }
        self.source, self.target = np.ones((2, COPIED))
        self.flops = {"f64": 0.0, "f32": 0.0}
        self.bandwidth = 0.0

    def measure(self) -> None:
        """Once more."""
        for name, (a, b) in self.factors.items():
            took = timed(lambda a=a, b=b: np.matmul(a, b))
            self.flops[name] = max(self.flops[name], 2 * MATRIX**3 / took)
        took = timed(lambda: np.copyto(self.target, self.source))
        self.bandwidth = max(self.bandwidth, 2 * self.source.nbytes / took)


def timed(work: Callable[[], object]) -> float:
    """The computing time of some work [s]."""
    begin = thread_time()
    work()
    return thread_time() - begin


def spread(model: sc.Model, worlds: int, lanes: bool, precision: str) -> sc.Batch:
    """Worlds along a motion under random controls."""
    batch = sc.Batch(model, worlds, threads=1, lanes=lanes, precision=precision)
    noise = sc.Noise(worlds, seed=0)
    batch.qvel += noise.normal(model.nv, 0.1)
    low, high = np.clip(model.actuator_ctrlrange, -1.0, 1.0).T
    for _ in range(SPREAD // 10):
        batch.ctrl[:] = noise.uniform(model.nu, low, high)
        batch.step(10)
    return batch


def counted(model: sc.Model, batch: sc.Batch) -> tuple[float, dict[str, float]]:
    """Operations of a world's step, the mean of some, and the share of each stage."""
    sim, stages = sc.Sim(model), {}
    states = batch.state()
    for state in states[:: max(1, len(states) // COUNTED)]:
        sim.restore(state)
        for stage, count in sim.stage_flops().items():
            name = stage.partition("/")[0]
            stages[name] = stages.get(name, 0) + count
    whole = sum(stages.values())
    return whole, {name: count / whole for name, count in stages.items()}


def main() -> None:
    options = record.arguments(__doc__.splitlines()[0])
    worlds = 64 if options.quick else WORLDS
    report = record.Report("peak", options, f"{worlds} worlds; ns of a world's step")
    core = Core()
    report.say()
    report.say(
        f"{'scene':20}{'way':12}{'ns':>9}{'gain':>6}{'operations':>12}{'Gflop/s':>9}{'of peak':>9}"
        f"{'bytes':>8}{'GB/s':>7}{'of copy':>9}"
    )
    for name, make in CASES.items():
        if options.only.lower() in name:
            compare(name, make().compile(), worlds, core, options, report)
    report.say()
    peaks = ", ".join(f"{kind} {rate / 1e9:.1f} Gflop/s" for kind, rate in core.flops.items())
    report.say(f"peak: {peaks}; copy: {core.bandwidth / 1e9:.1f} GB/s")
    report.add(peak=core.flops, bandwidth=core.bandwidth)
    report.close()


def compare(
    name: str, model: sc.Model, worlds: int, core: Core, options, report: record.Report
) -> None:
    """Lines of a scene, its ways measured in turn."""
    ways = {way: spread(model, worlds, *how) for way, how in WAYS.items()}
    operations, stages = counted(model, ways["alone"])
    times: dict[str, list[float]] = {way: [] for way in ways}
    for _ in range(options.pairs):
        core.measure()
        for way, batch in ways.items():
            steps = max(1, round(options.sample / max(1e-6, timed(lambda b=batch: b.step(1)))))
            times[way].append(timed(lambda b=batch, n=steps: [b.step(1) for _ in range(n)]) / steps)
    alone = float(np.median(times["alone"]))
    for way, batch in ways.items():
        took = float(np.median(times[way])) / worlds
        rate, size = operations / took, batch.nbytes / worlds
        peak, moved = core.flops[WAYS[way][1]], 2 * size / took
        gain = alone / worlds / took
        report.say(
            f"{name:20}{way:12}{1e9 * took:9.0f}{gain:6.1f}{operations:12.0f}{rate / 1e9:9.2f}"
            f"{rate / peak:9.1%}{size:8.0f}{moved / 1e9:7.2f}{moved / core.bandwidth:9.1%}"
        )
        report.add(scene=name, way=way, seconds=took, gain=gain, operations=operations, bytes=size)
    shares = ", ".join(f"{stage} {share:.0%}" for stage, share in stages.items())
    report.say(f"{'':20}operations: {shares}")


if __name__ == "__main__":
    main()
