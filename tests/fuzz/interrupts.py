"""Ctrl-C at random times: a KeyboardInterrupt or a finished call, and the state of a whole step."""

from __future__ import annotations

import os
import pickle
import random
import signal
import threading
import time
import warnings
from collections.abc import Callable

import numpy as np
from cases import Broken, finite
from zoo import ZOO

import stepcore as sc

STEPS = 400


def later(seconds: float) -> None:
    """Sends the signal of Ctrl-C to this process after a time."""
    timer = threading.Timer(seconds, os.kill, (os.getpid(), signal.SIGINT))
    timer.daemon = True
    timer.start()


def interrupted(seed: int) -> None:
    """A long call is interrupted; what it leaves is a state on the way of the same run."""
    rng = random.Random(seed)
    signal.signal(signal.SIGINT, signal.default_int_handler)
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        scene = sc.loads(ZOO[rng.choice(("all_together", "ball_joints", "connect"))].text)
    model = scene.compile()
    kind = rng.choice(("step", "batch", "run", "rollout", "load", "check"))
    sim = sc.Sim(model, integrator="implicitfast")
    calls: dict[str, Callable[[], object]] = {
        "step": lambda: sim.step(STEPS),
        "run": lambda: sim.run(STEPS * sim.settings.dt),
        "load": lambda: [sc.loads(ZOO["all_together"].text) for _ in range(20)],
        "check": lambda: sc.diagnose(sc.lesson.spring(), horizon=0.1),
    }
    batch = sc.Batch(model, 8, rng.choice((1, 2)), integrator="implicitfast")
    calls["batch"] = lambda: batch.step(STEPS)
    calls["rollout"] = lambda: batch.rollout(np.zeros((len(batch), STEPS, model.nu)))
    try:
        later(10 ** rng.uniform(-4, -0.7))
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")
            calls[kind]()
        # Where the call was done before: the signal comes here.
        time.sleep(10.0)
    except KeyboardInterrupt:
        pass
    whole(sim, model)
    for world in range(len(batch)):
        finite(batch)
        other = sc.Sim(model, integrator="implicitfast")
        other.restore(batch.state()[world])
        whole(other, model)


def whole(sim: sc.Sim, model: sc.Model) -> None:
    """The state is the one after some number of whole steps, and goes on."""
    finite(sim)
    done = round(sim.time / sim.settings.dt)
    other = sc.Sim(model, integrator="implicitfast")
    other.step(done)
    if not (np.array_equal(sim.qpos, other.qpos) and np.array_equal(sim.qvel, other.qvel)):
        raise Broken(f"the state at t = {sim.time} is none of the run")
    again = pickle.loads(pickle.dumps(sim))
    again.step(3)
    finite(again)
