"""Warn when a scene is loaded whose own dt has a stability margin below 2."""

from __future__ import annotations

import warnings
from typing import TYPE_CHECKING

from stepcore import escapes

if TYPE_CHECKING:
    from collections.abc import Sequence

    from stepcore._core import Settings
    from stepcore.engine.element import Element
    from stepcore.engine.model import Model
    from stepcore.scene.elements import Joint, Tendon
    from stepcore.scene.scene import Scene

# The least ratio of the largest stable dt to the scene's own dt without a warning.
MARGIN = 2.0
# Undamped motion is unstable if it grows e-fold in this time [s].
HORIZON = 1.0
# Larger scenes are not checked at load: at these sizes a check takes some milliseconds, at the most
# dofs some tens. `diagnose` checks scenes of any size.
MOST_JOINTS, MOST_GEOMS, MOST_DOFS = 100, 1000, 40


class StiffnessWarning(UserWarning):
    """A scene's own time step is unstable, or has a stability margin below 2.

    >>> import warnings
    >>> text = '''<mujoco><option timestep="0.01" integrator="implicitfast"/><worldbody>
    ... <body><joint name="knee" type="slide" stiffness="1e6"/><geom size=".1" mass="1"/></body>
    ... </worldbody></mujoco>'''
    >>> from stepcore import loads
    >>> with warnings.catch_warnings(record=True) as caught:
    ...     warnings.simplefilter("always")
    ...     _ = loads(text)
    >>> print(caught[0].message)  # doctest: +NORMALIZE_WHITESPACE
    dt 10 ms explodes under implicitfast: spring of joint `knee` limits dt to 2 ms
    (run stepcore diagnose for advice)
    """


def warn_of_stiffness(scene: Scene, stacklevel: int = 3) -> None:
    """Warn in one line if the scene's own dt has a stability margin below 2.

    The closed forms of `closed_form_bound` show most scenes to be safe. For the others, the whole
    step is linearised at the first keyframe or qpos0, and the warning reports only what that step
    shows. A scene that does not compile, or whose numbers overflow, raises no warning: compiling or
    running the scene raises the error.

    stacklevel: as of `warnings.warn`, counted from this function.
    """
    try:
        text = stiffness(scene)
    except (ValueError, ArithmeticError, RuntimeError):
        # A warning never fails a load.
        return
    if text:
        warnings.warn(StiffnessWarning(escapes.printable(text)), stacklevel=stacklevel)


def stiffness(scene: Scene) -> str:
    """Return the text of the warning, "" if there is none."""
    if not _may_be_stiff(scene):
        return ""
    import numpy as np

    from stepcore.engine.model import Model
    from stepcore.measure.diagnosis.isolated import closed_form_bound

    model = Model(scene)
    if model.nv > MOST_DOFS:
        return ""
    with np.errstate(all="ignore"):
        if closed_form_bound(model) >= MARGIN * model.settings.dt:
            return ""
        return _linearised(model)


def _may_be_stiff(scene: Scene) -> bool:
    """Return whether any element could limit dt; if none could, nothing is compiled."""
    if len(scene.joints) > MOST_JOINTS or len(scene.geoms) > MOST_GEOMS:
        return False
    if scene.options.get("law") == "penalty":
        return True
    lengths: list[Joint | Tendon] = [*scene.joints, *scene.tendons]
    if any(length.sprung or length.damped for length in lengths):
        return True
    if any(actuator.type != "motor" for actuator in scene.actuators):
        return True
    from stepcore.measure.diagnosis.elements import may_limit_dt, solrefs_of

    solrefs = [geom.solref for geom in scene.geoms] + [pair.solref for pair in scene.pairs]
    solrefs.append(scene.contact_override.solref)
    solrefs += [solref for _, solref in solrefs_of(scene, scene.options.get("law", "solref"))]
    refsafe = scene.options.get("refsafe", True)
    return any(may_limit_dt(solref, refsafe) for solref in solrefs)


def _linearised(model: Model) -> str:
    """Return the text from the step itself, linearised at the first keyframe or qpos0."""
    import numpy as np

    from stepcore.measure.diagnosis.growth import bisected
    from stepcore.measure.diagnosis.limits import SHORTEST, Limit, step_stability
    from stepcore.measure.diagnosis.linear_step import State, with_converged_rows
    from stepcore.measure.diagnosis.shares import limiters, limiting_shares

    model = with_converged_rows(model)
    settings = model.settings
    state = State("the start", 0.0, model.qpos0, np.zeros(model.nv), np.zeros(model.nu))
    if model.keys:
        key = model.keys[0]
        state = State("the start", 0.0, key.qpos, key.qvel, key.ctrl, act=key.act)
    here = step_stability(model, [state], HORIZON)

    def stable(dt: float) -> bool:
        return here.stable(settings.integrator, dt)

    near = MARGIN * settings.dt
    low = min(SHORTEST, settings.dt / 2)
    if stable(near):
        return ""
    while near > low and not stable(near):
        near /= 2
    limit = bisected(stable, near, 2 * near, fine=5e-3) if near > low else 0.0
    least = Limit(settings.integrator, limit, 0, shortest=low)
    elements = limiters(here, least, limiting_shares(here, least))
    return _text(settings, limit, low, elements)


def _text(settings: Settings, limit: float, shortest: float, elements: Sequence[Element]) -> str:
    """Return one line: whether dt [s] is unstable or nearly so, and which elements limit dt."""
    from stepcore.measure.diagnosis.words import limits_dt, no_stable_dt
    from stepcore.report.units import seconds, times

    dt, own = settings.dt, f"dt {seconds(settings.dt)}"
    cause = limits_dt(elements, limit) if limit > 0 else no_stable_dt(elements, shortest)
    cause += " (run stepcore diagnose for advice)"
    if dt > limit:
        return f"{own} explodes under {settings.integrator}: {cause}"
    margin = f"a stability margin of only {times(limit / dt)} under {settings.integrator}"
    return f"{own} has {margin}: {cause}"
