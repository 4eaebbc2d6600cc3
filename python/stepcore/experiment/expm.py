"""The matrix exponential, by scaling and squaring."""

from __future__ import annotations

import numpy as np

# Terms of the Taylor series at norm 1/2: the first left out is 2^-18/18! < 1e-21.
TERMS = 18


def expm(matrix: np.ndarray) -> np.ndarray:
    """e^A of a square matrix: Taylor's series of A/2^s, whose norm is at most 1/2, squared s times.

    Good to rounding times 2^s. Source: Moler and Van Loan, Nineteen Dubious Ways to Compute the
    Exponential of a Matrix, SIAM Review 45 (2003), method 3.

    >>> expm(np.array([[0.0, 1.0], [-1.0, 0.0]])).round(6).tolist()
    [[0.540302, 0.841471], [-0.841471, 0.540302]]
    """
    norm = float(np.abs(matrix).sum(axis=1).max(initial=0.0))
    squarings = max(0, int(np.ceil(np.log2(norm))) + 1) if norm > 0 else 0
    small = matrix / 2.0**squarings
    result = np.eye(len(matrix))
    term = np.eye(len(matrix))
    for k in range(1, TERMS + 1):
        term = term @ small / k
        result = result + term
    for _ in range(squarings):
        result = result @ result
    return result
