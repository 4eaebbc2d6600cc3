"""Who is right where stepcore and MuJoCo find other contacts of two geoms.

A contact claims a distance, a normal and a point of each shape, and the oracle checks claims
(`contact_oracle/certificate.py`); no engine is trusted. An engine is right about a pair if

* the planes across the normal of its deepest contact that touch both shapes are as far apart as it
  says, and no direction that anybody knows (its own, the other engine's, a search from both) shows
  a larger distance or a shorter way out;
* the points of its contacts lie on the shapes, and each normal is across one of them there.

Each engine is judged by the hull that it has: MuJoCo keeps vertices in single precision, and of a
mesh with `maxhullvert` both keep other vertices. Two that are right of other hulls are compared
with the whole mesh. A height field is judged where it is flat as far as the shape reaches.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import NamedTuple

import mujoco
import numpy as np
from contact_oracle.certificate import certify
from contact_oracle.convex import Convex, Posed
from contact_oracle.search import climb, search, sphere

import stepcore as sc

# Of the pair's size: an engine that is off by no more is right.
RIGHT = 1e-6
# Of the pair's size: contacts farther apart are at other places.
ELSEWHERE = 1e-4
# Of a contact's distance from its margin [m].
GRAZES = 1e-15
# Cosine of the angle between normals that count as one.
SAME_NORMAL = 1 - 1e-12


class Claims(NamedTuple):
    """The contacts that an engine lists of one pair, the deepest first; normals from the first geom
    to the second. dist: (n,) [m]; pos [m], normal: (n, 3)."""

    dist: np.ndarray
    pos: np.ndarray
    normal: np.ndarray


@dataclass
class Verdicts:
    """Who was right about pairs of one kind, and how far each was off, over the size."""

    counts: dict[str, int] = field(default_factory=dict)
    ours: float = 0.0
    theirs: float = 0.0

    def add(self, who: str, ours: float, theirs: float) -> None:
        self.counts[who] = self.counts.get(who, 0) + 1
        self.ours, self.theirs = max(self.ours, ours), max(self.theirs, theirs)

    def __str__(self) -> str:
        most = sorted(self.counts.items(), key=lambda item: (-item[1], item[0]))
        return ", ".join(f"{who} {count}" for who, count in most)


def claims(dist: list, pos: list, normal: list) -> Claims:
    order = np.argsort(dist, kind="stable")
    return Claims(*(np.array(x, dtype=float)[order] for x in (dist, pos, normal)))


def listed(sim: sc.Sim, geoms: np.ndarray) -> dict[tuple[int, int], Claims]:
    """Our contacts by pair of MuJoCo's geoms."""
    pairs: dict[tuple[int, int], list] = {}
    for c in sim.contacts:
        pairs.setdefault((int(geoms[c["geom1"]]), int(geoms[c["geom2"]])), []).append(
            (float(c["dist"]), c["pos"], c["normal"])
        )
    return {pair: claims(*zip(*found, strict=True)) for pair, found in pairs.items()}


def listed_by_mujoco(data: mujoco.MjData) -> dict[tuple[int, int], Claims]:
    """MuJoCo's, but for those exactly at the margin, which it lists and which make no rows."""
    pairs: dict[tuple[int, int], list] = {}
    for c in data.contact[: data.ncon]:
        if not (c.exclude == 1 and c.dist == c.includemargin):
            pair = (int(c.geom[0]), int(c.geom[1]))
            pairs.setdefault(pair, []).append((c.dist, c.pos.copy(), c.frame[:3].copy()))
    return {pair: claims(*zip(*found, strict=True)) for pair, found in pairs.items()}


def grazes(data: mujoco.MjData) -> bool:
    """Some contact is at its margin to rounding, which decides whether it makes rows."""
    return any(abs(c.dist - c.includemargin) <= GRAZES for c in data.contact[: data.ncon])


def elsewhere(one: Claims | None, two: Claims | None, size: float) -> bool:
    """Other contacts: another number of them, or some at other places or along other normals."""
    if one is None or two is None or len(one.dist) != len(two.dist):
        return True
    left = list(range(len(one.dist)))
    for k in range(len(two.dist)):
        near = min(left, key=lambda i: float(np.abs(one.pos[i] - two.pos[k]).max()))
        left.remove(near)
        apart = np.abs(one.pos[near] - two.pos[k]).max() + abs(one.dist[near] - two.dist[k])
        if apart > ELSEWHERE * size or np.abs(one.normal[near] - two.normal[k]).max() > ELSEWHERE:
            return True
    return False


class Judge:
    """Judges pairs of geoms of one model, whose two engines stand at the same state."""

    def __init__(self, sim: sc.Sim, model: mujoco.MjModel, data: mujoco.MjData, geoms: np.ndarray):
        """geoms: MuJoCo's index of each of ours."""
        self.sim, self.model, self.data, self.geoms = sim, model, data, geoms
        self.ours = {int(g): k for k, g in enumerate(geoms)}
        self.meshes: dict[tuple[int, bool | None], Convex] = {}

    def kind(self, geom: int) -> str:
        return mujoco.mjtGeom(self.model.geom_type[geom]).name[7:].lower()

    def size(self, pair: tuple[int, int]) -> float:
        """The radius of the smaller geom's bounding sphere [m]; a plane has none."""
        return min(float(r) for r in self.model.geom_rbound[list(pair)] if r > 0)

    def differ(self, verdicts: dict[str, Verdicts] | None = None) -> bool:
        """Whether any pair of geoms has other contacts; into `verdicts`, if given, who is right."""
        ours, theirs = listed(self.sim, self.geoms), listed_by_mujoco(self.data)
        differs = False
        for pair in sorted(ours.keys() | theirs.keys()):
            one, two = ours.get(pair), theirs.get(pair)
            if not elsewhere(one, two, self.size(pair)):
                continue
            differs = True
            if verdicts is not None:
                kinds = "–".join(self.kind(geom) for geom in pair)
                verdicts.setdefault(kinds, Verdicts()).add(*self.pair(pair, one, two))
        return differs

    def pair(
        self, pair: tuple[int, int], one: Claims | None, two: Claims | None
    ) -> tuple[str, float, float]:
        """The verdict in words, and by how much of the size each engine is off, at most 1."""
        posed = [posed for ours in (True, False) if (posed := self._posed(pair, ours)) is not None]
        if len(posed) < 2:
            return "not judged", 0.0, 0.0
        normals = np.concatenate([c.normal[:1] for c in (one, two) if c is not None])
        turn = self.data.geom_xmat[pair[0]].reshape(3, 3)
        errors = []
        for shapes, own in zip(posed, (one, two), strict=True):
            best = _largest(shapes, normals @ turn)
            errors.append(self._error(shapes, own, best, pair))
        ours, theirs = (min(error / float(posed[0].scale[0]), 1.0) for error in errors)
        if ours > RIGHT and theirs > RIGHT:
            return "stepcore nearer" if ours < theirs else "MuJoCo nearer", ours, theirs
        if ours <= RIGHT < theirs:
            return "stepcore right", ours, theirs
        if theirs <= RIGHT < ours:
            return "MuJoCo right", ours, theirs
        return self._by_whole_meshes(pair, one, two, normals @ turn), ours, theirs

    def _by_whole_meshes(
        self, pair: tuple[int, int], one: Claims | None, two: Claims | None, normals: np.ndarray
    ) -> str:
        """Of two that are right: who is, if their hulls differ."""
        whole = self._posed(pair, None)
        if one is None or two is None or whole is None:
            return "both right"
        true, size = _largest(whole, normals), float(whole.scale[0])
        ours, theirs = (abs(own.dist[0] - true) for own in (one, two))
        if max(ours, theirs) <= RIGHT * size:
            return "both right, other points"
        return "other hulls, stepcore nearer" if ours < theirs else "other hulls, MuJoCo nearer"

    def _error(
        self, shapes: Posed, own: Claims | None, best: float, pair: tuple[int, int]
    ) -> float:
        """How far an engine's claims are off [m]."""
        if own is None:
            # It says that the shapes are not nearer than the margin.
            return max(0.0, self._margin(pair) - best)
        turn, at = self.data.geom_xmat[pair[0]].reshape(3, 3), self.data.geom_xpos[pair[0]]
        pos, normal = (own.pos - at) @ turn, own.normal @ turn
        first = shapes.take(np.zeros(len(own.dist), int))
        found = certify(first, own.dist, pos, normal)
        gaps = first.gap(normal[:, None])[:, 0]
        error = max(found.plane[0], found.point[0], found.support[0], best - gaps[0])
        for k in range(1, len(own.dist)):
            error = max(error, found.point[k])
            if normal[k] @ normal[0] < SAME_NORMAL:
                error = max(error, _across(first, own.dist[k], pos[k], normal[k]))
        return float(error)

    def _margin(self, pair: tuple[int, int]) -> float:
        return float(self.model.geom_margin[list(pair)].max())

    def _posed(self, pair: tuple[int, int], ours: bool | None) -> Posed | None:
        shapes = [self._shape(geom, pair, ours) for geom in pair]
        if shapes[0] is None or shapes[1] is None:
            return None
        turns = [self.data.geom_xmat[geom].reshape(3, 3) for geom in pair]
        between = self.data.geom_xpos[pair[1]] - self.data.geom_xpos[pair[0]]
        if self.kind(pair[0]) == "hfield":
            between = between - turns[0][:, 2] * self._level(pair)
        offset, turn = turns[0].T @ between, turns[0].T @ turns[1]
        return Posed(shapes[0], shapes[1], offset[None], turn[None])

    def _shape(self, geom: int, pair: tuple[int, int], ours: bool | None) -> Convex | None:
        """A geom for the oracle; None if it is none of its shapes. ours: whose hull, None: all
        vertices of the mesh."""
        kind = self.kind(geom)
        if kind == "hfield":
            return None if self._level(pair) is None else Convex("plane")
        if kind != "mesh":
            return Convex(kind, tuple(self.model.geom_size[geom].tolist()))
        if (geom, ours) not in self.meshes:
            self.meshes[geom, ours] = Convex("mesh", vertices=self._vertices(geom, ours))
        return self.meshes[geom, ours]

    def _vertices(self, geom: int, ours: bool | None) -> np.ndarray:
        """Of a mesh, in MuJoCo's frame of the geom."""
        model, mesh = self.model, self.model.geom_dataid[geom]
        first, graph = model.mesh_vertadr[mesh], model.mesh_graphadr[mesh]
        vertices: np.ndarray = model.mesh_vert[first : first + model.mesh_vertnum[mesh]].astype(
            float
        )
        if ours:
            k = self.ours[geom]
            hull = np.asarray(self.sim.model.geom_hull(k)[0])
            # Its own frame may be another, where principal moments are equal.
            at = self.sim.geom_xpos[k] - self.data.geom_xpos[geom]
            world = hull @ self.sim.geom_xmat[k].T + at
            vertices = world @ self.data.geom_xmat[geom].reshape(3, 3)
        elif ours is False and graph >= 0:
            count = model.mesh_graph[graph]
            vertices = vertices[model.mesh_graph[graph + 2 + count : graph + 2 + 2 * count]]
        return vertices

    def _level(self, pair: tuple[int, int]) -> float | None:
        """The height of a field that is flat as far as the other shape may reach; else None."""
        model, (field_geom, other) = self.model, pair
        index = model.geom_dataid[field_geom]
        nrow, ncol = model.hfield_nrow[index], model.hfield_ncol[index]
        half, first = model.hfield_size[index], model.hfield_adr[index]
        heights = model.hfield_data[first : first + nrow * ncol].reshape(nrow, ncol) * half[2]
        turn = self.data.geom_xmat[field_geom].reshape(3, 3)
        at = turn.T @ (self.data.geom_xpos[other] - self.data.geom_xpos[field_geom])
        reach = 2.0 * model.geom_rbound[other]
        spans = [
            np.clip(((at[k] + np.array([-reach, reach])) / half[k] + 1) / 2 * (n - 1), 0, n - 1)
            for k, n in ((0, ncol), (1, nrow))
        ]
        (left, right), (low, high) = ((int(s[0]), int(np.ceil(s[1]))) for s in spans)
        part = heights[low : high + 1, left : right + 1]
        return float(part.flat[0]) if np.ptp(part) == 0 else None


def _across(shapes: Posed, dist: float, pos: np.ndarray, normal: np.ndarray) -> float:
    """How far a normal is from being across one of the surfaces at the contact's point [m]; of a
    plane, across the plane."""
    on_a, on_b = pos - normal * dist / 2, pos + normal * dist / 2 - shapes.offset[0]
    first = abs(float(shapes.a.height(normal[None])[0] - on_a @ normal))
    if shapes.a.kind == "plane":
        return first
    inward = -(normal @ shapes.turn[0])
    return min(first, abs(float(shapes.b.height(inward[None])[0] + on_b @ normal)))


def _largest(shapes: Posed, normals: np.ndarray) -> float:
    """The largest distance between planes across any direction that is known."""
    if shapes.a.kind == "plane":
        return float(shapes.gap(np.eye(3)[2:])[0, 0])
    if "mesh" not in (shapes.a.kind, shapes.b.kind):
        return max(float(search(shapes).dist[0]), float(shapes.gap(normals).max()))
    # Hulls of many vertices: a climb from the best of some directions all round.
    directions = sphere(320)
    best = directions[np.argsort(-shapes.gap(directions)[0])[:2]]
    climbed = climb(shapes, np.concatenate([normals, best])[None])
    return float(max(shapes.gap(climbed).max(), shapes.gap(normals).max()))
