"""A text that is not well-formed XML only where MuJoCo's parser does not look, made well-formed.

Files that people wrote for MuJoCo hold such comments, blanks and ampersands. Lines keep their
numbers.
"""

from __future__ import annotations

import re
from typing import cast

# An "&" that begins no reference.
_AMPERSAND = re.compile(rb"&(?!(?:\w+|#\d+|#x[0-9a-fA-F]+);)", re.ASCII)
_BLANKS = re.compile(rb"(?:\xef\xbb\xbf)?(\s+)(<\?xml[^>]*>)")
# Attributes that nothing parts.
_UNPARTED = re.compile(rb"""(<[^\s<>!?/"'=]+)((?:\s*[^\s<>"'=/]+\s*=\s*(?:"[^"<]*"|'[^'<]*'))*)""")
_ATTRIBUTE = re.compile(rb"""(\s*)([^\s<>"'=/]+\s*=\s*(?:"[^"<]*"|'[^'<]*'))""")


def mended(data: str | bytes) -> str | bytes:
    """The text with these things put right; the same text where there are none."""
    raw = data.encode("utf-8", "surrogatepass") if isinstance(data, str) else data
    raw = _plain_comments(raw)
    raw = _AMPERSAND.sub(b"&amp;", raw)
    if blanks := _BLANKS.match(raw):
        raw = blanks[2] + blanks[1] + raw[blanks.end() :]
    raw = _UNPARTED.sub(_parted, raw)
    if isinstance(data, str):
        return raw.decode("utf-8", "surrogatepass")
    return raw


def _plain_comments(raw: bytes) -> bytes:
    """The text without the "--" within comments, which XML does not allow."""
    parts: list[bytes] = []
    at = 0
    while (start := raw.find(b"<!--", at)) >= 0 and (end := raw.find(b"-->", start + 4)) >= 0:
        parts += [raw[at : start + 4], raw[start + 4 : end].replace(b"-", b" ")]
        at = end
    return b"".join([*parts, raw[at:]])


def _parted(found: re.Match[bytes]) -> bytes:
    apart = _ATTRIBUTE.sub(lambda one: (one[1] or b" ") + one[2], cast(bytes, found[2]))
    return cast(bytes, found[1]) + apart
