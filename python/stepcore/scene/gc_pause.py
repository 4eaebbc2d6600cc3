"""Pause garbage collection while a large scene is built."""

from __future__ import annotations

import gc
from collections.abc import Iterator
from contextlib import contextmanager


@contextmanager
def paused() -> Iterator[None]:
    """Garbage is not searched for in between.

    Python searches whenever some hundred more objects were made than freed: that is a third of the
    time in which a scene of thousands of bodies is read and compiled.
    """
    searches = gc.isenabled()
    gc.disable()
    try:
        yield
    finally:
        if searches:
            gc.enable()
