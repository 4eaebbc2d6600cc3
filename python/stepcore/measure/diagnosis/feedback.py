"""`Feedback`: a user's control function linearised at a state, and the closed-loop step.

A control function is sampled at the start of a control period and held over the period. For small
changes x = [dq, dv] at the sample

    u = C z + D x,    z⁺ = A z + B x,

where D is the gain and z the memory (delays, filters, integrals; empty for most functions). A step
with x⁺ = P x + Q u becomes a map of (x, z), the sampled-data closed loop. Source: Åström and
Wittenmark, Computer-Controlled Systems, chapter 3.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

from stepcore.engine.arrays import Floats
from stepcore.engine.control import Control


@dataclass(frozen=True, eq=False)
class Feedback:
    """A control function linearised at a state.

    function: the user's control function.
    period: how long its controls are held [s]; None: one step of any length.
    gain: D, shape (nu, 2 nv).
    settled: the gain after all delays, without integrals, shape (nu, 2 nv).
    a, b, c: A, B and C of the memory, shapes (m, m), (m, 2 nv) and (nu, m).
    """

    function: Control
    period: float | None
    gain: Floats
    settled: Floats
    a: Floats
    b: Floats
    c: Floats

    @property
    def order(self) -> int:
        """The dimension m of the memory."""
        return len(self.a)

    @property
    def acts(self) -> bool:
        """Whether the controls depend on the state."""
        return bool(np.any(self.gain) or np.any(self.b))

    @classmethod
    def prompt_law(cls, function: Control, gain: Floats, period: float | None = None) -> Feedback:
        """Return the feedback of a function without memory."""
        nu, width = gain.shape
        none = np.zeros((0, 0)), np.zeros((0, width)), np.zeros((nu, 0))
        return cls(function, period, gain, gain, *none)

    @property
    def prompt(self) -> Feedback:
        """The law with its settled gain and without its memory, as in the motion itself."""
        return self.prompt_law(self.function, self.settled, self.period)

    def controls(self, x: Any, z: Any) -> Any:
        """Return u of blocks of x, shape (2 nv, …), and z, shape (m, …)."""
        return self.gain @ x + self.c @ z

    def remembered(self, x: Any, z: Any) -> Any:
        """Return z of the next sample."""
        return self.a @ z + self.b @ x

    def closed(self, step: Floats, inputs: Floats, hold: int = 1) -> Floats:
        """Return the map of (x, z) over `hold` steps with the controls of the first step held.

        step: P, shape (2 nv, 2 nv).
        inputs: Q, shape (2 nv, nu).
        hold: the number of steps.
        """
        n, m = len(step), self.order
        whole = np.eye(n + m)
        x, z = whole[:n], whole[n:]
        # The map of [x, u] over one step, with u constant.
        held = np.zeros((n + inputs.shape[1],) * 2)
        held[:n, :n], held[:n, n:], held[n:, n:] = step, inputs, np.eye(inputs.shape[1])
        held = np.linalg.matrix_power(held, hold)
        after = held[:n, :n] @ x + held[:n, n:] @ self.controls(x, z)
        return np.vstack([after, self.remembered(x, z)])
