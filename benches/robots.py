"""Public robots: which load, how far they are from MuJoCo, how fast; the tables of docs/robots.md.

    python benches/robots.py [--folder DIR …] [--only TEXT] [--states 100] [--no-times] [--write]

Every model of gymnasium's and dm-control's wheels, and every MJCF file below each folder. At each
of 100 states (random falls: contacts, limits and pushes are active; half of them with forces
applied) both engines place, detect and solve from scratch, MuJoCo at its most accurate, and
everything that they compute is compared, relative to the largest entry. Where the two find other
contacts, or as many at other places, what follows from them is not compared: the state counts as
one whose contacts differ, and an independent oracle says of each such pair of geoms who is right
(`verdict.py`). Nor is it where a contact is at its margin to rounding. Then one step of each
integrator that both have, unless that happened.

Times: `robot_times.py`, the slowest first. `--states 0` measures these alone, and with `--write`
they go into docs/robots.md, the slowest also into README.md, and everything into results.
"""

from __future__ import annotations

import argparse
import json
import warnings
from dataclasses import asdict, dataclass, field
from pathlib import Path

import c_loop
import mujoco
import peers
import record
import robot_files
import robot_times
import verdict

import stepcore as sc

ROOT = Path(__file__).parent.parent
DOCS = ROOT / "docs" / "robots.md"
SAMPLE = 0.02  # of times [s]
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
        differs = judge.differ(None if grazes else row.verdicts)
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
        if not judge.differ():
            worst.note(f"step {integrator}", max(v for v, _ in one.seen.values()), index)
    row.errors |= {name: value for name, (value, _) in worst.seen.items()}
    theirs.opt.integrator = kept


def cells(row: Row) -> list[str]:
    """A line of the table."""
    name = row.name
    if row.refused:
        reason = row.refused if len(row.refused) < 160 else row.refused[:157] + "…"
        both = " (MuJoCo refuses it too)" if row.peer_refused else ""
        return [name, "no" + both, "", "", "", "", "", reason]
    if not row.states:
        return [name, "yes", str(row.nv), "", "", "", "", row.peer_refused or "nothing moves"]
    contacts = "" if not row.other_contacts else f"{row.other_contacts} of {row.states}"
    who = "; ".join(f"{kinds}: {found}" for kinds, found in sorted(row.verdicts.items()))
    steps = tuple(name for name in row.errors if name.startswith("step"))
    groups = (*GROUPS.values(), ("sensordata",), steps)
    columns = [f"{row.worst(names):.0e}" if names else "" for names in groups]
    placed, forces, solved, _, stepped = columns
    return [name, "yes", str(row.nv), f"{placed}, {forces}", solved, stepped, contacts, who]


HEAD = (
    *("model", "loads", "dofs", "placed, forces", "solved", "one step"),
    *("other contacts", "pairs that differ: who is right"),
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
    parser.add_argument(
        "--folder",
        type=Path,
        nargs="+",
        default=[],
        help="folders of MJCF files, beside the wheels",
    )
    parser.add_argument("--only", default="", help="only models with this text in their name")
    parser.add_argument("--states", type=int, default=100, help="0: only times")
    parser.add_argument("--no-times", action="store_true")
    parser.add_argument("--pairs", type=int, default=9, help="timed pairs")
    parser.add_argument("--write", action="store_true", help="put the tables into the docs")
    chosen = parser.parse_args()
    robots = robot_files.wheels()
    for folder in chosen.folder:
        robots += robot_files.folder_of(folder.name, folder)
    robots = [r for r in robots if chosen.only in f"{r.collection}/{r.name}"]
    warnings.simplefilter("ignore")
    if chosen.states:
        compare(robots, chosen.states, chosen.write)
    if not chosen.no_times:
        time(robots, chosen.pairs, chosen.write)


def compare(robots: list[robot_files.Robot], states: int, write: bool) -> None:
    """Every robot at random states; into the docs and results, if asked for."""
    rows = []
    for robot in robots:
        rows.append(examine(robot, states))
        print(" | ".join((robot.collection, *cells(rows[-1]))), flush=True)
    if write:
        record.put(DOCS, "robots", table(rows))
        data = {"machine": record.machine(), "versions": record.versions()}
        data["rows"] = [asdict(row) for row in rows]
        text = json.dumps(data, indent=1, default=float)
        (record.RESULTS / "robots.json").write_text(text + "\n")


def time(robots: list[robot_files.Robot], pairs: int, write: bool) -> None:
    """The times of every robot that moves; into README, the docs and results, if asked for."""
    rows, skipped = [], {}
    c_loop.timers(False)
    for robot in robots:
        name = f"{robot.collection}/{robot.name}"
        try:
            rows.append(robot_times.measure(robot, pairs, SAMPLE))
            print(" | ".join(rows[-1].cells()), flush=True)
        except (ValueError, sc.SimulationError) as error:
            skipped[name] = str(error).splitlines()[0]
            print(f"{name}: {skipped[name]}", flush=True)
    if not rows:
        return
    options = argparse.Namespace(pairs=pairs, sample=SAMPLE, save=write)
    text = robot_times.report(rows, skipped, options)
    if write:
        record.put(DOCS, "times", text)
        record.put(record.README, "slowest robots", robot_times.slowest(rows))


if __name__ == "__main__":
    main()
