"""Runs cases, each in a process of its own with limits of time and memory, and reports what became
of them.

A case is a function of a seed. It may return, or raise what a user is promised; a signal, a time
out, a panic or any other exception is a defect.
"""

from __future__ import annotations

import os
import resource
import select
import signal
import time
import traceback
from collections.abc import Callable, Iterable

# Of one case: processor time, and time by the clock, which other processes may take.
SECONDS = 10
BY_THE_CLOCK = 900.0
# Address space [bytes]: threads reserve more than they use.
MEMORY = 6 << 30
LONGEST_TEXT = 1500


def outcome(case: Callable[[int], None], seed: int, allowed: tuple[type, ...]) -> str:
    """ "" for a case that went well, else what went wrong, in this process."""
    try:
        case(seed)
    except allowed as error:
        text = str(error)
        if len(text) > LONGEST_TEXT:
            return f"{type(error).__name__} of {len(text)} characters"
        if "panic" in text or "internal error" in text:
            return text
        return ""
    except BaseException as error:
        where = traceback.extract_tb(error.__traceback__)[-1]
        place = f"{os.path.basename(where.filename)}:{where.lineno}"
        return f"{type(error).__name__}: {str(error)[:300]} ({place})"
    return ""


def isolated(case: Callable[[int], None], seed: int, allowed: tuple[type, ...]) -> str:
    """`outcome` in a forked process with limits of time and memory."""
    reader, writer = os.pipe()
    child = os.fork()
    if child == 0:
        os.close(reader)
        signal.signal(signal.SIGINT, signal.SIG_DFL)
        resource.setrlimit(resource.RLIMIT_CPU, (SECONDS, SECONDS + 1))
        resource.setrlimit(resource.RLIMIT_AS, (MEMORY, MEMORY))
        resource.setrlimit(resource.RLIMIT_CORE, (0, 0))
        # What a panic prints is told by its exception.
        null = os.open(os.devnull, os.O_WRONLY)
        os.dup2(null, 1)
        os.dup2(null, 2)
        os.write(writer, b"=" + outcome(case, seed, allowed).encode(errors="replace")[:4000])
        os._exit(0)
    os.close(writer)
    said = b""
    deadline = time.monotonic() + BY_THE_CLOCK
    while True:
        ready, _, _ = select.select([reader], [], [], max(0.0, deadline - time.monotonic()))
        if not ready:
            os.kill(child, signal.SIGKILL)
            os.waitpid(child, 0)
            os.close(reader)
            return f"no answer within {BY_THE_CLOCK:g} s"
        part = os.read(reader, 65536)
        if not part:
            break
        said += part
    os.close(reader)
    _, status = os.waitpid(child, 0)
    if os.WIFSIGNALED(status) and os.WTERMSIG(status) == signal.SIGXCPU:
        return f"no answer within {SECONDS} s"
    if os.WIFSIGNALED(status):
        return f"killed by {signal.Signals(os.WTERMSIG(status)).name}"
    return said[1:].decode() if said else f"ended with status {status} and no answer"


def defects(
    case: Callable[[int], None], seeds: Iterable[int], allowed: tuple[type, ...]
) -> list[str]:
    """The seeds that went wrong, with what happened."""
    results = ((seed, isolated(case, seed, allowed)) for seed in seeds)
    return [f"{case.__name__}({seed}): {what}" for seed, what in results if what]
