"""Calls that wait until another thread steps a world, however long that takes on this machine."""

import threading
import time


def when_busy(world, *acts):
    """Start a thread that calls functions as soon as a Sim or a Batch is being stepped."""

    def wait():
        while True:
            try:
                world.time  # noqa: B018
            except RuntimeError:
                break
            time.sleep(1e-3)
        for act in acts:
            act()

    thread = threading.Thread(target=wait, daemon=True)
    thread.start()
    return thread
