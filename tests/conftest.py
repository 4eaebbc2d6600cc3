"""What several tests share."""

import signal

import pytest


@pytest.fixture
def interruptible():
    """Python's own handler of Ctrl-C: a process started in the background may ignore it."""
    before = signal.signal(signal.SIGINT, signal.default_int_handler)
    yield
    signal.signal(signal.SIGINT, before)
