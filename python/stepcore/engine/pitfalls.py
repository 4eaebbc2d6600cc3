"""Pitfalls of a model's settings that a finite motion does not reveal.

Two closed forms of the scene and its settings detect them: no model is linearised or run.
"""

from __future__ import annotations

import contextlib
import warnings
from collections.abc import Iterator
from typing import TYPE_CHECKING, Any

import numpy as np

from stepcore import escapes
from stepcore.engine.coordinates import Coordinates
from stepcore.engine.linear_maps import INTEGRATORS, implicit_kinds
from stepcore.engine.stiffness import gains
from stepcore.report.units import metres
from stepcore.scene.layout import Layout

if TYPE_CHECKING:
    from stepcore.engine.model import Model
    from stepcore.engine.tables import ContactPair

# Contacts of a body at rest, which share its weight; other shapes have one per corner of a face.
CONTACTS = {"sphere": 1, "ellipsoid": 1, "capsule": 2}
# Texts of earlier warnings: a measurement creates many Sims of a model.
_warned_texts: set[str] = set()


class ModelWarning(UserWarning):
    """Settings make friction of a model too soft, or let damping undo constraint rows.

    >>> import warnings
    >>> from stepcore import Sim, loads
    >>> scene = loads('''<mujoco><worldbody><geom type="plane" size="1 1 1"/>
    ... <body pos="0 0 .1"><freejoint/><geom name="box" type="box" size=".1 .1 .1" friction="20"/>
    ... </body></worldbody></mujoco>''')
    >>> with warnings.catch_warnings(record=True) as caught:
    ...     warnings.simplefilter("always")
    ...     _ = Sim(scene)
    >>> print(caught[0].message)  # doctest: +NORMALIZE_WHITESPACE
    friction 20 makes the pyramids of geom `box` soft: under its weight it sinks by about 3.93 m;
    cone="elliptic" holds it
    """


def warn_of_pitfalls(model: Model, stacklevel: int = 3) -> None:
    """Warn of each pitfall of a model's settings in one line, once per process.

    stacklevel: as of `warnings.warn`, counted from this function.
    """
    settings = _pitfall_settings(model)
    if settings in model.warned:
        return
    model.warned.add(settings)
    for text in (*soft_pyramids(model), *undone_rows(model)):
        if text in _warned_texts:
            continue
        _warned_texts.add(text)
        warnings.warn(ModelWarning(escapes.printable(text)), stacklevel=stacklevel)


def unwarned(model: Model) -> Model:
    """Disable the warnings of a model that a measurement tries, and return the model."""
    model.warned.add(_pitfall_settings(model))
    return model


def _pitfall_settings(model: Model) -> tuple[Any, ...]:
    settings = model.settings
    return settings.cone, settings.law, settings.integrator, settings.dt


def soft_pyramids(model: Model) -> Iterator[str]:
    """Yield the geom that sinks deepest because its friction makes pyramids too soft to hold it.

    Each edge of a pyramid of friction μ is 2μ²(1 + μ²) times as soft as a normal alone, and four
    edges share a contact's force (MuJoCo's rows; without friction the depth at rest is
    (1 − d) g/(k d²), d the impedance of deep contacts and k = 1/timeconst² or -solref).
    """
    settings, scene = model.settings, model.scene
    colliding: list[Any] = [*scene.geoms, *scene.pairs, scene.contact_override]
    steepest = max((element.friction[0] for element in colliding if element.friction), default=0.0)
    if settings.cone != "pyramidal" or settings.law != "solref" or steepest <= 1:
        return
    geoms, sizes = Layout(scene).geoms, model.geom_size
    moving = np.isin(model.geom_body, [*Coordinates(model).moving]).tolist()
    gravity, deepest = float(np.linalg.norm(scene.gravity)), []
    pressed = {
        (index, pair.friction, pair.solref)
        for pair in _pairs(model, len(geoms))
        if pair.friction > 1 and pair.condim > 1
        for index in pair.geoms
        if moving[index]
    }
    for index, friction, (time, ratio) in pressed:
        size, geom, d = sizes[index], geoms[index], np.float64(geoms[index].solimp[1])
        # NumPy scalars overflow to infinity.
        slope, time = np.float64(friction), np.float64(time)
        with np.errstate(all="ignore"):
            stiffness = 1 / (d * time * ratio) ** 2 if time > 0 else -time / d**2
            soft = slope**2 * (1 + slope**2) / 2 / CONTACTS.get(geom.type, 4)
            depth = soft * (1 - d) * gravity / (stiffness * d**2)
        thin = size[size > 0].min(initial=np.inf)
        if depth > thin:
            deepest.append((depth / thin, depth, friction, index))
    if deepest:
        _, depth, friction, index = max(deepest)
        name = model.element_name("geom", index)
        # Depths above 10 m are not reported as numbers.
        far = f"by about {metres(depth)}" if depth < 10.0 else "without end"
        yield (
            f"friction {friction:g} makes the pyramids of {name} soft: under its weight it sinks "
            f'{far}; cone="elliptic" holds it'
        )


def _pairs(model: Model, geoms: int) -> Iterator[ContactPair]:
    """Yield the pairs that can meet; in a pile, which lists none, the pairs of its first geoms."""
    # Of a pile 2000 pairs are examined; pairs of the floor with a geom come first.
    for index in range(min(geoms**2, 2000) if model.is_heap else model.npair):
        with contextlib.suppress(ValueError):
            yield model.contact_pair(index)


def undone_rows(model: Model) -> Iterator[str]:
    """Yield the joint or tendon whose damping undoes most of the rows of a closed loop.

    Under a law on velocities, rows set velocities, and these integrators damp each one afterwards
    by 1/(1 + dt·c/m), which preserves a row only if all its dofs are damped equally.
    """
    settings = model.settings
    scheme = INTEGRATORS[settings.integrator]
    late = scheme["damping"] and not scheme["stiffness"]
    if settings.law not in ("lesson", "relaxed", "rigid") or not late or not model.scene.equalities:
        return
    hidden = implicit_kinds(settings.integrator, model.scene.features.eulerdamp)
    rates = dict[tuple[str, int], float]()
    for gain in gains(model):
        if gain.element[0] in hidden:
            rates[gain.along] = rates.get(gain.along, 0.0) + gain.mobility * gain.damping
    worst = max(rates, key=rates.__getitem__, default=("joint", 0))
    # Limit of dt·c/m, the removed over the remaining velocity, if an integrator damps after the
    # rows: two light slides in a closed loop hold at 5 and diverge at 10 (`tests/engine`).
    if settings.dt * rates.get(worst, 0.0) > 5.0:
        times = f"{settings.dt * rates[worst]:.3g}"
        name = model.element_name(*worst)
        yield (
            f"law {settings.law!r} with integrator {settings.integrator!r}: the damping of {name} "
            f"acts after the rows are solved, and takes {times} times what it leaves of a "
            "velocity, so that equalities do not hold and may diverge; integrator='discrete' or "
            "'rk4' holds them"
        )
