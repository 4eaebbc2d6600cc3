"""The same loop in plain numpy: the yardstick for the engine's numbers and its speed.

Read `model` (what is constant), `compile` (how a scene becomes it) and `world` (what moves),
then the stages in the order of a step: `place`, `detect`, `rows` and `solve`, `commit`, and `sim`
for the loop itself. Matrices are dense, nothing is cached between steps but the last impulses, and
no line was written for speed. Derived from the same formulas as the Rust engine, sharing no code.
"""

from .settings import Settings
from .sim import Sim

__all__ = ["Settings", "Sim"]
