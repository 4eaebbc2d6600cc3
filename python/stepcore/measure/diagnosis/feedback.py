"""`Feedback`: a user's control function made linear at a state, and the step that it closes.

A control function is sampled at the start of a control period and held over it. For small changes
x = [dq, dv] at the sample it is

    u = C z + D x,    z⁺ = A z + B x,

where D is its gain and z what it remembers (delays, filters, integrals; none of most). A step with
x⁺ = P x + Q u becomes a map of (x, z): the z-map of the sampled loop. Source: Åström and
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

    function: the user's. period: how long its controls are held [s]; None: one step, however long.
    gain: D, shape (nu, 2 nv). settled: the gain once all delays are over, without what it
    integrates, shape (nu, 2 nv). a, b, c: of its memory, shapes (m, m), (m, 2 nv) and (nu, m).
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
        """How many numbers it remembers."""
        return len(self.a)

    @property
    def acts(self) -> bool:
        """Whether the controls depend on the state at all."""
        return bool(np.any(self.gain) or np.any(self.b))

    @classmethod
    def prompt_law(cls, function: Control, gain: Floats, period: float | None = None) -> Feedback:
        """A function that remembers nothing."""
        nu, width = gain.shape
        none = np.zeros((0, 0)), np.zeros((0, width)), np.zeros((nu, 0))
        return cls(function, period, gain, gain, *none)

    @property
    def prompt(self) -> Feedback:
        """The law without its memory, with its settled gain: as the motion itself has it."""
        return self.prompt_law(self.function, self.settled, self.period)

    def controls(self, x: Any, z: Any) -> Any:
        """u of blocks of x, shape (2 nv, …), and z, shape (m, …)."""
        return self.gain @ x + self.c @ z

    def remembered(self, x: Any, z: Any) -> Any:
        """z of the next sample."""
        return self.a @ z + self.b @ x

    def closed(self, step: Floats, inputs: Floats, hold: int = 1) -> Floats:
        """The map of (x, z) over `hold` steps with the controls of the first held.

        step: P, shape (2 nv, 2 nv); inputs: Q, shape (2 nv, nu).
        """
        n, m = len(step), self.order
        whole = np.eye(n + m)
        x, z = whole[:n], whole[n:]
        # [x, u] over one step, u unchanged.
        held = np.zeros((n + inputs.shape[1],) * 2)
        held[:n, :n], held[:n, n:], held[n:, n:] = step, inputs, np.eye(inputs.shape[1])
        held = np.linalg.matrix_power(held, hold)
        after = held[:n, :n] @ x + held[:n, n:] @ self.controls(x, z)
        return np.vstack([after, self.remembered(x, z)])
