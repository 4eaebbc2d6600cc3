"""What executors cost: bytes that cross for a point, overhead a run, memory; and a killed worker.

The same 10 000 short runs (a stack of two balls, 20 steps; settings, masses and softness vary) in
one process, in threads, in a pool of spawned processes and on a Dask cluster of processes, whose
worker is then killed in the middle. Every line says whether all results have the bits of one
process. Overhead is time beyond the work: of the calling process by its processor time, which the
workers' own does not enter; the wall time of a busy machine is printed beside it.
"""

from __future__ import annotations

import multiprocessing
import os
import pickle
import resource
import signal
import threading
import time
from collections.abc import Callable
from concurrent.futures import Executor, ProcessPoolExecutor
from functools import partial

import record

import stepcore as sc
from stepcore import executors as jobs
from stepcore import lesson
from stepcore.measure.sweep import at_point

RUNS, WORKERS = 10_000, 4


def height(sim: sc.Sim) -> dict[str, str]:
    """Where the stack is after 20 steps, to the bit."""
    sim.reset(key="start")
    sim.step(20)
    return {"height": sim.qpos[0].hex(), "energy": float(sim.energy.total).hex()}


def nothing(point: int) -> int:
    """A point without work: what is left is the executor."""
    return point


def grid(runs: int) -> dict[str, list[float]]:
    softness = [0.01 * k for k in range(runs // 4)]
    return {"sweeps": [1, 3], "geom/shape1/mass": [0.5, 100.0], "softness": softness}


class Timed:
    """Wall and processor seconds of the calling process."""

    def __enter__(self) -> Timed:
        self.wall, self.own = time.perf_counter(), time.process_time()
        return self

    def __exit__(self, *_: object) -> None:
        self.wall, self.own = time.perf_counter() - self.wall, time.process_time() - self.own


def wire(report: record.Report, runs: int) -> None:
    """Bytes for a chunk of points, and for the model alone."""
    for name, scene in (("stack", lesson.stack()), ("grasp", lesson.grasp())):
        model = scene.compile()
        work = partial(at_point, model, height)
        points = [{"sweeps": 1, "geom/shape1/mass": 0.5, "softness": 0.01 * k} for k in range(runs)]
        size = -(-runs // jobs.MAX_CHUNKS)
        sent = len(pickle.dumps((jobs._run_chunk, work, points[:size], "0123456789abcdef 0")))
        report.say(
            f"{name}: model {len(pickle.dumps(model))} B; a chunk of {size} points {sent} B, "
            f"{sent / size:.0f} B a point"
        )
        report.add(case=f"wire {name}", model=len(pickle.dumps(model)), chunk=size, bytes=sent)


def sweep(
    report: record.Report,
    name: str,
    runs: int,
    truth: list,
    executor: Executor | None,
    **more: object,
) -> None:
    """One sweep of all runs, and the same number of points without work."""
    model, seen = lesson.stack().compile(), []
    with Timed() as timed:
        table = sc.sweep(
            model, grid(runs), height, executor=executor, progress=lambda *t: seen.append(t), **more
        )
    with Timed() as idle:
        bar = sc.progress.Progress("", runs, False)
        jobs.each(nothing, range(runs), bar=bar, executor=executor, threads=more.get("threads", 2))
    same = table.records == truth
    report.say(
        f"{name:<28} {runs} runs  {timed.wall:6.2f} s  {1e6 * timed.own / runs:7.1f} us a run here;"
        f"  without work {1e6 * idle.own / runs:6.1f} us;  progress told {len(seen)} times;  "
        f"{'same bits' if same else 'OTHER BITS'}"
    )
    report.add(
        case=name,
        runs=runs,
        wall_s=timed.wall,
        own_us=1e6 * timed.own / runs,
        idle_us=1e6 * idle.own / runs,
        told=len(seen),
        same=same,
    )


def killed(report: record.Report, runs: int, truth: list, client: object) -> None:
    """The sweep again, with SIGKILL for one worker when a third is done."""
    gone: list[int] = []

    def kill() -> None:
        gone.append(next(iter(client.run(os.getpid).values())))
        os.kill(gone[0], signal.SIGKILL)

    started: list[threading.Thread] = []

    def told(label: str, done: int, total: int) -> None:
        if done > total // 3 and not started:
            started.append(threading.Thread(target=kill))
            started[0].start()

    with Timed() as timed:
        model = lesson.stack().compile()
        table = sc.sweep(model, grid(runs), height, executor=client.get_executor(), progress=told)
    for thread in started:
        thread.join()
    same = table.records == truth
    report.say(
        f"dask, worker {gone} killed        {runs} runs  {timed.wall:6.2f} s;  "
        f"{'same bits' if same else 'OTHER BITS'}"
    )
    report.add(case="dask, killed", runs=runs, wall_s=timed.wall, killed=len(gone), same=same)


def memory(report: record.Report, where: str, ask: Callable[[], list[int]]) -> None:
    """The most that processes have held."""
    held = [kilobytes / 1024 for kilobytes in ask()]
    report.say(f"memory {where}: {', '.join(f'{mb:.0f} MB' for mb in held)}")
    report.add(case=f"memory {where}", megabytes=held)


def most(_: object = None) -> int:
    """[kB]"""
    return resource.getrusage(resource.RUSAGE_SELF).ru_maxrss


def main() -> None:
    options = record.arguments(__doc__)
    options.pairs = 0
    runs = 400 if options.quick else RUNS
    report = record.Report("executors", options, f"{runs} runs of 20 steps; {WORKERS} processes")
    wire(report, runs)
    truth = sc.sweep(
        lesson.stack().compile(), grid(runs), height, threads=1, progress=False
    ).records
    sweep(report, "one thread", runs, truth, None, threads=1)
    sweep(report, "two threads", runs, truth, None, threads=2)
    context = multiprocessing.get_context("spawn")
    with ProcessPoolExecutor(WORKERS, mp_context=context) as pool:
        list(pool.map(most, range(WORKERS)))
        sweep(report, f"{WORKERS} spawned processes", runs, truth, pool)
        memory(report, "of a spawned worker", lambda: [pool.submit(most).result()])
    import dask
    import distributed

    dask.config.set({"distributed.comm.timeouts.connect": "2s"})
    cluster = distributed.LocalCluster(
        n_workers=WORKERS,
        threads_per_worker=1,
        processes=True,
        dashboard_address=None,
        silence_logs=50,
    )
    with cluster, distributed.Client(cluster) as client:
        sweep(report, f"dask, {WORKERS} processes", runs, truth, client.get_executor())
        memory(report, "of dask workers", lambda: list(client.run(most).values()))
        killed(report, runs, truth, client)
    memory(report, "here", lambda: [most()])
    report.close()


if __name__ == "__main__":
    main()
