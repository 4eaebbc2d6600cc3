"""What the motion itself did at the wanted step, in words."""

from __future__ import annotations

from collections.abc import Iterator

from stepcore.measure.diagnosis.findings import DiagnosisFindings
from stepcore.measure.diagnosis.saturation import Saturation
from stepcore.report.units import seconds


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


def mild(d: DiagnosisFindings) -> Iterator[str]:
    """Servos that chatter only after a kick, and gently."""
    for one in d.saturations:
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
        "there its damping is gone, and its force jumps from one end to the other within steps, "
        f"which throws {one.joint} to {_speed(one, one.thrown)}"
    )
    return f"{begins[0].upper()}{begins[1:]}: {chatters}. The motion stays finite."


def _speed(one: Saturation, value: float) -> str:
    return f"{value:.3g} {'rad/s' if one.angular else 'm/s'}"


def _force(one: Saturation) -> str:
    return f"{one.force:.4g} {'N·m' if one.angular else 'N'}"
