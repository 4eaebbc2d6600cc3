"""The differences between two models, as `Change`s of the first one."""

from __future__ import annotations

import copy
import dataclasses
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from functools import reduce
from typing import Any

import numpy as np

from stepcore import checks, deadline
from stepcore.engine.model import Model
from stepcore.experiment.change import Change
from stepcore.experiment.engines import Stepcore
from stepcore.scene.element import field_rows
from stepcore.scene.elements import Actuator, Element
from stepcore.scene.elements.actuator_laws import ALL_LAW_FIELDS
from stepcore.scene.layout import LISTS, Layout
from stepcore.scene.value_paths import WHOLE, present

# Values are equal up to rounding if they differ by less than this share of their largest entry:
# half a unit of the seventh digit is 5e-7, and single precision has 6e-8.
ROUNDING = 1e-6
# Kinds of elements that are compared. Keyframes and sensors do not act on a motion.
KINDS = tuple(kind for kind in LISTS if kind not in ("key", "sensor"))
# Fields that do not act on a motion, or that are compared otherwise.
SKIPPED = ("name", "file", "group", "hidden")
LAW = ("type", *ALL_LAW_FIELDS)
MASSES = ("mass", "density", "shellinertia")
GAINS = ("kp", "kv")
PARAMETERS = ("gainprm", "biasprm", "dynprm")


@dataclass(frozen=True)
class Difference:
    """A difference between two models.

    path: the value that differs, as in `Change`: "joint/knee/armature", or a setting such as "dt".
    a, b: the value in both models. change: of the first model, which gives it the second's value.
    """

    path: str
    a: Any
    b: Any
    change: Change

    @property
    def words(self) -> str:
        """The path and both values."""
        if self.a is None and self.b is None:
            return self.path
        return f"{self.path} ({_words(self.a)} → {_words(self.b)})"


@dataclass(frozen=True)
class Differences:
    """All differences between two models.

    changes: the differences that are `Change`s of the first model.
    others: the other differences in words, such as elements that only one of the models has.
    unmapped: those of the others because of which a motion of one model is none of the other.
    rounding: the number of values that differ by rounding alone.
    """

    changes: list[Difference]
    others: list[str]
    unmapped: list[str]
    rounding: int


class Names:
    """The elements of a model by kind and key, in the order of the compiled model.

    The key of an element is its name. An element without a name is the n-th of its type and owner.
    """

    def __init__(self, model: Model) -> None:
        self.layout = Layout(model.scene)
        self.elements: dict[str, dict[str, Element]] = {}
        self._keys: dict[int, str] = {id(self.layout.bodies[0]): "world"}
        self._paths: dict[int, str] = {}
        for kind in KINDS:
            self.elements[kind] = {}
            for index, element in enumerate(self.layout.elements(kind)):
                key = self._key(kind, element)
                self._keys[id(element)] = key
                self._paths[id(element)] = f"{kind}/{getattr(element, 'name', '') or f'#{index}'}"
                self.elements[kind][key] = element

    def _key(self, kind: str, element: Any) -> str:
        if id(element) in self._keys:
            return self._keys[id(element)]
        if element.name:
            return str(element.name)
        owners = ("parent", "body", "joint", "tendon", "site", "joint1", "body1")
        owner = next((o for o in (getattr(element, f, None) for f in owners) if o), None)
        first = "" if owner is None else self._keys.get(id(owner), "")
        first = f"{first}/{getattr(element, 'type', '') or kind}"
        taken = self.elements[kind]
        return next(key for n in range(len(taken) + 1) if (key := f"{first}#{n}") not in taken)

    def path(self, element: Element) -> str:
        """Return the path of an element, "kind/name" or "kind/#index"."""
        return self._paths[id(element)]

    def record(self, value: Any) -> Any:
        """Return rules of a scene, or pairs of bodies, as plain data."""
        return value.record() if isinstance(value, Element) else set(map(self.plain, value))

    def plain(self, value: Any) -> Any:
        """Return a value with elements replaced by their keys, so that models can be compared."""
        if isinstance(value, Element) and id(value) in self._keys:
            return f"{type(value).__name__.lower()}/{self._keys[id(value)]}"
        if isinstance(value, list | tuple):
            return tuple(self.plain(each) for each in value)
        if dataclasses.is_dataclass(value) and not isinstance(value, type):
            rows = dataclasses.fields(value)
            return tuple(self.plain(getattr(value, row.name)) for row in rows)
        return value


def differences(a: Model, b: Model, engine: Stepcore) -> Differences:
    """Return the differences between two models; engine: of the first one, compiles changes."""
    search = _Search(a, b)
    others, unmapped = search.unmatched()
    found = [*search.values(), *search.whole(), *search.flags()]
    found += [
        Difference(name, dict(a.settings.as_dict())[name], value, Change(**{name: value}))
        for name, value in Change.between(b.settings, a.settings).settings
    ]
    changes, refused = _expressible(found, engine)
    return Differences(changes, others + search.others + refused, unmapped, search.rounding)


class _Search:
    """The comparison of two models.

    names: the elements of both. rounding, others: as in `Differences`.
    """

    def __init__(self, a: Model, b: Model) -> None:
        self.a, self.b, self.names = a, b, (Names(a), Names(b))
        self.sides = tuple(zip(self.names, (a, b), strict=True))
        self.rounding, self.others = 0, list[str]()
        # The bodies whose mass from geoms differs by a factor, or not at all.
        self.scaled: dict[int, Difference | None] = {}
        self._masses()

    def unmatched(self) -> tuple[list[str], list[str]]:
        """Describe elements without a counterpart; the second list: those that states need."""
        others, unmapped = list[str](), list[str]()
        for kind in KINDS:
            of_a, of_b = (names.elements[kind] for names in self.names)
            said = unmapped if kind in ("joint", "actuator") else others
            for mine, theirs, side in ((of_a, of_b, "A"), (of_b, of_a, "B")):
                named = (checks.quoted(key) for key in mine if key not in theirs)
                said += [f"{kind} {name} is only in {side}" for name in named]
            for key in of_a.keys() & of_b.keys() if said is unmapped else ():
                kinds = [_state(of[key]) for of in (of_a, of_b)]
                if kinds[0] != kinds[1]:
                    both = f"{kinds[0]} in A, {kinds[1]} in B"
                    unmapped.append(f"{kind} {checks.quoted(key)} is a {both}")
        return others + unmapped, unmapped

    def _masses(self) -> None:
        """Compare masses that come from geoms as masses of bodies, where this is enough."""
        bodies = [list(names.elements["body"].items()) for names in self.names]
        places = {key: k for k, (key, _) in enumerate(bodies[1])}
        for i, (key, body) in enumerate(bodies[0]):
            j, inferred = places.get(key, 0), getattr(body, "mass", None) is None
            a, b = float(self.a.body_mass[i]), float(self.b.body_mass[j])
            alike = [
                m.body_inertia[k] / (m.body_mass[k] or 1.0) for m, k in ((self.a, i), (self.b, j))
            ]
            centres = [m.body_ipos[k] for m, k in ((self.a, i), (self.b, j))]
            if (
                inferred
                and i
                and j
                and a
                and b
                and self.near(alike[:1] + centres[:1], alike[1:] + centres[1:])
            ):
                path, differ = f"{self.names[0].path(body)}/mass", self.differ(a, b, "mass")
                self.scaled[id(body)] = (
                    Difference(path, a, b, Change({path: b})) if differ else None
                )

    def differ(self, a: Any, b: Any, field: str) -> bool:
        """Return whether values differ, and count those that do so by rounding."""
        if a is b or (type(a) is type(b) and not isinstance(a, np.ndarray) and a == b):
            return False
        x, y = _numbers(a), _numbers(b)
        if x is None or y is None or x.shape != y.shape:
            return not (x is y is None and a == b)
        if field.endswith("quat") and (x * y).sum() < 0:
            y = -y
        if np.array_equal(x, y):
            return False
        sizes = [float(np.max(np.abs(v), initial=0.0, where=np.isfinite(v))) for v in (x, y)]
        near = bool(np.allclose(x, y, rtol=0.0, atol=ROUNDING * max(sizes)))
        self.rounding += near
        return not near

    def near(self, a: Sequence[Any], b: Sequence[Any]) -> bool:
        """Return whether two sequences are equal up to rounding, which is not counted."""
        counted = self.rounding
        same = len(a) == len(b) and not any(map(self.differ, a, b, [""] * len(a)))
        self.rounding = counted
        return same

    def values(self) -> Iterator[Difference]:
        """Yield the values of elements that differ."""
        for kind in KINDS:
            of_a, of_b = (names.elements[kind] for names in self.names)
            deadline.check()
            if kind == "body":
                yield from filter(None, self.scaled.values())
            for key in of_a:
                several = list(self._element(of_a[key], of_b[key])) if key in of_b else []
                # Another type needs other values of the other fields.
                typed = any(one.path.endswith("/type") for one in several)
                yield from [_joined(several)] if typed else several

    def _element(self, a: Any, b: Any) -> Iterator[Difference]:
        path, law = self.names[0].path(a), isinstance(a, Actuator)
        if law:
            yield from self._law(path, a, b)
        for row in field_rows(type(a)).values():
            name = row.name
            if name in SKIPPED or (law and name in LAW):
                continue
            if name in MASSES and id(getattr(a, "body", None)) in self.scaled:
                continue
            old, new = (n.plain(getattr(e, name)) for n, e in zip(self.names, (a, b), strict=True))
            if not self.differ(old, new, name):
                continue
            if row.type.refers or isinstance(new, np.ndarray):
                shown = "" if isinstance(new, np.ndarray) else f": {old} in A, {new} in B"
                self.others.append(f"{path}/{name} differs{shown}")
            else:
                yield Difference(f"{path}/{name}", old, new, Change({f"{path}/{name}": new}))

    def _law(self, path: str, a: Actuator, b: Actuator) -> Iterator[Difference]:
        """Yield the differences of force laws: gains if these are all, else all of the fields."""
        # An input has the law of the actuator that it feeds.
        if a.type == b.type == "input" or _law(a) == _law(b):
            return
        if self.near(_law(a), _law(b)):
            self.rounding += 1
            return
        gains = {}
        for name in GAINS:
            old, new = (e.servo_gains.get(name, present(e, name)) for e in (a, b))
            if old is not None and new is not None and self.differ(old, new, name):
                gains[name] = old, new
        if gains and self.near(_with_gains(a, gains), _law(b)):
            for name, (old, new) in gains.items():
                yield Difference(f"{path}/{name}", old, new, Change({f"{path}/{name}": new}))
            return
        fields = [name for name in LAW if getattr(a, name) != getattr(b, name)]
        values = {f"{path}/{name}": getattr(b, name) for name in fields}
        yield Difference(f"{path} ({', '.join(fields)})", None, None, Change(values))

    def whole(self) -> Iterator[Difference]:
        """Yield the values of the whole scene that differ, such as gravity."""
        for word in WHOLE:
            old, new = (getattr(model.scene, word) for model in (self.a, self.b))
            if self.differ(old, new, word):
                yield Difference(word, old, new, Change({word: new}))

    def flags(self) -> Iterator[Difference]:
        """Yield the effects that only the first model has; list other records of the scene."""
        old, new = (dict(model.scene.features.record()) for model in (self.a, self.b))
        for name in old:
            if old[name] and not new[name]:
                yield Difference(name, True, False, Change(without=[name]))
            elif old[name] != new[name]:
                self.others.append(f"{name} is disabled in A alone")
        # Rules of masses act on masses alone, which may be compared already.
        inferred = [b for b in self.a.scene.bodies[1:] if b.mass is None]
        known = all(id(body) in self.scaled for body in inferred)
        for name in ("mass_rules", "contact_override", "excludes")[known:]:
            old, new = (n.record(getattr(m.scene, name)) for n, m in self.sides)
            if old != new:
                self.others.append(f"{name.replace('_', ' ')} differ")


def _law(actuator: Actuator) -> tuple[Any, ...]:
    """Return a force law without zeros after its parameters, which files may leave out."""
    law = actuator.law._asdict()
    return tuple(np.trim_zeros(v, "b") if name in PARAMETERS else v for name, v in law.items())


def _with_gains(actuator: Actuator, gains: Mapping[str, tuple[float, float]]) -> Any:
    """Return the force law of an actuator with other gains; gains: (old, new) by name."""
    tried = copy.copy(actuator)
    try:
        for name, (_, new) in gains.items():
            if name in tried.servo_gains:
                tried.set_servo_gain(name, new)
            else:
                setattr(tried, name, new)
        return _law(tried)
    except ValueError:
        return ()


def _numbers(value: Any) -> np.ndarray | None:
    """Return a number or an array of numbers as an array; None for other values."""
    if value is None or isinstance(value, str | bool):
        return None
    try:
        array = np.asarray(value)
    except ValueError:
        return None
    return array.astype(float) if array.dtype.kind in "fiu" else None


def _state(element: Any) -> str:
    """Return the properties of a joint or an actuator on which the size of states depends."""
    if isinstance(element, Actuator):
        return f"actuator with {element.law.states} activations"
    return f"{element.type} joint"


def _expressible(
    found: Iterable[Difference], engine: Stepcore
) -> tuple[list[Difference], list[str]]:
    """Return the differences that the first model takes, and in words those that it refuses.

    Values of one element that are refused alone may be valid together.
    """
    taken, refused = list[Difference](), dict[str, list[Difference]]()
    for one in found:
        if _refusal(engine, one.change):
            refused.setdefault(one.path.rpartition("/")[0], []).append(one)
        else:
            taken.append(one)
    said = []
    for several in refused.values():
        joined = _joined(several)
        why = _refusal(engine, joined.change)
        if why:
            said.append(f"{joined.path} differs, and A does not take B's value: {why}")
        else:
            taken.append(joined)
    return taken, said


def _joined(several: Sequence[Difference]) -> Difference:
    """Return differences of one element as one."""
    element = several[0].path.rpartition("/")[0]
    fields = ", ".join(one.path.rpartition("/")[2] for one in several)
    return Difference(f"{element} ({fields})", None, None, together(several))


def _refusal(engine: Stepcore, change: Change) -> str:
    deadline.check()
    try:
        engine.of(change)
    except ValueError as error:
        return checks.one_line(error)
    return ""


def together(some: Sequence[Difference]) -> Change:
    """Return the change of several differences."""
    return reduce(Change.also, (one.change for one in some), Change())


def _words(value: Any) -> str:
    if isinstance(value, tuple | list):
        return checks.cut(" ".join(_words(each) for each in value), 40)
    return f"{value:.6g}" if isinstance(value, float) else str(value)


def counterparts(a: Names, b: Names, kind: str) -> list[int]:
    """Return, for each element of b, the index of its counterpart in a; -1 without one."""
    places = {key: index for index, key in enumerate(a.elements[kind])}
    return [places.get(key, -1) for key in b.elements[kind]]
