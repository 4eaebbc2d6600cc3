"""Python's garbage collector, held while thousands of objects are made that all stay."""

from __future__ import annotations

import gc
from collections.abc import Iterator
from contextlib import contextmanager


@contextmanager
def held() -> Iterator[None]:
    """The collector does not search for garbage, if it did before.

    It searches whenever some hundred objects more were made than freed: a third of the time in
    which a scene of thousands of bodies is read and compiled.
    """
    searches = gc.isenabled()
    gc.disable()
    try:
        yield
    finally:
        if searches:
            gc.enable()
