"""Settings under which rows are solved to rounding, so that only the time step is left to judge."""

from __future__ import annotations

from typing import Any

from stepcore._core import Settings


def converged_settings(
    settings: Settings,
    *,
    newton: int = 200,
    pgs: int = 20_000,
    tolerance: float = 1e-13,
    refsafe: bool | None = None,
    **changes: Any,
) -> Settings:
    """The same settings in double precision with converged rows: by Newton where the law is convex.

    newton, pgs: the most iterations or sweeps of either solver. tolerance: on the residual [m/s];
    0 runs all of them. refsafe: whether solref may be softened at a large dt, where the law is
    solref; None leaves it as it is. changes: further fields of Settings (dt, integrator, …).
    """
    convex = settings.law == "solref"
    if convex and refsafe is not None:
        changes["refsafe"] = refsafe
    return settings.replace(
        solver="newton" if convex else "pgs",
        sweeps=newton if convex else pgs,
        tolerance=tolerance,
        acceleration="none",
        precision="f64",
        **changes,
    )
