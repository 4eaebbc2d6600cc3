"""The table of docs/trust.md: every pair of shapes against the independent oracle, and MuJoCo's.

    python benches/trust.py [--poses 100000] [--pairs box-box,cylinder-box] [--cases]

Every pose is certified, `--searched` of the overlapping ones per batch of a thousand are searched
for a shorter way out, and `--covered` of these are bounded from above as well. Where MuJoCo's
distance is off by more than 1e-6 of the scale, the case is decided by bounds: a direction proves
that a distance is not smaller, the covering of all directions that it is not larger.
"""

from __future__ import annotations

import argparse
import math
import sys
from dataclasses import dataclass, field

import numpy as np
from contact_oracle.cover import upper_bound
from contact_oracle.judge import Verdict, judge
from contact_oracle.poses import STYLES, trial
from contact_oracle.search import search

BATCH = 1000
NOTABLE = 1e-6
PRECISE = 1e-9
SHAPES = ("plane", "sphere", "capsule", "ellipsoid", "cylinder", "box", "mesh")
PAIRS = [(a, b) for i, a in enumerate(SHAPES) for b in SHAPES[i:] if (a, b) != ("plane", "plane")]


@dataclass
class Row:
    """What was found of one pair; errors are the worst, times 1/scale."""

    poses: int = 0
    overlapping: int = 0
    asked: int = 0  # poses at which MuJoCo was asked too
    asked_overlapping: int = 0
    searched: int = 0
    dist: float = 0.0
    plane: float = 0.0
    point: float = 0.0
    off: int = 0  # poses in which anything is off by more than PRECISE
    differs: int = 0  # MuJoCo's distance is off by more than NOTABLE
    ours_wrong: int = 0  # of these: we are
    contact_differs: int = 0  # the same of the deepest contact of MuJoCo's step
    theirs: float = 0.0  # MuJoCo's worst
    cases: list[str] = field(default_factory=list)

    def add(self, verdict: Verdict) -> None:
        self.poses += len(verdict.dist)
        self.overlapping += int(verdict.overlap.sum())
        self.searched += len(verdict.searched)
        self.dist = max(self.dist, float(np.abs(verdict.dist).max()))
        self.plane = max(self.plane, float(np.maximum(verdict.plane, verdict.support).max()))
        self.point = max(self.point, float(np.maximum(verdict.point, verdict.manifold).max()))
        errors = (verdict.dist, verdict.plane, verdict.support, verdict.point, verdict.manifold)
        self.off += int((np.abs(errors) > PRECISE).any(axis=0).sum())
        if verdict.found is None:
            return
        self.asked += len(verdict.dist)
        self.asked_overlapping += int(verdict.overlap.sum())
        off = np.flatnonzero(np.abs(verdict.peer) > NOTABLE)
        self.differs += len(off)
        self.contact_differs += int((np.abs(verdict.peer_contact) > NOTABLE).sum())
        if len(off):
            self._decide(verdict, off)

    def _decide(self, verdict: Verdict, off: np.ndarray) -> None:
        """Who is wrong at these poses."""
        found, one = verdict.found, verdict.trial
        assert found is not None
        posed = one.posed.take(off)
        direction = one.into(found.normal[:, None])[off]
        proven = posed.gap(np.where(np.isfinite(direction), direction, 0.0))[:, 0]
        proven = np.where(np.isfinite(found.normal[off, 0]), proven, -np.inf)
        low = np.maximum(np.maximum(search(posed).dist, proven), verdict.true[off])
        ours = (verdict.true[off] - low) / posed.scale + verdict.dist[off]
        theirs = (found.dist[off] - low) / posed.scale
        self.ours_wrong += int((np.abs(ours) > NOTABLE).sum())
        worst = int(np.abs(theirs).argmax())
        if abs(theirs[worst]) > abs(self.theirs):
            self.theirs = float(theirs[worst])
            k = np.array([worst])
            self.cases.append(
                self._case(verdict, int(off[worst]), float(low[worst]), posed.take(k))
            )

    def _case(self, verdict: Verdict, k: int, low: float, posed) -> str:
        one, found = verdict.trial, verdict.found
        high = low if low > 0 else float(upper_bound(posed, np.array([low]))[0])
        shapes = [
            f"{s.kind} {s.size if s.vertices is None else s.vertices.tolist()}" for s in one.shapes
        ]
        return (
            f"{one.style}: {shapes[0]} at {one.poses[k, :7].tolist()}; {shapes[1]} at "
            f"{one.poses[k, 7:].tolist()}: distance between {low!r} and {high!r}, "
            f"MuJoCo {float(found.dist[k])!r}"
        )

    def line(self, name: str) -> str:
        def share(count: int, of: int) -> str:
            return f"{100 * count / max(of, 1):.2g} %" if count else "0"

        worst = f" (by {abs(self.theirs):.0e})" if self.differs else ""
        return (
            f"| {name} | {self.poses:,} | {self.overlapping:,} | {self.searched:,} | "
            f"{self.dist:.0e} | {self.plane:.0e} | {self.point:.0e} | {self.off} | "
            f"{share(self.differs, self.asked)}{worst} | {self.ours_wrong} | "
            f"{share(self.contact_differs, self.asked_overlapping)} |"
        )


HEAD = """| pair | poses | overlapping | searched | distance | normal | points | off by > 1e-9 \
| MuJoCo differs | we are wrong | its contacts differ |
|---|---|---|---|---|---|---|---|---|---|---|"""


def measured(pair: tuple[str, str], poses: int, searched: int, covered: int) -> Row:
    """All styles of one pair."""
    rng, row = np.random.default_rng(41), Row()
    batches = max(1, math.ceil(poses / BATCH / len(STYLES)))
    size = min(BATCH, max(1, math.ceil(poses / len(STYLES))))
    for style in STYLES:
        for batch in range(batches):
            one = trial(rng, pair, style, size)
            # MuJoCo takes its time: one batch of each style.
            row.add(judge(one, searched=searched, covered=covered, peer=batch == 0))
    return row


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--poses", type=int, default=100_000)
    parser.add_argument("--searched", type=int, default=100)
    parser.add_argument("--covered", type=int, default=0)
    parser.add_argument("--pairs", default=",".join("-".join(pair) for pair in PAIRS))
    parser.add_argument("--cases", action="store_true", help="print MuJoCo's worst cases")
    given = parser.parse_args()
    print(HEAD)
    for name in given.pairs.split(","):
        first, second = name.split("-")
        try:
            row = measured((first, second), given.poses, given.searched, given.covered)
        except ValueError as error:
            print(f"{name}: {str(error)[:200]}", file=sys.stderr)
            continue
        print(row.line(name), flush=True)
        if given.cases and row.cases:
            print(f"  {row.cases[-1]}", flush=True)


if __name__ == "__main__":
    main()
