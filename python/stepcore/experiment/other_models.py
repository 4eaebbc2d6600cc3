"""Separates the modelling error of a setting from its numerical error.

The *numerical* error is the distance of a run from the limit dt → 0 of its own model; the
*modelling* error is the distance of that limit from the shipped model's. Models differ in law, cone
and softness. Single precision counts as a model too: its modelling error is the distance of a run
from the same run in double precision. Both limits are computed by one integrator at one time step,
so that their own numerical errors largely cancel.
"""

from __future__ import annotations

import copy
import dataclasses
import math
from collections.abc import Callable, Sequence
from typing import Any

from stepcore._core import Settings
from stepcore.engine.model import Model
from stepcore.experiment.batched_runs import screened
from stepcore.experiment.converged import reference_settings
from stepcore.experiment.errors import STICKS, Errors, errors
from stepcore.experiment.reference import Gap, Level, Reference, ReferenceRuns
from stepcore.experiment.run import Run
from stepcore.experiment.runner import Runner
from stepcore.report.progress import Progress
from stepcore.scene.elements import Joint, Tendon
from stepcore.scene.scene import Scene

Ref = tuple[float, ...]

# Settings that say what is modelled, not how it is computed; in the order of the groups, all laws
# use them, those that are not solref, solref, a scene that sleeps, and penalty.
ALWAYS = ("law", "cone", "sleep", "max_recovery_speed")
VELOCITY_LEVEL = ("beta", "softness", "restitution", "slop")
SOFT = ("impratio", "noslip_iterations", "stiction")
SLEEPING = ("sleep_tolerance", "sleep_time")
PENALTY = ("penalty_stiffness", "penalty_damping_ratio")
# Integrators that only solref knows.
SMOOTH = ("euler", "implicitfast", "implicit", "discrete")
# Integrators that solve rows within the step, as sleep does not allow.
STAGED = ("midpoint", "rk4")
# Time constants of solref are divided by these, one after the other, towards a rigid scene.
STIFFER = (4.0, 16.0)
# Laws whose limit is soft, and how they are made harder, in words.
HARDER = {"solref": "solref time constants / {0:g}", "penalty": "penalty_stiffness × {1:g}"}
# The effect of softness is known if the last two distances differ by less than this share of the
# last, and if half the step and the reference's own error change each by less than it.
SETTLED = 0.25
# A step of this part of a contact's shortest time scale resolves it.
RESOLVED = 8.0
# One harder scene may cost this share of the reference's budget.
SHARE = 0.25


class ErrorSplit:
    """Splits errors into numerical and modelling ones; keeps the limits that it computes."""

    def __init__(self, runs: ReferenceRuns, reference: Reference, size: float) -> None:
        self.runs, self.reference, self.size = runs, reference, size
        chain = next((c for name, c in runs.chains.items() if name != "rk4"), None)
        chain = chain or runs.chains["rk4"]
        # Where limits alone are compared, a cheaper level than the reference's will do.
        self.cheap = next((level for level in chain if level.dt <= runs.finest / 2), chain[-1])
        self.acts = any(run.rows or run.overlap for run in self.cheap.runs)
        # Runs are compared with a limit at twice the reference's step.
        self.base: Level = reference.levels[-2]
        self.limits: dict[tuple[Any, ...], Level] = {}
        self.doubles: dict[Settings, list[Run]] = {}

    def keep(self, settings: Settings, runs: list[Run]) -> None:
        """Keeps runs in double precision, which those in single precision are compared with."""
        if settings.precision == "f64" and not runs[-1].failure:
            self.doubles[settings] = runs

    def errors(self, settings: Settings, runs: Sequence[Run]) -> Errors:
        """Errors of one setting, that of its worst start split.

        Where another model's own limit fails, or the run in double precision does, the two parts
        cannot be separated: modelling is then NaN, and numerical the whole error.
        """
        whole = self._apart(runs, self.reference.runs, settings.cone)
        unsplit = dataclasses.replace(whole, modelling=math.nan)
        numerical, modelling = whole.high, 0.0
        exact = settings.replace(precision="f64")
        if settings.precision != "f64":
            double = self._double(exact)
            if double is None:
                return unsplit
            modelling = self._apart(runs, double).high
            numerical = self._apart(double, self.reference.runs).high
            runs = double
        if _modelled(exact) != _modelled(self.runs.shipped) or self._clamp(exact):
            limit = self.limit(exact)
            if limit.failed:
                return unsplit
            modelling += self._apart(limit.runs, self.base.runs).high
            numerical = self._apart(runs, limit.runs).high
        return dataclasses.replace(whole, numerical=numerical, modelling=modelling)

    def limit(self, settings: Settings) -> Level:
        """The limit of the model that these settings compute."""
        key = (*_modelled(settings), self._clamp(settings))
        if key not in self.limits:
            runner = self.runs.runner
            if self._clamp(settings):
                runner = _runner_of(clamped(runner.model.scene, 2 * settings.dt), runner)
            self.limits[key] = self._level(runner, settings, self.base)
        return self.limits[key]

    def _clamp(self, settings: Settings) -> float:
        """The step at which `refsafe` makes the scene softer [s], 0 where it does not."""
        if settings.law != "solref" or not settings.refsafe or not self.acts:
            return 0.0
        shortest = clamping(self.runs.runner.model.scene)
        return settings.dt if shortest and 2 * settings.dt > shortest * (1 + 1e-12) else 0.0

    def gaps(self) -> dict[str, Gap]:
        """The distance of the shipped model to one with elliptic cones, and to a rigid one.

        "pyramid": where friction acts under pyramidal cones. "softness": under the laws solref and
        penalty, whose limit is soft; contacts are made harder until that changes little. Empty
        where no row acts.
        """
        if not self.acts:
            return {}
        gaps = {"pyramid": self._pyramid(), "softness": self._softness()}
        return {name: gap for name, gap in gaps.items() if gap is not None}

    def _pyramid(self) -> Gap | None:
        """The distance to elliptic cones, at a step that resolves the contacts."""
        runner, shipped = self.runs.runner, self.runs.shipped
        if shipped.cone != "pyramidal" or not any(any(run.slips) for run in self.cheap.runs):
            return None
        shortest = time_scale(runner.model.scene) if shipped.law == "solref" else math.inf
        levels = [self.cheap, *(level for chain in self.runs.chains.values() for level in chain)]
        fine = [level for level in levels if level.dt * RESOLVED <= shortest]
        if not fine:
            return None
        near = fine[0]
        if near is not self.cheap:
            near = max(fine, key=lambda level: (level.dt, level.integrator != "rk4"))
        limit = self._level(runner, shipped.replace(cone="elliptic"), near)
        if limit.failed:
            return None
        return Gap(self._apart(limit.runs, near.runs).high, "elliptic cones")

    def _softness(self) -> Gap | None:
        """The distance to the hardest contacts that could be run at steps that resolve them."""
        law, gap = self.runs.shipped.law, None
        for factor in STIFFER if law in HARDER else ():
            distance = self._softer_by(factor)
            if distance is None:
                break
            steady = gap is not None and abs(distance - gap.distance) <= SETTLED * distance
            gap = Gap(distance, HARDER[law].format(factor, factor**2), steady)
        return gap

    def _softer_by(self, factor: float) -> float | None:
        """The distance of the scene to one with harder contacts [m].

        None where that cannot be known: where the harder scene fails, where a step that resolves
        it costs too much, or where half that step still moves it by more than a share.
        """
        runs, dt, name = self.runs, self.cheap.dt, self.cheap.integrator
        runner, settings = runs.runner, runs.shipped
        if settings.law == "penalty":
            stiff = settings.penalty_stiffness * factor**2
            settings, dt = settings.replace(penalty_stiffness=stiff), dt / factor
        else:
            scene = stiffer(runner.model.scene, factor)
            runner = _runner_of(scene, runner)
            halvings = math.log2(max(1.0, dt * RESOLVED / time_scale(scene)))
            dt /= 2 ** math.ceil(halvings - 1e-9)
        if runs.cost(name, dt) + runs.cost(name, dt / 2) > SHARE * runs.budget:
            return None
        coarse = self._level(runner, settings, Level(dt, name, []))
        if coarse.failed:
            return None
        fine = self._level(runner, settings, Level(dt / 2, name, []))
        if fine.failed:
            return None
        distance = self._apart(fine.runs, self.reference.runs).high
        unsure = self._apart(coarse.runs, fine.runs).high + self.reference.high
        return distance if unsure <= SETTLED * distance else None

    def _level(self, runner: Runner, settings: Settings, like: Level) -> Level:
        """All starts of another model's runner, at the step and with the integrator of a level."""
        runs, name = self.runs, like.integrator
        if settings.law != "solref" and name in SMOOTH:
            name = "semi-implicit"
        if settings.sleep and name in STAGED:
            name = runs.second
        converged = reference_settings(settings, name, like.dt)
        made = self._run(runner, converged)
        runs.spent += runs.cost(name, like.dt) * len(made) / runs.starts
        return Level(like.dt, name, made)

    def _double(self, settings: Settings) -> list[Run] | None:
        """The runs of settings in double precision, None if they fail."""
        if settings not in self.doubles:
            made = self._run(self.runs.runner, settings)
            if made[-1].failure:
                return None
            self.doubles[settings] = made
        return self.doubles[settings]

    def _run(self, runner: Runner, settings: Settings) -> list[Run]:
        """The positions from every start, until one fails."""
        hidden = Progress("", self.runs.starts, False)
        return screened(runner, settings, runner.starts, self.runs.workers, hidden, True)

    def _apart(self, runs: Sequence[Run], truth: Sequence[Run], cone: str = "pyramidal") -> Errors:
        return errors(runs, truth, self.reference.scored, self.size, STICKS[cone])


def _runner_of(scene: Scene, runner: Runner) -> Runner:
    """The runner of another scene on the same motion."""
    return Runner(Model(scene, runner.model.settings), runner.schedule)


def stiffer(scene: Scene, factor: float) -> Scene:
    """A copy of a scene whose contacts, limits and connections are harder.

    Time constants of solref are divided by `factor`; a stiffness given directly is multiplied by
    its square and a damping by it, which is the same.
    """

    def hard(ref: Ref) -> Ref:
        if ref[0] > 0:
            return (ref[0] / factor, ref[1])
        return (ref[0] * factor**2, ref[1] * factor)

    return _softened(scene, hard)


def clamped(scene: Scene, least: float) -> Scene:
    """A copy of a scene none of whose time constants of solref is below `least` [s]."""
    return _softened(scene, lambda ref: (max(ref[0], least) if ref[0] > 0 else ref[0], ref[1]))


def _softened(scene: Any, change: Callable[[Ref], Ref]) -> Any:
    """A copy of a scene with every solref changed."""
    made = copy.deepcopy(scene)
    for other in (*made.geoms, *made.equalities, *made.pairs, made.contact_override):
        other.solref = change(other.solref)
    for length in (*made.joints, *made.tendons):
        length.solreflimit = change(length.solreflimit)
        length.solreffriction = change(length.solreffriction)
    return made


def _modelled(settings: Settings) -> tuple[Any, ...]:
    """What settings say of the model, with None for what their law does not use."""
    soft = settings.law == "solref"
    groups = (
        (ALWAYS, True),
        (VELOCITY_LEVEL, not soft),
        (SOFT, soft),
        (SLEEPING, settings.sleep),
        (PENALTY, settings.law == "penalty"),
    )
    return tuple(
        getattr(settings, name) if used else None for names, used in groups for name in names
    )


def time_scale(scene: Scene) -> float:
    """The shortest time in which a contact, limit or connection pushes back [s]; inf without any.

    A contact with solref (T, ζ) is an oscillator with 1/ω = ζT whose damping alone takes T, one
    with (−k, −b) has 1/ω = 1/√k and takes 2/b (the acceleration per overlap, and per speed).
    """
    shortest = math.inf
    for first, second in _solrefs(scene):
        if first > 0:
            shortest = min(shortest, first * min(1.0, second))
        elif first < 0:
            damping = 2.0 / -second if second < 0 else math.inf
            shortest = min(shortest, 1.0 / math.sqrt(-first), damping)
    return shortest


def _solrefs(scene: Scene) -> list[Ref]:
    """Of everything in a scene that can make rows."""
    refs = [g.solref for g in scene.geoms if g.contype or g.conaffinity]
    lengths: list[Joint | Tendon] = [*scene.joints, *scene.tendons]
    refs += [length.solreflimit for length in lengths if length.range is not None]
    refs += [length.solreffriction for length in lengths if length.frictionloss > 0]
    refs += [e.solref for e in scene.equalities if e.active]
    refs += [pair.solref for pair in scene.pairs]
    refs += [scene.contact_override.solref] * scene.contact_override.enable
    return refs


def clamping(scene: Scene) -> float | None:
    """The shortest time constant that `refsafe` guards [s]: at a dt above half of it, rows soften.

    None where no solref in the scene is a time constant.
    """
    return min((ref[0] for ref in _solrefs(scene) if ref[0] > 0), default=None)
