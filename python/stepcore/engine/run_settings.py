"""Settings under which measurements run a model."""

from __future__ import annotations

from typing import Any

from stepcore._core import Settings

# Limit of Newton iterations: Newton converges in about ten iterations, or not at all.
NEWTON = 200


def converged_settings(
    settings: Settings,
    *,
    sweeps: int = 20_000,
    tolerance: float = 1e-13,
    refsafe: bool | None = None,
    **changes: Any,
) -> Settings:
    """Return the settings with double precision, converged rows and steps of a fixed length.

    Under the convex law solref, Newton solves the rows; under other laws, PGS.

    sweeps: the largest number of PGS sweeps. 20,000 sweeps converge a stack with a mass ratio of
        1000; use fewer for long runs.
    tolerance: tolerance of the residual [m/s]; 0 runs all sweeps. The default is rounding in a
        scene with speeds of about 1 m/s.
    refsafe: under solref, whether time constants are softened at a large dt. None keeps the value
        in `settings`.
    changes: further fields of Settings (dt, integrator, …).
    """
    convex = settings.law == "solref"
    if convex and refsafe is not None:
        changes["refsafe"] = refsafe
    return settings.replace(
        solver="newton" if convex else "pgs",
        sweeps=NEWTON if convex else sweeps,
        tolerance=tolerance,
        acceleration="none",
        precision="f64",
        accuracy=None,
        **changes,
    )


def balanced(settings: Settings) -> Settings:
    """Return the settings with an account of energies, where steps have a fixed length."""
    return settings.replace(ledger=settings.accuracy is None)
