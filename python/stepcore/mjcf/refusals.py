"""Collect all errors of a file and raise them together."""

from __future__ import annotations

from collections.abc import Callable
from typing import TypeVar

from stepcore.checks import cut
from stepcore.mjcf.nodes import MJCFError, Node, below

T = TypeVar("T")
# Limits of a message: lines, characters per line, and line numbers listed per error.
LINES = 20
LINE = 600
PLACES = 4
# The number of errors after which reading stops, because looking up nearest names takes time.
MOST = 100


class Refusals:
    """A collection of the errors of a file; `raise_all` raises them as one error."""

    def __init__(self) -> None:
        self.errors: list[MJCFError] = []
        # Names of elements that could not be read; references to them are not new errors.
        self._gone: set[str] = set()

    def at(self, node: Node, read: Callable[[Node], T]) -> T | None:
        """Return the result of `read` for a node, or record its error and return None."""
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
        """Record an error. node: the element that is not read because of the error."""
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
        """Raise the errors as one MJCFError, if there are any."""
        if not self.errors:
            return
        files = list(dict.fromkeys(error.file for error in self.errors))
        self.errors.sort(key=lambda error: (files.index(error.file), error.line))
        first, *others = self.errors
        if not others:
            raise first
        raise first.with_others(tuple(others), _message(self.errors))


def _message(errors: list[MJCFError]) -> str:
    """Return a line for each error; errors with the same text and file share a line."""
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
