"""Escape characters that a terminal would interpret as commands."""

from __future__ import annotations

# Control characters (C0, DEL, C1) are commands to terminals. The others change the direction of
# writing, or count as line ends for some readers. Each is replaced by its code.
_TURNING = (0x061C, 0x200E, 0x200F, *range(0x2028, 0x202F), *range(0x2066, 0x206A))
_ESCAPES = {c: f"\\x{c:02x}" for c in (*range(32), *range(127, 160))}
_ESCAPES |= {c: f"\\u{c:04x}" for c in _TURNING}
_IN_LINES = {c: text for c, text in _ESCAPES.items() if chr(c) not in "\t\n"}


def escaped(text: str) -> str:
    """Return a text for one line: control characters and line ends are escaped."""
    return text.translate(_ESCAPES)


def printable(text: str) -> str:
    """Return a text of several lines for a terminal: control characters are escaped."""
    return text if text.isascii() and text.isprintable() else text.translate(_IN_LINES)
