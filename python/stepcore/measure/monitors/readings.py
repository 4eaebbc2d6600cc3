"""Readings of contacts in a run, and when a series of readings is at rest."""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

# The last share of a run, in which rest is judged; the largest relative variation of a quantity at
# rest; and the fewest readings from which rest or creep is judged.
REST, STEADY, FEWEST = 0.25, 0.2, 8

# A pair of geoms, and the index of one of its contacts.
Key = tuple[int, int]


class Look(NamedTuple):
    """One contact at one reading.

    look: the index of the reading.
    depth: the overlap [m].
    force: the normal force [N].
    share: friction over μ × normal force.
    held: whether friction holds the contact.
    past: the tangential velocity [m/s].
    rolls: the speed at which the surfaces turn on each other: angular velocity × lever [m/s].
    """

    look: int
    depth: float
    force: float
    share: float
    held: bool
    past: np.ndarray
    rolls: float


@dataclass(frozen=True)
class Contact:
    """The behaviour of one contact of a pair of geoms.

    depth: the overlap at the start, or at rest [m].
    force: the normal force at rest [N].
    speed: the mean tangential speed, or the speed at which the geoms left their overlap [m/s].
    movable: whether some joint can separate the geoms.
    settled: whether the contact came to rest.
    look: the index of the reading, of one.
    """

    pair: int
    part: int = 0
    depth: float = 0.0
    force: float = 0.0
    speed: float = 0.0
    movable: bool = True
    settled: bool = True
    look: int = 0


def settled(series: np.ndarray) -> float | None:
    """Return the mean of the end of a series; None if the series still varies there."""
    late = series[-max(FEWEST, int(REST * len(series))) :]
    mean = float(late.mean())
    steady = len(late) >= FEWEST and mean > 0 and float(np.ptp(late)) < STEADY * mean
    return mean if steady else None
