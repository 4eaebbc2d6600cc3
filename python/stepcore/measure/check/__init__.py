"""`check`: the first thing to run on a scene that misbehaves: what is wrong with it, in seconds."""

from __future__ import annotations

import dataclasses
import math
import os
import shlex
from collections.abc import Iterator, Mapping
from concurrent.futures import Executor
from dataclasses import dataclass, field
from typing import Any, ClassVar, Unpack

import numpy as np

from stepcore._core import Settings
from stepcore.checks import one_line
from stepcore.engine.model import Model
from stepcore.experiment.arguments import Setup, Source, set_up
from stepcore.experiment.coordinates import Start
from stepcore.experiment.motion import Motion, MotionFields, takes_motion
from stepcore.experiment.motion_words import held_motion_in_words, motion_in_words
from stepcore.experiment.runner import Runner
from stepcore.experiment.schedule import HORIZON, Schedule, home, scheduled
from stepcore.experiment.sizes import Sizes
from stepcore.measure.check.bodies import about_bodies
from stepcore.measure.check.ranges import about_ranges
from stepcore.measure.check.servos import about_servos
from stepcore.measure.diagnosis import Diagnosis, diagnose
from stepcore.measure.monitors import Finding, Monitor, Next, ordered
from stepcore.mjcf.worldbody import EmptyRange
from stepcore.report import units
from stepcore.report.progress import Choice
from stepcore.report.result import Result
from stepcore.report.settings import label
from stepcore.report.table import Table
from stepcore.report.units import beginning, counted

__all__ = ["Check", "check"]

# Control periods of the run where nothing sets them.
PERIODS = 100
# The most steps of a run whose horizon is not given: some seconds of computing.
LONGEST = 200_000
# What a length in "0.1%" is a share of has no meaning here.
NO_SIZE = 1.0
# The first sentences of a failure say when it was and what began it; the diagnosis cures it.
SENTENCES = 2
# So many commands are named; `diagnose` where the stability margin is below MARGIN.
COMMANDS, MARGIN = 3, 2.0
# Worth running on any scene.
ALWAYS = (
    Next("trade", "how large the error is, and what is cheaper", ("--error", "1mm")),
    Next("predict", "for how long its motion can be predicted"),
    Next("plan", "what a step computes"),
)
# The options of the motion that commands take, by its fields; `run` and `plan` take fewer.
MOTION = {name: f"--{name.replace('_', '-')}" for name in MotionFields.__annotations__}
TAKEN = {
    "run": MOTION | {"horizon": "--duration", "seed": ""},
    "plan": dict.fromkeys(MOTION, "") | {"key": "--key"},
}


@dataclass(eq=False, repr=False)
class Check(Result):
    """What is wrong with a scene, or may be; `stepcore.check` returns it.

    name: the name of the scene.
    settings: its own settings, under which it ran.
    motion: the motion that was run.
    findings: what was found, the most severe first.
    diagnosis: the `Diagnosis` of the time step; None where it failed, and a note says why.
    ran: what motion was run, in words.
    file: what commands call the scene, with the options that change how it is read.
    options: the motion as commands take it, by the field of `Motion`.
    """

    kind = "check"
    units: ClassVar = {"value": "unit"}

    name: str
    settings: Settings
    motion: Motion
    findings: list[Finding]
    diagnosis: Diagnosis | None
    ran: str = ""
    notes: list[str] = field(default_factory=list)
    file: str = "FILE"
    options: Mapping[str, str] = field(default_factory=dict)

    @property
    def commands(self) -> list[tuple[str, str]]:
        """What to run next on the same scene and motion, and why; the most useful first."""
        each = ((self._command(following), following.why) for following in self._following())
        return list(dict(each).items())[:COMMANDS]

    def _following(self) -> Iterator[Next]:
        dt = self.settings.dt
        limit = self.diagnosis.limit() if self.diagnosis else math.inf
        if limit < MARGIN * dt:
            yield Next("diagnose", "every element's largest stable dt, and all the advice")
        for finding in self.findings:
            if finding.kind == "failure":
                short = f"{min(dt / 4, limit / 2 if limit > 0 else dt):.1g}"
                yield Next("run", "whether a smaller time step survives", ("--dt", short))
            yield from finding.commands
        yield from ALWAYS

    def _command(self, following: Next) -> str:
        takes = TAKEN.get(following.command, MOTION)
        motion = [(takes[name], value) for name, value in self.options.items() if takes[name]]
        words = (*following.arguments, *(word for option in motion for word in option))
        return " ".join(["stepcore", following.command, self.file, *map(shlex.quote, words)])

    @property
    def title(self) -> str:
        """What was checked."""
        return f"{self.name}: check"

    @property
    def setup(self) -> str:
        """Under which settings, and on what motion the time step was judged."""
        said = f"Under {label(self.settings)}."
        # Controls that the user gives drive both; without them this run holds the keyframe's.
        driven = self.motion.control is not None or self.motion.ctrl is not None
        if self.diagnosis is not None and not driven and self.diagnosis.ran not in ("", self.ran):
            said += f"\nThe time step was judged on another motion: {self.diagnosis.ran}."
        return said

    @property
    def rows(self) -> list[Finding]:
        """The findings."""
        return self.findings

    @property
    def sentences(self) -> list[str]:
        """What was found with its cures, the diagnosis' answer, and the commands to run next."""
        return list(self._said())

    def _said(self) -> Iterator[str]:
        if self.findings:
            several = ", the most severe first" if len(self.findings) > 1 else ""
            yield f"{counted(len(self.findings), 'finding')}{several}:"
            yield from (f"- {finding.severity}: {finding.text}" for finding in self.findings)
        else:
            explodes = self.diagnosis and self.diagnosis.limit() < self.settings.dt
            yield f"No problems found{' other than the time step' if explodes else ''}."
        if self.diagnosis is not None:
            said = self.diagnosis.sentences
            if math.isinf(self.diagnosis.limit()) or self.diagnosis.rate is None:
                said = said[:1]
            yield from said
        yield "Next:"
        yield from (f"- {command} ({why})" for command, why in self.commands)

    @property
    def table(self) -> Table:
        """The findings; see `Finding`."""
        columns = ["severity", "kind", "element", "value", "unit", "text"]
        return Table((finding.record() for finding in self.findings), columns)

    def tables(self, full: bool) -> list[Table]:
        """The numbers that the findings are judged by."""
        if not self.findings:
            return []
        table = self.table
        return [Table(table, table.columns[:-1], heading="By element and value")]

    def details(self) -> dict[str, Any]:
        """The commands, and the diagnosis as data."""
        diagnosis = None if self.diagnosis is None else self.diagnosis.to_dict()
        return {"next": [command for command, _ in self.commands], "diagnosis": diagnosis}

    def __repr__(self) -> str:
        return f"<Check of {self.name}: {counted(len(self.findings), 'finding')}>"


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
    horizon = motion.horizon or max(dt, min(HORIZON, LONGEST * dt))
    schedule = _schedule(compiled, motion, horizon)
    failure, seen = _monitored(compiled, schedule, wanted)
    driven = motion.ctrl is not None or motion.control is not None
    if not driven and not compiled.keys:
        # A control of 0 that nothing asked for may be outside of its range.
        seen = [finding for finding in seen if finding.kind != "clamped control"]
    start, held = home(compiled, motion.key)
    read = list(_read(compiled, start, held, _key(compiled, motion.key)))
    diagnosis, notes = _diagnosis(setup, dataclasses.replace(motion, horizon=horizon))
    return Check(
        name=setup.name,
        settings=compiled.settings,
        motion=dataclasses.replace(motion, horizon=schedule.horizon, starts=1),
        findings=ordered([*failure, *_merged(read, seen)]),
        diagnosis=diagnosis,
        ran=motion_in_words(compiled, motion, schedule)
        if driven
        else held_motion_in_words(compiled, motion.key, schedule.horizon, held),
        notes=[*notes, *(n for n in compiled.scene.notes if not isinstance(n, EmptyRange))],
        file=_file(model, compiled),
        options=_options(motion),
    )


def _schedule(model: Model, motion: Motion, horizon: float) -> Schedule:
    """The motion, with the keyframe's controls held where the user gives none."""
    dt = model.settings.dt
    if motion.ctrl is None and motion.control is None and model.nu:
        held = home(model, motion.key)[1]
        motion = dataclasses.replace(motion, ctrl=held[None, :])
    steps = round(min(horizon / PERIODS / dt, LONGEST))
    period = motion.period(dt) or dt * max(1, steps)
    return scheduled(motion, model, min(period, max(horizon, dt)), starts=1, horizon=horizon)


def _monitored(
    model: Model, schedule: Schedule, depth: float | None
) -> tuple[list[Finding], list[Finding]]:
    """Why the run fails, if it does, and what it showed until its end."""
    runner = Runner(model, schedule)
    monitor = Monitor(model, runner.bodies, schedule.periods)
    failure = runner.run(model.settings.replace(ledger=True), 0, [monitor]).failure
    seen = monitor.findings(depth, failed=failure is not None)
    if failure is None:
        return [], seen
    replay = Next("run", "writes a replay of the failure for `stepcore replay`")
    said = f"The run fails: {beginning(failure, SENTENCES)}"
    return [Finding("failure", "error", said, commands=(replay,))], seen


def _read(model: Model, start: Start, held: np.ndarray, key: int | None) -> Iterator[Finding]:
    """What the scene alone shows; key: the keyframe that is the start."""
    yield from about_bodies(model, Sizes(model))
    yield from about_ranges(model, start, key)
    yield from about_servos(model, start, held)


def _merged(read: list[Finding], seen: list[Finding]) -> Iterator[Finding]:
    """What was read and what was seen, the same thing once: as read, but a limit as seen."""
    if any(finding.kind == "units" for finding in read):
        # A control range in degrees overpowers every limit.
        read = [finding for finding in read if finding.kind != "limit"]
    beyond = {at for finding in seen if finding.kind == "limit" for at in finding.elements}
    known = set()
    for finding in read:
        if finding.kind != "limit":
            known.add((finding.kind, finding.elements[:1]))
            yield finding
        elif not beyond.intersection(finding.elements):
            yield finding
    yield from (finding for finding in seen if (finding.kind, finding.elements[:1]) not in known)


def _key(model: Model, key: str | int | None) -> int | None:
    """The keyframe that is the start."""
    if key is None:
        return 0 if model.keys else None
    return model.index("key", key)


def _diagnosis(setup: Setup, motion: Motion) -> tuple[Diagnosis | None, list[str]]:
    """The diagnosis of the time step, or why there is none."""
    workers = setup.workers
    try:
        diagnosis = diagnose(
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
    return diagnosis, []


def _file(source: Source, model: Model) -> str:
    """What the next commands call the scene."""
    kinds = [line.partition(" ")[0] for line in model.scene.without]
    # A scene without some of its file is that of its file, with the kinds that are left out.
    read = model.scene._source if kinds else None
    file = read.files[0] if read else "FILE"
    if isinstance(source, (str, os.PathLike)):
        file = os.fspath(source)
    return file_in_words(file, kinds)


def file_in_words(file: str, without: list[str], fuse: bool = True) -> str:
    """The file as a command takes it, without some kinds of things."""
    left_out = [word for kind in without for word in ("--without", kind)]
    words = [file, *left_out, *(() if fuse else ("--no-fuse",))]
    return " ".join(map(shlex.quote, words))


def _options(motion: Motion) -> dict[str, str]:
    """The motion as commands take it; a file stands for a function or an array of Python's."""
    options = {}
    for name in MOTION:
        value, default = getattr(motion, name), getattr(Motion, name)
        if name == "control" and value is not None:
            options[name] = f"FILE.py:{getattr(value, '__name__', 'FUNCTION')}"
        elif name == "ctrl" and value is not None:
            options[name] = "FILE.npy"
        elif name != "starts" and value != default:
            options[name] = str(value)
    return options
