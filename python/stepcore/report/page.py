"""Result pages: self-contained files with the answer, the plot and sortable tables."""

from __future__ import annotations

import base64
import html
from importlib import resources

from stepcore import escapes
from stepcore.report.outputs import MARK

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


def page(title: str, answer: str, picture: str, details: str) -> str:
    """Return a page that needs no other file and no network; answer, picture, details: HTML."""
    return PAGE.format(
        title=html.escape(escapes.printable(title)),
        mark=MARK,
        style=_own("page.css"),
        answer=answer,
        picture=picture,
        details=details,
        script=_own("page.js"),
    )


def picture(drawn: bytes, title: str) -> str:
    """Return an SVG drawing as an inline image."""
    coded = base64.b64encode(drawn).decode("ascii")
    alt = html.escape(escapes.printable(title), quote=True)
    style = "max-width: 100%; height: auto"
    return f'<img alt="{alt}" style="{style}" src="data:image/svg+xml;base64,{coded}"/>'


def _own(name: str) -> str:
    return resources.files("stepcore.report").joinpath(name).read_text(encoding="utf-8")
