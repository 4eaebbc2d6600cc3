"""The split of a setting's error into a modelling error and a numerical error.

The *numerical* error is the distance of a run from the limit dt → 0 of the run's model. The
*modelling* error is the distance of that limit from the limit of the shipped model. Models differ
in law, cone and softness. Single precision also counts as a model: its modelling error is the
distance of a run from the same run in double precision. Both limits are computed with the same
integrator and time step, so that their numerical errors largely cancel.
"""

from __future__ import annotations

import copy
import dataclasses
import math
from collections.abc import Callable, Sequence
from typing import Any

from stepcore._core import Settings
from stepcore.engine.linear_maps import DAMPING_IMPLICIT, STAGED
from stepcore.engine.model import Model
from stepcore.experiment.batched_runs import screened
from stepcore.experiment.converged import reference_settings
from stepcore.experiment.errors import STICKS, Errors, errors
from stepcore.experiment.reference import Gap, Level, Reference, ReferenceRuns
from stepcore.experiment.run import Run
from stepcore.experiment.runner import Runner
from stepcore.scene.scene import Scene
from stepcore.scene.softness import Ref, clamping, solrefs

# Settings of the physical model, as opposed to its numerical solution. The groups apply to all
# laws, to laws other than solref, to solref, to scenes with sleep, and to penalty.
ALWAYS = ("law", "cone", "sleep", "max_recovery_speed")
VELOCITY_LEVEL = ("beta", "softness", "restitution", "slop")
SOFT = ("impratio", "noslip_iterations", "noslip_tolerance", "stiction")
SLEEPING = ("sleep_tolerance", "sleep_time")
PENALTY = ("penalty_stiffness", "penalty_damping_ratio")
# Divisors of the solref time constants, in successive steps towards a rigid scene.
STIFFER = (4.0, 16.0)
# Laws whose limit is soft, and the change that makes contacts harder, in words.
HARDER = {"solref": "solref time constants / {0:g}", "penalty": "penalty_stiffness × {1:g}"}
# The effect of softness is known if the last two distances differ by less than this share of the
# last one, and if halving the step and the reference's error change each by less than this share.
SETTLED = 0.25
# The number of steps per shortest time scale of a contact that resolves the contact.
RESOLVED = 8.0
# The largest cost of one harder scene, as a share of the reference's budget.
SHARE = 0.25


class ErrorSplit:
    """A splitter of errors into numerical and modelling errors, with a cache of computed limits.

    runs: the maker of the reference. reference: the converged motion. size: of the scene [m].
    """

    def __init__(self, runs: ReferenceRuns, reference: Reference, size: float) -> None:
        self.runs, self.reference, self.size = runs, reference, size
        chain = next((c for name, c in runs.chains.items() if name != "rk4"), None)
        chain = chain or runs.chains["rk4"]
        # A cheaper level than the reference suffices to compare limits with each other.
        self.cheap = next((level for level in chain if level.dt <= runs.finest / 2), chain[-1])
        self.acts = any(run.rows or run.overlap for run in self.cheap.runs)
        # Limits that runs are compared with have twice the reference's step.
        self.base: Level = reference.levels[-2]
        self.limits: dict[tuple[Any, ...], Level] = {}
        self.doubles: dict[Settings, list[Run]] = {}

    def keep(self, settings: Settings, runs: list[Run]) -> None:
        """Keep runs in double precision for the comparison with runs in single precision."""
        if settings.precision == "f64" and not runs[-1].failure:
            self.doubles[settings] = runs

    def errors(self, settings: Settings, runs: Sequence[Run]) -> Errors:
        """Compute the errors of one setting, with `high` split into `numerical` and `modelling`.

        If the limit of the setting's model or the run in double precision fails, the two parts
        cannot be separated: modelling is then NaN, and numerical is the whole error.
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
        """Return the limit of the settings' model, computed once."""
        key = (*_modelled(settings), self._clamp(settings))
        if key not in self.limits:
            runner = self.runs.runner
            if self._clamp(settings):
                runner = _runner_of(clamped(runner.model.scene, 2 * settings.dt), runner)
            self.limits[key] = self._level(runner, settings, self.base)
        return self.limits[key]

    def _clamp(self, settings: Settings) -> float:
        """Return the time step if `refsafe` softens the scene at this step, else 0 [s]."""
        fixed = settings.accuracy is None
        if settings.law != "solref" or not settings.refsafe or not fixed or not self.acts:
            return 0.0
        shortest = clamping(self.runs.runner.model.scene)
        return settings.dt if shortest and 2 * settings.dt > shortest * (1 + 1e-12) else 0.0

    def gaps(self) -> dict[str, Gap]:
        """Compute the distances of the shipped model to elliptic cones and to rigid contacts.

        "pyramid" is present if friction acts under pyramidal cones. "softness" is present under the
        laws solref and penalty, whose limit is soft; contacts are made harder until the distance
        changes little. The dict is empty if no row acts.
        """
        if not self.acts:
            return {}
        gaps = {"pyramid": self._pyramid(), "softness": self._softness()}
        return {name: gap for name, gap in gaps.items() if gap is not None}

    def _pyramid(self) -> Gap | None:
        """Compute the distance to elliptic cones at a step that resolves the contacts, or None."""
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
        """Compute the distance to the hardest contacts that could be resolved, or None."""
        law, gap = self.runs.shipped.law, None
        for factor in STIFFER if law in HARDER else ():
            distance = self._softer_by(factor)
            if distance is None:
                break
            steady = gap is not None and abs(distance - gap.distance) <= SETTLED * distance
            gap = Gap(distance, HARDER[law].format(factor, factor**2), steady)
        return gap

    def _softer_by(self, factor: float) -> float | None:
        """Compute the distance of the scene to one with harder contacts [m].

        Return None if the harder scene fails, if a step that resolves the harder contacts costs too
        much, or if the distance is too uncertain: halving that step and the reference's error
        change it by more than the share SETTLED.
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
        """Run another model from all starts, with the time step and integrator of a level.

        An integrator that the other model does not support is replaced.
        """
        runs, name = self.runs, like.integrator
        if settings.law != "solref" and name in DAMPING_IMPLICIT:
            name = "semi-implicit"
        if settings.sleep and name in STAGED:
            name = runs.second
        converged = reference_settings(settings, name, like.dt)
        made = self._run(runner, converged)
        runs.spent += runs.cost(name, like.dt) * len(made) / runs.starts
        return Level(like.dt, name, made)

    def _double(self, settings: Settings) -> list[Run] | None:
        """Return the runs under settings in double precision, or None if one fails."""
        if settings not in self.doubles:
            made = self._run(self.runs.runner, settings)
            if made[-1].failure:
                return None
            self.doubles[settings] = made
        return self.doubles[settings]

    def _run(self, runner: Runner, settings: Settings) -> list[Run]:
        """Run from every start until one run fails, and record positions alone."""
        return screened(runner, settings, runner.starts, self.runs.workers, None, True)

    def _apart(self, runs: Sequence[Run], truth: Sequence[Run], cone: str = "pyramidal") -> Errors:
        return errors(runs, truth, self.reference.scored, self.size, STICKS[cone])


def _runner_of(scene: Scene, runner: Runner) -> Runner:
    """Return a runner of another scene with the same settings and schedule."""
    return Runner(Model(scene, runner.model.settings), runner.schedule)


def stiffer(scene: Scene, factor: float) -> Scene:
    """Return a copy of a scene with harder contacts, limits and connections.

    Time constants of solref are divided by `factor`. Equivalently, a direct stiffness is multiplied
    by factor², and a direct damping by factor.
    """

    def hard(ref: Ref) -> Ref:
        if ref[0] > 0:
            return (ref[0] / factor, ref[1])
        return (ref[0] * factor**2, ref[1] * factor)

    return _softened(scene, hard)


def clamped(scene: Scene, least: float) -> Scene:
    """Return a copy of a scene with all solref time constants raised to at least `least` [s]."""
    return _softened(scene, lambda ref: (max(ref[0], least) if ref[0] > 0 else ref[0], ref[1]))


def _softened(scene: Any, change: Callable[[Ref], Ref]) -> Any:
    """Return a copy of a scene with `change` applied to every solref."""
    made = copy.deepcopy(scene)
    for other in (*made.geoms, *made.equalities, *made.pairs, made.contact_override):
        other.solref = change(other.solref)
    for length in (*made.joints, *made.tendons):
        length.solreflimit = change(length.solreflimit)
        length.solreffriction = change(length.solreffriction)
    return made


def _modelled(settings: Settings) -> tuple[Any, ...]:
    """Return the settings of the physical model, with None for those that the law does not use."""
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
    """Return the shortest response time of a contact, limit or connection [s]; inf without any.

    A contact with solref (T, ζ) is an oscillator with 1/ω = ζT and a damping time T. A contact with
    solref (−k, −b) has 1/ω = 1/√k and a damping time 2/b, where k is the acceleration per overlap
    and b the acceleration per speed.
    """
    shortest = math.inf
    for first, second in solrefs(scene):
        if first > 0:
            shortest = min(shortest, first * min(1.0, second))
        elif first < 0:
            damping = 2.0 / -second if second < 0 else math.inf
            shortest = min(shortest, 1.0 / math.sqrt(-first), damping)
    return shortest
