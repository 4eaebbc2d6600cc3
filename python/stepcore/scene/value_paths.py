"""Find and change values of a scene by path, "kind/name/field"."""

from __future__ import annotations

import copy
from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING, Any

from stepcore import checks
from stepcore.scene.element import field_rows
from stepcore.scene.elements import Actuator, Body, Element
from stepcore.scene.elements.actuator_laws import ALL_LAW_FIELDS
from stepcore.scene.layout import LISTS, Layout

if TYPE_CHECKING:
    from stepcore.scene.scene import Scene

# Values of the whole scene.
WHOLE = ("gravity", "density", "viscosity", "wind")


def is_path(name: str) -> bool:
    """Return whether a name is the path of a value of the scene, not a setting."""
    return "/" in name or name in WHOLE


def changed_scene(scene: Scene, values: Mapping[str, Any], body_mass: Mapping[str, float]) -> Scene:
    """Return a copy of `scene` with these values.

    values: new values by path.
    body_mass: the mass of each body in the compiled model, by name [kg].
    """
    checks.mapping("values", values, "paths and values")
    scene = copy.deepcopy(scene)
    assign(scene, values, body_mass)
    return scene


def assign(scene: Scene, values: Mapping[str, Any], body_mass: Mapping[str, float]) -> None:
    """Assign these values to `scene`; see `changed_scene`."""
    for path, value in values.items():
        if path in WHOLE:
            setattr(scene, path, value)
            continue
        element, field = find(scene, path)
        if field == "mass" and isinstance(element, Body) and element.mass is None:
            _scale_geoms(scene, element, body_mass[element.name], value)
        else:
            _set(element, field, value)


def find(scene: Scene, path: object) -> tuple[Element, str]:
    """Return the element and the field at a path.

    "#3" names the element with index 3 in the compiled model, unless one has it.
    """
    parts = path.split("/") if isinstance(path, str) else []
    shown = checks.cut(str(path), 80)
    if len(parts) < 3:
        words = ", ".join(f'"{word}"' for word in WHOLE)
        text = f'{checks.shown(path)}: must be {words} or "kind/name/field"'
        name, field = [*parts, "field"][:2] if parts else ("", "")
        layout = Layout(scene)
        kinds = [k for k in LISTS if name in [getattr(e, "name", 0) for e in layout.elements(k)]]
        near = ", ".join(checks.quoted(f"{kind}/{name}/{field}") for kind in kinds if name)
        raise ValueError(f"{text}; nearest: {near}" if near else text)
    # Names may contain slashes.
    kind, name, field = parts[0], "/".join(parts[1:-1]), parts[-1]
    if kind not in LISTS:
        near = checks.nearest(kind, LISTS)
        raise ValueError(f"{shown}: no kind of element is {checks.quoted(kind)}{near}")
    try:
        element: Element = _indexed(scene, kind, name) or getattr(scene, kind)(name)
    except ValueError as error:
        raise ValueError(f"{shown}: {error}") from None
    rows = field_rows(type(element)).values()
    fields = [row.name for row in rows if row.name not in ("name", "file") and not row.type.refers]
    if field not in fields:
        near, n = checks.nearest(field, fields), "n" * (kind[0] in "aeiou")
        raise ValueError(f"{shown}: a{n} {kind} has no value {checks.quoted(field)}{near}")
    return element, field


def _indexed(scene: Scene, kind: str, name: str) -> Element | None:
    """Return the element "#index"; None where the name is no index, or the name of an element."""
    if not (name.startswith("#") and name[1:].isdecimal()):
        return None
    elements: Sequence[Element] = Layout(scene).elements(kind)
    if any(getattr(element, "name", "") == name for element in elements):
        return None
    index = int(name[1:])
    if index >= len(elements):
        raise ValueError(f"no {kind} has the index {index}: there are {len(elements)}")
    return elements[index]


def present(element: Element, field: str) -> Any:
    """Return the value of a field; None only where it has no value and no default."""
    law = isinstance(element, Actuator) and field in ALL_LAW_FIELDS
    return element.law_value(field) if law else getattr(element, field)  # type: ignore[attr-defined]


def _set(element: Element, field: str, value: Any) -> None:
    """Assign a field; a single number replaces the first entry of a vector."""
    if isinstance(element, Actuator) and field in element.servo_gains:
        element.set_servo_gain(field, value)
        return
    old = getattr(element, field)
    first = checks.number(value)
    if isinstance(old, tuple) and first is not None:
        value = (first, *old[1:])
    setattr(element, field, value)


def _scale_geoms(scene: Scene, body: Body, old: float, value: Any) -> None:
    """Change a body's mass that comes from its geoms, by scaling their masses or densities.

    Other bodies keep their masses: a `settotalmass` grows by what the body gains.

    old: the present mass [kg].
    """
    mass: float = checks.real(above=0)(body, "mass", value)
    rules = scene.mass_rules
    if old == 0:
        text = "its geoms have no mass that could be scaled; give it an inertial"
        raise ValueError(f"{body}: mass = {checks.shown(value)}: {text}")
    factor = mass / old
    if rules.boundmass > 0:
        text = "cannot be set where boundmass decides masses"
        raise ValueError(f"{body}: mass = {checks.shown(value)}: {text}")
    if rules.settotalmass > 0:
        rules.settotalmass += mass - old
    low, high = rules.inertiagrouprange
    for geom in scene.geoms:
        if geom.body is body and low <= geom.group <= high:
            if geom.mass is not None:
                geom.mass *= factor
            else:
                geom.density *= factor
