"""What the instructions of a step are spent on, by stage, stepcore beside MuJoCo.

    RUSTFLAGS="-C target-feature=+avx2" cargo build --release -p stepcore-python
    cp target/release/lib_core.so python/stepcore/_core.abi3.so
    PYTHONPATH=python python benches/anatomy.py
    PYTHONPATH=python python benches/anatomy.py --file g1/scene_29dof.xml --only scene_29dof
    PYTHONPATH=python python benches/anatomy.py --only gymnasium/ant --functions 30

Valgrind's callgrind counts the instructions of each function while a step runs, and nothing else.
Counts repeat on a busy machine. They say what is done and not how long it takes. The motions are
those of `robot_times.py`: a robot settles for a second and holds its controls, with the solver,
tolerance and integrator of its file. Both sides take steps in blocks, MuJoCo in a C loop. The
module must have its symbols, which those of wheels do not have.
"""

from __future__ import annotations

import argparse
import pickle
import re
import subprocess
import sys
import tempfile
from pathlib import Path

import c_loop
import mujoco
import mujoco_side
import record
import robot_files
import robot_times
import stepcore_side

import stepcore as sc

ROBOTS = (
    *("gymnasium/ant", "gymnasium/humanoid"),
    *("dm_control/humanoid", "dm_control/fish", "dm_control/stacker"),
)
SIDES = ("stepcore", "MuJoCo")
# Function that a step is, as Valgrind knows it.
STEP = {"stepcore": "*Sim::__pymethod_step__*", "MuJoCo": "mj_step"}
CALLERS = 6  # so many are known of each function
# An instruction belongs to the first stage whose pattern, stepcore's or MuJoCo's, is in the name of
# its function or of one of the function's callers.
STAGES = {
    "collision: overlap search": (r"shapes::overlap", r"\bepa"),
    "collision: proof by a face": (r"Pairing>::on_face", "none"),
    "manifolds, plane and mesh": (
        r"shapes::(manifold|plane_mesh|height_field)",
        r"multicontact|mjc_PlaneConvex|mjc_ConvexHField|mjc_BoxBox",
    ),
    "collision: gjk, hints": (r"shapes::(separation|gjk|convex)", r"mjc_Convex|mjc_ccd"),
    "collision: broad, closed forms": (r"(detect|shapes)::", r"mj_collision"),
    "Newton: Hessian, factor": (
        r"newton::(hessian|columns|nodes|order)|::bend_at",
        r"(mju_chol|FactorizeHessian|MakeHessian|HessianCone|mju_sqrMat).*mj_solPrimal",
    ),
    "solve: start, islands, pattern": (
        r"warm|System<R>::start|newton::pattern|Bundles<R>::take|solve::islands",
        r"mj_island|^(?!.*mj_solP).*mj_fwdConstraint",
    ),
    "Newton: refinement": (r"newton::refine", "none"),
    "Newton: gradient, laws, line search": (r"solve::(newton|few|alone)", r"mj_solPrimal"),
    "other solvers": (r"Solvers<R>", r"mj_solPGS|mj_solNoSlip"),
    "rows made": (
        r"elements::constraint|::make_rows'",
        r"mj_(makeConstraint|projectConstraint|referenceConstraint|makeImpedance)",
    ),
    "implicit damping": (r"commit::(damped|implicit)", r"mj_(EulerSkip|implicitSkip)"),
    "kinematics, forces, factor": (
        r"stepcore::(place|elements)::",
        r"mj_(fwd(Position|Velocity|Actuation|Acceleration)|rne|passive)",
    ),
    "sensors, state": ("", ""),
}
# A line of callgrind_annotate: instructions, share, file, function'caller'caller, library.
LINE = re.compile(r"\s*([\d,]+) \([ \d.]+%\)\s+[^:\s]*:(.+?)(?: \[[^\[\]]+\])?$", re.MULTILINE)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--file", type=Path, nargs="+", default=[], help="MJCF files of robots")
    parser.add_argument("--only", default="", help="only what has this text in its name")
    parser.add_argument("--functions", type=int, default=0, help="list so many of each side")
    chosen = parser.parse_args()
    robots = [r for r in robot_files.wheels() if f"{r.collection}/{r.name}" in ROBOTS]
    robots += [robot_files.Robot("file", path.stem, path.resolve()) for path in chosen.file]
    for robot in robots:
        name = f"{robot.collection}/{robot.name}"
        if chosen.only in name:
            counts = counted(robot.path)
            print(f"\n{table(name, counts)}", flush=True)
            for side, calls in zip(SIDES, counts, strict=True):
                for function, count in largest(calls)[: chosen.functions]:
                    print(f"{count / 1e3:9.1f} {side} {function}")


def counted(path: Path) -> list[dict[str, float]]:
    """Instructions a step, of both sides, by function with its callers."""
    model = mujoco.MjModel.from_xml_path(str(path))
    settle = round(robot_times.SETTLE / model.opt.timestep)
    shape = (robot_times.STARTS, robot_times.BLOCKS, robot_times.HOLD)
    motion = mujoco_side.record(model, *shape, settle, noise=robot_times.NOISE)
    with tempfile.TemporaryDirectory() as folder:
        kept = Path(folder, "motion")
        kept.write_bytes(pickle.dumps((path, motion)))
        # Before each start our side takes one step more, for the impulses that begin the next.
        ours = instructions("stepcore", kept, motion.steps + robot_times.STARTS)
        return [ours, instructions("MuJoCo", kept, motion.steps)]


def instructions(side: str, motion: Path, steps: int) -> dict[str, float]:
    """Instructions a step of one side, by function with its callers."""
    out = motion.with_suffix(f".{side}")
    tool = ["valgrind", "-q", "--tool=callgrind", f"--callgrind-out-file={out}"]
    tool += ["--collect-atstart=no", f"--toggle-collect={STEP[side]}"]
    tool.append(f"--separate-callers={CALLERS}")
    subprocess.run([*tool, sys.executable, __file__, "run", side, str(motion)], check=True)
    annotate = ["callgrind_annotate", "--threshold=100", "--auto=no", str(out)]
    shown = subprocess.run(annotate, capture_output=True, text=True, check=True).stdout
    found: dict[str, float] = {}
    for count, calls in LINE.findall(shown):  # with line numbers, once for each file of its source
        found[calls] = found.get(calls, 0.0) + float(count.replace(",", "")) / steps
    if not found:
        raise ValueError(f"no step of {side} was counted: does its library have symbols?")
    return found


def table(name: str, counts: list[dict[str, float]]) -> str:
    """Thousand instructions a step by stage, in Markdown."""
    ours, theirs = (by_stage(calls, side) for side, calls in enumerate(counts))
    rows = [(stage, ours[stage], theirs[stage]) for stage in STAGES]
    rows.append(("all", sum(ours.values()), sum(theirs.values())))
    cells = [(stage, f"{a / 1e3:.1f}", f"{b / 1e3:.1f}") for stage, a, b in rows]
    return record.markdown((f"{name}: thousand instructions a step", *SIDES), cells)


def by_stage(calls: dict[str, float], side: int) -> dict[str, float]:
    found = dict.fromkeys(STAGES, 0.0)
    for names, count in calls.items():
        found[next(stage for stage, own in STAGES.items() if re.search(own[side], names))] += count
    return found


def largest(calls: dict[str, float]) -> list[tuple[str, float]]:
    """Functions by what they spend themselves, whoever calls them."""
    found: dict[str, float] = {}
    for names, count in calls.items():
        function = names.split("'")[0]
        found[function] = found.get(function, 0.0) + count
    return sorted(found.items(), key=lambda own: -own[1])


def run(side: str, motion: Path) -> None:
    """Plays a motion once, in a process that is counted."""
    path, motion = pickle.loads(motion.read_bytes())
    if side == "stepcore":
        stepcore_side.player(sc.Sim(sc.load(path).compile()), motion)()
        return
    c_loop.timers(False)
    model = mujoco.MjModel.from_xml_path(str(path))
    c_loop.player(model, mujoco.MjData(model), motion.states, motion.ctrl, motion.hold)()


if __name__ == "__main__":
    run(sys.argv[2], Path(sys.argv[3])) if sys.argv[1:2] == ["run"] else main()
