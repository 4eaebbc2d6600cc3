"""`Result`: what every measurement gives: it prints, plots, and leaves as data or as a page."""

from __future__ import annotations

import base64
import functools
import io
import json
import os
import textwrap
from abc import ABC, abstractmethod
from collections.abc import Callable
from pathlib import Path
from typing import Any

from stepcore import checks
from stepcore.report.table import jsonable, pre

# No line can be of use that is narrower.
NARROWEST = 20


class Result(ABC):
    """A measurement that prints itself, plots itself and exports itself.

    What a subclass gives as `text` is held to the width asked for: lines that are longer go on in
    the next. A width that is no whole number >= 20 is a ValueError.
    """

    def __init_subclass__(cls, **kwargs: Any) -> None:
        super().__init_subclass__(**kwargs)
        if "text" in cls.__dict__:
            cls.text = _held(cls.text)  # type: ignore[method-assign]

    @property
    @abstractmethod
    def title(self) -> str:
        """What was measured, in a few words."""

    @abstractmethod
    def text(self, width: int | None = None) -> str:
        """The result as printed, at most `width` characters wide."""

    @abstractmethod
    def to_dict(self) -> dict[str, Any]:
        """Everything as plain data."""

    @abstractmethod
    def plot(self, path: str | os.PathLike[str] | None = None) -> Any:
        """The picture; written to `path` if given. Needs matplotlib. Returns its Figure."""

    def to_json(self, indent: int | None = 2) -> str:
        """`to_dict` as JSON text; what is not finite is null."""
        return json.dumps(jsonable(self.to_dict()), indent=indent)

    def to_html(self, path: str | os.PathLike[str] | None = None) -> str:
        """The picture and the text as one page that needs no other file. Needs matplotlib.

        Written to `path` if given.
        """
        import html

        drawn = io.BytesIO()
        self.plot().savefig(drawn, format="svg")
        picture = base64.b64encode(drawn.getvalue()).decode("ascii")
        title = html.escape(self.title)
        page = PAGE.format(title=title, picture=picture, text=pre(self.text(width=160)))
        if path is not None:
            Path(path).write_text(page, encoding="utf-8")
        return page

    def __str__(self) -> str:
        return self.text()

    def __repr__(self) -> str:
        return f"<{type(self).__name__}: {self.title}>"

    def _repr_html_(self) -> str:
        """The printed result, as a notebook shows it."""
        return pre(self.text())


def _held(text: Callable[..., str]) -> Callable[..., str]:
    """A method `text` whose width is checked, and kept to."""

    @functools.wraps(text)
    def held(self: Result, width: int | None = None, *args: Any, **kwargs: Any) -> str:
        if width is None:
            return text(self, None, *args, **kwargs)
        width = checks.count("width", width, NARROWEST)
        lines = text(self, width, *args, **kwargs).splitlines()
        return "\n".join(part for line in lines for part in _parts(line, width))

    return held


def _parts(line: str, width: int) -> list[str]:
    """A line in pieces of at most `width` characters."""
    if len(line) <= width:
        return [line]
    return textwrap.wrap(line, width, break_on_hyphens=False)


PAGE = """<!doctype html>
<html lang="en"><head><meta charset="utf-8"><title>{title}</title>
<meta name="viewport" content="width=device-width, initial-scale=1">
<style>body {{ font: 16px/1.5 sans-serif; max-width: 75rem; margin: 2rem auto; padding: 0 1rem }}
img {{ max-width: 100%; height: auto }} pre {{ font-size: 13px }}</style></head>
<body><h1>{title}</h1>
<img alt="{title}" src="data:image/svg+xml;base64,{picture}">
{text}
</body></html>
"""
