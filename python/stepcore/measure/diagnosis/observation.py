"""What the motion does at the wanted step, and what that means for the limit."""

from __future__ import annotations

from dataclasses import dataclass, field, replace

from stepcore.measure.diagnosis.judgement import Judge, Outcome, Runaway
from stepcore.measure.diagnosis.limits import Limit
from stepcore.measure.diagnosis.saturation import Saturation, saturation_of, saturations
from stepcore.measure.diagnosis.shares import Shares


@dataclass(frozen=True)
class Observation:
    """What was seen of the motion at the wanted step.

    limit, shares: of the scene's integrator, after it. outcome: what the motion did; None where
    the step is too long to tell. saturations: servos that chatter. lasting: see `Judge.lasting`.
    runaway: where the motion blows up at every step.
    """

    limit: Limit
    shares: Shares
    outcome: Outcome | None = None
    saturations: list[Saturation] = field(default_factory=list)
    lasting: float | None = None
    runaway: Runaway | None = None


def look(judge: Judge | Runaway | None, limit: Limit, shares: Shares, wanted: float) -> Observation:
    """Runs the motion at the wanted step [s], and after kicks beyond the servos' force ranges.

    limit, shares: of the scene's integrator so far.
    """
    if isinstance(judge, Runaway):
        return Observation(limit, shares, runaway=judge)
    if judge is None or wanted > judge.longest:
        return Observation(limit, shares)
    run = judge.run(limit.integrator, wanted)
    outcome = judge.judged(run)
    if limit.dt >= wanted and outcome.kind == "explodes":
        # Driven near its limit, the motion swings wider than the fine run's.
        outcome = replace(outcome, kind="holds")
    if limit.dt < wanted:
        chatter = []
        if limit.outcome == "chatters":
            element = max(shares, key=lambda element: shares[element])
            chatter = [saturation_of(judge, element, run, limit.dt)]
        return Observation(limit, shares, outcome, chatter)
    limit, shares, chatter = kicked(judge, limit, shares, wanted)
    lasting = judge.lasting(limit.integrator, wanted) if outcome.holds else None
    return Observation(limit, shares, outcome, chatter, lasting)


def kicked(
    judge: Judge, limit: Limit, shares: Shares, wanted: float
) -> tuple[Limit, Shares, list[Saturation]]:
    """A limit and its shares after kicks of the servos, and those that chatter then."""
    chatter = saturations(judge, limit.integrator, wanted)
    if chatter and chatter[0].severe:
        limit = replace(limit, dt=chatter[0].dt, state=0, outcome="chatters")
        shares = {chatter[0].element: 1.0}
    return limit, shares, chatter
