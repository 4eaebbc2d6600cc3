"""Show a scene, a model or a world in a notebook: its words over its picture."""

from __future__ import annotations

import base64
import html
import io
from collections.abc import Callable
from typing import Any

from stepcore.needs import need

# The largest number of geoms that is drawn without a noticeable delay.
MAX_GEOMS = 1000


def html_picture(value: Any, geoms: int, world: Callable[[], Any]) -> str | None:
    """Return `repr(value)` over a picture of the Sim that `world` makes, as HTML.

    Returns None, so that only the words are shown, for over `MAX_GEOMS` geoms, for a scene that
    does not compile, and if no renderer works here.
    """
    if geoms > MAX_GEOMS:
        return None
    from stepcore.viewing.picture import picture

    try:
        image = need("PIL.Image", "a picture in a notebook", "video")
        drawn = picture(world(), width=480, height=360)
    except (ImportError, RuntimeError, ValueError):
        return None
    written = io.BytesIO()
    image.fromarray(drawn).save(written, format="png")
    data = base64.b64encode(written.getvalue()).decode()
    words = html.escape(repr(value))
    style = "border:1px solid #8884;border-radius:6px;max-width:100%"
    picture_of = f'<img alt="{words}" style="{style}" src="data:image/png;base64,{data}">'
    return f"<div><code>{words}</code><br>{picture_of}</div>"
