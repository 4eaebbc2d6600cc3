"""Texts on terminals whose encoding lacks some of their characters."""

from __future__ import annotations

import codecs
import sys

ERRORS = "stepcore.plain"
# What stands in for a character that cannot be printed.
SPELT = """
µ u ² ^2 ³ ^3 · * × x − - – - … ... ± +- ≤ <= ≥ >= ≈ ~ ∞ inf √ sqrt ° deg → -> “ " ” " ’ '
Δ d ω omega ζ zeta μ mu λ lambda ρ rho
"""
WORDS = SPELT.split()
PLAIN = dict(zip(WORDS[::2], WORDS[1::2], strict=True))


def _plain(error: UnicodeError) -> tuple[str, int]:
    if not isinstance(error, UnicodeEncodeError):
        raise error
    lost = error.object[error.start : error.end]
    # The bytes of a file's name that were no text come as lone surrogates.
    return "".join(PLAIN.get(character, "?") for character in lost), error.end


def print_what_can_be_printed() -> None:
    """Replaces characters that the output cannot show: a result is never lost to its last sign."""
    codecs.register_error(ERRORS, _plain)
    for stream in (sys.stdout, sys.stderr):
        reconfigure = getattr(stream, "reconfigure", None)
        # Python chooses the second where the locale is C.
        strict = getattr(stream, "errors", "") in ("strict", "surrogateescape")
        if reconfigure is not None and strict:
            reconfigure(errors=ERRORS)
