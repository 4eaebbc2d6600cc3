"""Settings under which measurements run a model."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np

from stepcore._core import Settings
from stepcore.report.units import length, metres, seconds
from stepcore.scene.softness import UNKNOWN, clamping, extent

if TYPE_CHECKING:
    from stepcore.engine.model import Model
    from stepcore.scene.scene import Scene
    from stepcore.signatures import SettingsFields


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
        # Newton converges in about ten iterations, or not at all.
        sweeps=200 if convex else sweeps,
        tolerance=tolerance,
        acceleration="none",
        precision="f64",
        accuracy=None,
        **changes,
    )


def balanced(settings: Settings) -> Settings:
    """Return the settings with an energy ledger, unless steps are adaptive."""
    return settings.replace(ledger=settings.accuracy is None)


def in_metres(scene: Scene, fields: SettingsFields) -> SettingsFields:
    """Return the fields with an accuracy such as "0.1%" of the scene's size in metres."""
    accuracy = fields.get("accuracy")
    if not (isinstance(accuracy, str) and accuracy.strip().endswith("%")):
        return fields
    converted: SettingsFields = {**fields}
    converted["accuracy"] = length("Settings", "accuracy", accuracy, extent(scene) or UNKNOWN)
    return converted


def refsafe_note(scene: Scene, settings: Settings) -> str:
    """Return a note that contacts are harder in adaptive steps than at the file's step; else "".

    Adaptive steps do not apply refsafe.
    """
    dt, tau = scene.options.get("dt", Settings().dt), clamping(scene)
    if settings.accuracy is None or not settings.refsafe or tau is None or tau >= 2 * dt:
        return ""
    return (
        f"within an accuracy, rows have the time constant of the file, {seconds(tau)} at least; at "
        f"its step of {seconds(dt)}, refsafe softens them to {seconds(2 * dt)}"
    )


def spinning_note(model: Model, settings: Settings, speeds: np.ndarray) -> str:
    """Return a note on the joint whose turn is too fast for the accuracy of adaptive steps.

    An error of velocity counts for 0.03 s (`commit/extrapolation.rs`). If a body turns by more than
    a radian in that time, the error lasts longer: 5 times the accuracy for a heavy top at 60 rad/s.

    speeds: velocities of the run, (…, nv).
    """
    if settings.accuracy is None:
        return ""
    for name, kind, first in zip(model.joint_names, model.jnt_type, model.jnt_dofadr, strict=True):
        turning = {"ball": first, "free": first + 3}.get(kind)
        if turning is None:
            continue
        fastest = float(np.linalg.norm(speeds[..., turning : turning + 3], axis=-1).max(initial=0))
        if fastest * 0.03 > 1:
            subject = f"joint `{name}`" if name else f"a {kind} joint"
            return (
                f"{subject} turns at up to {fastest:.3g} rad/s: errors of so fast a turn last "
                f"longer than counts, and may be several times the accuracy of "
                f"{metres(settings.accuracy)}"
            )
    return ""
