"""`check`: find the problems of a scene in seconds; the first command to run."""

from __future__ import annotations

import dataclasses
import itertools
import math
import os
import shlex
from collections.abc import Collection, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any, ClassVar, Unpack

import numpy as np

from stepcore import checks
from stepcore._core import Settings
from stepcore.checks import one_line
from stepcore.deadline import OutOfTime
from stepcore.engine.actuator import actuators
from stepcore.engine.control import control_option
from stepcore.engine.follow import Followed
from stepcore.engine.model import Model
from stepcore.engine.run_settings import balanced
from stepcore.experiment.arguments import MeasurementFields, Setup, Source, measurement, set_up
from stepcore.experiment.control_table import control_table
from stepcore.experiment.horizon import PILOT_STEPS, Horizon, horizon_of
from stepcore.experiment.motion import Motion, MotionFields
from stepcore.experiment.motion_words import held_motion_in_words, motion_in_words
from stepcore.experiment.schedule import HORIZON, SAMPLES, Schedule, home, scheduled
from stepcore.measure.check.described import ENDLESS, Described, described
from stepcore.measure.check.plausible import plausibility
from stepcore.measure.diagnosis import Diagnosis, diagnose
from stepcore.measure.monitors import Finding, Next, monitored, ordered, verified
from stepcore.measure.monitors.finding import HALF, SEVERITIES
from stepcore.report import units
from stepcore.report.result import Result
from stepcore.report.settings import label
from stepcore.report.table import Table
from stepcore.report.units import beginning, counted, seconds
from stepcore.report.verdict import Verdict

__all__ = ["Check", "check"]

AS_SHIPPED, TIME_STEP = "the run as shipped", "the diagnosis of the time step"
# The kind of the finding on a time step that fails.
UNSTABLE = "time step"
# Commands for any scene.
ALWAYS = (
    Next("trade", "how large the error is, and what is cheaper", ("--error", "1mm")),
    Next("predict", "for how long its motion can be predicted"),
    Next("plan", "what a step computes"),
)
# Command options by fields of the motion; `run` and `plan` accept fewer.
MOTION = {name: f"--{name.replace('_', '-')}" for name in MotionFields.__annotations__}
MOTION["kind"] = "--motion"
TAKEN = {
    "run": MOTION,
    "plan": dict.fromkeys(MOTION, "") | {"key": "--key"},
}
# The kinds of motion in words.
OF_KIND = {
    "hold": "holding the pose",
    "move": "point-to-point motion",
    "sines": "sinusoidal motion",
    "fall": "free motion",
    "random": "random motion",
}


@dataclass(eq=False, repr=False)
class Check(Result):
    """The problems of a scene; `stepcore.check` returns it.

    settings: the settings as shipped, under which the scene ran.
    motion: the motion that was run.
    findings: the problems, most severe first.
    diagnosis: the `Diagnosis` of the time step; None if the diagnosis failed, and a note gives the
        reason.
    file: the file argument of the commands, with the options that change how the file is read.
    options: the options of the motion for the commands, by the field of `Motion`.
    holding: the additional options of `run`, for the motion of this run.
    examined: what was examined, in words: parts of the scene and the motion that was run.
    """

    kind = "check"
    units: ClassVar = {"value": "unit"}

    settings: Settings
    motion: Motion
    findings: list[Finding]
    diagnosis: Diagnosis | None
    file: str = "FILE"
    options: Mapping[str, str] = field(default_factory=dict)
    holding: Mapping[str, str] = field(default_factory=dict)
    examined: Sequence[str] = ()

    @property
    def commands(self) -> list[tuple[str, str]]:
        """Up to three commands to run next on the same scene and motion, with reasons."""
        said: dict[str, str] = {}
        for following in self._following():
            takes = TAKEN.get(following.command, MOTION)
            own = self.holding if following.command == "run" else {}
            options = {**self.options, **own}.items()
            motion = [(takes[name], value) for name, value in options if takes[name]]
            words = map(shlex.quote, [*following.arguments, *itertools.chain(*motion)])
            said[" ".join(["stepcore", following.command, self.file, *words])] = following.why
        return list(said.items())[:3]

    def _following(self) -> Iterator[Next]:
        dt = self.settings.dt
        limit = self.diagnosis.limit() if self.diagnosis else math.inf
        if self.diagnosis is not None and not math.isfinite(limit):
            # The longest step that holds, where the limit is not known.
            limit = self.diagnosis.own.holds
        if HALF * limit < dt:
            yield Next("diagnose", "every element's largest stable dt, and all the advice")
        for finding in self.findings:
            if finding.kind == "failure" and not self.endless:
                short = f"{min(dt / 4, limit / 2 if limit > 0 else dt):.1g}"
                yield Next("run", "whether a smaller time step survives", ("--dt", short))
            yield from finding.commands
        yield from ALWAYS

    def verdict(self, level: str = "error", accepted: Collection[tuple[str, str]] = ()) -> Verdict:
        """Return whether the scene passes: no finding of a level, or a more severe one.

        level: "error", "warning" or "remark"; "never" passes always. accepted: the kind and the
        element of findings that do not count. It is undecided if no finding fails, but the time
        ended before the run was examined.
        """
        checks.one_of(*SEVERITIES, "never")("verdict", "level", level)
        test = f"no finding of level {level}"
        failing = () if level == "never" else SEVERITIES[: SEVERITIES.index(level) + 1]
        fails = [
            finding
            for finding in self.findings
            if finding.severity in failing and (finding.kind, finding.element) not in accepted
        ]
        if fails:
            return Verdict(test, False, "; ".join(finding.text for finding in fails))
        if failing and AS_SHIPPED in self.not_done:
            return Verdict(test, None, f"the run was not examined in time; {self.unfinished}")
        return Verdict(test, True, "none")

    @property
    def failed(self) -> bool:
        """Whether the run failed."""
        return any(finding.kind == "failure" for finding in self.findings)

    @property
    def endless(self) -> bool:
        """Whether the motion grows at every time step, so that no step is a fix."""
        return any(finding.kind == ENDLESS for finding in self.findings)

    @property
    def mjcf(self) -> str:
        """The elements to paste, one per line, of findings that have several."""
        return "\n".join(line for finding in self.findings for line in finding.lines)

    @property
    def title(self) -> str:
        """The scene checked."""
        return f"{self.name}: check"

    @property
    def setup(self) -> str:
        """The settings, and the motion on which the time step was judged."""
        said = f"Under {label(self.settings)}."
        # The user's controls drive both runs; without them, this run holds the keyframe's controls
        # constant.
        same = self.motion.is_users or self.motion.kind is not None or self.failed
        if self.diagnosis is not None and not same and self.diagnosis.ran not in ("", self.ran):
            said += f"\nThe time step was judged on another motion: {self.diagnosis.ran}."
        return said

    @property
    def rows(self) -> list[Finding]:
        """The findings."""
        return self.findings

    @property
    def sentences(self) -> list[str]:
        """The problems with their fixes, the diagnosis' answer, and the commands to run next."""
        said = [
            text
            for finding in self.findings
            for text in (
                f"{finding.severity.capitalize()}: {finding.text}",
                *(f"  {line}" for line in finding.lines),
            )
        ]
        said += _for_urdf(shlex.split(self.file)[0], self.findings)
        unknown = [what for what in (AS_SHIPPED, TIME_STEP) if what in self.not_done]
        if not said and not self._unstable and self.examined:
            *first, last = self.examined
            examined = f"{', '.join(first)} and {last}" if first else last
            said = [f"No problems found in {examined}."]
        if unknown:
            said.insert(0, f"Not known yet: {' and '.join(unknown)}.")
        if self.diagnosis is not None:
            said += self._stability(self.diagnosis)
        return [*said, "Next:", *(f"- {command} ({why})" for command, why in self.commands)]

    @property
    def _unstable(self) -> bool:
        """Whether the shipped time step fails, or is beyond the stability limit."""
        diagnosis = self.diagnosis
        return diagnosis is not None and (diagnosis.fails or diagnosis.limit() < self.settings.dt)

    def _stability(self, diagnosis: Diagnosis) -> list[str]:
        """Return the diagnosis' answer, without the part that a finding has already."""
        if self.endless:
            # A motion that grows at every time step has no largest stable step.
            return []
        answers = diagnosis.sentences
        if not (diagnosis.fails and math.isfinite(diagnosis.limit())):
            # After a failed run, the stability of another part of the motion is left out.
            shown = diagnosis.fails or not self.failed
            answers = [f"{beginning(answers[0])}."] if shown else []
        found = any(finding.kind == UNSTABLE for finding in self.findings)
        found |= self.failed and diagnosis.names_cause
        motion = f"The motion: {diagnosis.ran}."
        return [text for text in answers[int(found) :] if text != motion]

    @property
    def table(self) -> Table:
        """The findings; see `Finding`."""
        columns = ["severity", "kind", "element", "value", "unit", "fix", "text"]
        return Table((finding.record() for finding in self.findings), columns)

    def tables(self, full: bool) -> list[Table]:
        """Return the numbers by which the findings are judged."""
        if not self.findings:
            return []
        table = self.table
        return [Table(table, table.columns[:-2], heading="By element and value")]

    def details(self) -> dict[str, Any]:
        """Return the commands and the diagnosis as plain data."""
        diagnosis = None if self.diagnosis is None else self.diagnosis.to_dict()
        commands = [command for command, _ in self.commands]
        return {"next": commands, "diagnosis": diagnosis, "mjcf": self.mjcf}

    def __repr__(self) -> str:
        return f"<Check of {self.name}: {counted(len(self.findings), 'finding')}>"


@measurement(without=("starts",))
def check(
    model: Source,
    motion: Motion | str | None = None,
    *,
    depth: float | str | None = None,
    **fields: Unpack[MeasurementFields],
) -> Check:
    """Find the problems of a scene in seconds; the first command to run.

    `check` reads the scene (implausible masses and inertias, units that look like mm or
    degrees, starts and keyframes outside of limits, saturated servos, loads that actuators cannot
    hold, limits that an actuator overpowers), monitors one run as shipped (overlaps, creep,
    gaps, depths, sag, saturation), and diagnoses the time step. Each finding is a sentence with its
    fix, most severe first. The diagnosis' answer and the commands to run next follow.

    model: a Model, a Scene, or the path of an MJCF file (or "package:name").
    motion: the `Motion` that is run; or write its fields as arguments, except `starts`, because
        there is one start; or a kind of motion. Without one, this run holds the controls of the
        keyframe (zero without a keyframe; motors made for a URDF hold its pose), and the time step
        is diagnosed along the motion of `diagnose`. The run goes on until the motion has come to
        rest, repeats, or has lasted 10 s; see `stepcore.experiment.horizon`. The diagnosis covers
        1 s.
    depth: the wanted depth of resting contacts, a length such as 1e-4 or "0.1mm". For contacts
        that rest deeper, the result names the solref that gives this depth.
    threads, executor, progress, seconds: see `stepcore.experiment.arguments.Workers`.

    Raises ValueError for an argument outside its limits, for a scene that cannot be compiled, and
    for a scene in which nothing can move.

    >>> from stepcore import loads
    >>> scene = loads('''<mujoco><worldbody><body><joint name="knee" range="-90 90"/>
    ... <geom size=".1"/></body></worldbody><keyframe><key name="home" qpos="2"/></keyframe>
    ... </mujoco>''')
    >>> result = check(scene, progress=False)
    >>> [finding.kind for finding in result.findings]
    ['outside a limit']
    """
    setup = set_up(check, model, motion, fields, missing="nothing to check")
    wanted = None if depth is None else units.length("check", "depth", depth, 1.0)
    compiled, motion, deadline = setup.model, setup.motion, setup.workers.deadline
    start, held = home(compiled, motion.key)
    first = 0 if compiled.keys else None
    key = first if motion.key is None else compiled.index("key", motion.key)
    # The findings of the scene alone come first: they take no run.
    scene = Described(compiled, start, held, key)
    read = [*described(scene), *plausibility(scene)]
    deadline.so_far(_first(read, "the file alone"))
    dt = compiled.settings.dt
    horizon = motion.horizon or max(dt, min(HORIZON, PILOT_STEPS * dt))
    holds = _held(compiled, motion)
    far, failure, seen, judged = Horizon(horizon), list[Finding](), list[Finding](), motion
    schedule = None
    # Half of the time is left for the diagnosis.
    with deadline.stage(AS_SHIPPED, HALF):
        far = horizon_of(compiled, holds, horizon)
        schedule = _schedule(compiled, holds, far.length)
        failure, seen = _monitored(compiled, schedule, wanted, far.ran)
        deadline.so_far(_first([*failure, *_merged(read, seen)], "the file and its run"))
    if schedule is None:
        schedule = _schedule(compiled, holds, far.length)
    if failure:
        # The step is judged on the motion that failed.
        judged, horizon = holds, schedule.horizon
    with deadline.stage("runs of the fixes that the scene alone suggests", HALF):
        read = verified(read, compiled)
    diagnosis, notes = _diagnosis(setup, dataclasses.replace(judged, horizon=horizon))
    merged = list(_merged(read, seen))
    found = [*(_caused(finding, diagnosis) for finding in failure), *merged]
    if diagnosis is not None and diagnosis.fails and not failure:
        found = [_unstable(diagnosis), *_unblamed(found)]
    if any(finding.kind == ENDLESS for finding in read):
        # The cause is the motion that grows at every time step, not the step.
        found = [*merged, *failure]
    return Check(
        name=setup.name,
        settings=compiled.settings,
        motion=dataclasses.replace(motion, horizon=schedule.horizon, starts=1),
        findings=_causes_first(ordered(found), compiled),
        diagnosis=diagnosis,
        ran=far.after(
            motion_in_words(compiled, holds, schedule)
            if motion.is_users or holds.kind
            else held_motion_in_words(compiled, motion.key, schedule.horizon, held)
        ),
        notes=[*notes, *(schedule.notes if motion.is_users else ()), *compiled.scene.notes],
        file=_file(model, compiled),
        options=_options(motion),
        holding={"kind": holds.kind} if holds.kind and not motion.kind else {},
        examined=_examined(compiled, motion, schedule, AS_SHIPPED not in deadline.left_out),
    )


def _causes_first(findings: list[Finding], model: Model) -> list[Finding]:
    """Return findings with overlaps at the start before the passages of the same bodies.

    Parts that begin inside each other are pushed out on any side.
    """
    passed = [k for k, finding in enumerate(findings) if finding.kind == "tunnelling"]
    if not passed:
        return findings
    bodies = _bodies_of(findings[passed[0]], model)
    causes = [
        finding
        for finding in findings[passed[0] :]
        if finding.kind.startswith("overlap") and bodies & _bodies_of(finding, model)
    ]
    others = [finding for finding in findings if not any(finding is cause for cause in causes)]
    return [*others[: passed[0]], *causes, *others[passed[0] :]]


def _bodies_of(finding: Finding, model: Model) -> set[int]:
    """Return the moving bodies of the geoms and contacts of a finding."""
    geoms = [of.index for of in finding.elements if of.kind == "geom"]
    pairs = [of.index for of in finding.elements if of.kind == "contact"]
    geoms += np.ravel(model.pair_geoms[pairs]).tolist() if pairs else []
    return {int(model.geom_body[geom]) for geom in geoms} - {0}


def _for_urdf(path: str, findings: Sequence[Finding]) -> Iterator[str]:
    """Yield how to write the advice of findings in a file that is a URDF."""
    advised = " ".join(finding.text for finding in findings)
    if not path.lower().endswith(".urdf"):
        return
    if "<exclude" in advised:
        yield "In a URDF, <exclude> stands in <mujoco><contact>…</contact></mujoco>."
    if "solref=" in advised:
        saved = f'sc.load("{path}").save("{os.path.splitext(path)[0]}.xml")'
        yield f"A URDF has no solref; {saved} writes the robot as MJCF, which has it."


def _first(findings: list[Finding], where: str) -> str:
    """Return the findings that do not depend on runs of their fixes, as text."""
    findings = [
        one for one in ordered(findings) if one.proposals is None or not one.proposals.needed
    ]
    said = (f"\n- {finding.severity}: {finding.problem}" for finding in findings)
    what = counted(len(findings), "finding") if findings else "no problem"
    return f"{what} in {where}{':' * bool(findings)}{''.join(said)}"


def _held(model: Model, motion: Motion) -> Motion:
    """Return the motion, with the keyframe's controls held constant if the user gives none.

    Motors that stepcore made have no controls in the file, and hold the pose.
    """
    if motion.is_users or motion.kind or not model.nu:
        return motion
    if model.scene._powered and not model.keys:
        return dataclasses.replace(motion, kind="hold")
    return dataclasses.replace(motion, ctrl=home(model, motion.key)[1][None, :])


def _examined(model: Model, motion: Motion, schedule: Schedule, ran: bool) -> list[str]:
    """Return the parts of a scene that are examined, and the motion if it ran, in words."""
    drives = {of.holds for of in actuators(model)}
    parts = {
        "geometry": model.ngeom > 0,
        "inertia": True,
        "limits": bool(np.isfinite(model.jnt_range).any()),
        "servos": True in drives,
        "motors": False in drives,
    }
    if motion.control is not None or motion.table is not None:
        how = "the given motion"
    else:
        kind = _held(model, motion).kind
        how = OF_KIND[kind or "fall"] if kind or not model.nu else "motion with constant controls"
    examined = [part for part, there in parts.items() if there]
    return [*examined, f"{seconds(schedule.horizon)} of {how}"] if ran else examined


def _schedule(model: Model, motion: Motion, horizon: float) -> Schedule:
    dt = model.settings.dt
    period = motion.period(dt) or dt * max(1, min(round(horizon / (2 * SAMPLES) / dt), PILOT_STEPS))
    return scheduled(motion, model, min(period, max(horizon, dt)), starts=1, horizon=horizon)


def _monitored(
    model: Model, schedule: Schedule, depth: float | None, ran: Followed | None
) -> tuple[list[Finding], list[Finding]]:
    """Return the failure of the run, if any, and the findings that the run shows."""
    seen, failure = monitored(model, schedule, depth, ran)
    if failure is None:
        return [], seen
    # A run with an energy account reports what drove it.
    cause = monitored(model.with_settings(balanced(model.settings)), schedule, depth)[1] or ""
    replay = Next("run", "writes a replay of the failure for `stepcore replay`")
    why = beginning(cause, 2).removeprefix(beginning(cause))
    said = f"The run fails: {beginning(failure)}{why}"
    return [Finding("failure", "error", said, commands=(replay,))], seen


def _caused(failure: Finding, diagnosis: Diagnosis | None) -> Finding:
    """Return a failure with the cause that the diagnosis of the same motion found."""
    if diagnosis is None or not diagnosis.names_cause:
        return failure
    answer = diagnosis.sentences[0].rstrip(".")
    said = f"The run fails: {answer[0].lower()}{answer[1:]}"
    return dataclasses.replace(failure, problem=said)


def _unstable(diagnosis: Diagnosis) -> Finding:
    """Return the finding on a time step that fails, with what the diagnosis knows of it."""
    limiting = diagnosis.limiting()
    elements = () if limiting is None else (limiting.element,)
    limit = diagnosis.limit()
    value, unit = (limit, "s") if math.isfinite(limit) else (None, "")
    problem = diagnosis.sentences[0].rstrip(".")
    return Finding(UNSTABLE, "error", problem, "", elements, value, unit)


def _unblamed(findings: list[Finding]) -> Iterator[Finding]:
    """Yield findings without the causes that a run shows whose time step fails.

    Chatter saturates servos, and a servo that chatters does not follow.
    """
    for finding in findings:
        if finding.kind == "servo does not follow":
            problem = f"{finding.observation}, in a run whose time step fails"
            yield dataclasses.replace(finding, problem=problem, fix="", commands=())
        elif finding.kind != "saturation":
            yield finding


def _merged(read: list[Finding], seen: list[Finding]) -> Iterator[Finding]:
    """Yield the findings of the scene and of the run without duplicates.

    The scene's finding is kept, except for limits, where the run's is kept.
    """
    limits = {at for finding in seen if finding.kind == "limit" for at in finding.elements}
    # A control range in degrees overpowers every limit; only the range is reported.
    degrees = any(finding.kind == "units" for finding in read)
    known = set()
    for finding in read:
        if finding.kind != "limit" or not (degrees or limits.intersection(finding.elements)):
            known.add((finding.kind, finding.elements[:1]))
            yield finding
    yield from (finding for finding in seen if (finding.kind, finding.elements[:1]) not in known)


def _diagnosis(setup: Setup, motion: Motion) -> tuple[Diagnosis | None, list[str]]:
    """Return the diagnosis of the time step, or None and the reason."""
    workers = setup.workers
    try:
        diagnosis = diagnose(
            setup.model,
            dataclasses.replace(motion, starts=None),
            integrators=[setup.model.settings.integrator],
            threads=workers.threads,
            executor=workers.executor,
            progress=workers.progress,
        )
    except OutOfTime:
        workers.deadline.left_out.append(TIME_STEP)
        return None, []
    except Exception as error:
        # The diagnosis may fail on a misbehaving scene; the findings must still be reported.
        return None, [
            f"the time step was not diagnosed ({type(error).__name__}: {one_line(error)})"
        ]
    workers.deadline.left_out += diagnosis.not_done
    return diagnosis, []


def _file(source: Source, model: Model) -> str:
    """Return the file argument of the commands, with options for kinds that were left out."""
    kinds = [line.partition(" ")[0] for line in model.scene.without]
    read = model.scene._source if kinds else None
    file = read.files[0] if read else "FILE"
    return file_in_words(
        os.fspath(source) if isinstance(source, str | os.PathLike) else file, kinds
    )


def file_in_words(file: str, without: list[str], flags: Sequence[str] = ()) -> str:
    """Return a file argument with the options of loading: kinds left out, and flags."""
    left_out = [word for kind in without for word in ("--without", kind)]
    words = [file, *left_out, *flags]
    return " ".join(map(shlex.quote, words))


def _options(motion: Motion) -> dict[str, str]:
    """Return the motion as command options, with placeholders for values in no file."""
    options = {}
    for name in MOTION:
        value, default = getattr(motion, name), getattr(Motion, name)
        if name == "control" and value is not None:
            options[name] = control_option(value)
        elif name in ("ctrl", "follow") and value is not None:
            if name == "follow" or motion.follow is None:
                options[name] = control_table(motion.ctrl).option
        elif name != "starts" and value != default:
            options[name] = str(value)
    return options
