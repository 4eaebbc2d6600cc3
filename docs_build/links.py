"""Links between the repository's texts, as the pages of the site need them."""

from __future__ import annotations

import posixpath
import re

# [text](target) and ![text](target); and [name]: target, where a text lists its targets.
LINK = re.compile(r"(!?\[[^\]]*\])\(([^)\s]+)\)")
LISTED = re.compile(r"^(\[[^\]]+\]: )(\S+)$", re.MULTILINE)
# A file of the repository under its address on a host: …/blob/main/docs/trade.md, …/raw/main/….
HOSTED = re.compile(r"https://[^\s)]+?/(?:blob/|raw/)?(?:refs/heads/)?main/docs/([\w./-]+)")
# Texts of the repository that are pages of the site.
PAGES = {"README.md": "index.md", "CONTRIBUTING.md": "contributing.md"}
PAGES |= {"CHANGELOG.md": "changelog.md"}


def as_in_docs(text: str) -> str:
    """A text of the repository's root as if it stood in docs/."""

    def moved(link: re.Match[str]) -> str:
        shown, target = link.groups()
        target = HOSTED.sub(r"docs/\1", target)
        if "://" in target or target.startswith("#"):
            return link[0]
        if target.startswith("docs/"):
            return f"{shown}({target.removeprefix('docs/')})"
        return f"{shown}(../{target})"

    listed = LISTED.sub(lambda found: found[1] + HOSTED.sub(r"\1", found[2]), text)
    return LINK.sub(moved, listed)


def to_repository(text: str, page: str, address: str) -> str:
    """A page whose links to files outside of docs/ lead to the repository's address.

    page: its path in docs/.
    """
    folder = posixpath.dirname(page)

    def led(link: re.Match[str]) -> str:
        shown, target = link.groups()
        path = posixpath.normpath(posixpath.join(folder, target))
        if not path.startswith("../") or "://" in target:
            return link[0]
        path = path.removeprefix("../")
        if path in PAGES:
            return f"{shown}({posixpath.relpath(PAGES[path], folder or '.')})"
        return f"{shown}({address}/blob/main/{path})"

    return LINK.sub(led, text)


def split_at_section(text: str, title: str) -> tuple[str, str, str]:
    """What is before a section, the section's body, and what is after it."""
    before, _, rest = text.partition(f"## {title}\n")
    body, mark, after = rest.partition("\n## ")
    return before, "\n" + body, mark.lstrip("\n") + after
