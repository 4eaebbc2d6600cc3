"""The matrix exponential, by scaling and squaring."""

from __future__ import annotations

import numpy as np

# Terms of the Taylor series at norm 1/2: the first left out is 2^-18/18! < 1e-21.
TERMS = 18
# Balancing ends by itself, nearly always after a few rounds.
BALANCINGS = 50


def expm(matrix: np.ndarray) -> np.ndarray:
    """e^A of a square matrix: Taylor's series of A/2^s, whose norm is at most 1/2, squared s times.

    Good to rounding times 2^s, so A is balanced first: for a spring of stiffness k and mass 1 its
    norm is then √k and not k. Source: Moler and Van Loan, Nineteen Dubious Ways to Compute the
    Exponential of a Matrix, SIAM Review 45 (2003), method 3.

    >>> expm(np.array([[0.0, 1.0], [-1.0, 0.0]])).round(6).tolist()
    [[0.540302, 0.841471], [-0.841471, 0.540302]]
    """
    matrix, scale = _balanced(matrix)
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
    return result * scale[:, None] / scale[None, :]


def _balanced(matrix: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """D⁻¹ A D, whose rows and columns are of like size, and the diagonal of D, powers of two.

    Source: Osborne, On Pre-Conditioning of Matrices, Journal of the ACM 7 (1960).
    """
    matrix, scale = matrix.copy(), np.ones(len(matrix))
    for _ in range(BALANCINGS):
        before = scale.copy()
        for k in range(len(matrix)):
            own = abs(matrix[k, k])
            column, row = np.abs(matrix[:, k]).sum() - own, np.abs(matrix[k]).sum() - own
            if column > 0 and row > 0:
                factor = 2.0 ** np.round(np.log2(row / column) / 2)
                matrix[:, k] *= factor
                matrix[k] /= factor
                scale[k] *= factor
        if np.array_equal(scale, before):
            break
    return matrix, scale
