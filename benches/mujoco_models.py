"""MuJoCo's own test models: which load, and how far they are from MuJoCo; docs/mujoco_models.md.

    git clone https://github.com/google-deepmind/mujoco
    python benches/mujoco_models.py [--folder mujoco] [--only TEXT] [--seconds 60] [--write]

Every MJCF and URDF file below model/, test/, mjx/ and python/. Each is examined in a process of
its own with limits of time and memory. Compared are the arrays of the model, and all that a forward
pass computes (`peers.note_forward`, MuJoCo at its most accurate) at qpos0, at each keyframe and at
six states of random falls. Where pairs of geoms have other contacts, an oracle says who is right
(`verdict.py`), and what follows from them is not compared.

The causes of refusals and differences are those of `mujoco_causes.py`: by what a file says, not by
its name, where that is possible. A file with none is printed last.
"""

from __future__ import annotations

import argparse
import json
import os
import re
import resource
import select
import signal
import tempfile
import time
import warnings
from collections import Counter
from dataclasses import asdict, dataclass, field
from pathlib import Path

import mujoco
import mujoco_causes
import numpy as np
import peers
import record
import robot_files
import robots

import stepcore as sc

DOCS = Path(__file__).parent.parent / "docs" / "mujoco_models.md"
RESULTS = record.RESULTS / "mujoco_models.json"
MARKS = ("<!-- models -->", "<!-- end of models -->")
FOLDERS = ("model", "test", "mjx", "python")
FALLS = 6
# Beyond these many dofs only qpos0 and keyframes are compared.
MANY_DOFS = 200
MEMORY = 6 << 30
# Larger differences have a cause each.
EQUAL = 1e-6
# Arrays that mean the same in both models.
ARRAYS = (
    *("qpos0", "body_mass", "body_ipos", "body_invweight0", "dof_invweight0", "jnt_pos"),
    *("jnt_axis", "tendon_length0", "tendon_lengthspring", "tendon_invweight0", "actuator_gear"),
)
# Magnitudes [m] below which a place is not told from 0: mass centres of meshes are roundings.
FLOORS = {"body_ipos": 1e-2, "jnt_pos": 1e-2}
# Ranges, infinite here where MuJoCo says in another array that there is none.
RANGES = {
    "jnt_range": "jnt_limited",
    "tendon_range": "tendon_limited",
    "actuator_ctrlrange": "actuator_ctrllimited",
    "actuator_forcerange": "actuator_forcelimited",
}


@dataclass
class KeyState(peers.State):
    """With the poses of mocap bodies, which a keyframe has too."""

    mocap_pos: np.ndarray = field(default_factory=lambda: np.zeros((0, 3)))
    mocap_quat: np.ndarray = field(default_factory=lambda: np.zeros((0, 4)))


@dataclass
class Row(robots.Row):
    """What was found of one file."""

    # Of the model's arrays, those that differ by more than rounding.
    model: dict[str, float] = field(default_factory=dict)
    # What ended the examination: a limit of time, an exception, a signal.
    ended: str = ""
    cause: str = ""

    @property
    def kind(self) -> str:
        """The row's class in the table of counts."""
        if self.peer_refused:
            return "refused by both" if self.refused else "refused by MuJoCo alone"
        if self.refused:
            return "refused by stepcore alone"
        if self.ended and not self.states:
            return "not compared"
        return "equal" if self.worst_of_all() <= EQUAL and not self.other_contacts else "differs"

    def worst_of_all(self) -> float:
        known = (*self.errors.values(), *self.model.values())
        return max((float(value) for value in known), default=0.0)


def files(folder: Path) -> list[robot_files.Robot]:
    found = [path for part in FOLDERS for path in (folder / part).rglob("*.xml")]
    found += [path for part in FOLDERS for path in (folder / part).rglob("*.urdf")]
    # Test data only: the rest are settings of editors and of builds.
    kept = [p for p in found if p.is_relative_to(folder / "model") or "test" in str(p)]
    return [robot_files.Robot("mujoco", str(p.relative_to(folder)), p) for p in sorted(kept)]


def key_states(model: mujoco.MjModel) -> list[peers.State]:
    """qpos0 and the keyframes."""
    data = mujoco.MjData(model)
    states = []
    for key in range(-1, min(model.nkey, 20)):
        mujoco.mj_resetData(model, data)
        if key >= 0:
            mujoco.mj_resetDataKeyframe(model, data, key)
        names = KeyState.__dataclass_fields__
        states.append(KeyState(**{name: getattr(data, name).copy() for name in names}))
    return states


def model_apart(model: sc.Model, theirs: mujoco.MjModel) -> dict[str, float]:
    """How far the arrays are apart, where it is more than 1e-12 of the largest entry."""
    found = {}
    # An actuator of several controls is several here.
    several = bool((theirs.actuator_ctrlnum != 1).any())
    for name in (*ARRAYS, *RANGES):
        ours, other = np.asarray(getattr(model, name)), getattr(theirs, name)
        if several and name.startswith("actuator"):
            continue
        if name in RANGES and len(ours) == len(other):
            limited = getattr(theirs, RANGES[name]).astype(bool)
            if (limited != np.isfinite(ours).any(axis=1)).any():
                found[name] = np.inf
                continue
            ours, other = ours[limited], other[limited]
        if ours.shape != other.shape:
            found[name] = np.inf
        elif (value := peers.apart(ours, other, FLOORS.get(name, 1e-6))) > 1e-12:
            found[name] = value
    turn = np.zeros((theirs.nbody, 9))
    for k in range(theirs.nbody):
        mujoco.mju_quat2Mat(turn[k], theirs.body_iquat[k])
    turn = turn.reshape(-1, 3, 3)
    inertia = np.einsum("kij,kj,klj->kil", turn, theirs.body_inertia, turn)
    if (value := peers.apart(model.body_inertia, inertia)) > 1e-12:
        found["body_inertia"] = value
    return found


def examine(robot: robot_files.Robot):
    """Yields the row as it grows."""
    row = Row(robot.collection, robot.name)
    try:
        theirs = peers.strict(mujoco.MjModel.from_xml_path(str(robot.path)))
    except (ValueError, mujoco.FatalError) as error:
        row.peer_refused = str(error).splitlines()[0]
        theirs = None
    try:
        model = sc.load(robot.path).compile()
    except (ValueError, OSError) as error:
        said = str(error).replace(str(robot.path.parent) + "/", "").replace("\n", "; ")
        row.refused = said if isinstance(error, ValueError) else f"{type(error).__name__}: {said}"
        model = None
    yield row
    if theirs is None or model is None:
        return
    row.nv, row.nu = model.nv, model.nu
    row.ended = "other sizes"
    if (model.nv, model.nbody, model.nu) != (theirs.nv, theirs.nbody, theirs.nu):
        yield row
        return
    row.model = model_apart(model, theirs)
    row.ended = ""
    yield row
    if not row.nv:
        return
    states = key_states(theirs)
    robots.compare_forward(row, model, theirs, states)
    row.states = len(states)
    yield row
    if row.nv > MANY_DOFS:
        return
    more = Row(robot.collection, robot.name)
    states = peers.fall_states(theirs, FALLS, seed=7)
    robots.compare_forward(more, model, theirs, states)
    row.states += len(states)
    row.other_contacts += more.other_contacts
    for name, value in more.errors.items():
        row.errors[name] = max(row.errors.get(name, 0.0), value)
    for kinds, found in more.verdicts.items():
        for who, count in found.counts.items():
            own = row.verdicts.setdefault(kinds, robots.verdict.Verdicts())
            own.counts[who] = own.counts.get(who, 0) + count
    yield row


def alone(robot: robot_files.Robot, seconds: float) -> dict:
    """`examine` in a process of its own: the last row that it gave, as a dict."""
    reader, writer = os.pipe()
    child = os.fork()
    if child == 0:
        os.close(reader)
        _examine_to(writer, robot)
    os.close(writer)
    said, deadline, ended = b"", time.monotonic() + seconds, ""
    while True:
        ready, _, _ = select.select([reader], [], [], max(0.0, deadline - time.monotonic()))
        if not ready:
            os.kill(child, signal.SIGKILL)
            ended = f"no end within {seconds:g} s"
            break
        part = os.read(reader, 1 << 20)
        if not part:
            break
        said += part
    os.close(reader)
    _, status = os.waitpid(child, 0)
    if os.WIFSIGNALED(status) and not ended:
        ended = f"killed by {signal.Signals(os.WTERMSIG(status)).name}"
    lines = said.decode().split("\n")[:-1]
    row = json.loads(lines[-1]) if lines else asdict(Row(robot.collection, robot.name))
    row["ended"] = row["ended"] or ended
    return row


def _examine_to(writer: int, robot: robot_files.Robot) -> None:
    resource.setrlimit(resource.RLIMIT_AS, (MEMORY, MEMORY))
    os.chdir(tempfile.mkdtemp())
    last: dict = {}

    def tell() -> None:
        os.write(writer, json.dumps(last, default=float).encode() + b"\n")

    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")
            for row in examine(robot):
                last = asdict(row)
                tell()
    except BaseException as error:
        last = (last or asdict(Row(robot.collection, robot.name))) | {
            "ended": f"{type(error).__name__}: {str(error)[:300]}"
        }
        tell()
    os._exit(0)


def row_of(found: dict) -> Row:
    verdicts = {k: robots.verdict.Verdicts(**v) for k, v in found["verdicts"].items()}
    return Row(**(found | {"verdicts": verdicts}))


def kept(found: dict) -> Row:
    """A row of the kept results."""
    known = {name: value for name, value in found.items() if name != "kind"}
    return row_of(asdict(Row("", "")) | known)


def cell(row: Row) -> list[str]:
    """A line of the table."""
    kind = row.kind
    if kind.startswith("refused"):
        text = row.refused if row.refused and not row.peer_refused else row.peer_refused
        return [row.name, kind, "", "", "", row.cause or _short(text)]
    model = max((float(v) for v in row.model.values()), default=0.0)
    solved = f"{model:.0e}", f"{max(map(float, row.errors.values()), default=0.0):.0e}"
    contacts = f"{row.other_contacts} of {row.states}" if row.other_contacts else ""
    who = "; ".join(f"{kinds}: {found}" for kinds, found in sorted(row.verdicts.items()))
    cause = "; ".join(text for text in (row.cause, who, _short(row.ended)) if text)
    return [row.name, kind, *solved, contacts, cause]


def _short(text: str, most: int = 160) -> str:
    text = re.sub(r"\s+", " ", text)
    return text if len(text) <= most else text[: most - 1] + "…"


def table(rows: list[Row]) -> str:
    """Counts by class and cause, and the rows that are not simply equal, in Markdown."""
    kinds = Counter(row.kind for row in rows)
    theirs = [row for row in rows if not row.peer_refused]
    ours = sum(row.loaded for row in theirs)
    said = f"Of {len(rows)} files MuJoCo loads {len(theirs)}, and of these stepcore loads {ours}."
    lines = [said, "", "| | files |", "|---|---|"]
    lines += [f"| {kind} | {count} |" for kind, count in kinds.most_common()]
    causes = Counter((row.kind, row.cause) for row in rows if row.cause)
    lines += ["", "| class | cause | files |", "|---|---|---|"]
    lines += [f"| {kind} | {cause} | {n} |" for (kind, cause), n in sorted(causes.items())]
    head = ("file", "class", "model", "forward", "other contacts", "cause, who is right")
    lines += ["", "| " + " | ".join(head) + " |", "|" + "---|" * len(head)]
    shown = [row for row in rows if row.kind not in ("equal", "refused by both")]
    lines += ["| " + " | ".join(c.replace("|", "\\|") for c in cell(row)) + " |" for row in shown]
    return "\n".join(lines) + "\n"


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--folder", type=Path, default=Path("mujoco"), help="a clone of MuJoCo")
    parser.add_argument("--only", default="", help="only files with this text in their path")
    parser.add_argument("--seconds", type=float, default=60.0, help="of one file at most")
    parser.add_argument("--write", action="store_true", help="put the table into the docs")
    chosen = parser.parse_args()
    rows = []
    for robot in files(chosen.folder.resolve()):
        if chosen.only not in robot.name:
            continue
        row = row_of(alone(robot, chosen.seconds))
        row.cause = mujoco_causes.cause(row, robot.path)
        print(" | ".join(cell(row)), flush=True)
        rows.append(row)
    missing = [row for row in rows if not row.cause and row.kind != "equal"]
    print(f"{len(missing)} of {len(rows)} without a cause:")
    for row in missing:
        print(" | ".join(cell(row)))
    if chosen.write:
        write(rows)


def write(rows: list[Row]) -> None:
    """The table into the docs page, and all figures into results."""
    before, rest = DOCS.read_text().split(MARKS[0])
    after = rest.split(MARKS[1])[1]
    DOCS.write_text(f"{before}{MARKS[0]}\n{table(rows)}{MARKS[1]}{after}")
    data = {"machine": record.machine(), "versions": record.versions()}
    plain = asdict(Row("", ""))
    data["rows"] = [
        {name: value for name, value in asdict(row).items() if value != plain[name]}
        | {"kind": row.kind, "cause": row.cause}
        for row in rows
    ]
    RESULTS.write_text(json.dumps(data, indent=1, default=float) + "\n")


if __name__ == "__main__":
    main()
