"""What a model is wrong by, apart from what its numbers are wrong by.

A *numerical* error is the distance of a run from the limit dt → 0 of its own model; a *modelling*
error is the distance of that limit from another model's. Models differ in the law, the cone and the
softness; single precision counts as one, whose distance is that of a run from the same run in
double precision. Limits are taken with one integrator at one step, so that what is left of their
numerical errors is much the same on both sides.
"""

from __future__ import annotations

import copy
import dataclasses
from collections.abc import Sequence
from typing import Any

from stepcore._core import Settings
from stepcore.model import Model
from stepcore.progress import Progress
from stepcore.trade.errors import STICKS, Errors, errors
from stepcore.trade.reference import Gap, Level, Reference, Search
from stepcore.trade.run import Course, Path

# Settings that say what is modelled, not how it is computed.
MODELLED = (
    *("law", "beta", "softness", "restitution", "slop", "cone", "impratio"),
    *("penalty_stiffness", "penalty_damping_ratio"),
)
# Integrators that only solref knows.
SMOOTH = ("euler", "implicitfast")
# Time constants of solref are divided by these, one after the other, towards a rigid scene.
STIFFER = (4.0, 16.0)
# The last two may differ by this share of the last for softness to be told at all.
SETTLED = 0.25


class Models:
    """Splits errors into numerical and modelling ones; keeps the limits that it finds."""

    def __init__(self, search: Search, reference: Reference, size: float) -> None:
        self.search, self.reference, self.size = search, reference, size
        chains = search.chains
        names = sorted(chains, key=lambda name: name == "rk4")
        near = [level for level in chains[names[0]] if level.dt <= search.finest / 2]
        self.base: Level = near[0] if near else chains[names[0]][-1]
        self.limits: dict[tuple[Any, ...], Level] = {_modelled(search.shipped): self.base}
        self.doubles: dict[Settings, list[Path]] = {}

    def keep(self, settings: Settings, paths: list[Path]) -> None:
        """Remembers runs, so that those in single precision can be compared with them."""
        if settings.precision == "f64" and not paths[-1].failure:
            self.doubles[settings] = paths

    def errors(self, settings: Settings, paths: Sequence[Path]) -> Errors:
        """Errors of one setting, its position error split.

        Where another model's own limit fails, or the run in double precision does, nothing can
        be told apart: modelling is then NaN, and numerical the whole error.
        """
        whole = self._apart(paths, self.reference.paths, settings.cone)
        numerical, modelling = whole.position, 0.0
        exact = settings.replace(precision="f64")
        if settings.precision != "f64":
            double = self._double(exact)
            if double is None:
                return dataclasses.replace(whole, modelling=float("nan"))
            modelling = self._apart(paths, double).position
            numerical = self._apart(double, self.reference.paths).position
            paths = double
        if _modelled(exact) != _modelled(self.search.shipped):
            limit = self.limit(exact)
            if limit.failed:
                return dataclasses.replace(whole, modelling=float("nan"))
            modelling += self._apart(limit.paths, self.base.paths).position
            numerical = self._apart(paths, limit.paths).position
        return dataclasses.replace(whole, numerical=numerical, modelling=modelling)

    def limit(self, settings: Settings) -> Level:
        """The limit of the model that settings stand for."""
        key = _modelled(settings)
        if key not in self.limits:
            pairs = zip(MODELLED, key, strict=True)
            fields = {name: value for name, value in pairs if value is not None}
            self.limits[key] = self._level(self.search.course, fields)
        return self.limits[key]

    def gaps(self) -> dict[str, Gap]:
        """How far the scene as shipped is from one with round cones, and from a rigid one.

        "pyramid": where friction acts under pyramidal cones. "softness": under solref, with all
        time constants shorter until that changes little. Empty where no row acts.
        """
        found: dict[str, Gap] = {}
        course, shipped = self.search.course, self.search.shipped
        if not any(path.rows or path.overlap for path in self.base.paths):
            return found
        if shipped.cone == "pyramidal" and any(any(path.slips) for path in self.base.paths):
            limit = self.limit(shipped.replace(cone="elliptic"))
            if not limit.failed:
                apart = self._apart(limit.paths, self.base.paths).position
                found["pyramid"] = Gap(apart, "elliptic cones")
        if shipped.law == "solref":
            apart_by = []
            for factor in STIFFER:
                scene = stiffer(course.model.scene, factor)
                stiff = Course(Model(scene, course.model.settings), course.dofs, course.motion)
                level = self._level(stiff, {})
                if level.failed:
                    break
                apart_by.append(self._apart(level.paths, self.base.paths).position)
            if apart_by:
                last = apart_by[-1]
                steady = len(apart_by) > 1 and abs(last - apart_by[-2]) <= SETTLED * last
                words = f"solref time constants / {STIFFER[len(apart_by) - 1]:g}"
                found["softness"] = Gap(last, words, steady)
        return found

    def _level(self, course: Course, fields: dict[str, Any]) -> Level:
        """All starts of a course at the step of the base, with some settings changed."""
        search, name = self.search, self.base.integrator
        soft = fields.get("law", search.shipped.law) == "solref"
        if not soft and name in SMOOTH:
            name = "semi-implicit"
        solver = "newton" if soft else "pgs"
        shipped = search.shipped.replace(**fields, integrator=name, solver=solver)
        other = Search(course, shipped, search.finest, 0.0, search.threads, search.executor)
        level = other.level(name, self.base.dt, Progress("", 1, False))
        search.spent += other.spent
        return level

    def _double(self, settings: Settings) -> list[Path] | None:
        """The same runs in double precision, None if they fail."""
        if settings not in self.doubles:
            starts = range(len(self.search.course.motion.starts))
            paths = [self.search.course.run(settings, start) for start in starts]
            if any(path.failure for path in paths):
                return None
            self.doubles[settings] = paths
        return self.doubles[settings]

    def _apart(
        self, paths: Sequence[Path], truth: Sequence[Path], cone: str = "pyramidal"
    ) -> Errors:
        return errors(paths, truth, self.reference.scored, self.size, STICKS[cone])


def stiffer(scene: Any, factor: float) -> Any:
    """A copy of a scene whose contacts, limits and connections are harder.

    Time constants of solref are divided by `factor`; a stiffness given directly is multiplied by
    its square and a damping by it, which is the same.
    """
    made = copy.deepcopy(scene)

    def hard(ref: Sequence[float]) -> tuple[float, float]:
        if ref[0] > 0:
            return (ref[0] / factor, ref[1])
        return (ref[0] * factor**2, ref[1] * factor)

    for geom in made.geoms:
        geom.solref = hard(geom.solref)
    for joint in made.joints:
        joint.solreflimit = hard(joint.solreflimit)
        joint.solreffriction = hard(joint.solreffriction)
    for equality in made.equalities:
        equality.solref = hard(equality.solref)
    return made


def _modelled(settings: Settings) -> tuple[Any, ...]:
    """What settings say of the model; what a law does not use is left out."""
    values = {name: getattr(settings, name) for name in MODELLED}
    soft = settings.law == "solref"
    for name in MODELLED:
        unused = (
            (name in ("beta", "softness", "restitution", "slop") and soft)
            or (name == "impratio" and not soft)
            or (name.startswith("penalty") and settings.law != "penalty")
        )
        if unused:
            values[name] = None
    return tuple(values.values())
