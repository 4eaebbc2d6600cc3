"""What processes of an executor run in tests: functions of a module, so that they pickle."""

import os
import signal
import time

import numpy as np


def height(sim):
    """Where a drop or a stack is after 20 steps, to the bit; failures where it diverges."""
    sim.reset(key="start")
    sim.step(20)
    return {"height": sim.qpos[0].hex(), "energy": float(sim.energy.total).hex()}


def where(sim):
    """The process that does the work."""
    return {"process": os.getpid()}


def broken(sim):
    raise ZeroDivisionError("a mistake of the user")


def dies(point):
    """A worker is killed by one of the points; the others take a moment."""
    if point == 3:
        os.kill(os.getpid(), signal.SIGKILL)
    time.sleep(0.01)
    return point


def killed_once(flag, point):
    """The first process that reaches the point in the middle is killed, as by a lack of memory."""
    if point == 100 and not os.path.exists(flag):
        open(flag, "w").close()
        os.kill(os.getpid(), signal.SIGKILL)
    return float(np.sqrt(point)).hex()
