"""Worlds, lanes and threads under a memory checker; CONTRIBUTING.md has the command.

    PYTHONMALLOC=malloc valgrind --error-exitcode=9 ... python benches/memory_check.py

What a step, a batch in threads, views that outlive their worlds, failures and snapshots touch: the
pool of threads and the memory that numpy and the engine share. Its numbers mean nothing there:
valgrind's comparison that leaves out NaN (`_CMP_NEQ_OQ`) does not.
"""

from __future__ import annotations

import gc
import threading
import warnings

import numpy as np

import stepcore as sc

TEXT = """<mujoco><worldbody><geom type="plane" size="2 2 1"/>
<body pos="0 0 .3"><freejoint/><geom type="box" size=".1 .1 .1"/></body>
<body pos="0 .3 .3"><joint name="j" axis="0 1 0" range="-1 1"/><geom type="capsule" size=".05 .2"/>
<site name="s"/></body></worldbody><actuator><position joint="j" kp="5"/></actuator>
<sensor><accelerometer site="s"/></sensor></mujoco>"""


def main() -> None:
    warnings.simplefilter("ignore")
    model = sc.loads(TEXT).compile()
    kept = [views_of(sc.Sim(model, precision=precision)) for precision in ("f64", "f32")]
    for lanes in (True, False):
        kept += [batch_of(model, lanes, threads) for threads in (1, 2, 3)]
    gc.collect()
    print(sum(float(view.sum()) for views in kept for view in views))


def views_of(sim: sc.Sim) -> list[np.ndarray]:
    """What is read of a world that steps, is restored, and is gone."""
    sim.ctrl[:] = 0.3
    sim.step(8)
    state = sim.state()
    sim.qvel[:] = 1e200 if sim.settings.precision == "f64" else 1e30
    try:
        sim.step(3)
    except sc.SimulationError as error:
        str(error)
    sim.restore(state)
    sim.contacts, sim.rows, sim.sensordata, sim.energy, sim.linearize()
    return [sim.qpos, sim.qvel, sim.ctrl, sim.xpos]


def batch_of(model: sc.Model, lanes: bool, threads: int) -> list[np.ndarray]:
    """The same of many worlds, of which some fail, stepped and read by two Python threads."""
    batch = sc.Batch(model, 9, threads=threads, lanes=lanes, on_failure="go on")
    batch.qvel[4] = 1e200

    def play() -> None:
        for _ in range(2):
            try:
                batch.step(2)
                batch.ctrl[:] = 0.1
                batch.state()
            except (RuntimeError, ValueError):
                # The other thread steps it; or valgrind took NaN for finite, and a step refuses it.
                batch.qpos.sum()

    both = [threading.Thread(target=play) for _ in range(2)]
    for one in both:
        one.start()
    for one in both:
        one.join()
    batch.reset()
    batch.reset(worlds=np.arange(9) % 2 == 0)
    batch.rollout(np.zeros((9, 3, model.nu)))
    return [batch.qpos, batch.qvel, batch.ctrl]


if __name__ == "__main__":
    main()
