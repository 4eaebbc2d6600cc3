"""`Touches`: contact points of two geoms at given positions, computed by `Model.touches`."""

from __future__ import annotations

import operator
from typing import TYPE_CHECKING, NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

from stepcore import checks
from stepcore.engine.arrays import Floats, numbers

if TYPE_CHECKING:
    from stepcore.engine.model import Model


class Touches(NamedTuple):
    """The contacts of two geoms, by pose and then by slot.

    exists: whether the slot has a contact, at any distance, shape (…, slots). Without a contact the
        other entries are undefined.
    dist: signed distance [m], negative = overlap, shape (…, slots).
    pos: halfway between the surfaces [m], shape (…, slots, 3).
    normal: unit vector from the first geom to the second, shape (…, slots, 3).
    feature: an integer that identifies the touching features (a corner, a pair of edges)
        consistently over all poses, shape (…, slots).
    """

    exists: NDArray[np.bool_]
    dist: Floats
    pos: Floats
    normal: Floats
    feature: Floats


def touches(
    model: Model,
    geom1: int | str,
    geom2: int | str,
    qpos: ArrayLike,
    precision: str,
    lanes: bool,
) -> Touches:
    """Compute the contacts of two geoms; see `Model.touches`."""
    first, second = _geom(model, "geom1", geom1), _geom(model, "geom2", geom2)
    positions = numbers("qpos", qpos)
    if positions.ndim == 0 or positions.shape[-1] != model.nq:
        raise ValueError(f"qpos has shape {positions.shape}: must be (…, {model.nq})")
    if not np.isfinite(positions).all():
        raise ValueError("qpos has entries that are not finite: every entry must be")
    if precision not in ("f64", "f32"):
        raise ValueError(f"precision = {checks.shown(precision)}: must be 'f64' or 'f32'")
    leading = positions.shape[:-1]
    flat = np.ascontiguousarray(positions.reshape(int(np.prod(leading, dtype=int)), model.nq))
    contacts = model.core.touches(
        first, second, flat, precision + " lanes" * checks.flag_of("lanes", lanes)
    )
    return Touches(*(array.reshape(leading + array.shape[1:]) for array in contacts))  # type: ignore[arg-type]


def _geom(model: Model, field: str, geom: int | str) -> int:
    names = model.geom_names
    if isinstance(geom, str):
        if not geom or geom not in names:
            raise ValueError(f"{field}: no geom {checks.quoted(geom)}{checks.nearest(geom, names)}")
        return names.index(geom)
    try:
        index = operator.index(geom)
    except TypeError:
        index = -1
    if not 0 <= index < model.ngeom:
        limit = f"must be a geom's name or an index from 0 to {model.ngeom - 1}"
        raise ValueError(f"{field} = {checks.shown(geom)}: {limit}")
    return index
