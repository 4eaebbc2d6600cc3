"""A diagnosis in words: the answer first, then the advice, then notes on its limits."""

from __future__ import annotations

import math
from collections.abc import Iterator

from stepcore.measure.diagnosis.advice import MARGIN
from stepcore.measure.diagnosis.dt_limits import SHORTEST
from stepcore.measure.diagnosis.element_limits import ElementLimits
from stepcore.measure.diagnosis.element_names import acting_in_words, are_several, listed
from stepcore.measure.diagnosis.findings import DiagnosisFindings
from stepcore.measure.diagnosis.linear_step import VELOCITY_LAWS
from stepcore.measure.diagnosis.outcomes import blown_up, growth, observed
from stepcore.measure.diagnosis.step_stability import StepStability
from stepcore.measure.diagnosis.visited_states import Visit
from stepcore.report.units import counted, hertz, seconds, times

# Growth of the motion itself that deserves a note [1/s].
NOTABLE = 0.1
# Slower growth, by less than e to this power over the horizon, is not called an explosion.
SLOW = 10.0

# Rates between these [1/s] are named; a damping ratio above this is told by its rate instead, and
# one below this is none.
SLOWEST, FASTEST, OVERDAMPED, NONE = 1e-3, 1e9, 100.0, 1e-6

# Rows that can open.
OPEN = ("contact", "limit", "tendon limit")


def sentences(d: DiagnosisFindings) -> Iterator[str]:
    """The answer, the advice, and the state that decides."""
    own = d.settings.integrator
    yield from blown_up(d)
    yield _answer(d, own)
    yield from observed(d)
    if d.longest_period is not None and d.motion.control_dt is not None:
        yield _period(d.longest_period, d.motion.control_dt, d.wanted)
    met = [a.text for a in d.advice if a.met]
    failed = [a.text for a in d.advice if not a.met]
    if met:
        stable = f"makes {seconds(d.wanted)} stable with a margin of {times(MARGIN)}"
        yield f"Any one of these changes {stable}, the smallest change of the model first:"
        yield from (f"- {text}" for text in met)
        verified = f"verified on the linearised step at {counted(len(d.states), 'state')}"
        yield f"Each was made on a copy of the model, {verified} and in a run of the real step."
    elif d.limit(own) < d.wanted:
        yield f"No change that was tried makes {seconds(d.wanted)} stable."
    if failed:
        yield f"Not enough: {'; '.join(failed)}."
    if 0 < d.limit(own) < d.wanted:
        safe = seconds(round_below(d.limit(own) / MARGIN))
        yield f"Unchanged, the scene needs a step of {safe} for the same margin."
    if d.ran:
        yield f"The motion: {d.ran}."
    limit = d.limits[own]
    if limit.state > 0:
        state = d.states[limit.state]
        acting = acting_in_words([element.name for element in state.rows])
        verb = "acts" if len(state.rows) == 1 else "act"
        where = f", where {acting} {verb}" if acting else ""
        yield f"The limiting state is {state.label}{where}."


def _period(longest: float, asked: float, dt: float) -> str:
    """How long the user's controls are held, and how long they may be."""
    held = f"The control function is sampled every {seconds(asked)}"
    if math.isinf(longest):
        return f"{held}; at steps of {seconds(dt)} every period is stable."
    if longest <= 0:
        return f"{held}; at steps of {seconds(dt)} no period is stable, however short."
    return f"{held}; at steps of {seconds(dt)} a period of up to {seconds(longest)} is stable."


def _answer(d: DiagnosisFindings, own: str) -> str:
    """Whether the wanted dt is stable, and which element limits it."""
    limit, wanted, limiting = d.limit(own), seconds(d.wanted), d.limiting(own)
    name = d.stiffest(own)
    traits = _traits(limiting, len(d.together(own)) > 1) if limiting else ""
    if math.isinf(limit):
        fastest = f" The fastest element is {name}{traits}." if name else ""
        none = f"No element limits dt below {seconds(d.limits[own].longest)} under {own}"
        judged = "until then" if d.runaway else f"judged over {seconds(d.horizon)} of motion"
        return f"{none}, {judged}.{fastest}"
    if limit <= 0:
        cause = no_stable_dt(name, d.limits[own].shortest, traits)
        return f"A step of {wanted} explodes under {own}: {cause}."
    cause = limits_dt(name, limit, traits)
    if d.wanted > limit:
        return f"A step of {wanted} {_outcome(d, limiting)} under {own}: {cause}."
    margin = f"with a stability margin of {times(limit / d.wanted)}"
    stable = f"is stable under {own} {'until then' if d.runaway else f'over {seconds(d.horizon)}'}"
    return f"A step of {wanted} {stable}, {margin}: {cause}."


def limits_dt(name: str, dt: float, traits: str = "") -> str:
    """Which element limits dt to how much [s]; name: "" where no single one does."""
    verb = "limit" if are_several(name) else "limits"
    return f"{name or 'no single element'}{traits} {verb} dt to {seconds(dt)}"


def no_stable_dt(name: str, shortest: float, traits: str = "") -> str:
    """Which element makes every step that was tried, down to `shortest` [s], unstable."""
    verb = "make" if are_several(name) else "makes"
    tried = f"every step tried unstable, down to {seconds(shortest)}"
    return f"{name or 'the motion'}{traits} {verb} {tried}"


def _outcome(d: DiagnosisFindings, limiting: ElementLimits | None) -> str:
    """What happens beyond the limit."""
    if d.limits[own := d.settings.integrator].outcome == "chatters":
        return "chatters"
    if d.limits[own].outcome == "explodes" and d.observed is not None:
        return f"explodes after {seconds(d.observed.time)}"
    kind = limiting.element.kind if limiting else ""
    if kind in ("friction loss", "tendon friction loss"):
        # Its force is bounded.
        return "chatters"
    if kind in OPEN:
        # What opens may come to rest again, and open again.
        return "explodes or rattles"
    if d.rate is None or not d.rate * d.horizon < SLOW:
        return "explodes"
    return f"slowly gains energy from the integrator (e-fold in {seconds(1 / d.rate)})"


def _traits(limits: ElementLimits, several: bool) -> str:
    """Frequency and damping of an element, in brackets; several: of the stiffest of equal ones."""
    traits = ["the stiffest by itself"] if several else []
    damped = not math.isnan(limits.ratio) and limits.element.kind != "spin"
    if SLOWEST < limits.omega < FASTEST and not (damped and limits.ratio > OVERDAMPED):
        traits.append(f"{hertz(limits.omega)}, {limits.omega:.4g} rad/s")
        if damped:
            traits.append(f"damping ratio {limits.ratio if limits.ratio > NONE else 0:.2g}")
    elif SLOWEST < limits.rate < FASTEST:
        traits.append(f"damping rate {limits.rate:.4g}/s")
    return f" ({', '.join(traits)})" if len(traits) > several else ""


def round_below(value: float) -> float:
    """The largest round number that is not above a value > 0.

    >>> round_below(0.00071), round_below(0.0199), round_below(0.001)
    (0.0005, 0.01, 0.001)
    """
    place = math.floor(math.log10(value) + 1e-9)
    return max(x for k in (1, 2, 5) if (x := float(f"{k}e{place}")) <= value * (1 + 1e-9))


def notes(
    here: StepStability,
    visit: Visit,
    elements: list[ElementLimits],
    horizon: float,
    confirmed: bool,
) -> Iterator[str]:
    """Notes on the limits of the diagnosis.

    confirmed: whether two runs at fine steps agree on what the motion itself does.
    """
    labels = ", ".join(state.label for state in here.states)
    run = f"a run of {seconds(visit.reached)} at dt {seconds(visit.dt)} under implicitfast"
    yield f"linearised at {counted(len(here.states), 'state')} of {run}: {labels}"
    if visit.failure:
        yield f"this run ended early: {visit.failure}"
    elif visit.reached < 0.99 * horizon:
        yield (
            f"this run stopped at {seconds(visit.reached)} of {seconds(horizon)}: at a dt that the "
            "stiffest element allows, the whole horizon would take too many steps"
        )
    growing = max(float(rates.real.max(initial=0.0)) for rates in here.rates)
    if growing > NOTABLE:
        yield growth(growing, confirmed)
    softened = [limits for limits in elements if math.isfinite(limits.softened)]
    if softened:
        least = min(limits.softened for limits in softened)
        above = seconds(max(least, SHORTEST))
        names = listed([limits.name for limits in softened if limits.softened == least])
        yield (
            f"above dt {above} the setting refsafe softens {names} as far as stability "
            "needs; refsafe=False, or a solref of negative numbers, keeps the stiffness"
        )
    if any(limits.element.kind in (*OPEN, "friction loss") for limits in elements):
        yield (
            "contacts, limits and friction losses are taken as they act at each state; one that "
            "opens on rebound rattles beyond its largest stable dt, but does not explode"
        )
    if here.model.settings.law in VELOCITY_LAWS:
        yield (
            f"under the law {here.model.settings.law} the stiffness of a row is 1/dt², so rows "
            "limit no dt"
        )
