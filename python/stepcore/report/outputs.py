"""Files that stepcore writes carry a mark, by which an earlier output is told from anything else.

Pages, plots, JSON, trajectories and logs have it where their format keeps remarks, replay files in
their kind. An MJCF file has none, nor have formats of pictures without remarks, such as JPEG.
"""

from __future__ import annotations

import os
import stat
from typing import Any

from stepcore.files import LARGEST

MARK = "written by stepcore"
MARKS = (MARK.encode(), b'"kind": "stepcore replay"')
# Where matplotlib puts a remark, by the ending of the file.
REMARKS = {"png": "Software", "svg": "Creator", "pdf": "Creator", "ps": "Creator", "eps": "Creator"}


def remark(path: str) -> dict[str, Any]:
    """The options with which matplotlib writes the mark, in formats that take it."""
    field = REMARKS.get(os.path.splitext(path)[1][1:].lower())
    return {} if field is None else {"metadata": {field: MARK}}


def is_replaceable(path: str) -> bool:
    """Whether nothing is lost if a file is written there: none, an empty one, or one of these."""
    try:
        status = os.stat(path)
        # What is no regular file, such as /dev/stdout, is not replaced.
        if not stat.S_ISREG(status.st_mode) or not status.st_size:
            return True
        with open(path, "rb") as file:
            data = file.read(LARGEST)
    except FileNotFoundError:
        return True
    except OSError:
        return False
    return any(mark in data for mark in MARKS)
