"""`check`: the first thing to run on a scene that misbehaves: what is wrong with it, in seconds."""

from __future__ import annotations

import dataclasses
import os
from collections.abc import Iterator
from concurrent.futures import Executor
from typing import Unpack

import numpy as np

from stepcore.checks import one_line
from stepcore.engine.model import Model
from stepcore.experiment.arguments import Setup, Source, set_up
from stepcore.experiment.coordinates import Start
from stepcore.experiment.motion import Motion, MotionFields, takes_motion
from stepcore.experiment.motion_words import held_motion_in_words, motion_in_words
from stepcore.experiment.runner import Runner
from stepcore.experiment.schedule import HORIZON, Schedule, home, scheduled
from stepcore.experiment.sizes import Sizes
from stepcore.experiment.watch import Watch
from stepcore.measure.check.commands import next_commands
from stepcore.measure.check.limits import about_limits
from stepcore.measure.check.masses import about_masses
from stepcore.measure.check.ranges import about_ranges
from stepcore.measure.check.result import Check
from stepcore.measure.check.servos import about_servos
from stepcore.measure.check.tendons import about_tendons
from stepcore.measure.check.units import about_units
from stepcore.measure.diagnosis import Diagnosis, diagnose
from stepcore.measure.findings import Finding, findings_of, ordered
from stepcore.mjcf.worldbody import EMPTY
from stepcore.report import units
from stepcore.report.progress import Choice

__all__ = ["Check", "check"]

# Control periods of the run where nothing sets them.
PERIODS = 100
# The most steps of the run where nobody says how long it is: some seconds of computing.
MOST = 200_000
# Of the text of a failure.
SENTENCES = 2
# What a length in "0.1%" is a share of has no meaning here.
NO_SIZE = 1.0


@takes_motion(without=("starts",))
def check(
    model: Source,
    motion: Motion | None = None,
    *,
    depth: float | str | None = None,
    threads: int | None = None,
    executor: Executor | None = None,
    progress: Choice = None,
    **fields: Unpack[MotionFields],
) -> Check:
    """Looks for what makes a scene misbehave: the first thing to run, in seconds.

    It reads the scene (masses and inertias that no real thing has, units that look like mm or
    degrees, starts and keyframes outside of limits, servos that are too weak, too stiff or
    saturated, limits that an actuator overpowers), watches one run as shipped (overlaps, creep,
    gaps, depths, saturation), and diagnoses the time step. Each finding is a sentence with its
    cure, the most severe first; then come the diagnosis' answer and the commands to run next.

    model: a Model, a Scene, or the path of an MJCF file (or "package:name").
    motion: the `Motion` that is run; or write its fields as arguments, except `starts`, because
        there is one start. Without controls those of the keyframe are held (zero without one).
        The horizon is 1 s by default, or 200,000 steps if that is shorter.
    depth: at which contacts are wanted to rest, a length such as 1e-4 or "0.1mm"; the result then
        names the solref that gives it, wherever contacts rest deeper.
    threads: the number of integrators diagnosed at the same time (default: one per core).
    executor: any concurrent.futures executor, used in place of threads.
    progress: False for no bar, or a function of (label, done, total).

    Raises ValueError for an argument outside its limits, for a scene that cannot be compiled, and
    for one in which nothing can move.

    >>> from stepcore import loads
    >>> scene = loads('''<mujoco><worldbody><body><joint name="knee" range="-90 90"/>
    ... <geom size=".1"/></body></worldbody><keyframe><key name="home" qpos="2"/></keyframe>
    ... </mujoco>''')
    >>> result = check(scene, progress=False)
    >>> [finding.kind for finding in result.findings]
    ['outside a limit']
    """
    setup = set_up(
        check,
        model,
        motion,
        fields,
        missing="nothing to check",
        threads=threads,
        executor=executor,
        progress=progress,
    )
    wanted = None if depth is None else units.length("check", "depth", depth, NO_SIZE)
    compiled, motion = setup.model, setup.motion
    dt = compiled.settings.dt
    horizon = motion.horizon or max(dt, min(HORIZON, MOST * dt))
    schedule = _schedule(compiled, motion, horizon)
    failure, seen = _watched(compiled, schedule, wanted)
    if motion.ctrl is None and motion.control is None and not compiled.keys:
        # A control of 0 is nobody's wish.
        seen = [one for one in seen if one.kind != "clamped control"]
    start, held = home(compiled, motion.key)
    read = list(_read(compiled, start, held, _key(compiled, motion.key)))
    findings = ordered([*failure, *_merged(read, seen)])
    diagnosis, notes = _diagnosis(setup, dataclasses.replace(motion, horizon=horizon))
    return Check(
        name=setup.name,
        settings=compiled.settings,
        motion=dataclasses.replace(motion, horizon=schedule.horizon, starts=1),
        findings=findings,
        diagnosis=diagnosis,
        ran=_ran(compiled, motion, schedule, held),
        commands=next_commands(_file(model, compiled), compiled, findings, diagnosis),
        notes=[*notes, *(n for n in compiled.scene.notes if not n.endswith(EMPTY))],
    )


def _schedule(model: Model, motion: Motion, horizon: float) -> Schedule:
    """The motion, with the keyframe's controls held where the user gives none."""
    dt = model.settings.dt
    if motion.ctrl is None and motion.control is None and model.nu:
        held = home(model, motion.key)[1]
        motion = dataclasses.replace(motion, ctrl=held[None, :])
    steps = round(min(horizon / PERIODS / dt, MOST))
    period = motion.period(dt) or dt * max(1, steps)
    return scheduled(motion, model, min(period, max(horizon, dt)), starts=1, horizon=horizon)


def _ran(model: Model, motion: Motion, schedule: Schedule, held: np.ndarray) -> str:
    """What motion was run, in words."""
    if motion.ctrl is not None or motion.control is not None:
        return motion_in_words(model, motion, schedule)
    return held_motion_in_words(model, motion.key, schedule.horizon, held)


def _watched(
    model: Model, schedule: Schedule, depth: float | None
) -> tuple[list[Finding], list[Finding]]:
    """Why the run fails, if it does, and what it showed until its end."""
    runner = Runner(model, schedule)
    watch = Watch(model, runner.bodies, schedule.periods)
    path = runner.run(model.settings.replace(ledger=True), 0, [watch])
    failed = []
    if path.failure:
        # When it failed and what began it; the diagnosis says how it is cured.
        said = ". ".join(path.failure.split(". ")[:SENTENCES])
        failed.append(Finding("failure", "error", "", f"The run fails: {said}."))
    return failed, findings_of(model, watch, depth, failed=bool(failed))


def _read(model: Model, start: Start, held: np.ndarray, key: int | None) -> Iterator[Finding]:
    """What the scene alone shows."""
    sizes = Sizes(model)
    yield from about_units(model, sizes)
    yield from about_ranges(model, start, key)
    yield from about_tendons(model, start, key)
    yield from about_servos(model, start, held)
    yield from about_limits(model)
    yield from about_masses(model, sizes)


def _merged(read: list[Finding], seen: list[Finding]) -> Iterator[Finding]:
    """What was read and what was seen, the same thing once: as read, but a limit as seen."""
    if any(one.kind == "units" for one in read):
        # A control range in degrees overpowers every limit.
        read = [one for one in read if one.kind != "limit"]
    known = {(one.kind, one.element) for one in read if one.kind != "limit"}
    seen = [one for one in seen if (one.kind, one.element) not in known]
    limits = " ".join(one.text for one in seen if one.kind == "limit")
    yield from (
        one
        for one in read
        if one.kind != "limit" or one.element.removeprefix("limit of ") not in limits
    )
    yield from seen


def _key(model: Model, key: str | int | None) -> int | None:
    """The keyframe that is the start."""
    if key is None:
        return 0 if model.keys else None
    return model.index("key", key)


def _diagnosis(setup: Setup, motion: Motion) -> tuple[Diagnosis | None, list[str]]:
    """The diagnosis of the time step, or why there is none."""
    workers = setup.workers
    try:
        found = diagnose(
            setup.model,
            dataclasses.replace(motion, starts=None),
            threads=workers.threads,
            executor=workers.executor,
            progress=workers.progress,
        )
    except Exception as error:
        # A scene that misbehaves may do so in its diagnosis; what was found is still to be said.
        return None, [
            f"the time step was not diagnosed ({type(error).__name__}: {one_line(error)})"
        ]
    return found, []


def _file(source: Source, model: Model) -> str:
    """What the next commands call the scene."""
    if isinstance(source, (str, os.PathLike)):
        return os.fspath(source)
    # A scene without some of its file is that of its file, with the kinds that are left out.
    read = model.scene._source if model.scene.without else None
    return read.files[0] if read else "FILE"
