"""Mark in every file that stepcore writes, which distinguishes earlier outputs from other files.

Pages, plots, JSON, trajectories and logs have the mark in a comment field of their format; replay
files have it in their kind. MJCF files have no mark, nor have picture formats without comments,
such as JPEG.
"""

from __future__ import annotations

import os
import stat
from typing import Any

from stepcore.files import LARGEST_FILE

MARK = "written by stepcore"
MARKS = (MARK.encode(), b'"kind": "stepcore replay"')
# The comment field that matplotlib writes, by file extension.
REMARKS = {"png": "Software", "svg": "Creator", "pdf": "Creator", "ps": "Creator", "eps": "Creator"}


def remark(path: str) -> dict[str, Any]:
    """Return matplotlib's options that write the mark, in formats with a comment field."""
    field = REMARKS.get(os.path.splitext(path)[1][1:].lower())
    return {} if field is None else {"metadata": {field: MARK}}


def is_replaceable(path: str) -> bool:
    """Return whether overwriting loses nothing: no file, an empty file or an output of stepcore."""
    try:
        status = os.stat(path)
        # Writing to a special file, such as /dev/stdout, replaces nothing.
        if not stat.S_ISREG(status.st_mode) or not status.st_size:
            return True
        with open(path, "rb") as file:
            data = file.read(LARGEST_FILE)
    except FileNotFoundError:
        return True
    except OSError:
        return False
    return any(mark in data for mark in MARKS)
