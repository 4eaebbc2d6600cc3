"""Reads the files that a user or a model names: regular ones of a bounded size, without waiting."""

from __future__ import annotations

import os
import stat

from stepcore import checks

# No model and no replay is larger [bytes]; a file that is would fill the memory.
LARGEST = 2**28

# Files that the command which runs will write, as (device, inode): none of them is read.
outputs: set[tuple[int, int]] = set()


def path(name: str, value: object) -> str:
    """`value` as the path of a file: a string, or what stands for one."""
    if isinstance(value, (str, bytes, os.PathLike)):
        try:
            text = os.fsdecode(value)
        except TypeError:
            text = ""
        if text and "\0" not in text:
            return text
    raise ValueError(f"{name} = {checks.shown(value)}: must be a path")


def read(path: str | os.PathLike[str], expected: str) -> bytes:
    """Reads a regular file of at most `LARGEST` bytes.

    expected: what it should be, such as "an MJCF file".

    An error in one line names the file: FileNotFoundError, IsADirectoryError; ValueError for a
    device, a pipe or a socket, which are not opened, for a file that is too large, and for one that
    cannot be read.
    """
    name = os.fsdecode(path)
    called = checks.cut(checks.without_middle(name))
    if "\0" in name:
        raise ValueError(f"{checks.shown(name)}: cannot be read: no file has a NUL in its name")
    try:
        # Before it is opened, because some devices act on that.
        _readable(os.stat(name), called, expected)
        with open(name, "rb", opener=_without_waiting) as file:
            # No more than it says that it has: files of the system that wait for news have 0.
            return file.read(_readable(os.fstat(file.fileno()), called, expected))
    except FileNotFoundError:
        raise FileNotFoundError(f"{called}: no such file") from None
    except IsADirectoryError:
        raise IsADirectoryError(f"{called}: is a folder, not {expected}") from None
    except OSError as error:
        raise ValueError(f"{called}: cannot be read: {error.strerror or error}") from None


def _readable(status: os.stat_result, name: str, expected: str) -> int:
    """The size of a file that is read [bytes]."""
    if stat.S_ISDIR(status.st_mode):
        raise IsADirectoryError
    if not stat.S_ISREG(status.st_mode):
        raise ValueError(f"{name}: is not a regular file, so it is not read")
    if (status.st_dev, status.st_ino) in outputs:
        raise ValueError(f"{name}: is an output of this command, which reads it")
    if status.st_size > LARGEST:
        limit = f"has more than {LARGEST // 2**20} MiB"
        raise ValueError(f"{name}: {limit}, which {expected} never has")
    return status.st_size


def _without_waiting(name: str, flags: int) -> int:
    """Opens a file; one that has become a pipe in the meantime does not wait for its writer."""
    return os.open(name, flags | getattr(os, "O_NONBLOCK", 0))
