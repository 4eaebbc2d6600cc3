"""How long a step of a robot takes as its file asks for it, while it stands, grasps or lies.

A robot starts from its first keyframe, or as its file poses it, settles for a second under the
keyframe's controls, and holds them with a noise of 2 % of their range. Both sides play the motion
from the same states: in blocks of constant controls (MuJoCo in a C loop, stepcore by `step(n)`),
and in a Python loop (`ctrl[:] = …` and one step). First both engines solve to rounding at each
start: where they find the same contacts their accelerations must agree.
"""

from __future__ import annotations

import copy
from dataclasses import dataclass

import c_loop
import mujoco
import mujoco_side
import numpy as np
import peers
import record
import stepcore_side
import verdict
from robot_files import Robot
from timing import Duel, Side, duel

import stepcore as sc

STARTS, BLOCKS, HOLD, SETTLE, NOISE = 6, 2, 25, 1.0, 0.02
# Accelerations agree to this share of the largest; normals of meshes are MuJoCo's to 1e-6.
SAME = 1e-3
FALLS = 3.0  # a free body without contacts that is as quick [m/s] has nothing to stand on
LOOPS = ("C loop", "Python loop")


@dataclass(frozen=True)
class Load:
    """Means over the steps of a motion."""

    contacts: float
    rows: float
    iterations: float


@dataclass(frozen=True)
class Times:
    """What a step of one robot costs.

    apart: of the accelerations of both engines at the starts at which they find the same contacts,
    relative to the largest. others: the same of those at which they find other contacts.
    """

    name: str
    nv: int
    apart: list[float]
    others: list[float]
    ours: Load
    theirs: Load
    c_loop: Duel
    python_loop: Duel

    @property
    def touches(self) -> bool:
        return max(self.ours.contacts, self.theirs.contacts) >= 0.5

    @property
    def difference(self) -> str:
        """How far the accelerations are apart, in words."""
        apart = [f"{max(self.apart):.0e}"] if self.apart else []
        if self.others:
            apart.append(
                f"other contacts at {len(self.others)} of {STARTS}: {max(self.others):.0e}"
            )
        return "; ".join(apart)

    def cells(self) -> tuple[str, ...]:
        """A line of the table."""
        loads = [(getattr(self.ours, n), getattr(self.theirs, n)) for n in vars(self.ours)]
        loops = (self.c_loop, self.python_loop)
        us = [(np.median(found.ours), np.median(found.theirs)) for found in loops]
        ratios = [f"**{found.ratio:.2f}**" for found in loops]
        return (
            *(self.name, str(self.nv)),
            *(f"{one:.1f}, {two:.1f}" for one, two in loads),
            *(ratios[0], f"{us[0][0]:.3g}, {us[0][1]:.3g}"),
            *(ratios[1], f"{us[1][0]:.3g}, {us[1][1]:.3g}"),
            self.difference,
        )


APART = "accelerations apart"
HEAD = (
    *("robot", "dofs", "contacts", "rows", "iterations"),
    *(part for loop in LOOPS for part in (loop, "µs a step")),
    APART,
)


def measure(robot: Robot, pairs: int, sample: float) -> Times:
    """Plays the same motion on both sides, in turn.

    Raises ValueError where there is nothing to compare: a file that either side refuses (a mesh
    that is missing, say), a robot without ground, or accelerations that differ.
    """
    theirs = mujoco.MjModel.from_xml_path(str(robot.path))
    model = sc.load(robot.path).compile()
    if not model.nu:
        raise ValueError("it has no actuators")
    settle = round(SETTLE / theirs.opt.timestep)
    motion = mujoco_side.record(theirs, STARTS, BLOCKS, HOLD, settle, noise=NOISE)
    sim, data = sc.Sim(model), mujoco.MjData(theirs)
    loads = our_load(sim, motion), their_load(theirs, data, motion)
    speeds = motion.starts["qvel"][:, theirs.jnt_dofadr[theirs.jnt_type == 0]]
    if not (loads[0].contacts or loads[1].contacts) and np.abs(speeds).max(initial=0.0) > FALLS:
        raise ValueError("it falls: there is no ground")
    apart, others = differences(model, theirs, motion)
    if max(apart, default=0.0) > SAME:
        raise ValueError(f"accelerations differ by {max(apart):.0e} of the largest")
    loop = (theirs, data, motion.states, motion.ctrl, motion.hold)
    players = (
        (stepcore_side.player(sim, motion), c_loop.player(*loop)),
        (stepcore_side.player(sim, motion, 1), c_loop.python_player(*loop)),
    )
    duels = [
        duel(Side("stepcore", a, motion.steps), Side("MuJoCo", b, motion.steps), pairs, sample)
        for a, b in players
    ]
    name = f"{robot.collection}/{robot.name}"
    return Times(name, model.nv, apart, others, *loads, *duels)


def our_load(sim: sc.Sim, motion: mujoco_side.Motion) -> Load:
    found = [
        (len(sim.contacts), len(sim.rows), sim.sweeps_done) for _ in stepcore_side.walk(sim, motion)
    ]
    return Load(*np.mean(found, axis=0))


def their_load(model: mujoco.MjModel, data: mujoco.MjData, motion: mujoco_side.Motion) -> Load:
    found = [
        (data.ncon, data.nefc, data.solver_niter[: max(data.nisland, 1)].max())
        for _ in mujoco_side.walk(model, data, motion)
    ]
    return Load(*np.mean(found, axis=0))


def differences(
    model: sc.Model, theirs: mujoco.MjModel, motion: mujoco_side.Motion
) -> tuple[list[float], list[float]]:
    """How far the accelerations are apart at starts with the same contacts, and with others."""
    exact, sim = peers.strict(copy.copy(theirs)), sc.Sim(model, **peers.EXACT)
    data = mujoco.MjData(exact)
    judge = verdict.Judge(sim, exact, data, peers.kept_geoms(sim, exact))
    found: tuple[list[float], list[float]] = [], []
    starts = zip(stepcore_side.snapshots(sim, motion), motion.states, strict=True)
    for ours, state in starts:
        sim.restore(ours)
        sim.forward()
        mujoco.mj_setState(exact, data, state, c_loop.STATE)
        mujoco.mj_forward(exact, data)
        other = judge.differ() or verdict.grazes(data)
        found[other].append(peers.apart(sim.qacc, data.qacc))
    return found


def report(rows: list[Times], skipped: dict[str, str], options) -> str:
    """Prints and keeps everything, the slowest first; returns the table in Markdown."""
    kept = record.Report("robots", options, c_loop.how())
    rows = sorted(rows, key=lambda row: row.c_loop.ratio)
    for row in rows:
        loads = {"ours": vars(row.ours), "theirs": vars(row.theirs)}
        for loop, found in zip(LOOPS, (row.c_loop, row.python_loop), strict=True):
            kept.add(case=row.name, solver=loop, nv=row.nv, **loads, duel=found.record())
    table = record.markdown(HEAD, [row.cells() for row in rows])
    kept.say(f"{table}\n{summary(rows)}\n")
    for name, why in skipped.items():
        kept.say(f"not measured: {name}: {why}")
    kept.close()
    return f"{summary(rows)}\n\n{table}"


def summary(rows: list[Times]) -> str:
    """Median and least of each column, of the robots that touch something and of the others."""
    parts = []
    for name, chosen in (
        ("with contacts", [row for row in rows if row.touches]),
        ("without", [row for row in rows if not row.touches]),
    ):
        if chosen:
            columns = [(row.c_loop.ratio, row.python_loop.ratio) for row in chosen]
            medians, least = np.median(columns, axis=0), np.min(columns, axis=0)
            figures = (
                f"{loop}: median {median:.2f}, least {low:.2f}"
                for loop, median, low in zip(LOOPS, medians, least, strict=True)
            )
            parts.append(f"{len(chosen)} robots {name}: {'; '.join(figures)}.")
    return "\n".join(parts)


def slowest(rows: list[Times], count: int = 6) -> str:
    """The table of README: those that touch something, the slowest first, and the median."""
    rows = sorted((row for row in rows if row.touches), key=lambda row: row.c_loop.ratio)
    lines = []
    for row in rows[:count]:
        ratios = (f"{row.c_loop.ratio:.2f}", f"{row.python_loop.ratio:.2f}")
        lines.append((row.name, f"{row.theirs.contacts:.0f}", *ratios, row.difference))
    medians = np.median([(row.c_loop.ratio, row.python_loop.ratio) for row in rows], axis=0)
    lines.append((f"median of {len(rows)}", "", *(f"{median:.2f}" for median in medians), ""))
    return record.markdown(("", "contacts", *LOOPS, APART), lines)
