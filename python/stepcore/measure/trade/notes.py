"""Notes on a trade: on its reference, on what it observed, and on the settings that failed."""

from __future__ import annotations

import re
from collections.abc import Iterator, Mapping, Sequence

import numpy as np

from stepcore.experiment.growth import GROWTH, NEARBY
from stepcore.experiment.reference import FINER, Gap, Reference, smallest
from stepcore.experiment.schedule import Schedule
from stepcore.measure.trade.moves import Steps
from stepcore.measure.trade.row import TradeRow
from stepcore.report.units import compact, counted, metres, seconds, times

# A residual of the reference that is worth saying [m/s].
UNSOLVED = 1e-9
# Two integrators do not agree where they are this many times further apart than the
# reference's error and what the other's last halving moved it.
DISAGREE = 4.0


def about_run(
    schedule: Schedule, rows: int, forces: bool, softened: float | None, asked: float | None
) -> Iterator[str]:
    """Notes on the motion.

    rows: the most at once. forces: contacts are forces and not rows. softened: the time constant
    that refsafe guards [s], or None. asked: the horizon that was asked for [s].
    """
    if asked is not None and schedule.horizon < asked * (1 - 1e-9):
        yield (
            f"the horizon is {seconds(schedule.horizon)} instead of {seconds(asked)}, because it "
            "must be a whole number of samples"
        )
    if rows == 0:
        what = "contacts are forces under the law penalty, and" if forces else "no contact,"
        what += " no limit or other row" if forces else " limit or other row"
        yield f"{what} was ever active, so the solver does not matter"
    if schedule.undriven:
        names = ", ".join(schedule.undriven)
        yield f"actuators without a control range are not driven: {names}"
    if softened is not None:
        yield (
            f"refsafe keeps the time constants of contacts and limits at 2 dt or more; above "
            f"dt {seconds(softened / 2)} (rows marked c) this softens the scene itself"
        )


def about_reference(reference: Reference, rows: Sequence[TradeRow], size: float) -> Iterator[str]:
    """Notes on the converged motion that errors are measured from, and how well it is known."""
    ends = reference.growth.ends
    lost = int(np.isfinite(ends).sum())
    if lost:
        yield (
            f"{lost} of {len(ends)} starts cannot be predicted to the end (the first one only for "
            f"{seconds(float(ends.min()))}), and their errors count only until then: a "
            f"perturbation of {NEARBY:g} of the scene's size has grown more than {GROWTH:g} times"
        )
    if reference.exact is not None:
        yield (
            "errors are measured from the closed form of the motion; the converged run differs "
            f"from it by {metres(reference.exact.check)}"
        )
    if reference.stiffens:
        yield (
            f'under the law "{reference.settings.law}" contacts stiffen as dt shrinks (beta/dt): '
            "errors are measured from the limit dt → 0, where contacts are harder than as shipped"
        )
    for name, gap in reference.gaps.items():
        yield _modelling(name, gap)
    least = smallest([row.errors.high for row in rows if row.errors], size)
    if reference.high * FINER > least > 0:
        yield (
            "errors are measured from a converged motion, which is itself only known to "
            f"{metres(reference.high)}: errors up to {FINER:.0f} times that are uncertain by so "
            f"much, and smaller ones are printed as <{compact(reference.high)}; a larger `effort` "
            "(--effort) converges it further"
        )
    marked = sum(row.best and row.below_max and not row.below for row in rows)
    if marked:
        yield (
            f"the column max is uncertain by {metres(reference.largest)}, the largest error of the "
            f"converged motion; {marked} of the best rows are below that"
        )
    rest = max(path.residual for path in reference.runs)
    if rest > UNSOLVED:
        yield (
            "the converged motion that errors are measured from has rows that its solver left at a "
            f"residual of {rest:.0e} m/s"
        )
    if reference.other and reference.agreement > DISAGREE * (
        reference.other_error + reference.error
    ):
        yield (
            f"two integrators converge to motions {metres(reference.agreement)} apart: "
            f"{reference.other} moved by only {metres(reference.other_error)} when its step was "
            f"halved, and does not come nearer to {reference.level.integrator}; take errors below "
            "that distance as unknown"
        )


def about_search(reference: Reference, steps: Steps, finest: float) -> Iterator[str]:
    """What a search left out: time steps shorter than the reference can judge.

    finest: the shortest step [s] that it begins with where the reference is fine enough.
    """
    shortest = 2 * reference.settings.dt
    if shortest > min(finest, steps.shipped) * (1 + 1e-9):
        yield (
            f"no time step below {seconds(shortest)} was searched: the converged motion, at dt "
            f"{seconds(reference.settings.dt)} within its `effort` (--effort), cannot judge them"
        )


def observed(reference: Reference, horizon: float, orders: Mapping[str, float]) -> Iterator[str]:
    """How long the motion can be predicted, and the order that each integrator shows."""
    growth = reference.growth
    if np.isfinite(growth.overall):
        yield f"the motion can be predicted for {seconds(growth.overall)} of {seconds(horizon)}"
    else:
        most = float(growth.factor.max())
        yield (
            f"the motion can be predicted over all of {seconds(horizon)}: perturbations grow at "
            f"most {times(most)}"
        )
    if orders:
        shown = ", ".join(f"{name} {order:.2g}" for name, order in orders.items())
        yield f"observed order of accuracy in the worst start: {shown}"


def failed(rows: Sequence[TradeRow]) -> Iterator[str]:
    """One note on all failures, by integrator and solver."""
    failures: dict[tuple[str, str], list[TradeRow]] = {}
    for row in rows:
        if row.failure:
            failures.setdefault((row.settings.integrator, row.settings.solver), []).append(row)
    if not failures:
        return
    count = sum(map(len, failures.values()))
    steps = [f"{', '.join(kind)} at {_steps(some)}" for kind, some in failures.items()]
    first = next(iter(failures.values()))[0]
    steps[0] += f" ({short(first.failure or '')})"
    yield f"{counted(count, 'setting')} fail{'s' * (count == 1)}: {'; '.join(steps)}"


def _steps(some: Sequence[TradeRow]) -> str:
    """The time steps of rows that stand coarsest first."""
    coarsest, finest = (seconds(row.settings.dt) for row in (some[0], some[-1]))
    return f"dt {coarsest}" if coarsest == finest else f"dt {finest} to {coarsest}"


def short(failure: str) -> str:
    """The first sentence of a failure; the post-mortem is in the row's `failure`.

    >>> short("start 0: diverged at 0.1 s: a force is not finite. The cause is spring `a`, 9 %.")
    'start 0: diverged at 0.1 s: a force is not finite'
    """
    return re.split(r"\.\s+(?=[A-Z])", failure, maxsplit=1)[0].rstrip(".")


def _modelling(name: str, gap: Gap) -> str:
    """How far the scene's own model is from another."""
    what = {
        "pyramid": "the friction pyramid moves positions by",
        "softness": "the softness of contacts and limits moves positions by",
    }[name]
    least = "" if gap.settled else " at least"
    return (
        f"modelling error: {what}{least} {metres(gap.distance)} (RMS, worst start; compared with "
        f"{gap.against}); no time step and no solver changes this"
    )
