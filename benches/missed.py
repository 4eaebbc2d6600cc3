"""Poses at which MuJoCo's direction proves a shorter way out, or a larger distance, than ours.

    python benches/missed.py [--poses 33000] [--pairs ellipsoid-box,cylinder-mesh] [--seed 41]

Any direction proves a bound of the distance (`contact_oracle/certificate.py`), whoever found it.
So the direction of `mj_geomDistance` finds our misses, a thousand poses in a second, where the
oracle's own search takes minutes; misses that both engines share are left to `trust.py`. Poses are
also counted of which a point stands out of its shape.
"""

from __future__ import annotations

import argparse

import numpy as np
from contact_oracle.certificate import certify
from contact_oracle.judge import touched
from contact_oracle.peer import mujoco_touches
from contact_oracle.poses import STYLES, Trial, trial

BATCH = 1000
PRECISE = 1e-9
# Of the scale, 17 km from the origin: what rounding of positions leaves.
FAR = 1e-7
BENT = (
    "ellipsoid-ellipsoid,ellipsoid-cylinder,cylinder-cylinder,ellipsoid-box,cylinder-box,"
    "capsule-ellipsoid,capsule-cylinder,ellipsoid-mesh,cylinder-mesh,mesh-mesh,capsule-mesh,"
    "box-mesh,capsule-box"
)


def off(one: Trial) -> tuple[np.ndarray, np.ndarray]:
    """By pose, over the scale: by how much MuJoCo's direction is better than ours, and how far our
    points stand out."""
    posed, touches = one.posed, touched(one)
    listed = np.where(touches.exists, touches.dist, np.inf)
    rows, slot = np.arange(len(listed)), listed.argmin(axis=1)
    normals, pos = one.into(touches.normal), one.points_into(touches.pos)
    ours = normals[rows, slot]
    theirs = one.into(mujoco_touches(one).normal[:, None])[:, 0]
    known = np.isfinite(theirs[:, 0])
    proven = posed.gap(np.where(known[:, None], theirs, 0.0)[:, None])[:, 0]
    missed = np.where(known, proven - posed.gap(ours[:, None])[:, 0], 0.0)
    claim = certify(posed, listed[rows, slot], pos[rows, slot], ours)
    half = normals * touches.dist[..., None] / 2
    into_b = (pos + half - posed.offset[:, None]) @ posed.turn
    out = np.maximum(posed.a.outside(pos - half), posed.b.outside(into_b))
    out = np.where(touches.exists, out, 0.0).max(axis=1)
    worst = np.maximum.reduce([out, claim.plane, claim.support])
    return missed / posed.scale, worst / posed.scale


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--poses", type=int, default=33_000)
    parser.add_argument("--pairs", default=BENT)
    parser.add_argument("--seed", type=int, default=41)
    given = parser.parse_args()
    batches = -(-given.poses // BATCH // len(STYLES))
    print("| pair | poses | missed | by at most | points off | by at most |")
    print("|---|---|---|---|---|---|", flush=True)
    for name in given.pairs.split(","):
        first, second = name.split("-")
        rng, missed, points = np.random.default_rng(given.seed), [], []
        for style in STYLES:
            for _ in range(batches):
                better, out = off(trial(rng, (first, second), style, BATCH))
                limit = FAR if style == "far" else PRECISE
                missed += better[better > limit].tolist()
                points += out[out > limit].tolist()
        count = BATCH * batches * len(STYLES)
        print(
            f"| {name} | {count:,} | {len(missed)} | {max(missed, default=0):.0e} | "
            f"{len(points)} | {max(points, default=0):.0e} |",
            flush=True,
        )


if __name__ == "__main__":
    main()
