"""Public robots: which load, how far they are from MuJoCo, how fast; the table of docs/robots.md.

    python benches/robots.py [--folder DIR] [--only TEXT] [--states 100] [--no-times] [--write]

Every model of gymnasium's and dm-control's wheels, and every MJCF file below --folder. At each of
100 states (random falls: contacts, limits and pushes are active; half of them with forces applied)
both engines place, detect and solve from scratch, MuJoCo at its most accurate, and everything that
they compute is compared, relative to the largest entry. Where the two find other contacts, or as
many at other places, what follows from them is not compared: the state counts as one whose contacts
differ, and an independent oracle says of each such pair of geoms who is right (`verdict.py`). Nor
is it where a contact is at its margin to rounding. Then one step of each integrator that both have,
unless that happened.

Times: MuJoCo in a C loop with its timers off, stepcore by `sim.step(n)`, both from the same starts,
in turn. "equal": Newton, to the residual that MuJoCo reaches. "shipped": what the file asks for, on
either side.
"""

from __future__ import annotations

import argparse
import json
import warnings
from dataclasses import asdict, dataclass, field
from pathlib import Path

import mujoco
import numpy as np
import peers
import record
import robot_files
import verdict
from robot_times import Times, times

import stepcore as sc

DOCS = Path(__file__).parent.parent / "docs" / "robots.md"
MARKS = ("<!-- robots -->", "<!-- end of robots -->")
# Which columns of the table hold which quantities.
GROUPS = {
    "placed": ("xpos", "xquat", "geom_xpos", "geom_xmat", "site_xpos", "mass"),
    "forces": ("bias", "passive", "actuator"),
    "solved": ("constraint", "qacc"),
}


@dataclass
class Row:
    """What was found of one file; errors are the worst over the states."""

    collection: str
    name: str
    refused: str = ""
    peer_refused: str = ""
    nv: int = 0
    nu: int = 0
    states: int = 0
    other_contacts: int = 0
    # By kinds of geoms: who is right where their contacts differ.
    verdicts: dict[str, verdict.Verdicts] = field(default_factory=dict)
    errors: dict[str, float] = field(default_factory=dict)
    times: Times | None = None

    @property
    def loaded(self) -> bool:
        return not self.refused

    def worst(self, names: tuple[str, ...]) -> float:
        return max((self.errors.get(name, 0.0) for name in names), default=0.0)


def examine(robot: robot_files.Robot, count: int) -> Row:
    """Loads a file in both engines and compares them at `count` states."""
    row = Row(robot.collection, robot.name)
    try:
        theirs = peers.strict(mujoco.MjModel.from_xml_path(str(robot.path)))
    except ValueError as error:
        row.peer_refused = str(error).splitlines()[0]
        theirs = None
    try:
        model = sc.load(robot.path).compile()
    except ValueError as error:
        row.refused = str(error).replace(str(robot.path.parent) + "/", "").replace("\n", "; ")
        return row
    if theirs is None or not model.nv:
        return row
    row.nv, row.nu = model.nv, model.nu
    states = peers.fall_states(theirs, count, seed=7)
    row.states = len(states)
    states = compare_forward(row, model, theirs, states)
    for integrator in peers.INTEGRATORS:
        compare_steps(row, model, theirs, states, integrator)
    return row


def compare_forward(row: Row, model: sc.Model, theirs: mujoco.MjModel, states: list) -> list:
    """Everything that a forward pass computes; the states from which steps can be compared."""
    sim, data = sc.Sim(model, **peers.EXACT), mujoco.MjData(theirs)
    every, same, alike = peers.Worst(), peers.Worst(), []
    grazed = False
    judge = verdict.Judge(sim, theirs, data, peers.kept_geoms(sim, theirs))
    for index, state in enumerate(states):
        one = peers.Worst()
        peers.note_forward(one, index, sim, theirs, data, state)
        grazes = verdict.grazes(data)
        grazed |= grazes
        differs = note_pairs(judge, None if grazes else row)
        row.other_contacts += differs and not grazes
        differs |= grazes
        if not differs:
            alike.append(state)
        for name, (value, _) in one.seen.items():
            if name not in ("constraint", "qacc", "contacts", "sensordata"):
                every.note(name, value, index)
            elif not differs:
                same.note(name, value, index)
    row.errors = {name: value for name, (value, _) in (every.seen | same.seen).items()}
    # What touches so in one state may do it within a step from any other.
    return [] if grazed else alike


def note_pairs(judge: verdict.Judge, row: Row | None = None) -> bool:
    """Whether any pair of geoms has other contacts; with a row, who is right about it."""
    ours = verdict.listed(judge.sim, judge.geoms)
    peer = verdict.listed_by_mujoco(judge.data)
    differs = False
    for pair in sorted(ours.keys() | peer.keys()):
        own, other = ours.get(pair), peer.get(pair)
        if not verdict.elsewhere(own, other, judge.size(pair)):
            continue
        differs = True
        if row is not None:
            kinds = "–".join(judge.kind(geom) for geom in pair)
            row.verdicts.setdefault(kinds, verdict.Verdicts()).add(*judge.pair(pair, own, other))
    return differs


def compare_steps(
    row: Row, model: sc.Model, theirs: mujoco.MjModel, states: list, integrator: str
) -> None:
    """One step of an integrator, from states in which both find the same contacts, and find them
    again when they last place: at the step's end, or in the last stage of `rk4`."""
    kept = theirs.opt.integrator
    theirs.opt.integrator = peers.INTEGRATORS[integrator]
    sim = sc.Sim(model, **peers.EXACT, integrator=integrator)
    data, worst = mujoco.MjData(theirs), peers.Worst()
    judge = verdict.Judge(sim, theirs, data, peers.kept_geoms(sim, theirs))
    for index, state in enumerate(states):
        one = peers.Worst()
        peers.note_step(one, index, sim, theirs, data, state)
        if not note_pairs(judge):
            worst.note(f"step {integrator}", max(v for v, _ in one.seen.values()), index)
    row.errors |= {name: value for name, (value, _) in worst.seen.items()}
    theirs.opt.integrator = kept


def cells(row: Row) -> list[str]:
    """A line of the table."""
    name = row.name
    if row.refused:
        reason = row.refused if len(row.refused) < 160 else row.refused[:157] + "…"
        both = " (MuJoCo refuses it too)" if row.peer_refused else ""
        return [name, "no" + both, "", "", "", "", "", "", reason]
    if not row.states:
        return [name, "yes", str(row.nv), "", "", "", "", "", row.peer_refused or "nothing moves"]
    contacts = "" if not row.other_contacts else f"{row.other_contacts} of {row.states}"
    who = "; ".join(f"{kinds}: {found}" for kinds, found in sorted(row.verdicts.items()))
    steps = tuple(name for name in row.errors if name.startswith("step"))
    groups = (*GROUPS.values(), ("sensordata",), steps)
    columns = [f"{row.worst(names):.0e}" if names else "" for names in groups]
    placed, forces, solved, _, stepped = columns
    own = [name, "yes", str(row.nv), f"{placed}, {forces}", solved, stepped, contacts, who]
    return [*own, row.times.cell() if row.times else ""]


HEAD = (
    *("model", "loads", "dofs", "placed, forces", "solved", "one step"),
    *("other contacts", "pairs that differ: who is right"),
    "µs a step: ours, MuJoCo's (equal; shipped)",
)


def table(rows: list[Row]) -> str:
    """The rows in Markdown, a table a collection."""
    parts = []
    for collection in dict.fromkeys(row.collection for row in rows):
        own = [row for row in rows if row.collection == collection]
        loaded = sum(row.loaded for row in own)
        parts.append(f"### {collection}: {loaded} of {len(own)} load\n")
        parts.append("| " + " | ".join(HEAD) + " |")
        parts.append("|" + "---|" * len(HEAD))
        parts += ["| " + " | ".join(c.replace("|", "\\|") for c in cells(r)) + " |" for r in own]
        parts.append("")
    return "\n".join(parts)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--folder", type=Path, help="a folder of MJCF files, beside the wheels")
    parser.add_argument("--only", default="", help="only models with this text in their name")
    parser.add_argument("--states", type=int, default=100)
    parser.add_argument("--no-times", action="store_true")
    parser.add_argument("--write", action="store_true", help="put the table into docs/robots.md")
    chosen = parser.parse_args()
    robots = robot_files.wheels()
    if chosen.folder:
        robots += robot_files.folder_of(chosen.folder.name, chosen.folder)
    rows = []
    for robot in robots:
        if chosen.only not in f"{robot.collection}/{robot.name}":
            continue
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")
            row = examine(robot, chosen.states)
            if row.states and not chosen.no_times:
                row.times = times(robot.path)
        print(" | ".join((row.collection, *cells(row))), flush=True)
        rows.append(row)
    text = table(rows)
    ratios = [r.times.equal for r in rows if r.times and r.times.equal]
    if ratios:
        print(f"equal settings: median {np.median(ratios):.2f}, least {min(ratios):.2f}")
    if chosen.write:
        write(text, rows)


def write(text: str, rows: list[Row]) -> None:
    """The table into the docs page, and all figures into results."""
    page = DOCS.read_text()
    before, rest = page.split(MARKS[0])
    after = rest.split(MARKS[1])[1]
    machine = record.machine()
    DOCS.write_text(f"{before}{MARKS[0]}\n{text}{MARKS[1]}{after}")
    data = {"machine": machine, "versions": record.versions(), "rows": [asdict(r) for r in rows]}
    (record.RESULTS / "robots.json").write_text(json.dumps(data, indent=1, default=float) + "\n")


if __name__ == "__main__":
    main()
