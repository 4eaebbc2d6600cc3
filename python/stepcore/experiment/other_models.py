"""Separates the modelling error of a setting from its numerical error.

The *numerical* error is the distance of a run from the limit dt → 0 of its own model; the
*modelling* error is the distance of that limit from the shipped model's. Models differ in law, cone
and softness. Single precision counts as a model too: its modelling error is the distance of a run
from the same run in double precision. Both limits are computed by one integrator at one time step,
so that their own numerical errors largely cancel: the reference's integrator at twice its step
where runs are measured from a limit, a cheaper one where only limits are compared.
"""

from __future__ import annotations

import copy
import dataclasses
import math
from collections.abc import Callable, Sequence
from functools import partial
from typing import Any

from stepcore._core import Settings
from stepcore.engine.model import Model
from stepcore.experiment.errors import STICKS, Errors, errors
from stepcore.experiment.reference import Gap, Level, Reference, ReferenceRuns
from stepcore.experiment.run import Run
from stepcore.experiment.runner import Runner
from stepcore.report.progress import Progress
from stepcore.scene.elements import Joint, Tendon
from stepcore.scene.scene import Scene

Ref = tuple[float, ...]

# Settings that say what is modelled, not how it is computed.
MODELLED = (
    *(
        "law",
        "beta",
        "softness",
        "restitution",
        "slop",
        "cone",
        "impratio",
        "noslip_iterations",
        "stiction",
    ),
    *("sleep", "sleep_tolerance", "sleep_time"),
    *("max_recovery_speed", "penalty_stiffness", "penalty_damping_ratio"),
)
# Integrators that only solref knows.
SMOOTH = ("euler", "implicitfast", "implicit", "discrete")
# Integrators that solve rows within the step, as sleep does not allow.
STAGED = ("midpoint", "rk4")
# Time constants of solref are divided by these, one after the other, towards a rigid scene.
STIFFER = (4.0, 16.0)
# Laws whose limit is soft, and how they are made harder, in words.
HARDER = {"solref": "solref time constants / {0:g}", "penalty": "penalty_stiffness × {1:g}"}
# The last two may differ by this share of the last for the effect of softness to be known; so may
# each by what half its step changes, and by the reference's own error.
SETTLED = 0.25
# Steps in the shortest time scale of a contact that resolve it; the share of the reference's budget
# that one harder scene may cost.
RESOLVED, SHARE = 8.0, 0.25


class ErrorSplit:
    """Splits errors into numerical and modelling ones; keeps the limits that it computes."""

    def __init__(self, runs: ReferenceRuns, reference: Reference, size: float) -> None:
        self.runs, self.reference, self.size = runs, reference, size
        chains = runs.chains
        names = sorted(chains, key=lambda name: name == "rk4")
        near = [level for level in chains[names[0]] if level.dt <= runs.finest / 2]
        self.cheap: Level = near[0] if near else chains[names[0]][-1]
        self.acts = any(path.rows or path.overlap for path in self.cheap.runs)
        self.base: Level = reference.levels[-2]
        self.limits: dict[tuple[Any, ...], Level] = {}
        self.doubles: dict[Settings, list[Run]] = {}

    def keep(self, settings: Settings, paths: list[Run]) -> None:
        """Keeps runs in double precision, which those in single precision are compared with."""
        if settings.precision == "f64" and not paths[-1].failure:
            self.doubles[settings] = paths

    def errors(self, settings: Settings, paths: Sequence[Run]) -> Errors:
        """Errors of one setting, that of its worst start split.

        Where another model's own limit fails, or the run in double precision does, the two
        parts cannot be separated: modelling is then NaN, and numerical the whole error.
        """
        whole = self._apart(paths, self.reference.runs, settings.cone)
        numerical, modelling = whole.high, 0.0
        exact = settings.replace(precision="f64")
        if settings.precision != "f64":
            double = self._double(exact)
            if double is None:
                return dataclasses.replace(whole, modelling=float("nan"))
            modelling = self._apart(paths, double).high
            numerical = self._apart(double, self.reference.runs).high
            paths = double
        own = self.runs.shipped
        if _modelled(exact) != _modelled(own) or self._clamp(exact):
            limit = self.limit(exact)
            if limit.failed:
                return dataclasses.replace(whole, modelling=float("nan"))
            modelling += self._apart(limit.runs, self.base.runs).high
            numerical = self._apart(paths, limit.runs).high
        return dataclasses.replace(whole, numerical=numerical, modelling=modelling)

    def limit(self, settings: Settings) -> Level:
        """The limit of the model that these settings compute."""
        key = (*_modelled(settings), self._clamp(settings))
        if key not in self.limits:
            runner = self.runs.runner
            if self._clamp(settings):
                scene = clamped(runner.model.scene, 2 * settings.dt)
                model = Model(scene, runner.model.settings)
                runner = Runner(model, runner.schedule)
            self.limits[key] = self._level(runner, settings, self.base)
        return self.limits[key]

    def _clamp(self, settings: Settings) -> float:
        """The step at which `refsafe` makes the scene softer [s], 0 where it does not."""
        if settings.law != "solref" or not settings.refsafe or not self.acts:
            return 0.0
        shortest = clamping(self.runs.runner.model.scene)
        return settings.dt if shortest and 2 * settings.dt > shortest * (1 + 1e-12) else 0.0

    def gaps(self) -> dict[str, Gap]:
        """How far the shipped model is from one with elliptic cones, and from a rigid one.

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
        if shipped.cone != "pyramidal" or not any(any(path.slips) for path in self.cheap.runs):
            return None
        shortest = time_scale(runner.model.scene) if shipped.law == "solref" else math.inf
        levels = [self.cheap, *(level for chain in self.runs.chains.values() for level in chain)]
        fine = [level for level in levels if level.dt * RESOLVED <= shortest]
        if not fine:
            return None
        near = next((level for level in fine if level is self.cheap), None)
        near = near or max(fine, key=lambda level: (level.dt, level.integrator != "rk4"))
        limit = self._level(runner, shipped.replace(cone="elliptic"), near)
        if limit.failed:
            return None
        return Gap(self._apart(limit.runs, near.runs).high, "elliptic cones")

    def _softness(self) -> Gap | None:
        """The distance to the hardest contacts that could be run at steps that resolve them."""
        law, found = self.runs.shipped.law, None
        for factor in STIFFER if law in HARDER else ():
            distance = self._softer_by(factor)
            if distance is None:
                break
            steady = found is not None and abs(distance - found.distance) <= SETTLED * distance
            found = Gap(distance, HARDER[law].format(factor, factor**2), steady)
        return found

    def _softer_by(self, factor: float) -> float | None:
        """How far the scene is from one with harder contacts [m].

        None where that cannot be known: where the harder scene fails, where a step that resolves
        it costs too much, or where half that step still moves it by more than a share.
        """
        runs = self.runs
        runner, settings = runs.runner, runs.shipped
        if settings.law == "penalty":
            stiff = settings.penalty_stiffness * factor**2
            settings, dt = settings.replace(penalty_stiffness=stiff), self.cheap.dt / factor
        else:
            scene = stiffer(runner.model.scene, factor)
            runner, dt = Runner(Model(scene, runner.model.settings), runner.schedule), self.cheap.dt
            halvings = math.log2(max(1.0, dt * RESOLVED / time_scale(scene)))
            dt /= 2 ** math.ceil(halvings - 1e-9)
        coarse, fine = (Level(step, self.cheap.integrator, []) for step in (dt, dt / 2))
        if sum(runs.cost(level.integrator, level.dt) for level in (coarse, fine)) > (
            SHARE * runs.budget
        ):
            return None
        coarse = self._level(runner, settings, coarse)
        fine = fine if coarse.failed else self._level(runner, settings, fine)
        if coarse.failed or fine.failed:
            return None
        distance = self._apart(fine.runs, self.reference.runs).high
        unsure = self._apart(coarse.runs, fine.runs).high + self.reference.high
        return distance if unsure <= SETTLED * distance else None

    def _level(self, runner: Runner, settings: Settings, like: Level) -> Level:
        """All starts of another model's runner, at the step and with the integrator of a level."""
        runs, name = self.runs, like.integrator
        soft = settings.law == "solref"
        if not soft and name in SMOOTH:
            name = "semi-implicit"
        if settings.sleep and name in STAGED:
            name = runs.second
        solver = "newton" if soft else "pgs"
        shipped = settings.replace(integrator=name, solver=solver, acceleration="none")
        other = ReferenceRuns(runner, shipped, runs.finest, 0.0, runs.workers, runs.weight)
        level = other.level(name, like.dt, Progress("", 1, False), bare=True)
        runs.spent += other.spent
        return level

    def _double(self, settings: Settings) -> list[Run] | None:
        """The same runs in double precision, None if they fail."""
        if settings not in self.doubles:
            runs, bar = self.runs, Progress("", self.runs.starts, False)
            job = partial(runs.runner.run, settings)
            paths = runs.workers.until(lambda path: path.failure, job, range(runs.starts), bar)
            if paths[-1].failure:
                return None
            self.doubles[settings] = paths
        return self.doubles[settings]

    def _apart(self, paths: Sequence[Run], truth: Sequence[Run], cone: str = "pyramidal") -> Errors:
        return errors(paths, truth, self.reference.scored, self.size, STICKS[cone])


def stiffer(scene: Any, factor: float) -> Any:
    """A copy of a scene whose contacts, limits and connections are harder.

    Time constants of solref are divided by `factor`; a stiffness given directly is multiplied by
    its square and a damping by it, which is the same.
    """

    def hard(ref: Ref) -> Ref:
        if ref[0] > 0:
            return (ref[0] / factor, ref[1])
        return (ref[0] * factor**2, ref[1] * factor)

    return _softened(scene, hard)


def clamped(scene: Any, least: float) -> Any:
    """A copy of a scene none of whose time constants of solref is below `least` [s]."""
    return _softened(scene, lambda ref: (max(ref[0], least) if ref[0] > 0 else ref[0], ref[1]))


def _softened(scene: Any, change: Callable[[Ref], Ref]) -> Any:
    """A copy of a scene with every solref changed."""
    made = copy.deepcopy(scene)
    for geom in made.geoms:
        geom.solref = change(geom.solref)
    lengths: list[Joint | Tendon] = [*made.joints, *made.tendons]
    for length in lengths:
        length.solreflimit = change(length.solreflimit)
        length.solreffriction = change(length.solreffriction)
    for other in (*made.equalities, *made.pairs, made.contact_override):
        other.solref = change(other.solref)
    return made


def _modelled(settings: Settings) -> tuple[Any, ...]:
    """What settings say of the model; what a law does not use is left out."""
    values = {name: getattr(settings, name) for name in MODELLED}
    soft = settings.law == "solref"
    for name in MODELLED:
        unused = (
            (name in ("beta", "softness", "restitution", "slop") and soft)
            or (name in ("impratio", "noslip_iterations", "stiction") and not soft)
            or (name.startswith("sleep_") and not settings.sleep)
            or (name.startswith("penalty") and settings.law != "penalty")
        )
        if unused:
            values[name] = None
    return tuple(values.values())


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
