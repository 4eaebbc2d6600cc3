"""Characters that command a terminal, shown by their codes."""

from __future__ import annotations

# Control characters (C0, DEL, C1) are commands to terminals; the others turn the direction of
# writing, or are ends of lines to some readers. Each is shown by its code.
_TURNING = (0x061C, 0x200E, 0x200F, *range(0x2028, 0x202F), *range(0x2066, 0x206A))
_ESCAPES = {c: f"\\x{c:02x}" for c in (*range(32), *range(127, 160))}
_ESCAPES |= {c: f"\\u{c:04x}" for c in _TURNING}
_IN_LINES = {c: text for c, text in _ESCAPES.items() if chr(c) not in "\t\n"}


def escaped(text: str) -> str:
    """A text as it stands in a line: ends of lines are escaped as well."""
    return text.translate(_ESCAPES)


def printable(text: str) -> str:
    """A text of several lines as a terminal may show it: whatever would command it is escaped."""
    return text if text.isascii() and text.isprintable() else text.translate(_IN_LINES)
