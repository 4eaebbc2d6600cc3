"""Several elements by name, in a few words."""

from __future__ import annotations

import re
from collections import Counter
from collections.abc import Sequence

from stepcore.report.units import counted, plural

# The most names in a list.
NAMES = 4


def listed(names: Sequence[str]) -> str:
    """The first names, and how many more there are."""
    more = len(names) - NAMES
    return ", ".join(names[:NAMES]) + (f" and {more} more" if more > 0 else "")


def acting_in_words(names: Sequence[str]) -> str:
    """A few elements by name; more of them by how many there are of each kind.

    >>> acting_in_words([f"friction loss of joint `j{i}`" for i in range(6)] + ["contact `a`/`b`"])
    '6 friction losses and 1 contact'
    """
    if len(names) <= NAMES:
        return listed(names)
    kinds = Counter(re.split(r" of | `", name)[0] for name in names)
    counts = [counted(n, kind) for kind, n in kinds.items()]
    return " and ".join(filter(None, (", ".join(counts[:-1]), counts[-1])))


def together(names: Sequence[str]) -> str:
    """One element by its name; several as what does something together."""
    return named(names) + (" together" if len(names) > 1 else "")


def named(names: Sequence[str]) -> str:
    """One element by its name; equal elements as what they are.

    >>> named([f"spring of joint `h{i}`" for i in range(10)])
    'the 10 springs of joints `h0`, `h1`, `h2`, `h3` and 6 more'
    """
    if len(names) < 2:
        return "".join(names)
    kinds = {name.split("`")[0] for name in names}
    if len(kinds) > 1 or not all("`" in name for name in names):
        return listed(names)
    kind = kinds.pop().strip()
    several = re.sub(r"\w+(?= of\b|$)", lambda word: plural(word[0]), kind)
    owners = listed([name[len(kind) + 1 :] for name in names])
    return f"the {len(names)} {several} {owners}"
