"""Information of many worlds, in the form of gymnasium's vector environments.

Each name has an array with the worlds first, and "_name" says which worlds have an entry; the
others have 0 or None.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from stepcore.engine.arrays import Floats

Mask = NDArray[np.bool_]


def masked(infos: dict[str, Any], info: dict[str, Any], mask: Mask) -> dict[str, Any]:
    """Add the entries of the worlds of a mask to `infos`."""
    worlds = np.flatnonzero(mask)
    for name, value in info.items():
        rows = np.asarray(value)
        if len(rows) == len(mask):
            rows = rows[worlds]
        if rows.dtype == object:
            present = np.array([row is not None for row in rows], dtype=bool)
            _fill(infos, name, rows[present], worlds[present], mask)
        else:
            _fill(infos, name, rows, worlds, mask)
    return infos


def _fill(infos: dict[str, Any], name: str, rows: Any, worlds: Any, mask: Mask) -> None:
    if not len(worlds):
        return
    if name not in infos:
        empty = None if rows.dtype == object else 0
        infos[name] = np.full((len(mask), *rows.shape[1:]), empty, dtype=rows.dtype)
        infos[f"_{name}"] = np.zeros(len(mask), dtype=bool)
    infos[name][worlds] = rows
    infos[f"_{name}"][worlds] = True


def final_infos(info: dict[str, Any], observations: Floats, ended: Mask) -> dict[str, Any]:
    """Return "final_obs" and "final_info" of worlds whose episodes ended."""
    last = np.full(len(ended), None, dtype=object)
    for world in np.flatnonzero(ended):
        last[world] = observations[world].copy()
    return {
        "final_obs": last,
        "_final_obs": ended.copy(),
        "final_info": masked({}, info, ended),
        "_final_info": ended.copy(),
    }


def failures(errors: dict[int, Any], n: int) -> NDArray[Any]:
    """Return the text of each world's failure, or None."""
    texts = np.full(n, None, dtype=object)
    for world, error in errors.items():
        texts[world] = str(error)
    return texts
