"""Estimate from closed forms whether a scene's step is too long for the elements on a joint.

A joint or a tendon with all elements that act along it, everything else free, is an oscillator with
stiffness k, damping c and the inertia that it moves, whose inverse the engine has. Its largest
stable dt has a closed form for each integrator. Nothing is linearised or run, so this is cheap
enough for `load`; `stepcore.diagnose` runs the motion.
"""

from __future__ import annotations

import math
import warnings
from collections.abc import Iterator
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from stepcore import escapes
from stepcore.engine.actuator import actuators
from stepcore.engine.element import Element, Elements
from stepcore.engine.linear_maps import STIFFNESS_IMPLICIT, implicit_kinds
from stepcore.report.units import seconds
from stepcore.scene.layout import Layout

if TYPE_CHECKING:
    from stepcore.engine.model import Model
    from stepcore.scene.elements.body import Joint
    from stepcore.scene.elements.tendon import Tendon
    from stepcore.scene.scene import Scene

# Shorter steps are not reported as numbers [s].
SHORTEST_DT = 1e-6
# A scene with more joints or geoms is not compiled by `load`.
LARGE_SCENE = 1000


class StiffnessWarning(UserWarning):
    """A scene's time step may be unstable, by an estimate for each joint alone.

    >>> import warnings
    >>> text = '''<mujoco><option timestep="0.01" integrator="implicitfast"/><worldbody>
    ... <body><joint name="knee" type="slide" stiffness="1e6"/><geom size=".1" mass="1"/></body>
    ... </worldbody></mujoco>'''
    >>> from stepcore import loads
    >>> with warnings.catch_warnings(record=True) as caught:
    ...     warnings.simplefilter("always")
    ...     _ = loads(text)
    >>> print(caught[0].message)  # doctest: +NORMALIZE_WHITESPACE
    dt 10 ms may be unstable under implicitfast: spring of joint `knee` alone limits dt to 2 ms
    (run stepcore diagnose, which runs the motion)
    """


class Gain(NamedTuple):
    """Stiffness and damping of an element along a joint or a tendon.

    element: its kind and index. along: ("joint" or "tendon", its index). mobility: the inverse of
    the inertia that moves along it, everything else free. stiffness, damping: the first coefficient
    of polynomials; a servo's feedback is included.
    """

    element: tuple[str, int]
    along: tuple[str, int]
    mobility: float
    stiffness: float
    damping: float


def slack_lengths(model: Model) -> dict[int, tuple[float, float]]:
    """Return the lengths between which tendons with a spring are slack, by tendon."""
    bands = enumerate(zip(model.scene.tendons, model.tendon_lengthspring.tolist(), strict=True))
    return {k: (low, high) for k, (tendon, (low, high)) in bands if tendon.sprung and low < high}


def gains(model: Model) -> Iterator[Gain]:
    """Yield the springs and dampers of joints and tendons, and the actuators along these.

    The spring of a tendon has zero stiffness if it is slack at qpos0.
    """
    scene, features, length = model.scene, model.scene.features, model.tendon_length0
    mobility = {("joint", j): model.dof_invweight0[d] for j, d in enumerate(model.jnt_dofadr)}
    mobility |= {("tendon", t): weight for t, weight in enumerate(model.tendon_invweight0)}
    slack = {("tendon", t) for t, (lo, hi) in slack_lengths(model).items() if lo < length[t] < hi}
    owners: list[Joint | Tendon] = [*Layout(scene).joints, *scene.tendons]
    for along, owner in zip(mobility, owners, strict=True):
        if owner.sprung or owner.damped:
            (kind, index), record = along, owner.record()
            k, c = (float(record[law][0]) for law in ("stiffness", "damping"))
            k, c = features.spring * (along not in slack) * k, features.damper * c
            prefix = "tendon " if kind == "tendon" else ""
            yield Gain((f"{prefix}spring", index), along, mobility[along], k, 0.0)
            yield Gain((f"{prefix}damper", index), along, mobility[along], 0.0, c)
    for drive in actuators(model) if features.actuation else ():
        for kind, end in (("joint", drive.joint), ("tendon", drive.tendon)):
            if end is not None:
                at, push = (kind, end), (drive.stiffness, drive.damping)
                yield Gain(("actuator", drive.index), at, mobility[at], *push)


def oscillator_dt(square: float, implicit: float, explicit: float, integrator: str) -> float:
    """Return the largest stable dt [s] of an oscillator; inf if every step is stable.

    square: ω² [1/s²]. implicit, explicit: the implicitly and explicitly treated damping [1/s].
    """
    if integrator == "midpoint":
        return math.inf
    omega, rate = math.sqrt(square), implicit + explicit
    if integrator in ("explicit", "rk4"):
        fastest = rate / 2 + math.sqrt(max(rate**2 / 4 - square, 0.0))
        if integrator == "rk4":
            # The region of stability extends to 2.785 on the real axis, to 2√2 on the imaginary.
            reach = 2.785 if rate > omega else 2 * math.sqrt(2)
            return reach / max(fastest, omega, 1e-300)
        return 2 / fastest if rate > 2 * omega else rate / square if square else math.inf
    if integrator in STIFFNESS_IMPLICIT:
        square = 0.0
    # h² ω² − 2 h (implicit − explicit) < 4.
    less = implicit - explicit
    if square == 0:
        return math.inf if less >= 0 else -2 / less
    return (less + math.sqrt(less**2 + 4 * square)) / square


def stiffest(model: Model) -> tuple[float, Element | None]:
    """Return the least stable dt [s] of the single joints and tendons, and the stiffest element."""
    integrator = model.settings.integrator
    hidden = implicit_kinds(integrator, model.scene.features.eulerdamp)
    # For each joint or tendon: ω², the implicitly and explicitly treated damping rates, and the
    # element of each.
    parts_of: dict[tuple[str, int], list[tuple[float, float, float, tuple[str, int]]]] = {}
    for gain in gains(model):
        rate = gain.mobility * gain.damping
        rates = (rate, 0.0) if gain.element[0] in hidden else (0.0, rate)
        # A servo that pushes away from its target grows physically, at any dt.
        part = (max(gain.stiffness, 0.0) * gain.mobility, *rates, gain.element)
        parts_of.setdefault(gain.along, []).append(part)
    least, element = math.inf, None
    for parts in parts_of.values():
        square, implicit, explicit = np.sum([part[:3] for part in parts], axis=0).tolist()
        limit = oscillator_dt(square, implicit, explicit, integrator)
        if 0 < limit < least:
            alone = [oscillator_dt(part[0], implicit, part[2], integrator) for part in parts]
            least, element = limit, Element.of(model, *parts[int(np.argmin(alone))][3])
    return least, element


def estimate(scene: Scene) -> str:
    """Return the text of the warning; "" if there is none."""
    acts = any(joint.sprung or joint.damped for joint in scene.joints)
    acts = acts or any(tendon.sprung or tendon.damped for tendon in scene.tendons)
    acts = acts or any(actuator.type != "motor" for actuator in scene.actuators)
    large = max(len(scene.joints), len(scene.geoms)) > LARGE_SCENE
    if scene.settings.accuracy is not None or large or not acts:
        return ""
    model = scene.compile()
    settings, dt = model.settings, model.settings.dt
    with np.errstate(all="ignore"):
        limit, element = stiffest(model)
    if element is None or limit >= dt:
        return ""
    cause = f"alone limits dt to {seconds(limit)}"
    if limit < SHORTEST_DT:
        cause = f"alone makes every step unstable, down to {seconds(SHORTEST_DT)}"
    cause = f"{Elements([element]).name} {cause}"
    advice = "(run stepcore diagnose, which runs the motion)"
    return f"dt {seconds(dt)} may be unstable under {settings.integrator}: {cause} {advice}"


def warn_of_stiffness(scene: Scene, stacklevel: int = 3) -> None:
    """Warn in one line if a closed form shows that the scene's dt is unstable.

    A scene that does not compile, or whose numbers overflow, raises no warning: compiling or
    running the scene raises the error.

    stacklevel: as of `warnings.warn`, counted from this function.
    """
    try:
        text = estimate(scene)
    except (ValueError, ArithmeticError, RuntimeError):
        # A warning never makes `load` fail.
        return
    if text:
        warnings.warn(StiffnessWarning(escapes.printable(text)), stacklevel=stacklevel)
