"""Settings in a few words, as tables, plots and sentences name them."""

from __future__ import annotations

from stepcore._core import Settings
from stepcore.report.units import seconds


def label(settings: Settings, shipped: Settings | None = None, sweeps: bool = True) -> str:
    """Settings in a few words; with `shipped`, what differs from it in the rarer fields too."""
    parts = [settings.integrator, solver_words(settings) if sweeps else settings.solver]
    if settings.precision != "f64":
        parts.append(settings.precision)
    if shipped is not None:
        parts += rarer(settings, shipped)
    return ", ".join([*parts, f"dt {seconds(settings.dt)}"])


def solver_words(settings: Settings) -> str:
    """The solver, and for PGS its sweeps."""
    if settings.solver != "pgs":
        return str(settings.solver)
    return f"pgs {settings.sweeps} sweep" + "s" * (settings.sweeps != 1)


def rarer(settings: Settings, shipped: Settings) -> list[str]:
    """What differs in the fields that have no column of their own."""
    s, found = settings, []
    if s.solver == "newton" and s.sweeps != (shipped.sweeps if shipped.solver == "newton" else 100):
        found.append(f"{s.sweeps} iteration" + "s" * (s.sweeps != 1))
    if s.tolerance != shipped.tolerance:
        found.append(f"tolerance {s.tolerance:g}")
    if s.warm_start != shipped.warm_start:
        found.append("warm" if s.warm_start else "cold")
    if s.acceleration != shipped.acceleration:
        found.append("plain" if s.acceleration == "none" else "accelerated")
    if s.cone != shipped.cone:
        found.append(s.cone)
    return found
