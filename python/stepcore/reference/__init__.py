"""The same loop in plain numpy: the yardstick for the engine's numbers and its speed.

Read it in the order of a step: `model` (what is constant), `place`, `detect`,
`rows` and `solve`, `commit`, and `sim` for the loop itself. Matrices are dense,
nothing is cached between steps but the last impulses, and no line was written
for speed. Derived from the same formulas as the Rust engine, sharing no code.
"""

from .sim import Settings, Sim

__all__ = ["Settings", "Sim"]
