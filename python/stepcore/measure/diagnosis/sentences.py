"""What a diagnosis says in words: the answer first, then what to do, then what to bear in mind."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

from stepcore.report.units import hertz, seconds, times

if TYPE_CHECKING:
    from stepcore.engine.model import Model
    from stepcore.measure.diagnosis.dt_limits import Situation
    from stepcore.measure.diagnosis.element_forces import Key
    from stepcore.measure.diagnosis.element_limits import ElementLimits
    from stepcore.measure.diagnosis.result import Diagnosis
    from stepcore.measure.diagnosis.visited_states import Visit

# Growth of the motion itself that is worth a word [1/s].
NOTABLE = 0.1
# Growth by less than e to this power over the horizon is not called an explosion.
SLOW = 10.0


def answer(d: Diagnosis) -> str:
    """The first sentence: does the wanted dt hold, and who limits it."""
    own = d.settings.integrator
    limit, wanted = d.limit(own), d.wanted
    if math.isinf(limit):
        longest = seconds(d.limits[own].longest)
        return f"Nothing here limits dt below {longest} under {own}{_fastest(d, own)}."
    who = f"{d.stiffest(own)}{_traits(d, own)}"
    if limit <= 0:
        return f"No dt is stable under {own}: {who} grows at every one."
    if wanted > limit:
        verb = _verb(d)
        return f"At {seconds(wanted)} this {verb} under {own}: {who} allows {seconds(limit)}."
    return (
        f"At {seconds(wanted)} this is stable under {own}, with a stability margin of "
        f"{times(limit / wanted)}: {who} allows {seconds(limit)}."
    )


def _verb(d: Diagnosis) -> str:
    """What happens beyond the limit: a fast growth explodes, a slow one is told as such."""
    if d.stiffest().startswith("friction loss"):
        # Its force has an end.
        return "chatters"
    if d.stiffest().startswith(("contact", "limit")):
        # What opens may come to rest again, and open again.
        return "explodes or rattles"
    if d.rate is None or not d.rate * d.horizon < SLOW:
        return "explodes"
    return f"gains energy (e-fold in {seconds(1 / d.rate)}) by the integrator's doing"


def _fastest(d: Diagnosis, own: str) -> str:
    name = d.stiffest(own)
    return f"; the fastest is {name}{_traits(d, own)}" if name else ""


def _traits(d: Diagnosis, own: str) -> str:
    """Frequency and damping of the stiffest element, in brackets."""
    figures = d.element(d.stiffest(own))
    if figures is None:
        return ""
    said = []
    if figures.omega > 0:
        said.append(f"{hertz(figures.omega)}, {figures.omega:.4g} rad/s")
        if not math.isnan(figures.ratio) and figures.key.kind != "spin":
            said.append(f"damping ratio {figures.ratio:.2g}")
    elif figures.rate > 0:
        said.append(f"damping rate {figures.rate:.4g}/s")
    return f" ({', '.join(said)})" if said else ""


def sentences(d: Diagnosis) -> list[str]:
    """The answer and the advice, a sentence each."""
    lines = [answer(d)]
    met = [a.text for a in d.advice if a.met]
    own = d.settings.integrator
    if met:
        lines.append(f"{seconds(d.wanted)} would be met by any one of:")
        lines += [f"- {text}" for text in met]
        lines.append(
            "Each was made on a copy of the model and its step linearised again at all "
            f"{len(d.states)} states."
        )
    elif d.limit(own) < d.wanted:
        lines.append(f"Nothing tried meets {seconds(d.wanted)}.")
    lines += [f"- not enough: {a.text}" for a in d.advice if not a.met]
    limit = d.limits[own]
    if limit.state > 0:
        lines.append(f"The state that decides: {_state(d, limit.state)}.")
    return lines


def _state(d: Diagnosis, index: int) -> str:
    state = d.states[index]
    acting = ", ".join(state.rows[:4]) + (" …" if len(state.rows) > 4 else "")
    return f"{state.label}" + (f", where {acting} act" if acting else "")


def notes(
    model: Model, visit: Visit, here: Situation, elements: dict[Key, ElementLimits], horizon: float
) -> list[str]:
    """What to bear in mind."""
    said = [
        f"looked at {len(here.states)} states: "
        + ", ".join(state.label for state in here.states)
        + f" (a run of {seconds(visit.reached)} at dt {seconds(visit.dt)}, implicitfast)"
    ]
    if visit.failure:
        said.append(f"the run to other states ended early: {visit.failure}")
    elif visit.reached < 0.99 * horizon:
        said.append(
            f"the run was cut at {seconds(visit.reached)} of {seconds(horizon)}: at the dt that "
            "the stiffest element allows the whole would take too many steps"
        )
    growing = max(float(rates.real.max(initial=0.0)) for rates in here.rates)
    if growing > NOTABLE:
        said.append(
            f"the motion itself grows (up to e-fold in {seconds(1 / growing)}: falling, "
            "balanced, or driven): that is physical, and no dt changes it"
        )
    soft = {key: one.softened for key, one in elements.items() if math.isfinite(one.softened)}
    if soft:
        least = min(soft.values())
        names = _some([k.label for k, beyond in soft.items() if beyond == least])
        said.append(
            f"refsafe softens {names} beyond dt {seconds(least)}: it limits no dt, and asks for "
            "less than the scene does instead (refsafe=False, or solref in direct form, keep it)"
        )
    rows = {"contact", "limit", "friction loss"}
    if any(key.kind in rows for key in elements):
        said.append(
            "rows are linearised as they act at each state: a contact or limit that opens when it "
            "rebounds stays finite beyond its limit, and rattles"
        )
    if model.settings.law in ("lesson", "relaxed", "rigid"):
        said.append(
            f"under the law {model.settings.law} the stiffness of a row is 1/dt²: rows follow dt "
            "and limit none"
        )
    return said


def _some(names: list[str], most: int = 4) -> str:
    """The first names, whole, and how many more there are."""
    more = len(names) - most
    return ", ".join(names[:most]) + (f" and {more} more" if more > 0 else "")
