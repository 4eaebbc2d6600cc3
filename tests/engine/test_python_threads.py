"""Python's threads, with and without the GIL: what is shared holds, and a run has its bits."""

import subprocess
import sys
import sysconfig
import threading
from concurrent.futures import ThreadPoolExecutor

import numpy as np
import pytest
from small import ball, pendulum

import stepcore as sc

FREE_THREADED = bool(sysconfig.get_config_var("Py_GIL_DISABLED"))
THREADS = 8


@pytest.mark.skipif(not FREE_THREADED, reason="this Python has the GIL")
def test_a_free_threaded_python_stays_without_the_gil():
    code = "import sys, stepcore; stepcore.Sim; print(sys._is_gil_enabled())"
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert done.stdout == "False\n" and not done.stderr


END = """
import sys, threading, time
import stepcore as sc

model, steps = sc.lesson.stack().compile(), int(sys.argv[2])

def go_on(world):
    while True:
        world.step(steps)

for _ in range(3):
    world = sc.Sim(model) if sys.argv[1] == "Sim" else sc.Batch(model, 64)
    threading.Thread(target=go_on, args=(world,), daemon=True).start()
time.sleep(0.2)
print("ends")
"""


@pytest.mark.parametrize("kind", ["Sim", "Batch"])
@pytest.mark.parametrize("steps", [5, 10**9])
def test_a_program_ends_while_threads_step(kind, steps):
    """A daemon thread that takes the GIL back while the interpreter ends is not torn down."""
    command = [sys.executable, "-c", END, kind, str(steps)]
    done = subprocess.run(command, capture_output=True, text=True, timeout=600)
    assert (done.returncode, done.stdout) == (0, "ends\n"), done.stderr


def run(model, seed):
    sim = sc.Sim(model, solver="newton")
    sim.qvel[:] = np.random.default_rng(seed).normal(size=len(sim.qvel))
    for _ in range(200):
        sim.step()
        sim.ctrl[:] = np.tanh(sim.qvel[: len(sim.ctrl)])
    return sim.state(), sim.contacts["force"].tobytes()


@pytest.mark.parametrize("scene", [pendulum, ball])
def test_runs_of_one_model_in_threads_are_those_one_after_the_other(scene):
    model = scene().compile()
    with ThreadPoolExecutor(THREADS) as pool:
        together = list(pool.map(lambda seed: run(model, seed), range(3 * THREADS)))
    assert together == [run(model, seed) for seed in range(3 * THREADS)]


def test_scenes_are_built_and_compiled_in_threads():
    with ThreadPoolExecutor(THREADS) as pool:
        states = list(pool.map(lambda _: run(pendulum().compile(), 3), range(2 * THREADS)))
    assert set(states) == {run(pendulum().compile(), 3)}


def work_on(kind, model):
    """One object that every thread of a test reads, writes, steps and restores."""
    return sc.Sim(model) if kind == "Sim" else sc.Batch(model, 9)


@pytest.mark.parametrize("kind", ["Sim", "Batch"])
def test_one_object_in_many_threads_is_busy_or_does_what_it_is_asked(kind):
    """Steps are counted, none is lost and none is half done; the rest reads whole states."""
    world = work_on(kind, pendulum().compile())
    start = world.state()
    done, wrong, ready = [0] * THREADS, [], threading.Barrier(THREADS)

    def step(thread):
        ready.wait()
        for _ in range(300):
            try:
                world.step()
                done[thread] += 1
                world.state()
                _ = world.xpos, world.qacc, world.energy
            except RuntimeError as error:
                if "is busy in another thread" not in str(error):
                    wrong.append(error)

    threads = [threading.Thread(target=step, args=(thread,)) for thread in range(THREADS)]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    assert not wrong
    assert world.time == pytest.approx(sum(done) * world.settings.dt)
    assert np.isfinite(world.qpos).all() and np.isfinite(world.qvel).all()
    world.restore(start)
    assert world.state() == start


def test_what_was_checked_is_what_is_stepped():
    """Numpy writes without the GIL while others step: no number that was refused is ever used."""
    batch = sc.Batch(ball(), 64, threads=1)
    good, bad = np.array(batch.qvel), np.full(batch.qvel.shape, np.nan)
    done = threading.Event()

    def write():
        while not done.is_set():
            np.copyto(batch.qvel, bad)
            np.copyto(batch.qvel, good)

    writer = threading.Thread(target=write)
    writer.start()
    try:
        for _ in range(2000):
            try:
                batch.step()
            except ValueError as error:
                assert "qvel" in str(error) and "finite" in str(error)
            assert np.isfinite(batch.qpos).all()
    finally:
        done.set()
        writer.join()
