"""Repair XML that MuJoCo's parser accepts: bare "&", "--" in comments, blanks before the document,
and attributes without blanks between them. Line numbers do not change.
"""

from __future__ import annotations

import re
from typing import cast

# An "&" that does not begin a reference.
_AMPERSAND = re.compile(rb"&(?!(?:\w+|#\d+|#x[0-9a-fA-F]+);)", re.ASCII)
_BLANKS = re.compile(rb"(?:\xef\xbb\xbf)?(\s+)(<\?xml[^>]*>)")
# A start tag with attributes that may lack blanks between them.
_TAG = re.compile(rb"""(<[^\s<>!?/"'=]+)((?:\s*[^\s<>"'=/]+\s*=\s*(?:"[^"<]*"|'[^'<]*'))*)""")
_ATTRIBUTE = re.compile(rb"""(\s*)([^\s<>"'=/]+\s*=\s*(?:"[^"<]*"|'[^'<]*'))""")


def repaired(data: str | bytes) -> str | bytes:
    """Return the repaired text, or the same text if there is nothing to repair."""
    raw = data.encode("utf-8", "surrogatepass") if isinstance(data, str) else data
    raw = _plain_comments(raw)
    raw = _AMPERSAND.sub(b"&amp;", raw)
    if blanks := _BLANKS.match(raw):
        raw = blanks[2] + blanks[1] + raw[blanks.end() :]
    raw = _TAG.sub(_with_blanks, raw)
    if isinstance(data, str):
        return raw.decode("utf-8", "surrogatepass")
    return raw


def _plain_comments(raw: bytes) -> bytes:
    """Return the text without "--" inside comments, which XML does not allow."""
    parts: list[bytes] = []
    at = 0
    while (start := raw.find(b"<!--", at)) >= 0 and (end := raw.find(b"-->", start + 4)) >= 0:
        parts += [raw[at : start + 4], raw[start + 4 : end].replace(b"-", b" ")]
        at = end
    return b"".join([*parts, raw[at:]])


def _with_blanks(tag: re.Match[bytes]) -> bytes:
    attributes = _ATTRIBUTE.sub(lambda found: (found[1] or b" ") + found[2], cast(bytes, tag[2]))
    return cast(bytes, tag[1]) + attributes
