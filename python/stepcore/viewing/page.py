"""Pages that replay runs: one file each, which needs neither Python nor a network.

The renderer is three.js, which is read from the installed package trimesh when a page is written:
its wheel contains all of it (release 140, MIT licence, 0.6 MB) as one script without modules, as a
page opened from a disk needs. plotly's script is seven times as large and has no shapes but meshes;
k3d's is four times as large. A page of viser's scene serializer has no readings and no curves.
"""

from __future__ import annotations

import base64
import html
import io
import json
import os
import re
import zipfile
import zlib
from collections.abc import Sequence
from importlib import resources
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from stepcore import escapes, files
from stepcore.needs import need
from stepcore.report.outputs import MARK
from stepcore.report.plot.style import TINTS, VIEW, rgb
from stepcore.viewing.drawing import ARROW, Drawing
from stepcore.viewing.frames import Replayed, rms_distance


def replay_page(runs: Sequence[Replayed], title: str = "") -> str:
    """Return the page that replays these runs over each other."""
    first = runs[0].drawing
    title = title or first.name or "stepcore"
    tints = [None, *(rgb(TINTS[k % len(TINTS)]) for k in range(len(runs) - 1))]
    weight = max(run.drawing.weight for run in runs)
    data = {
        "title": title,
        "extent": first.extent,
        "runs": [_run(run, tint) for run, tint in zip(runs, tints, strict=True)],
        # The force of an arrow of length `ARROW`.
        "newtons": weight or max(run.strongest for run in runs) or 1.0,
        "arrow": ARROW * first.extent,
        "colours": VIEW,
        "notes": [f"Not drawn: {note}." for note in first.notes],
    }
    if len(runs) > 1:
        data["distance"] = [_packed(rms_distance(runs[0], run)) for run in runs[1:]]
    coded = base64.b64encode(zlib.compress(json.dumps(data).encode(), 9)).decode()
    parts = {
        "MARK": MARK,
        "TITLE": html.escape(escapes.printable(title)),
        "STYLE": _own("page.css"),
        "THREE": three(),
        "DATA": coded,
        "SHAPES": _own("page_shapes.js"),
        "FIGURES": _own("page_figures.js"),
        "SCRIPT": _own("page.js"),
    }
    # In one pass, so that the inserted texts are not searched.
    return re.sub(r"\$([A-Z]+)\$", lambda match: parts[match[1]], _own("page.html"))


def save_page(runs: Sequence[Replayed], path: str | os.PathLike[str]) -> None:
    """Write the page to a file."""
    Path(files.as_path("path", path)).write_text(replay_page(runs), encoding="utf-8")


def framed(text: str, height: int = 480) -> str:
    """Return the page in a frame, isolated from the notebook's scripts."""
    inner = html.escape(text)
    style = f"box-sizing:border-box;width:100%;height:{height}px;"
    style += "border:1px solid #8884;border-radius:6px"
    return f'<iframe srcdoc="{inner}" style="{style}" sandbox="allow-scripts"></iframe>'


def three() -> str:
    """Return the script of three.js from the installed package trimesh."""
    trimesh = need("trimesh", "a page that replays a run")
    archive = resources.files(trimesh).joinpath("resources/templates/viewer.zip")
    try:
        with zipfile.ZipFile(io.BytesIO(archive.read_bytes())) as unzipped:
            template = unzipped.read("viewer.html.template").decode()
        script = template[template.index("<script>") + 8 : template.rindex("</script>")]
        # After the library, trimesh's page begins.
        library = script[: script.index("var camera,controls,scene,renderer")]
    except (OSError, KeyError, ValueError):
        version = getattr(trimesh, "__version__", "")
        raise RuntimeError(f"trimesh {version} carries no three.js that is known here") from None
    return library.replace("</script", "<\\/script")


def _own(name: str) -> str:
    return resources.files("stepcore.viewing").joinpath(name).read_text(encoding="utf-8")


def _run(run: Replayed, tint: Any) -> dict[str, Any]:
    instants = run.instants
    poses = [np.concatenate([i.xpos, i.xquat], axis=1) for i in instants]
    contacts = [np.concatenate([i.places, i.forces], axis=1) for i in instants]
    starts = np.cumsum([0, *(len(each) for each in contacts)])
    return {
        "label": run.label,
        "tint": tint,
        "drawing": _drawing(run.drawing),
        "time": _packed(run.time),
        "poses": _packed(np.array(poses)),
        "contacts": _packed(np.concatenate(contacts)),
        "starts": _packed(starts, "<u4"),
        "energy": _packed([i.energy for i in instants]),
        "residual": _packed([i.residual for i in instants]),
        "tendons": [_packed(ways) for ways in zip(*(i.tendons for i in instants), strict=True)],
    }


def _drawing(drawing: Drawing) -> dict[str, Any]:
    surfaces: dict[bytes, int] = {}
    packed: list[dict[str, Any]] = []
    shapes = []
    for shape in drawing.shapes:
        names = ("body", "kind", "size", "pos", "quat", "rgba", "shown")
        entry = {name: getattr(shape, name) for name in names}
        if shape.kind == "plane":
            entry["squares"] = shape.checks
        if shape.surface is not None:
            vertices, faces = shape.surface
            # Geoms of one mesh share its surface.
            key = np.asarray(vertices, "<f4").tobytes() + np.asarray(faces, "<u4").tobytes()
            if key not in surfaces:
                surfaces[key] = len(packed)
                packed.append(_surface(vertices, faces))
            entry["surface"] = surfaces[key]
        shapes.append(entry)
    return {
        "shapes": shapes,
        "surfaces": packed,
        "bodies": list(drawing.bodies),
        "moving": drawing.moving.tolist(),
    }


def _surface(vertices: NDArray[Any], faces: NDArray[Any]) -> dict[str, Any]:
    """Return a surface with coordinates of 16 bits (1/65,000 of its size)."""
    low, high = vertices.min(axis=0), vertices.max(axis=0)
    span = np.where(high > low, high - low, 1.0)
    grid = np.round((vertices - low) / span * 65535)
    small = len(vertices) <= 65535
    return {
        "low": low.tolist(),
        "span": span.tolist(),
        "places": _packed(grid, "<u2"),
        "faces": _packed(faces, "<u2" if small else "<u4"),
        "small": small,
    }


def _packed(numbers: Any, kind: str = "<f4") -> str:
    """Return numbers for the page: little-endian, in base64."""
    # A run that explodes has numbers beyond single precision.
    with np.errstate(over="ignore"):
        return base64.b64encode(np.ascontiguousarray(numbers, kind).tobytes()).decode()
