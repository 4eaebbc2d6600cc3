"""Eigenvalues of matrices that may be singular, huge or not finite at all: no exception, no NaN."""

from __future__ import annotations

from typing import Any

import numpy as np


def eigenvalues(matrix: Any) -> Any:
    """The eigenvalues of a matrix, shape (n,), complex; None where they cannot be computed.

    That is where an entry is not finite, or the iteration leaves the range of numbers or does not
    converge.
    """
    if matrix is None or not np.isfinite(matrix).all():
        return None
    try:
        with np.errstate(all="ignore"):
            values = np.linalg.eigvals(matrix).astype(complex)
    except np.linalg.LinAlgError:
        return None
    return values if np.isfinite(values).all() else None
