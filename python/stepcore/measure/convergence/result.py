"""`Convergence`: what `converge` returns."""

from __future__ import annotations

import math
import os
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from stepcore._core import Settings
from stepcore.measure.convergence.closing import Closing, Push
from stepcore.measure.convergence.runs import Plan, Run
from stepcore.measure.convergence.theory import Theory
from stepcore.report.result import Result
from stepcore.report.table import Table

# Forces that are not converged matter where they move bodies by more than this share of what the
# time step does, and by more than this share of the scene's size.
SHARE, NOTABLE = 1.0, 1e-5
# A residual moves a body no further than its speed for the whole motion, times this where small
# differences grow.
GROWTH = 100.0
# Something that moves less than this share of the distance in the whole motion rests.
STILL = 0.1


@dataclass(frozen=True)
class Rest:
    """Where the settings' own motion ends beside that with converged forces.

    body: the one furthest apart, by `apart` [m], in which start. speed, solved_speed: its mean
    over the last tenth of the motion [m/s]. solver: positions apart over the motion, rms [m].
    """

    start: int
    body: str
    apart: float
    speed: float
    solved_speed: float
    solver: float


@dataclass
class Convergence(Result):
    """Whether a scene's rows are solved, and whether sweeps or smaller steps buy more.

    runs: by settings; curves: see `Closing`; plan: which runs are which. reference: the settings
    of the converged run that all are compared with, itself known to `reference_error` [m].

    >>> from stepcore import converge, lesson
    >>> tower = lesson.stack(50, "rigid", (1.0, 1.0))
    >>> found = converge(tower, horizon=0.2, starts=1, states=2, progress=False)
    >>> found
    <Convergence of tower: solved>
    >>> print(f"{found.contraction:.3f}, theory", found.theory.formula)
    0.500, theory m_top/(m_top + m_bottom) = 1/(1 + 1)
    """

    name: str
    settings: Settings
    horizon: float
    starts: int
    plan: Plan
    runs: dict[Settings, Run]
    curves: list[Closing]
    reference: Settings
    reference_error: float
    size: float
    rest: Rest | None
    notes: list[str] = field(default_factory=list)

    @property
    def title(self) -> str:
        """What was measured."""
        return f"How {self.name} converges"

    @property
    def own(self) -> Run:
        """The run under the scene's own settings."""
        return self.runs[self.settings]

    @property
    def solved(self) -> Run:
        """The same with converged forces."""
        return self.runs[self.plan.solved]

    @property
    def verdict(self) -> str:
        """ "diverging", "under-solved", "no rows" or "solved"."""
        if self.own.failure or self.rest is None:
            return "diverging"
        if not self.curves:
            return "no rows"
        apart = self.rest.solver
        matters = apart > max(SHARE * self.solved.error, NOTABLE * self.size)
        able = apart < GROWTH * self.own.residual * self.horizon
        return "under-solved" if matters and able else "solved"

    @property
    def slowest(self) -> Closing | None:
        """The state at which sweeps close in slowest, at the settings' own time step."""
        known = [c for c in self.at(self.settings.dt) if c.contraction is not None]
        return max(known, key=lambda c: c.contraction or 0.0, default=None)

    @property
    def contraction(self) -> float | None:
        """What a sweep leaves of the error in the end, at the slowest state, as measured."""
        return self.slowest.contraction if self.slowest else None

    @property
    def theory(self) -> Theory:
        """What theory says of the same state."""
        return self.slowest.theory if self.slowest else Theory(why="no two rows at once")

    def at(self, dt: float) -> list[Closing]:
        """The curves at one time step."""
        return [curve for curve in self.curves if curve.dt == dt]

    def residual(self, dt: float, sweeps: int, warm: bool = False) -> float:
        """After so many sweeps (one of `Closing.sweeps`), the median of the states [m/s]."""
        found = []
        for curve in self.at(dt):
            if curve.cold:
                values = curve.warm if warm else curve.cold
                found.append(values[curve.sweeps.index(sweeps)])
        return float(np.median(found)) if found else math.nan

    @property
    def rows(self) -> Table:
        """What has rows, the furthest from its converged force first; see `Push`.

        After the settings' own sweeps, at the state where most is missing; states: in how many
        it has rows.
        """
        worst: dict[str, Push] = {}
        count: dict[str, int] = {}
        for curve in self.at(self.settings.dt):
            for push in curve.pushes:
                name = push.name
                if name not in worst or push.missing > worst[name].missing:
                    worst[name] = push
                count[name] = count.get(name, 0) + 1
        order = sorted(worst.values(), key=lambda push: -push.missing)
        records = [{**vars(push), "states": count[push.name]} for push in order]
        names = ["name", "missing", "residual", "force", "solved", "states"]
        return Table(records, names, dict.fromkeys(("missing", "residual"), ".2e"))

    @property
    def sweeps(self) -> Table:
        """Residual by the number of sweeps, cold and warm: median and worst of the states [m/s]."""
        curves = [c for c in self.at(self.settings.dt) if c.cold]
        records = []
        for k, count in enumerate(curves[0].sweeps if curves else ()):
            record: dict[str, Any] = {"sweeps": count}
            for kind in ("cold", "warm"):
                values = [getattr(curve, kind)[k] for curve in curves]
                record[kind], record[f"{kind} worst"] = float(np.median(values)), max(values)
            records.append(record)
        names = ("cold", "cold worst", "warm", "warm worst")
        return Table(records, ["sweeps", *names], dict.fromkeys(names, ".2e"))

    @property
    def steps(self) -> Table:
        """By time step, all else as it is.

        residual: the worst along the motion [m/s]; contraction: at the slowest state; error: of
        positions [m]; updates: of rows per simulated second.
        """
        records = []
        for settings in self.plan.dts:
            run = self.runs[settings]
            known = [c.contraction for c in self.at(settings.dt) if c.contraction is not None]
            records.append(
                {
                    "dt": settings.dt,
                    "residual": run.residual,
                    "contraction": max(known, default=math.nan),
                    "error": run.error,
                    "updates": run.updates,
                    "failure": run.failure,
                }
            )
        return _numbers(records)

    @property
    def work(self) -> Table:
        """Equal row updates as steps × sweeps, under pgs; and four times the settings' own work.

        error: of positions [m]; overlap, joint: the deepest and the widest gap [m].
        """
        named = [(f"{s.steps}x{s.sweeps}", s.settings) for s in self.plan.splits]
        named.append(("own", self.settings))
        if self.plan.more is not None:
            named.append(("own, 4 x sweeps", self.plan.more))
        quarter = [s for s in self.plan.dts if math.isclose(s.dt, self.settings.dt / 4)]
        named += [("own, 1/4 dt", quarter[0])] if quarter else []
        named.append(("own dt, converged", self.plan.solved))
        records = []
        for name, settings in named:
            run = self.runs[settings]
            solver = settings.solver
            records.append(
                {
                    "steps x sweeps": name,
                    "dt": settings.dt,
                    "sweeps": settings.sweeps if solver == "pgs" else solver,
                    "error": run.error,
                    "overlap": run.overlap,
                    "joint": run.joint,
                    "updates": run.updates,
                    "failure": run.failure,
                }
            )
        return _numbers(records)

    @property
    def better(self) -> str:
        """ "smaller steps", "more sweeps" or "neither": what buys more at equal row updates."""
        from stepcore.measure.convergence.report import better

        return better(self)

    def text(self, width: int | None = None, full: bool = False) -> str:
        """The verdict in words, and the tables."""
        from stepcore.measure.convergence.report import text

        return text(self, width)

    def to_dict(self) -> dict[str, Any]:
        """Everything as plain data."""
        slowest = self.slowest
        return {
            "name": self.name,
            "verdict": self.verdict,
            "better": self.better,
            "settings": self.settings.as_dict(),
            "horizon": self.horizon,
            "starts": self.starts,
            "contraction": self.contraction,
            "theory": self.theory.radius,
            "closed_form": self.theory.formula,
            "closed_form_value": self.theory.closed,
            "slowest_time": slowest.time if slowest else None,
            "reference": self.reference.as_dict(),
            "reference_error": self.reference_error,
            "size": self.size,
            "rest": None if self.rest is None else vars(self.rest),
            "rows": self.rows.records,
            "sweeps": self.sweeps.records,
            "steps": self.steps.records,
            "work": self.work.records,
            "notes": self.notes,
        }

    def plot(self, path: str | os.PathLike[str] | None = None) -> Any:
        """Residual against sweeps, and the error of equal work. Needs matplotlib."""
        from stepcore.report.plot.convergence import plot_convergence

        return plot_convergence(self, path)

    def __repr__(self) -> str:
        return f"<Convergence of {self.name}: {self.verdict}>"


def _numbers(records: list[dict[str, Any]]) -> Table:
    """Without columns that say nothing; errors in two digits."""
    columns = [n for n in records[0] if any(r[n] not in (None, "") for r in records)]
    short = ("residual", "error", "overlap", "joint", "updates")
    return Table(records, columns, dict.fromkeys(short, ".2e") | {"contraction": ".4f"})
