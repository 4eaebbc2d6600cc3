"""The warning at load: the scene's own dt has a stability margin below two."""

from __future__ import annotations

import warnings
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from stepcore._core import Settings
    from stepcore.engine.model import Model
    from stepcore.scene.scene import Scene

# The stability margin below which a scene is warned about.
IN_HAND = 2.0
# Growth that counts where nothing damps: e-fold in this time [s].
HORIZON = 1.0
# Joints and geoms beyond which a scene is not looked at, and dofs beyond which its step is not
# linearised: the element that is stiffest alone decides then. Each is some milliseconds.
MOST_JOINTS, MOST_GEOMS, MOST_DOFS = 100, 1000, 12


class StiffnessWarning(UserWarning):
    """A scene's own time step has a stability margin below two.

    >>> import warnings
    >>> text = '''<mujoco><option timestep="0.01" integrator="implicitfast"/><worldbody>
    ... <body><joint name="knee" type="slide" stiffness="1e6"/><geom size=".1" mass="1"/></body>
    ... </worldbody></mujoco>'''
    >>> from stepcore import loads
    >>> with warnings.catch_warnings(record=True) as caught:
    ...     warnings.simplefilter("always")
    ...     _ = loads(text)
    >>> print(caught[0].message)
    dt 10 ms explodes under implicitfast: spring "knee" allows 2 ms (stepcore diagnose tells more)
    """


def warn_of_stiffness(scene: Scene, stacklevel: int = 3) -> None:
    """Warns, in one line, of a scene whose own dt is within a factor of two of its limit.

    First by the closed forms of `bound`; only where they are near, by the step itself, linearised
    at the first key or qpos0. A scene that does not compile is left to whoever compiles it.
    """
    text = stiffness(scene)
    if text:
        warnings.warn(StiffnessWarning(text), stacklevel=stacklevel)


def stiffness(scene: Scene) -> str:
    """What is to be said of a scene at load; "" for nothing."""
    if not _may_be_stiff(scene):
        return ""
    from stepcore.engine.model import Model
    from stepcore.measure.diagnosis.closed_form_bound import closed_form

    try:
        model = Model(scene)
    except ValueError:
        return ""
    dt = model.settings.dt
    bound = closed_form(model)
    if bound.dt >= IN_HAND * dt:
        return ""
    if model.nv > MOST_DOFS:
        found = bound.alone < IN_HAND * dt and bound.key is not None
        return _text(model.settings, bound.alone, bound.key.label) if found else ""  # type: ignore[union-attr]
    return _linearised(model)


def _may_be_stiff(scene: Scene) -> bool:
    """Whether any element could limit dt; without one nothing is compiled."""
    if len(scene.joints) > MOST_JOINTS or len(scene.geoms) > MOST_GEOMS:
        return False
    from stepcore.measure.diagnosis.solref import may_limit

    refsafe = scene.options.get("refsafe", True)
    soft = [geom.solref for geom in scene.geoms] + [e.solref for e in scene.equalities]
    for joint in scene.joints:
        soft += [joint.solreflimit] * (joint.range is not None)
        soft += [joint.solreffriction] * (joint.frictionloss > 0)
    springs = any(joint.stiffness > 0 or joint.damping > 0 for joint in scene.joints)
    servos = any(actuator.type != "motor" for actuator in scene.actuators)
    if scene.options.get("law") == "penalty":
        return True
    return springs or servos or any(may_limit(solref, refsafe) for solref in soft)


def _linearised(model: Model) -> str:
    """The step itself at the first key or qpos0, and who limits it."""
    import numpy as np

    from stepcore.measure.diagnosis import dt_limits
    from stepcore.measure.diagnosis.growth import between
    from stepcore.measure.diagnosis.linear_step import State, exact
    from stepcore.measure.diagnosis.shares import shares_at

    model = exact(model)
    settings = model.settings
    ctrl = model.keys[0].ctrl if model.keys else np.zeros(model.nu)
    qpos, qvel = (model.keys[0].qpos, model.keys[0].qvel) if model.keys else (model.qpos0, None)
    state = State("the start", 0.0, qpos, np.zeros(model.nv) if qvel is None else qvel, ctrl)
    try:
        here = dt_limits.situation(model, [state], HORIZON)
    except ValueError:
        return ""
    far = IN_HAND * settings.dt
    if here.stable(settings.integrator, far):
        return ""
    low = here.shortest(0)

    def stable(dt: float) -> bool:
        return here.stable(settings.integrator, dt)

    near = far
    while near > low and not stable(near):
        near /= 2
    limit = between(stable, near, 2 * near, fine=5e-3) if near > low else 0.0
    shares = shares_at(here, dt_limits.Limit(settings.integrator, limit, 0))
    name = max(shares, key=lambda key: shares[key]).label if shares else "a stiff element"
    return _text(settings, limit, name)


def _text(settings: Settings, limit: float, name: str) -> str:
    """One line: by how much the step is too long, or nearly so, and who says so."""
    from stepcore.report.units import seconds

    dt, allows = settings.dt, f"{name} allows {seconds(limit)} (stepcore diagnose tells more)"
    if dt > limit:
        return f"dt {seconds(dt)} explodes under {settings.integrator}: {allows}"
    margin = f"a stability margin of {limit / dt:.2g}× under {settings.integrator}"
    return f"dt {seconds(dt)} has only {margin}: {allows}"
