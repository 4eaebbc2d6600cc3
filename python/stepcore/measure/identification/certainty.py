"""How certain estimates are: their errors, correlations, and what cannot be told apart."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

# Estimates whose correlation is above this cannot be told apart.
ALIKE = 0.99
# Directions of which a log says less than this share of what it says of the best known.
WEAK = 1e-6


@dataclass(frozen=True)
class Certainty:
    """What the logs say of the estimates.

    errors: the standard error of each; inf where the logs say nothing.
    correlations: between each two, shape (n, n).
    alike: sets of parameters that cannot be told apart.
    inverse: J⁺: times a residual, by how much all values are too large for it; 0 where nothing is
        known.
    """

    errors: np.ndarray
    correlations: np.ndarray
    alike: list[tuple[str, ...]]
    inverse: np.ndarray


def certainty(
    jacobian: np.ndarray, residual: np.ndarray, kinds: np.ndarray, labels: Sequence[str]
) -> Certainty:
    """Return the certainty of estimates from the Jacobian of the residuals.

    jacobian: shape (n, all), of which the first columns are of the parameters `labels`.
    residual: shape (n,). kinds: the quantity of each residual, whose variance is its own.

    The estimates are off by J⁺ e, whose covariance is J⁺ V J⁺ᵀ with the variances V of e.
    """
    spare = max(1, len(residual) - jacobian.shape[1]) / len(residual)
    variances = np.array(
        [np.mean(residual[kinds == kind] ** 2) / spare for kind in range(kinds.max() + 1)]
    )
    inverse, turns, weak = _inverse(jacobian)
    count = len(labels)
    own = inverse[:count]
    covariance = (own * variances[kinds]) @ own.T
    unknown = (np.abs(turns[weak][:, :count]) > WEAK).any(axis=0)
    spread = np.sqrt(np.diag(covariance))
    with np.errstate(divide="ignore", invalid="ignore"):
        related = np.nan_to_num(covariance / np.outer(spread, spread))
    np.fill_diagonal(related, 1.0)
    # A part of this size leaves a correlation as large.
    ways = np.abs(turns[weak][:, :count]) > math.sqrt(1 - ALIKE)
    alike = [tuple(labels[int(k)] for k in np.flatnonzero(way)) for way in ways if way.any()]
    for i in range(count):
        for k in range(i):
            pair = (labels[k], labels[i])
            known = any(set(pair) <= set(names) for names in alike)
            if abs(related[i, k]) > ALIKE and not known:
                alike.append(pair)
    return Certainty(np.where(unknown, np.inf, spread), related, alike, inverse)


def _inverse(jacobian: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return the pseudo-inverse; directions in units of the columns' sizes, and the weak ones."""
    sizes = np.linalg.norm(jacobian, axis=0)
    sizes = np.where(sizes > 0, sizes, 1.0)
    left, singular, turns = np.linalg.svd(jacobian / sizes, full_matrices=False)
    weak = singular <= WEAK * max(singular.max(initial=0.0), 1e-300)
    inverse = (turns[~weak].T / singular[~weak]) @ left[:, ~weak].T
    return inverse / sizes[:, None], turns, weak
