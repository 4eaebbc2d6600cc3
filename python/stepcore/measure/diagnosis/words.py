"""Put a diagnosis into words: what limits dt, what the motion did, and notes on the limits."""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence

from stepcore.engine.element import INERTIAL, Element, Elements, listed
from stepcore.measure.diagnosis.circulation import Circulation
from stepcore.measure.diagnosis.isolated import ElementLimits
from stepcore.measure.diagnosis.limits import SHORTEST, Limit
from stepcore.measure.diagnosis.linear_step import VELOCITY_LAWS
from stepcore.measure.diagnosis.motion_check import Runaway
from stepcore.measure.diagnosis.saturation import Saturation
from stepcore.measure.diagnosis.visited_states import Visit
from stepcore.report.units import counted, hertz, seconds

# Growth of the motion itself that deserves a note, and growth that no dt resolves [1/s].
NOTABLE, UNRESOLVED = 0.1, 1e6
# Frequencies and rates in this range [1/s] are printed.
PRINTED = (1e-3, 1e9)
# A damping ratio above the first is printed as a rate instead, and one below the second as 0.
OVERDAMPED, UNDAMPED = 100.0, 1e-6
# The sentence gives a servo's speed from this ratio to the fastest of the fine run.
THROWN = 1.5
# Rows that can open.
OPEN = ("contact", "limit", "tendon limit")
FRICTION = ("friction loss", "tendon friction loss")


def named(elements: Sequence[Element]) -> str:
    """Return the names of elements as text; "" for none."""
    return Elements(elements).together


def limits_dt(elements: Sequence[Element], dt: float, traits: str = "") -> str:
    """Return which elements limit dt, and to what value.

    elements: the elements.
    dt: the limit [s].
    traits: a text in brackets after the elements' names.
    """
    if not elements:
        return f"the motion as a whole, no single element, limits dt to {seconds(dt)}"
    return f"{named(elements)}{traits} {_verb(elements, 'limit')} dt to {seconds(dt)}"


def no_stable_dt(elements: Sequence[Element], shortest: float, traits: str = "") -> str:
    """Return which elements make every step tried unstable.

    elements: the elements.
    shortest: the shortest step tried [s].
    traits: a text in brackets after the elements' names.
    """
    tried = f"every step tried unstable, down to {seconds(shortest)}"
    return f"{named(elements) or 'the motion'}{traits} {_verb(elements, 'make')} {tried}"


def _verb(elements: Sequence[Element], verb: str) -> str:
    """Return the verb in the form that follows the elements' names."""
    return verb if len(elements) > 1 or INERTIAL in elements else verb + "s"


def traits_of(limits: ElementLimits, several: bool) -> str:
    """Return frequency and damping of an element, in brackets.

    limits: the element on its own.
    several: whether the element is the stiffest of several equal ones.
    """
    low, high = PRINTED
    traits = ["the stiffest by itself"] if several else []
    damped = not math.isnan(limits.ratio) and limits.element.kind != "spin"
    if low < limits.omega < high and not (damped and limits.ratio > OVERDAMPED):
        traits.append(f"{hertz(limits.omega)}, {limits.omega:.4g} rad/s")
        if damped:
            traits.append(f"damping ratio {limits.ratio if limits.ratio > UNDAMPED else 0:.2g}")
    elif low < limits.rate < high:
        traits.append(f"damping rate {limits.rate:.4g}/s")
    return f" ({', '.join(traits)})" if len(traits) > several else ""


# The failure beyond a limit, as a verb phrase.
BEYOND = {
    "passes": "lets a body pass through another one",
    "turns": "lets a body make more than half a turn in a step",
}


def state_of_limit(limit: Limit) -> str:
    """Return the state in which an element limits dt, where it does not limit it as usual; or "".

    The frequency of an element on its own has nothing to do with these limits.
    """
    if limit.outcome == "passes":
        return ", where a longer step lets one body pass through the other,"
    if limit.outcome == "chatters":
        return ", while saturated,"
    if limit.speed is not None:
        half = ", half a turn a step" if limit.outcome == "turns" else ""
        return f" (at {limit.speed:.3g} rad/s{half})"
    return ""


def circulatory(circulation: Circulation) -> str:
    """Return the sentence on servos whose forces derive from no energy."""
    servos, one = Elements(circulation.elements).name, len(circulation.elements) == 1
    on = f" on the joint {circulation.joint.removeprefix('joint ')}" if circulation.joint else ""
    doubling = seconds(math.log(2) / circulation.growth)
    rest = "does not grow" if circulation.without <= 0 else "hardly grows"
    return (
        f"{servos[0].upper()}{servos[1:]}{on} {'is' if one else 'are'} no gradient of an energy: "
        f"turning, {'it feeds' if one else 'they feed'} the motion (circulatory forces, flutter), "
        f"which doubles every {doubling} at any dt; without that part it {rest}. No dt and no "
        "integrator cures that. An orientation servo for the whole rotation has an energy."
    )


def period_in_words(longest: float, asked: float, dt: float) -> str:
    """Return the control period, and the longest stable one.

    longest: the longest stable period [s].
    asked: the present period [s].
    dt: the step [s].
    """
    stable = f"a period of up to {seconds(longest)} is stable"
    if math.isinf(longest):
        stable = "every period is stable"
    elif longest <= 0:
        stable = "no period is stable, however short"
    held = f"The control function is sampled every {seconds(asked)}"
    return f"{held}; at steps of {seconds(dt)} {stable}."


def blown_up(runaway: Runaway) -> str:
    """Return the sentence on a motion that blows up at every step."""
    coarse, fine = (seconds(dt) for dt in runaway.dts)
    before, after = (seconds(time) for time in runaway.times)
    if not runaway.alike:
        how = f": after {before} at {coarse}, after {after} at {fine}. These do not agree"
        if min(runaway.dts) < SHORTEST:
            # Nobody asks for such steps, or for times as short.
            longest = seconds(max(*runaway.times, SHORTEST))
            how = f", within {longest} but at different times"
        cause = "the cause may be the step or the motion"
        return f"The motion blows up at every step tried{how}: {cause}."
    grows = ""
    if runaway.element:
        grows = f": {runaway.element.name} {_verb([runaway.element], 'make')} it grow"
    return (
        f"The motion itself blows up after {after}, at a step of {fine} as at {coarse}{grows}. "
        "No dt cures that."
    )


def late_growth(horizon: float, dt: float, lasting: float) -> str:
    """Return the sentence on growth by the integrator that shows after the horizon.

    horizon: the time that was judged [s].
    dt: the step [s].
    lasting: when the motion explodes [s].
    """
    return (
        f"Beyond the {seconds(horizon)} that was judged the integrator's error adds up: at "
        f"{seconds(dt)} the motion explodes after {seconds(lasting)}; at a quarter of the step it "
        "does not."
    )


def chatter(servo: Saturation) -> str:
    """Return the sentence on a servo whose force jumps from end to end."""
    kicked = "" if servo.reached else f"kicked beyond {_speed(servo, servo.speed)}, "
    begins = f"{kicked}{servo.element.name} reaches its force range of ±{_force(servo)}"
    chatters = (
        "saturated, its kv has no effect, and its force jumps from one end to the other within a "
        "step"
    )
    if servo.swinging:
        chatters = (
            "its force jumps from one end to the other, for good. Where friction or the range "
            "holds it, the linearised step does not show this"
        )
    elif servo.thrown > THROWN * servo.usual:
        chatters += f", which throws {servo.joint} to {_speed(servo, servo.thrown)}"
    return f"{begins[0].upper()}{begins[1:]}: {chatters}. The motion stays finite."


def gentle_chatter(servo: Saturation) -> str:
    """Return the note on a servo that chatters only after a kick, and gently."""
    return (
        f"kicked beyond {_speed(servo, servo.speed)}, {servo.element.name} saturates, so its kv "
        f"has no effect, and it chatters between the ends of its force range, ±{_force(servo)}, at "
        f"up to {_speed(servo, servo.thrown)}; below dt {seconds(servo.dt)} it does not"
    )


def _speed(servo: Saturation, value: float) -> str:
    return f"{value:.3g} {'rad/s' if servo.angular else 'm/s'}"


def _force(servo: Saturation) -> str:
    return f"{servo.force:.4g} {'N·m' if servo.angular else 'N'}"


def notes(
    visit: Visit, elements: Sequence[ElementLimits], horizon: float, confirmed: bool
) -> Iterator[str]:
    """Yield notes on the validity of the diagnosis.

    visit: the states along the motion.
    elements: the elements on their own.
    horizon: the length of the motion [s].
    confirmed: whether two runs at fine steps agree on the motion itself.
    """
    here = visit.here
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
        names = listed([limits.name for limits in softened if limits.softened == least])
        yield (
            f"above dt {seconds(max(least, SHORTEST))} the setting refsafe (MuJoCo's) softens "
            f"{names}; refsafe=False, or a solref of negative numbers, keeps the stiffness"
        )
    if any(limits.element.kind in (*OPEN, "friction loss") for limits in elements):
        yield (
            "contacts, limits and friction losses are linearised as they act at each state; above "
            "their largest stable dt contacts and limits may rattle, but do not explode"
        )
    if here.model.settings.law in VELOCITY_LAWS:
        yield (
            f"under the law {here.model.settings.law} the stiffness of a row is 1/dt², so rows "
            "do not limit dt"
        )


def growth(rate: float, confirmed: bool) -> str:
    """Return the note on growth of the motion itself.

    rate: the fastest growth at any state [1/s].
    confirmed: whether two runs at fine steps agree on the motion itself.
    """
    if rate > UNRESOLVED:
        return (
            f"at some state nearby motions diverge e-fold in less than {seconds(1 / UNRESOLVED)}, "
            "faster than any step that is tried: check masses and gains"
        )
    doubling = f"nearby motions diverge, doubling every {seconds(math.log(2) / rate)}"
    if confirmed:
        return (
            f"{doubling} at the fastest, as where a body falls, balances or is driven; two fine "
            "steps agree, so this is physical, and no dt changes it"
        )
    return f"{doubling} at some state; no finer step confirms that this is physical"
