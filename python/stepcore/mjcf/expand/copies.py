"""How many elements copies may have: one account for all that a model replicates and attaches."""

from __future__ import annotations

from collections.abc import Iterable

from stepcore.mjcf.nodes import Node
from stepcore.mjcf.refusals import below

# The most elements that the copies of one load may have together.
MOST = 1_000_000


class Copies:
    """The elements that were copied so far."""

    def __init__(self) -> None:
        self.made = 0

    def take(self, node: Node, nodes: Iterable[Node], count: int, more: int = 0) -> None:
        """Counts `count` copies of these elements and of what they hold, before they are made.

        node: what asks for the copies. more: what each copy takes beside. Raises MJCFError.
        """
        size = more + sum(1 for one in nodes for _ in below(one))
        if self.made + count * size > MOST:
            raise node.error(
                f"<{node.tag}> makes {count * size} elements after {self.made} of other copies: "
                f"a model has at most {MOST} copied elements"
            )
        self.made += count * size
