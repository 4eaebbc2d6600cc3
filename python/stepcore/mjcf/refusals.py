"""All errors of a file together, so that a reader sees at once what stands in the way."""

from __future__ import annotations

from collections.abc import Callable
from typing import TypeVar

from stepcore.checks import cut
from stepcore.mjcf.nodes import MJCFError, Node, below

T = TypeVar("T")
# Limits of a message: its lines, the characters of a line, and the places that a line lists.
LINES = 20
LINE = 600
PLACES = 4
# After this many errors no more elements are read: each may look up nearest names.
MOST = 100


class Refusals:
    """Collects the errors of a file; `raise_all` raises them as one."""

    def __init__(self) -> None:
        self.errors: list[MJCFError] = []
        # Names of elements that are not read, so that what refers to them is no new error.
        self._gone: set[str] = set()

    def at(self, node: Node, read: Callable[[Node], T]) -> T | None:
        """The result of `read` for a node, or None after an error, which is kept."""
        if len(self.errors) >= MOST:
            return None
        try:
            return read(node)
        except MJCFError as error:
            self.add(error, node)
        except ValueError as error:
            self.add(node.error(str(error)), node)
        return None

    def add(self, error: MJCFError, node: Node | None = None) -> None:
        """Keeps an error; node: the element that is not read because of it."""
        if node is not None:
            follows = bool(self._gone) and not error.kind and self._refers_to_gone(node)
            self._gone.update(n.attrs["name"] for n in below(node) if "name" in n.attrs)
            if follows:
                return
        self.errors += error.errors

    def _refers_to_gone(self, node: Node) -> bool:
        return any(
            name in self._gone
            for inner in below(node)
            for attribute, name in inner.attrs.items()
            if attribute != "name"
        )

    def raise_all(self) -> None:
        """Raises the errors, if there are any."""
        if not self.errors:
            return
        files = list(dict.fromkeys(error.file for error in self.errors))
        self.errors.sort(key=lambda error: (files.index(error.file), error.line))
        first, *others = self.errors
        if not others:
            raise first
        raise first.with_others(tuple(others), _message(self.errors))


def _message(errors: list[MJCFError]) -> str:
    """A line for each error; those of the same text and file are one."""
    groups: dict[tuple[str, str], list[MJCFError]] = {}
    for error in errors:
        groups.setdefault((error.file, error.text), []).append(error)
    lines = [cut(_line(group), LINE) for group in groups.values()]
    if len(lines) > LINES:
        lines[LINES:] = [f"… and {len(lines) - LINES} more"]
    kinds = list(dict.fromkeys(error.kind for error in errors))
    if all(kinds):
        words = ", ".join(f'"{kind}"' for kind in kinds)
        lines.append(cut(f"without=[{words}] leaves these things out", 600))
    return "\n".join(lines)


def _line(group: list[MJCFError]) -> str:
    text = str(group[0])
    rest = [str(error.line) for error in group[1 : 1 + PLACES]]
    if not rest:
        return text
    more = f" and {len(group) - 1 - PLACES} more" if len(group) > 1 + PLACES else ""
    return f"{text} (also in line {', '.join(rest)}{more})"
