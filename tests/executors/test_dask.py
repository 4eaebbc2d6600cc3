"""The same work on a Dask cluster of processes on this machine: the extra `dask`."""

import functools
import os
import signal
import threading
import time

import pytest
import workers

import stepcore as sc
from stepcore import executors as jobs
from stepcore import lesson
from stepcore.report.progress import Progress


@pytest.fixture(scope="module")
def client():
    import sys

    import dask
    import distributed

    # A worker process imports the functions of these tests as they are imported here.
    place = os.path.dirname(os.path.dirname(__file__))
    before = os.environ.get("PYTHONPATH")
    os.environ["PYTHONPATH"] = os.pathsep.join([place, *sys.path])
    cluster = distributed.LocalCluster(
        n_workers=2, threads_per_worker=1, processes=True, dashboard_address=None, silence_logs=50
    )
    # Results that a killed worker held are computed again once nothing answers there.
    quick = dask.config.set({"distributed.comm.timeouts.connect": "2s"})
    with quick, cluster, distributed.Client(cluster) as client:
        yield client
    if before is None:
        del os.environ["PYTHONPATH"]
    else:
        os.environ["PYTHONPATH"] = before


def grid(points):
    """Drops by softness, sweeps and step, a few of which cannot be."""
    softness = [0.01 * k for k in range(points // 4 - 1)] + [-1.0]
    return {"sweeps": [1, 3], "geom/shape1/mass": [0.5, 100.0], "softness": softness}


def test_a_cluster_gives_the_bits_of_one_process(client):
    """200 runs on two processes, with progress and failures in their rows."""
    model = lesson.stack().compile()
    seen = []
    ours = sc.sweep(model, grid(200), workers.height, threads=1)
    theirs = sc.sweep(
        model,
        grid(200),
        workers.height,
        executor=client.get_executor(),
        progress=lambda *told: seen.append(told[1:]),
    )
    assert theirs.records == ours.records
    assert sum(record["failure"] is not None for record in ours) == 4
    assert len(seen) >= 40 and seen[-1] == (200, 200)
    found = sc.sweep(model, grid(40), workers.where, executor=client.get_executor())
    assert os.getpid() not in found["process"]
    # Dask pickles what no module holds.
    local = sc.sweep(
        model, {"dt": [0.1]}, lambda sim: sim.settings.dt, executor=client.get_executor()
    )
    assert local["value"] == [0.1]


def test_a_killed_worker_is_survived(client, tmp_path):
    """A worker dies of one point: Dask starts another, and nothing is missing or done wrong."""
    work = functools.partial(workers.killed_once, str(tmp_path / "killed"))
    bar = Progress("", 200, False)
    got = jobs.each(work, range(200), bar=bar, executor=client.get_executor())
    assert (tmp_path / "killed").exists()
    assert got == [float(k**0.5).hex() for k in range(200)]
    assert bar.done == 200


@pytest.mark.long
def test_ten_thousand_runs_and_a_worker_killed_from_outside(client):
    """10 000 runs with SIGKILL in the middle: bit for bit what one process gives."""
    model = lesson.stack().compile()
    axes = grid(10_000)
    killed = []

    def kill():
        pid = next(iter(client.run(os.getpid).values()))
        os.kill(pid, signal.SIGKILL)
        killed.append(pid)

    def told(label, done, total):
        if done > total // 3 and not killed:
            killed.append(None)
            threading.Thread(target=kill).start()

    theirs = sc.sweep(model, axes, workers.height, executor=client.get_executor(), progress=told)
    while len(killed) < 2:
        time.sleep(0.01)
    ours = sc.sweep(model, axes, workers.height, threads=1, progress=False)
    assert len(ours) == 10_000
    assert theirs.records == ours.records
