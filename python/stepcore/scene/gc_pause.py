"""Pause garbage collection while a large scene is built."""

from __future__ import annotations

import gc
from collections.abc import Iterator
from contextlib import contextmanager


@contextmanager
def paused() -> Iterator[None]:
    """Pause the garbage collector inside a ``with`` block.

    Python collects whenever some hundred more objects were allocated than freed, which takes a
    third of the time to read and compile a scene of thousands of bodies.
    """
    searches = gc.isenabled()
    gc.disable()
    try:
        yield
    finally:
        if searches:
            gc.enable()
