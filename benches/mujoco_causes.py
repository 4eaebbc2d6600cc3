"""Why a test model of MuJoCo's is refused or differs: the causes in docs/mujoco_models.md.

Each cause was looked into once. Where a cause can be seen in what was found, it is; the rest are
named by file.
"""

from __future__ import annotations

import re
from pathlib import Path
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from mujoco_models import Row

# By the text of the refusal.
REFUSALS = {
    r"flag \"sleep\"": "MuJoCo's `sleep`",
    r"<flexcomp>|<flex>|<skin>": "flexes",
    r"<plugin>": "plugins",
    r"type sdf": "signed distance fields",
    r"of <replicate>": "`<replicate>` with a `prefix`",
    r"plane against hfield": "a static plane and a static height field",
    r"fov_theta": "a wedge of no height",
    r"the mass matrix has no inverse": "a slide that others move already: no inverse mass matrix",
}
# By the text of MuJoCo's refusal.
THEIRS = {
    r"attribute: 'internal'|keyword: 'vert'|engine error: (passive )?flex": (
        "flexes of another version of MuJoCo than the wheel's"
    ),
    r"Lengthrange computation did not converge": "a length range that MuJoCo does not find",
    r"unrecognized element": "composites of another version of MuJoCo than the wheel's",
    r"": "made to be refused",
}
# What only the file can say; at a difference above 1e-6 each was looked into.
FILES = {
    r"ray/hfield": "mass of a height field on a body that does not move: ours",
    r"testdata/(collisions|frame|frame1)\.xml": (
        "contacts that nothing can move press with 1e14 to 1e18 N; what is left of them is rounding"
    ),
    r"replicate/bunnies": "hundreds of large meshes: the oracle takes too long",
    r"sensor/fromto_": "nearest points that are not unique, or a distance that is the cutoff: ties",
}
NORMALS = (
    "directions of MuJoCo's convex contacts, which it finds to 1e-6, or vertices of meshes, which "
    "it keeps in single precision"
)
AXES = "axes of meshes with equal principal moments"
CONTACTS = "other contacts; the oracle decides"
# Relative differences that follow from a normal that is off by 1e-6.
OF_NORMALS = {"contacts": 1e-5, "constraint": 1e-4, "qacc": 1e-4, "sensordata": 1e-5}
SMALL = 1e-6


def cause(row: Row, path: Path) -> str:
    """In words; "" for a row that is equal, or whose cause is not known."""
    if row.refused and not row.peer_refused:
        return _first(REFUSALS, row.refused)
    if row.peer_refused:
        return _first(THEIRS, row.peer_refused)
    if row.kind == "equal":
        return ""
    found = []
    if named := _first(FILES, str(path)):
        found.append(named)
    if row.kind == "not compared":
        return named
    if row.other_contacts:
        found.append(CONTACTS)
    large = {name for name, value in row.errors.items() if float(value) > SMALL}
    if "geom_xmat" in large:
        found.append(AXES)
        large -= {"geom_xmat"}
    large |= {name for name, value in row.model.items() if float(value) > SMALL}
    if large == {"body_ipos"} and found == [AXES]:
        return AXES
    if not named and large:
        if not all(float(row.errors.get(name, 1.0)) <= OF_NORMALS.get(name, 0) for name in large):
            return ""
        found.append(NORMALS)
    return "; ".join(found)


def _first(causes: dict[str, str], text: str) -> str:
    return next((cause for pattern, cause in causes.items() if re.search(pattern, text)), "")
