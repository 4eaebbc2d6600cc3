"""Energy and momentum of a world."""

from __future__ import annotations

from typing import NamedTuple

from stepcore.engine.arrays import Floats


class Energy(NamedTuple):
    """Kinetic and potential energy [J].

    The potential energy is the energy of springs and of gravity on every body, fixed bodies
    included. Gravitational energy is zero at the world's origin.
    """

    kinetic: float
    potential: float

    @property
    def total(self) -> float:
        """The sum of kinetic and potential energy [J]."""
        return self.kinetic + self.potential


class Momentum(NamedTuple):
    """Total momentum of all bodies, in world axes.

    linear: [kg·m/s], shape (3,). angular: about the world's origin [kg·m²/s], shape (3,).
    For a `Batch` both have shape (n, 3).
    """

    linear: Floats
    angular: Floats
