"""What a step and an operation take: the two numbers by which settings are ranked.

    python benches/cost_of_work.py             # stepcore; a minute
    python benches/cost_of_work.py --mujoco    # how well MuJoCo's estimated work fits its times

Each scene runs random controls under every method that a trade tries. Processor time per step is
fitted by STEP + OPERATION × operations, at equal relative weight; the last columns tell how far the
fit is off. `stepcore.experiment.price` holds the two numbers; only their ratio decides a choice.
"""

from __future__ import annotations

import argparse

import numpy as np

from stepcore import lesson
from stepcore.experiment import Change, Motion, Study
from stepcore.experiment.price import OPERATION, STEP_TIME

SCENES = (
    *("gymnasium:half_cheetah", "gymnasium:hopper", "gymnasium:walker2d", "gymnasium:ant"),
    *("gymnasium:humanoid", "gymnasium:reacher", "gymnasium:inverted_double_pendulum"),
    *("dm_control:cartpole", "dm_control:walker", "dm_control:manipulator", "dm_control:fish"),
)
LESSON = (lesson.spring, lesson.stack, lesson.drop)


def measured(study: Study) -> list[tuple[Change, float, float]]:
    """Return each method with its operations and its time [µs] per step, where it runs."""
    engine = study.engine
    families = [Change(), *engine.families(study.schedule)]
    times = study.times(families)
    steps = {f: float(engine.settings(f).dt) for f in times}
    return [
        (f, study.engine.work(f, study.schedule) * steps[f], times[f] * steps[f]) for f in times
    ]


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--mujoco", action="store_true")
    engine = "mujoco" if parser.parse_args().mujoco else "stepcore"
    sources = [*SCENES] if engine == "mujoco" else [*SCENES, *(make() for make in LESSON)]
    rows = []
    for source in sources:
        # A control function in Python would be timed too.
        kind = "sines" if isinstance(source, str) else "fall"
        study = Study(source, Motion(kind=kind, starts=1), engine=engine)
        rows += [(study.engine.title, *row) for row in measured(study)]
    work, took = (np.array([row[k] for row in rows]) for k in (2, 3))
    terms = np.stack([np.ones(len(work)), work], axis=1) / took[:, None]
    step, operation = np.linalg.lstsq(terms, np.ones(len(work)), rcond=None)[0]
    off = np.log((STEP_TIME + OPERATION * work) / took)
    off -= np.median(off)
    order = np.argsort(-np.abs(off))
    print(f"{'scene':28} {'method':34} {'operations':>10} {'µs a step':>10} {'said/took':>10}")
    for k in order[:20]:
        name, change, operations, time = rows[k]
        print(f"{name:28} {change.words:34} {operations:10.0f} {time:10.2f} {np.exp(off[k]):10.2f}")
    print(f"of {len(rows)} methods; said/took is relative to their median")
    print(f"fitted: {step:.3g} µs a step, {operation:.3g} µs; in use {STEP_TIME}, {OPERATION}")
    print(f"standard deviation of said/took: {100 * np.std(off):.0f} %")


if __name__ == "__main__":
    main()
