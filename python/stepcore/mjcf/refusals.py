"""All errors of a file together, so that a reader sees at once what stands in the way."""

from __future__ import annotations

from collections.abc import Callable
from typing import TypeVar

from stepcore.checks import cut
from stepcore.mjcf.nodes import MJCFError, Node, below

T = TypeVar("T")
# The most lines of a message, their length, and the lines of the file that one of them lists.
LINES = 20
LINE = 600
PLACES = 4
# After so many errors elements are read no more.
MOST = 100


class Refusals:
    """Errors of a file as they are found; `raise_all` raises them as one."""

    def __init__(self) -> None:
        self.errors: list[MJCFError] = []
        # Names of elements that are not read, so that what refers to them is no new error.
        self._gone: set[str] = set()

    def at(self, node: Node, read: Callable[[Node], T]) -> T | None:
        """What `read` gives for a node; an error is kept, with the node's file and line."""
        # To look up the nearest name of each of thousands takes minutes.
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
            self._gone.update(one.attrs["name"] for one in below(node) if "name" in one.attrs)
            if follows:
                return
        self.errors += error.errors

    def _refers_to_gone(self, node: Node) -> bool:
        return any(
            name in self._gone
            for one in below(node)
            for attribute, name in one.attrs.items()
            if attribute != "name"
        )

    def raise_all(self) -> None:
        """Raises what was found, if anything."""
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
