"""`Change`: the differences from the scene as shipped; the only way to make a changed copy."""

from __future__ import annotations

import copy
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, NamedTuple, Unpack

import numpy as np

from stepcore import checks
from stepcore.engine.element import name_list
from stepcore.engine.features import Removal, without
from stepcore.engine.model import Model
from stepcore.mjcf.option import as_option, shortest
from stepcore.report.settings import label
from stepcore.report.units import metres, seconds, time
from stepcore.scene.elements.actuator_laws import ALL_LAW_FIELDS
from stepcore.scene.layout import Layout

if TYPE_CHECKING:
    from stepcore._core import Settings
    from stepcore.signatures import SettingsFields


# Settings that change the modelled physics, and so the limit dt → 0. (Sleep and f32 cause numerical
# errors; refsafe softens contacts at long steps only.)
MODELLING = (
    *("law", "softness", "beta", "restitution", "slop", "max_recovery_speed", "penalty_stiffness"),
    *("penalty_damping_ratio", "cone", "impratio", "stiction", "noslip_iterations"),
)


class Servo(NamedTuple):
    """A position servo, replacing an actuator: force = kp × (control − length) − kv × velocity.

    actuator: its name or index; in a model without actuators, the name of a joint, which gets one.
    kp, kv: the gains, before the gear. forcerange: bounds of the force, before the gear.
    """

    actuator: str | int
    kp: float
    kv: float
    forcerange: tuple[float, float] = (-np.inf, np.inf)


@dataclass(frozen=True, init=False, repr=False)
class Change:
    """Settings, values of the model, features left out, and servos that replace actuators.

    values: new values by path, as in `Model.with_values`: ``{"actuator/knee/kp": 80.0}``.
    without: features to leave out: names of flags of the scene ("gravity", "contact", "limit", …),
        or `Removal`s.
    servos: `Servo`s that replace actuators.
    settings: fields of `Settings`, such as ``dt=0.001, integrator="rk4"``; ``dt="1ms"`` is a time.

    Changes are constant, can be compared, hashed and pickled. An empty one is the scene as shipped.

    >>> from stepcore import lesson
    >>> change = Change({"joint/spring/stiffness": 20.0}, dt=0.001)
    >>> print(change)
    dt 1 ms, joint/spring/stiffness 20
    >>> model = change.of(lesson.spring().compile())
    >>> model.settings.dt, model.scene.joint("spring").stiffness
    (0.001, 20.0)
    """

    settings: tuple[tuple[str, Any], ...]
    values: tuple[tuple[str, Any], ...]
    without: tuple[Removal, ...]
    servos: tuple[Servo, ...]

    def __init__(
        self,
        values: Mapping[str, Any] | None = None,
        without: Iterable[str | Removal] = (),
        servos: Iterable[Servo] = (),
        **settings: Unpack[SettingsFields],
    ) -> None:
        constants = {path: _constant(value) for path, value in (values or {}).items()}
        # A string names a feature for which the scene has a flag.
        removed = {
            Removal(item, "", (("feature", item),)) if isinstance(item, str) else item
            for item in without
        }
        fields: dict[str, Any] = {**settings}
        if isinstance(fields.get("dt"), str):
            fields["dt"] = time("dt", fields["dt"])
        object.__setattr__(self, "settings", tuple(sorted(fields.items())))
        object.__setattr__(self, "values", tuple(sorted(constants.items())))
        object.__setattr__(self, "without", tuple(sorted(removed, key=lambda r: r.label)))
        object.__setattr__(self, "servos", tuple(servos))

    def __repr__(self) -> str:
        return f"<Change: {self.words}>"

    def __str__(self) -> str:
        return self.words

    @classmethod
    def between(cls, settings: Settings, shipped: Settings) -> Change:
        """Return the change from shipped settings to others."""
        before = shipped.as_dict()
        return cls(**{k: v for k, v in settings.as_dict().items() if v != before[k]})

    def also(self, other: Change) -> Change:
        """Return both changes; `other` takes precedence for settings and values in both."""
        settings = {**dict(self.settings), **dict(other.settings)}
        values = {**dict(self.values), **dict(other.values)}
        servos = {servo.actuator: servo for servo in (*self.servos, *other.servos)}
        return Change(values, (*self.without, *other.without), servos.values(), **settings)

    @property
    def physics(self) -> Change:
        """The part that changes the model: without the settings that are not in `MODELLING`."""
        model = {name: value for name, value in self.settings if name in MODELLING}
        return Change(dict(self.values), self.without, self.servos, **model)

    @property
    def size(self) -> int:
        """The number of changed values, features left out and servos.

        Settings do not count, because they leave the model as it is.
        """
        return len(self.values) + len(self.without) + len(self.servos)

    @property
    def models(self) -> bool:
        """Whether the modelled physics changes, so that the motion has another limit dt → 0."""
        return bool(self.size) or any(name in MODELLING for name, _ in self.settings)

    def of(self, model: Model) -> Model:
        """Return the changed model.

        Raises ValueError for elements that the model lacks, and for values outside their limits.
        """
        if self.without:
            # A removal may be a setting, such as warm start.
            scene = model.scene.with_settings(model.settings)
            model = without(scene, self.without).compile()
        if self.values:
            model = model.with_values(dict(self.values))
        if self.servos:
            model = _with_servos(model, self.servos)
        return self.with_settings(model)

    def with_settings(self, model: Model) -> Model:
        """Return a model with the changed settings; it must have the other changes already."""
        return model.with_settings(**dict(self.settings)) if self.settings else model

    @property
    def words(self) -> str:
        """The change in words; "as shipped" if it is empty."""
        settings = dict(self.settings)
        order = dict.fromkeys([*(name for name in FIRST if name in settings), *settings])
        parts = [_setting(name, settings[name]) for name in order]
        parts += [f"{path} {_number(value)}" for path, value in self.values]
        parts += [f"without {removal.label}" for removal in self.without]
        parts += [f"servo {s.actuator} (kp {s.kp:g}, kv {s.kv:g})" for s in self.servos]
        return ", ".join(parts) or "as shipped"

    def label(self, shipped: Settings) -> str:
        """Return the settings in the words of tables, and the other changes.

        shipped: the settings of the scene.
        """
        physics = self.physics
        parts = [label(shipped.replace(**dict(self.settings)), shipped)]
        return ", ".join([*parts, physics.words] if physics.size else parts)

    @property
    def mjcf(self) -> str:
        """The change as MJCF: `<option>`, and attributes by element.

        Comments list the parts that MJCF cannot express.
        """
        attributes, flags, rest = as_option(dict(self.settings))
        lines = []
        if attributes or flags:
            inner = f"<flag {_attributes(flags)}/>" if flags else ""
            head = " ".join(filter(None, ("option", _attributes(attributes))))
            lines.append(f"<{head}>{inner}</option>" if inner else f"<{head}/>")
        by_element: dict[str, dict[str, str]] = {}
        for path, value in self.values:
            element, _, field = path.rpartition("/")
            fields = by_element.setdefault(element, {})
            if value is not None:
                fields[field] = _number(value)
        for element, fields in by_element.items():
            kind, _, name = element.partition("/")
            # "#3" is the index of an element without a name.
            unnamed = f"  <!-- {kind} {name[1:]} -->" if name.startswith("#") else ""
            head = kind if unnamed else f'{kind} name="{name}"' if name else "option"
            lines.append(f"<{head} {_attributes(fields)}/>{unnamed}")
        for servo in self.servos:
            law = {"name": servo.actuator, **_law(servo)}.items()
            fields = {name: _number(value) for name, value in law if value is not None}
            lines.append(f"<general {_attributes(fields)}/>")
        lines += [f"<!-- without {removal.label} -->" for removal in self.without]
        lines += [f"<!-- {name} = {value} -->" for name, value in rest.items()]
        return "\n".join(lines)


def _law(servo: Servo) -> dict[str, Any]:
    """Return the fields of a general actuator that is a servo."""
    bounded = bool(np.isfinite(servo.forcerange).all())
    return {
        "gainprm": (servo.kp,),
        "biastype": "affine",
        "biasprm": (0.0, -servo.kp, -servo.kv),
        "forcerange": servo.forcerange if bounded else None,
    }


def _with_servos(model: Model, servos: Iterable[Servo]) -> Model:
    """Return the model with servos that replace actuators and keep their control filters."""
    if not model.nu:
        model = with_motors(model, [model.index("joint", servo.actuator) for servo in servos])
    scene = copy.deepcopy(model.scene)
    for servo in servos:
        actuator = scene.actuators[model.index("actuator", servo.actuator)]
        law = actuator.law
        cleared: dict[str, Any] = dict.fromkeys([*ALL_LAW_FIELDS, "ctrlrange"])
        kept: dict[str, Any] = {"type": "general", "gaintype": "fixed"}
        kept |= {"dyntype": law.dyntype, "dynprm": law.dynprm}
        for field, value in (cleared | kept | _law(servo)).items():
            setattr(actuator, field, value)
    return Model(scene, model.settings)


def powered(model: Model) -> Model:
    """Add motors to a model without actuators, on the joints whose effort it bounds.

    A URDF lists no motors, but bounds their efforts. If it bounds no effort (many files have 0,
    which is no bound), joints with a range get motors without bounds. If it bounds some, only those
    whose limit is not filled in get them. Joints that follow another joint get no motor.
    """
    if model.nu:
        return model
    source, joints = model.scene._source, Layout(model.scene).joints
    led = [tie.joint1 for tie in model.scene.equalities if tie.type == "joint" and tie.active]
    free = [k for k, joint in enumerate(joints) if not any(joint is other for other in led)]
    bounded = [k for k in free if joints[k].actuatorfrcrange is not None]
    ranged = [k for k in free if joints[k].range is not None and k not in bounded]
    if source is None or not source.urdf:
        ranged = []
    elif bounded:
        ranged = [k for k in ranged if joints[k].name in source.unfilled]
    if not bounded and not ranged:
        return model
    called, why = model.called("joint"), list[str]()
    if bounded:
        named = name_list(called[k] for k in bounded)
        why.append(f"the joints whose effort is bounded: {named}")
    if ranged:
        named = name_list(called[k] for k in ranged)
        none = "no effort of theirs" if bounded else "no effort"
        why.append(f"joints with a range, without bounds, because the file bounds {none}: {named}")
    powered_model = with_motors(model, sorted(bounded + ranged))
    powered_model.scene._powered = True
    powered_model.scene.notes.insert(0, f"motors were made for {'; for '.join(why)}")
    return powered_model


def with_motors(model: Model, joints: Sequence[int], others: Sequence[int] = ()) -> Model:
    """Return the model with motors on some joints, and instead of some actuators (`others`)."""
    if not joints and not others:
        return model
    scene = copy.deepcopy(model.scene)
    for k in others:
        for name in (*ALL_LAW_FIELDS, "ctrlrange"):
            setattr(scene.actuators[k], name, None)
        scene.actuators[k].type = "motor"
    taken, owners = {actuator.name for actuator in scene.actuators}, Layout(scene).joints
    for joint in joints:
        name = model.joint_names[joint]
        scene.add_actuator(owners[joint], name="" if name in taken else name)
    for key in scene.keys:
        if key.ctrl is not None:
            key.ctrl = (*key.ctrl, *[0.0] * len(joints))
    return Model(scene, model.settings)


def _constant(value: Any) -> Any:
    return tuple(np.asarray(value).tolist()) if isinstance(value, list | np.ndarray) else value


# The settings that are listed first, in this order; the others follow by name.
FIRST = ("integrator", "solver", "sweeps", "accuracy", "dt")


def _setting(name: str, value: Any) -> str:
    if name in ("integrator", "solver", "cone", "precision"):
        return str(value)
    if name == "sweeps":
        return f"sweeps {value}"
    if name == "dt":
        return f"dt {seconds(value)}"
    if name == "accuracy":
        return "steps of fixed length" if value is None else f"accuracy {metres(value)}"
    return f"{name} {checks.shown(value)}"


def _number(value: Any) -> str:
    if isinstance(value, tuple):
        return " ".join(_number(entry) for entry in value)
    if isinstance(value, bool):
        return str(value).lower()
    return shortest(value) if isinstance(value, float) else str(value)


def _attributes(fields: Mapping[str, str]) -> str:
    return " ".join(f'{name}="{value}"' for name, value in fields.items())
