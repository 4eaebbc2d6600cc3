"""Read files that a user or a model names: regular files of bounded size, without blocking."""

from __future__ import annotations

import io
import math
import os
import stat
import zipfile
import zlib
from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any, BinaryIO

import numpy as np
from numpy.typing import NDArray

from stepcore import checks

# Largest file [bytes]. No model or replay is larger, and a larger file could fill the memory.
LARGEST_FILE = 2**28

# How a pointer of Git LFS begins.
LFS = b"version https://git-lfs.github.com/spec/"

# Outputs of the running command, as (device, inode): reading them is refused.
outputs: set[tuple[int, int]] = set()


def as_path(name: str, value: object) -> str:
    """Return `value` as the path of a file; raise ValueError if it is no path."""
    if isinstance(value, (str, bytes, os.PathLike)):
        try:
            text = os.fsdecode(value)
        except TypeError:
            text = ""
        if text and "\0" not in text:
            return text
    raise ValueError(f"{name} = {checks.shown(value)}: must be a path")


def contents(path: str | os.PathLike[str], expected: str) -> bytes:
    """Return the bytes of a regular file of at most `LARGEST_FILE` bytes; see `open_regular`.

    Raises ValueError for a Git LFS pointer, whose file was not fetched.
    """
    with open_regular(path, expected) as (file, size):
        # At most the reported size: system files that block until an event report 0.
        data = file.read(size)
    if data.startswith(LFS):
        called = checks.cut(checks.without_middle(os.fsdecode(path)))
        raise ValueError(
            f"{called}: is a pointer of Git LFS, not {expected}: `git lfs pull` in its repository "
            "brings the file"
        )
    return data


@contextmanager
def open_regular(
    path: str | os.PathLike[str], expected: str, largest: int | None = None
) -> Iterator[tuple[BinaryIO, int]]:
    """Open a regular file, and give its size [bytes].

    expected: the expected kind of file in errors, such as "an MJCF file". largest: the largest size
        [bytes]; None: `LARGEST_FILE`.

    Raises FileNotFoundError, IsADirectoryError, and ValueError for a device, a pipe or a socket
    (none is opened), for a file that is too large and for a file that cannot be read. The text is
    one line that names the file.
    """
    name, most = os.fsdecode(path), LARGEST_FILE if largest is None else largest
    called = checks.cut(checks.without_middle(name))
    if "\0" in name:
        raise ValueError(f"{checks.shown(name)}: cannot be read: no file has a NUL in its name")
    try:
        # Checked before opening, because opening triggers an action of some devices.
        _size(os.stat(name), called, expected, most)
        with open(name, "rb", opener=_without_waiting) as file:
            yield file, _size(os.fstat(file.fileno()), called, expected, most)
    except FileNotFoundError:
        text = "; `loads` reads a text" if name.lstrip().startswith("<") else ""
        raise FileNotFoundError(f"{called}: no such file{text}") from None
    except IsADirectoryError:
        raise IsADirectoryError(f"{called}: is a folder, not {expected}") from None
    except OSError as error:
        raise ValueError(f"{called}: cannot be read: {error.strerror or error}") from None


def arrays(path: str | os.PathLike[str], expected: str) -> dict[str, NDArray[Any]]:
    """Return the arrays of an .npz file by name, or the array of an .npy file under "".

    Raises ValueError for a file that is neither or is damaged, for arrays of Python objects and for
    arrays that are together larger than `LARGEST_FILE`, which a small file can claim to hold; also
    the errors of `contents`.
    """
    data = contents(path, expected)
    try:
        if not zipfile.is_zipfile(io.BytesIO(data)):
            return {"": _array(data)}
        with zipfile.ZipFile(io.BytesIO(data)) as archive:
            members = archive.infolist()
            if {m.compress_type for m in members} - {zipfile.ZIP_STORED, zipfile.ZIP_DEFLATED}:
                raise ValueError("its arrays are compressed as numpy does not")
            if sum(member.file_size for member in members) > LARGEST_FILE:
                raise ValueError(f"has arrays of more than {LARGEST_FILE // 2**20} MiB")
            return {m.filename.removesuffix(".npy"): _array(archive.read(m)) for m in members}
    except (ValueError, TypeError, EOFError, RuntimeError, zipfile.BadZipFile, zlib.error) as error:
        name = checks.cut(checks.without_middle(os.fsdecode(path)))
        raise ValueError(f"{name}: is not {expected}: {checks.one_line(error)}") from None


def _array(data: bytes) -> NDArray[Any]:
    """Return the array of an .npy file; its header must not claim more numbers than it has."""
    file = io.BytesIO(data)
    version = np.lib.format.read_magic(file)
    header = np.lib.format.read_array_header_1_0
    shape, _, dtype = (header if version == (1, 0) else np.lib.format.read_array_header_2_0)(file)
    if (
        dtype.hasobject
        or math.prod(shape) * dtype.itemsize > len(data)
        or min(shape, default=0) < 0
    ):
        raise ValueError("its numbers are not those that its header tells of")
    return np.load(io.BytesIO(data), allow_pickle=False)


def _size(status: os.stat_result, name: str, expected: str, largest: int) -> int:
    """Return the size of a file [bytes]; raise if the file must not be read."""
    if stat.S_ISDIR(status.st_mode):
        raise IsADirectoryError
    if not stat.S_ISREG(status.st_mode):
        raise ValueError(f"{name}: is not a regular file, so it is not read")
    if (status.st_dev, status.st_ino) in outputs:
        raise ValueError(f"{name}: is an output of this command, which reads it")
    if status.st_size > largest:
        limit = f"has more than {largest // 2**20} MiB"
        raise ValueError(f"{name}: {limit}, which {expected} never has")
    return status.st_size


def _without_waiting(name: str, flags: int) -> int:
    """Open a file; do not wait for a writer if the file has become a pipe in the meantime."""
    return os.open(name, flags | getattr(os, "O_NONBLOCK", 0))
