"""Short descriptions of settings, for tables, plots and sentences."""

from __future__ import annotations

from stepcore._core import Settings
from stepcore.report.units import counted, metres, seconds


def label(settings: Settings, shipped: Settings | None = None, sweeps: bool = True) -> str:
    """Return integrator, solver and time step; with `shipped`, also further differences."""
    parts = [settings.integrator, solver_words(settings) if sweeps else settings.solver]
    if settings.precision != "f64":
        parts.append(settings.precision)
    if shipped is not None:
        parts += [words for words in unlabelled(settings, shipped) if words not in parts[1]]
    parts += [tolerance_words(settings)] if shipped is None else []
    return ", ".join([*filter(None, parts), f"dt {seconds(settings.dt)}"])


def differing(settings: Settings) -> str:
    """Return the fields that differ from the defaults, as text of Python; else a description."""
    text = repr(settings)
    return text if text != "Settings()" else f"Under {label(settings)}."


def tolerance_words(settings: Settings) -> str:
    """Return the accuracy that the steps keep, in words; "" for steps of a fixed length."""
    return "" if settings.accuracy is None else f"accuracy {metres(settings.accuracy)}"


def solver_words(settings: Settings) -> str:
    """Return the solver, and the number of PGS sweeps, or of Newton iterations if they are few."""
    # Newton converges in about ten iterations, or not at all.
    if settings.solver == "newton" and settings.sweeps < 10:
        return f"newton {counted(int(settings.sweeps), 'iteration')}"
    if settings.solver != "pgs":
        return str(settings.solver)
    if settings.sweeps == "auto":
        return "pgs, sweeps auto"
    return f"pgs {counted(int(settings.sweeps), 'sweep')}"


def unlabelled(settings: Settings, shipped: Settings) -> list[str]:
    """Return the differences in fields that `label` omits."""
    words = []
    usual = shipped.sweeps if shipped.solver == "newton" else 100
    if settings.solver == "newton" and settings.sweeps != usual:
        words.append(counted(int(settings.sweeps), "iteration"))
    if settings.tolerance != shipped.tolerance:
        words.append(f"tolerance {settings.tolerance:g}")
    if settings.cost_tolerance != shipped.cost_tolerance:
        words.append(f"cost tolerance {settings.cost_tolerance:g}")
    if settings.warm_start != shipped.warm_start:
        words.append("warm start" if settings.warm_start else "no warm start")
    if settings.acceleration != shipped.acceleration:
        words.append("plain" if settings.acceleration == "none" else "accelerated")
    if settings.cone != shipped.cone:
        words.append(settings.cone)
    if settings.accuracy != shipped.accuracy:
        words.append(tolerance_words(settings) or "steps of fixed length")
    return words
