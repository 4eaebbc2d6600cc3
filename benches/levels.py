"""What wider vector instructions gain: batches of each level against `mujoco.rollout`, in turn.

One thread, worlds spread along a driven motion, both sides keep every state. One process loads one
module, so each level has its own; they take turns with MuJoCo in this one. Processor time. The bits
of the levels are compared. The baseline of a wheel has no lanes.
"""

from __future__ import annotations

import multiprocessing
import os
import time

import mujoco
import mujoco_side
import numpy as np
import record
import rollouts
import scenes
import vs_mujoco
from mujoco import rollout

import stepcore as sc
from stepcore import vectors

MODELS = ("half_cheetah", "hopper", "walker2d", "ant", "chain20")
CASES = [case for case in vs_mujoco.CASES if case.name in MODELS]
CASES.append(vs_mujoco.Case("humanoid", scenes.gym_path("humanoid"), True, settle=300))
PRECISIONS = ("f64", "f32")
LANES = (True, False)
WORLDS, STEPS = 512, 10


class Level:
    """A process with one level's module."""

    def __init__(self, environment: dict[str, str]) -> None:
        before = dict(os.environ)
        os.environ.update(environment)
        context = multiprocessing.get_context("spawn")
        self._pipe, other = context.Pipe()
        self.process = context.Process(target=serve, args=(other,), daemon=True)
        self.process.start()
        os.environ.clear()
        os.environ.update(before)

    def ask(self, what):
        self._pipe.send(what)
        answer = self._pipe.recv()
        if isinstance(answer, BaseException):
            raise answer
        return answer


def serve(pipe) -> None:
    """Makes batches from (text, settings, states, controls), and runs that of a number."""
    batches = []
    while True:
        try:
            what = pipe.recv()
        except EOFError:  # The bench is over.
            return
        try:
            if isinstance(what, int):
                pipe.send(run(*batches[what]))
            else:
                case, settings, qpos, qvel, ctrl = what
                batch = sc.Batch(case.stepcore(), len(qpos), threads=1, **settings)
                batches.append((batch, qpos, qvel, ctrl))
                pipe.send(len(batches) - 1)
        except Exception as error:
            pipe.send(error)


def run(batch, qpos, qvel, ctrl):
    """Processor time of a rollout [s], and where it ends."""
    batch.reset()
    batch.qpos[:], batch.qvel[:] = qpos, qvel
    start = time.thread_time()
    states = batch.rollout(ctrl)
    return time.thread_time() - start, states.qpos[:, -1].copy()


def main() -> None:
    options = record.arguments(__doc__.splitlines()[0])
    report = record.Report("levels", options, "against mujoco.rollout, one thread")
    names = list(vectors.levels())[::-1]
    levels = {name: Level({vectors.VARIABLE: name}) for name in names}
    report.say()
    report.say("times MuJoCo's speed (quartiles), lanes and singly")
    heads = [f"{name} {'lanes' if lanes else 'singly'}" for name in names for lanes in LANES]
    report.say(f"{'model':14}{'':5}" + "".join(f"{head:>22}" for head in heads))
    for case in CASES:
        if options.only in case.name:
            compare(case, levels, options, report)
    report.close()


def compare(case, levels: dict[str, Level], options, report: record.Report) -> None:
    """A line for each precision."""
    model = case.mujoco()
    integrator = mujoco_side.shipped_integrator(model)
    mujoco_side.configure(model, integrator, "newton")
    worlds, steps = (32, 5) if options.quick else (WORLDS, STEPS)
    motion = mujoco_side.record(model, worlds, 1, 5, case.settle)
    ctrl = np.repeat(motion.ctrl, steps, axis=1)
    states = np.array([rollouts.physics(model, state) for state in motion.states])
    kept = np.empty((worlds, steps, states.shape[1]))
    data, pool = [mujoco.MjData(model)], rollout.Rollout(nthread=0)

    def theirs() -> float:
        start = time.thread_time()
        pool.rollout(model, data, states, ctrl, state=kept)
        return time.thread_time() - start

    for precision in PRECISIONS:
        made = {}
        for name, level in levels.items():
            for lanes in LANES:
                settings = {"solver": "newton", "integrator": integrator}
                settings |= {"lanes": lanes, "precision": precision}
                given = (case, settings, motion.starts["qpos"], motion.starts["qvel"], ctrl)
                made[name, lanes] = (level, level.ask(given))
        times, ends = {key: [] for key in made}, {}
        try:
            for pair in range(-1, options.pairs):
                mujoco_time = theirs()
                for key, (level, batch) in made.items():
                    spent, ends[key] = level.ask(batch)
                    if pair >= 0:
                        times[key].append(mujoco_time / spent)
        except sc.SimulationError as error:
            report.say(f"{case.name:14}{precision:5}no ratio: {str(error).partition(':')[0]}")
            report.add(case=case.name, precision=precision, refused=str(error))
            continue
        first = next(iter(ends.values()))
        if any(end.tobytes() != first.tobytes() for end in ends.values()):
            raise AssertionError("the level shows in the bits")
        line, entry = f"{case.name:14}{precision:5}", {"case": case.name, "precision": precision}
        for (name, lanes), ratios in times.items():
            low, middle, high = np.quantile(ratios, (0.25, 0.5, 0.75))
            line += f"{middle:9.2f} ({low:.2f}–{high:.2f})".rjust(22)
            way = "lanes" if lanes else "singly"
            entry[f"{name} {way}"] = {"ratio": middle, "ratio_quartiles": (low, high)}
        report.say(line)
        report.add(**entry, worlds=worlds, steps=steps, integrator=integrator, solver="newton")


if __name__ == "__main__":
    main()
