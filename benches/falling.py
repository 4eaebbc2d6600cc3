"""Spheres that fall and come to rest, in stepcore and in an engine with other contact laws.

What can be compared is what both agree on. Checked first: a ball's fall before it lands (to 1 mm),
and, once everything has come to rest, the mean height of all bodies (to 1 % of a radius for the
ball, 10 % for the pile) and their speed, and that stepcore's deepest overlap, which is printed for
both, is no larger. stepcore takes the fewest sweeps of 1, 2, 4 … 64 at which that holds; where
none does there is no ratio. Both take one call from Python a step.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import record
import scenes
from timing import Side, duel

import stepcore as sc

DT = 0.002
LADDER = (1, 2, 4, 8, 16, 32, 64)  # ours
OURS = {"law": "rigid", "solver": "pgs", "integrator": "semi-implicit", "cone": "elliptic"}
OURS |= {"tolerance": 0.0, "warm_start": True, "dt": DT}
AT_REST = 0.01  # mean speed [m/s]
ROUNDED = 1e-6  # an overlap of so many radii is none: single precision


@dataclass(frozen=True)
class Case:
    name: str
    xml: str
    centres: np.ndarray
    radius: float
    walls: float  # half the width of the box; 0 for none
    settle: int
    same: float  # of the mean height, in radii


def pile(side: int) -> Case:
    half, centres = scenes.pile_centres(side)
    return Case(f"pile of {side**3}", scenes.pile(side), centres, 0.05, half, 2000, 0.1)


CASES = [
    Case("ball", scenes.free_ball(), np.array([[0.0, 0.0, 0.4]]), 0.1, 0.0, 1000, 0.01),
    pile(3),
    pile(4),
]


class Ours:
    def __init__(self, case: Case, sweeps: int) -> None:
        self.settings = OURS | {"sweeps": sweeps}
        self.sim = sc.Sim(sc.loads(case.xml).compile(), **self.settings)

    def step(self, n: int) -> None:
        for _ in range(n):
            self.sim.step(1)

    def read(self) -> tuple[np.ndarray, np.ndarray]:
        return self.sim.qpos.reshape(-1, 7)[:, :3].copy(), self.sim.qvel.reshape(-1, 6)[
            :, :3
        ].copy()


def header(report: record.Report, peer) -> None:
    report.say()
    report.say(
        f"{'scene':14}{'mean height [mm]':>22}{'deepest overlap [mm]':>24}{'sweeps':>8}"
        f"{'µs a step':>20}{'ratio (quartiles)':>22}"
    )
    both = f"{'stepcore':>12}{peer.name:>10}"
    report.say(f"{'':14}{both}{both}{'':8}{both}")


def compare(case: Case, options, report: record.Report, peer) -> None:
    """One case against a class like `vs_rapier.Rapier`, at the fewest sweeps that do as well."""
    theirs = peer(case)
    wanted = settle(theirs, case, options)
    for sweeps in LADDER:
        ours = Ours(case, sweeps)
        found = settle(ours, case, options)
        refusal = differs(found, wanted, case)
        if refusal is None:
            break
    heights, depths, speeds = ([getattr(one, of) for one in (found, wanted)] for of in MEASURED)
    line = f"{case.name:14}" + "".join(f"{1e3 * h:11.3f}" for h in heights)
    line += "".join(f"{1e3 * d:12.4f}" for d in depths)
    entry = {"case": case.name, "height": heights, "overlap": depths, "speed": speeds}
    if refusal is not None:
        report.say(f"{line}  no ratio: {refusal}")
        report.add(**entry, refused=refusal)
        return
    sides = (
        Side("stepcore", lambda: ours.step(20), 20),
        Side(peer.name, lambda: theirs.step(20), 20),
    )
    fight = duel(*sides, options.pairs, options.sample, wall=peer.threads)
    low, high = fight.ratio_spread
    times = f"{np.median(fight.ours):10.2f}{np.median(fight.theirs):10.2f}"
    report.say(f"{line}{sweeps:8}{times}{fight.ratio:8.2f} ({low:.2f}–{high:.2f})")
    report.add(**entry, settings=ours.settings, **fight.record())


@dataclass(frozen=True)
class Rest:
    """How bodies fell, and how they lie."""

    fallen: np.ndarray
    height: float
    overlap: float
    speed: float


MEASURED = ("height", "overlap", "speed")


def settle(side, case: Case, options) -> Rest:
    side.step(50)  # 0.1 s: a ball is still in the air
    fallen = side.read()[0]
    side.step(case.settle // (2 if options.quick else 1))
    places, velocities = side.read()
    speed = float(np.linalg.norm(velocities, axis=1).mean())
    return Rest(fallen, float(places[:, 2].mean()), overlap(places, case), speed)


def differs(ours: Rest, theirs: Rest, case: Case) -> str | None:
    """Why there is no ratio."""
    if max(ours.speed, theirs.speed) > AT_REST:
        return f"no rest (mean speeds {ours.speed:.1e}, {theirs.speed:.1e} m/s)"
    if len(case.centres) == 1 and np.abs(ours.fallen - theirs.fallen).max() > 1e-3:
        return "another fall"
    if abs(ours.height - theirs.height) > case.same * case.radius:
        return "another height"
    if ours.overlap > max(theirs.overlap, ROUNDED * case.radius):
        return "stepcore overlaps deeper"
    return None


def overlap(places: np.ndarray, case: Case) -> float:
    """The deepest overlap of two spheres, or of one with a wall [m]."""
    gaps = [places[:, 2].min() - case.radius]
    if case.walls:
        gaps.append(case.walls - np.abs(places[:, :2]).max() - case.radius)
    first, second = np.triu_indices(len(places), 1)
    if len(first):
        apart = np.linalg.norm(places[first] - places[second], axis=1)
        gaps.append(apart.min() - 2 * case.radius)
    return max(0.0, -float(min(gaps)))
