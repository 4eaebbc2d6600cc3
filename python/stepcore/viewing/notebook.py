"""Show a scene, a model or a world in a notebook: its words over its picture."""

from __future__ import annotations

import base64
import html
import io
from collections.abc import Callable
from typing import Any

from stepcore.needs import need

# Geoms up to which drawing takes no time that anybody waits for.
MOST = 1000


def shown(value: Any, geoms: int, world: Callable[[], Any]) -> str | None:
    """Return `repr(value)` over a picture of the Sim that `world` makes, as HTML.

    None, so that the words alone are shown, of more than `MOST` geoms and where nothing draws: no
    renderer works here, or it is a scene that does not compile.
    """
    if geoms > MOST:
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
