"""`Report`: the printed form of a result: answer in sentences, then tables, then notes.

The same blocks are printed as text, shown in a notebook and written as a page. `Result` writes them
as JSON.
"""

from __future__ import annotations

import base64
import html
import math
import re
import textwrap
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from importlib import resources

from stepcore import checks, escapes
from stepcore.report.outputs import MARK
from stepcore.report.table import Table
from stepcore.report.terminal import window
from stepcore.report.units import NAMES, counted

# The maximum number of lines of a short report; further notes are only counted.
SCREEN = 40
# Rows of a short table.
SHORT = 10
# The prefix of a sentence that is a list item below the preceding sentence.
ITEM = "- "
# A number and its unit are joined by this space, to keep both on one line.
FIXED = "\N{NO-BREAK SPACE}"
CODE = re.compile(r"`([^`]+)`")
BEFORE_UNIT = re.compile(rf"(?<=\d) (?=(?:{'|'.join(map(re.escape, NAMES))})(?!\w))")


# A result page: the answer, the plot and sortable tables; it needs no other file, no network.
PAGE = """<!doctype html>
<html lang="en"><head><meta charset="utf-8"><title>{title}</title>
<meta name="generator" content="{mark}">
<meta name="viewport" content="width=device-width, initial-scale=1">
<style>{style}</style></head>
<body><header><h1>{title}</h1><button id="theme" type="button">light / dark</button></header>
<section id="answer">
{answer}
</section>
{picture}
{details}
<script>{script}</script>
</body></html>
"""


@dataclass(frozen=True)
class Report:
    """A title, sentences, a description of the measurement, tables and notes.

    sentences: the answer first. A sentence that begins with "- " is a list item below the preceding
    sentence.

    >>> table = Table([{"dt": 0.01, "error": 1.5e-3}], heading="Error [m] by time step [s]")
    >>> print(Report("ball: error", ["The error is 1.5 mm."], [table], ["one start"]).text())
    ball: error
    <BLANKLINE>
    The error is 1.5 mm.
    <BLANKLINE>
    Error [m] by time step [s]
      dt   error
    0.01  0.0015
    <BLANKLINE>
    Note: one start.
    """

    title: str
    sentences: Sequence[str] = ()
    tables: Sequence[Table] = ()
    notes: Sequence[str] = ()
    setup: str = ""

    def text(self, width: int | None = None, full: bool = True) -> str:
        """Return the report in lines of at most `width` >= 20 characters (default: the terminal's).

        full: every note; else the notes that fit on a screen, and the number of further notes.
        """
        size = window() if width is None else checks.count("width", width, 20)
        answer = [line for sentence in self.sentences for line in _wrapped(sentence, size)]
        setup = [line for text in self.setup.splitlines() for line in _wrapped(text, size)]
        tables = [[*_table(table, size)] for table in self.tables]
        blocks = [block for block in (_wrapped(self.title, size), answer, setup, *tables) if block]
        room = math.inf if full else SCREEN - sum(len(block) + 1 for block in blocks)
        blocks.append([*_notes(self.notes, size, room)])
        return "\n\n".join("\n".join(block) for block in blocks if block)

    def html(self, picture: str = "") -> str:
        """Return the report as an HTML fragment; picture: an image below the answer."""
        return "\n".join(filter(None, [*_prose(self.sentences), picture, self._details()]))

    def page(self, plot: bytes) -> str:
        """Return the report and its plot (SVG) as a self-contained page."""
        style, script = (
            resources.files("stepcore.report").joinpath(name).read_text(encoding="utf-8")
            for name in ("page.css", "page.js")
        )
        return PAGE.format(
            title=html.escape(escapes.printable(self.title)),
            mark=MARK,
            style=style,
            answer="\n".join(_prose(self.sentences)),
            picture=inline_picture(plot, self.title),
            details=self._details(),
            script=script,
        )

    def _details(self) -> str:
        setup = [f"<p>{_marked(text)}</p>" for text in self.setup.splitlines()]
        tables = [
            part for t in self.tables for part in (t.html(), _small(_stopped(t.legend))) if part
        ]
        notes = [_small(_note(note)) for note in self.notes]
        return "\n".join([*setup, *tables, *notes])


def inline_picture(drawn: bytes, title: str) -> str:
    """Return an SVG drawing as an inline image."""
    coded = base64.b64encode(drawn).decode("ascii")
    alt = html.escape(escapes.printable(title), quote=True)
    style = "max-width: 100%; height: auto"
    return f'<img alt="{alt}" style="{style}" src="data:image/svg+xml;base64,{coded}"/>'


def _notes(notes: Sequence[str], size: int, room: float) -> Iterator[str]:
    """Yield the notes that fit into `room` lines, and a line with the number of other notes."""
    left = len(notes)
    for note in notes:
        lines = _wrapped(_note(note), size)
        # One line is reserved for the number of hidden notes.
        if len(lines) + (left > 1) > room:
            break
        yield from lines
        room, left = room - len(lines), left - 1
    if left:
        more = "more note" if left < len(notes) else "note"
        yield from _wrapped(not_shown(counted(left, more)), size)


def not_shown(content: str) -> str:
    """Return how to see what a short report leaves out, as a sentence."""
    return f"Not shown: {content} (--all; in Python text(full=True))."


def _note(note: str) -> str:
    return f"Note: {_stopped(note)}"


def _stopped(text: str) -> str:
    return text if not text or text.endswith((".", ":")) else f"{text}."


def _wrapped(sentence: str, size: int) -> list[str]:
    """Wrap a sentence to lines of at most `size` characters, keeping each number with its unit.

    Prose has at most 100 characters in a line.
    """
    item = sentence.startswith(ITEM)
    lines = textwrap.wrap(
        BEFORE_UNIT.sub(FIXED, escapes.printable(sentence)),
        min(size, 100),
        initial_indent="  " if item else "",
        subsequent_indent="    " if item else "",
        break_on_hyphens=False,
    )
    return [line.replace(FIXED, " ") for line in lines]


def _table(table: Table, size: int) -> Iterator[str]:
    yield from _wrapped(table.heading, size)
    for line in table.text(size).splitlines():
        # A single column can be wider than the line.
        yield from [line] if len(line) <= size else textwrap.wrap(line, size)
    yield from _wrapped(_stopped(table.legend), size)


def _prose(sentences: Sequence[str]) -> Iterator[str]:
    """Yield paragraphs, and lists of items."""
    listing = False
    for sentence in sentences:
        item = sentence.startswith(ITEM)
        if item != listing:
            yield "<ul>" if item else "</ul>"
        listing = item
        text = _marked(sentence.removeprefix(ITEM))
        yield f"<li>{text}</li>" if item else f"<p>{text}</p>"
    if listing:
        yield "</ul>"


def _small(text: str) -> str:
    return f"<p><small>{_marked(text)}</small></p>" if text else ""


def _marked(text: str) -> str:
    return CODE.sub(r"<code>\1</code>", html.escape(escapes.printable(text)))
