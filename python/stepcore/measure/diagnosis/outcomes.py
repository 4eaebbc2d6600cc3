"""What the motion itself did at the wanted step, in words."""

from __future__ import annotations

from collections.abc import Iterator, Sequence

from stepcore.measure.diagnosis.element_names import are_several
from stepcore.measure.diagnosis.findings import DiagnosisFindings
from stepcore.measure.diagnosis.saturation import Saturation
from stepcore.report.units import seconds

# A speed over that of the motion at a fine step that is told.
THROWN = 1.5
# Growth that no step resolves [1/s].
FASTEST = 1e6


def observed(d: DiagnosisFindings) -> Iterator[str]:
    """What was seen of the motion beyond the answer: saturated servos, slow growth."""
    for saturation in d.saturations:
        if saturation.reached or saturation.severe:
            yield _chatter(d, saturation)
    if d.lasting is not None:
        yield (
            f"Beyond the {seconds(d.horizon)} that was judged the integrator's error adds up: at "
            f"{seconds(d.wanted)} the motion explodes after {seconds(d.lasting)}; at a quarter of "
            "the step it does not."
        )


def blown_up(d: DiagnosisFindings) -> Iterator[str]:
    """That the motion blows up at every step, and what grows."""
    runaway = d.runaway
    if runaway is None:
        return
    coarse, fine = (seconds(dt) for dt in runaway.dts)
    before, after = (seconds(time) for time in runaway.times)
    if runaway.alike:
        grows = ""
        if runaway.element:
            name = runaway.element.name
            grows = f": {name} {'make' if are_several(name) else 'makes'} it grow"
        yield (
            f"The motion itself blows up after {after}, at a step of {fine} as at {coarse}{grows}. "
            "No dt cures that."
        )
    else:
        yield (
            f"The motion blows up at every step tried: after {before} at {coarse}, after {after} "
            f"at {fine}. These do not agree: the cause may be the step or the motion."
        )


def growth(rate: float, confirmed: bool) -> str:
    """A note on growth of the motion itself. rate: the fastest at any state [1/s]."""
    if rate > FASTEST:
        return (
            f"at some state the motion grows e-fold in less than {seconds(1 / FASTEST)}, faster "
            "than any step that is tried: look at its masses and gains"
        )
    fold = f"small differences in the motion itself grow by a factor of e in {seconds(1 / rate)}"
    if confirmed:
        return (
            f"{fold} at the fastest, as where a body falls, balances or is driven; two fine steps "
            "agree, so this is physical, and no dt changes it"
        )
    return f"{fold} at some state; no finer step confirms that it is physical"


def gentle_chatter(saturations: Sequence[Saturation]) -> Iterator[str]:
    """Notes on servos that chatter only after a kick, and gently."""
    for one in saturations:
        if not (one.reached or one.severe):
            yield (
                f"kicked beyond {_speed(one, one.speed)}, {one.element.name} chatters between the "
                f"ends of its force range, ±{_force(one)}, at up to {_speed(one, one.thrown)}, "
                f"where its damping is gone; below dt {seconds(one.dt)} it does not"
            )


def _chatter(d: DiagnosisFindings, one: Saturation) -> str:
    """A servo whose force jumps from end to end."""
    kicked = "" if one.reached else f"kicked beyond {_speed(one, one.speed)}, "
    begins = f"{kicked}{one.element.name} reaches its force range of ±{_force(one)}"
    chatters = (
        "there its damping is gone, and its force jumps from one end to the other within a step"
    )
    if one.swinging:
        chatters = (
            "its force jumps from one end to the other, for good. Where friction or the range "
            "holds it, the linearised step does not show this"
        )
    elif one.thrown > THROWN * one.usual:
        chatters += f", which throws {one.joint} to {_speed(one, one.thrown)}"
    return f"{begins[0].upper()}{begins[1:]}: {chatters}. The motion stays finite."


def _speed(one: Saturation, value: float) -> str:
    return f"{value:.3g} {'rad/s' if one.angular else 'm/s'}"


def _force(one: Saturation) -> str:
    return f"{one.force:.4g} {'N·m' if one.angular else 'N'}"
