"""Small MJCF scenes, one per row kind, per shape pair and per joint, and one with all together.

`ZOO[name]` is an `Entry`: the text, the kinds of rows its states must reach
(so that a scene that never touches anything fails instead of passing idly),
and how far from the initial configuration its states start.
"""

from __future__ import annotations

# The order in which they stand in the zoo.
# isort: off
from . import joints, equalities, tendons, passive, actuators, pairs, materials, heaps

# isort: on
from .entry import CONTACT, EQUALITY, FRICTION, LIMIT, ZOO, Entry
from .heaps import HEAPS
from .inexact import INEXACT

__all__ = [
    "CONTACT",
    "EQUALITY",
    "FRICTION",
    "HEAPS",
    "INEXACT",
    "LIMIT",
    "ZOO",
    "Entry",
    "actuators",
    "equalities",
    "heaps",
    "joints",
    "materials",
    "pairs",
    "passive",
    "tendons",
]
