"""The sections `<compiler>` and `<default>`, which complete the attributes of elements."""

from __future__ import annotations

import math
import os
from collections.abc import Iterable
from typing import Any

from stepcore.checks import nearest
from stepcore.mjcf import gains
from stepcore.mjcf.nodes import Node
from stepcore.mjcf.schema import ACTUATORS, ORIENTATION, given
from stepcore.mjcf.validation import bad
from stepcore.scene import frames
from stepcore.scene.elements import LengthRange, MassRules
from stepcore.scene.frames import Vec


class Compiler:
    """The compiler settings of a file; a later section overrides an earlier one.

    directory: the folder of the model's main file, or None for a text without a folder.
    file: the name of the main file; elements of included files have another name.
    """

    def __init__(
        self, sections: Iterable[Node], directory: str | None = None, file: str = ""
    ) -> None:
        self.directory = directory
        self.file = file
        self.values: dict[str, Any] = {}
        self.ranges: dict[str, Any] = {}
        for node in sections:
            self.values |= node.values
            if node.values.get("coordinate") == "global":
                limit = "local: MuJoCo dropped global coordinates"
                raise bad(node, "coordinate", "global", limit)
            sequence = node.values.get("eulerseq", "xyz")
            if len(sequence) != 3 or sequence.lower().strip("xyz"):
                raise bad(node, "eulerseq", sequence, "three letters of x, y, z, X, Y, Z")
            for child in node.children:
                self.ranges |= child.values
        self.degrees = self.values.get("angle", "degree") == "degree"
        self.autolimits: bool = self.values.get("autolimits", True)
        self.eulerseq: str = self.values.get("eulerseq", "xyz")

    def path(self, node: Node, name: str, folder: str = "") -> str:
        """Return the path of the file that an element names.

        As in MuJoCo, the file is searched in `folder`, relative to the main file. For an element of
        an included file, the search continues in the included file's relative folder within
        `folder`, and then in the included file's own folder.
        """
        home = os.path.join(self.directory or "", folder)
        places = [os.path.join(home, name)]
        if node.file != self.file:
            beside = os.path.abspath(os.path.dirname(node.file))
            within = os.path.relpath(beside, self.directory)
            places += [os.path.join(home, within, name), os.path.join(beside, name)]
        return next((place for place in places if os.path.isfile(place)), places[0])

    def mass_rules(self) -> MassRules:
        return MassRules(**given(MassRules, self.values))

    def lengthrange(self) -> LengthRange:
        return LengthRange(**self.ranges)

    def radians(self, angle: float) -> float:
        return angle * (math.pi / 180) if self.degrees else angle

    def orientation(self, node: Node, values: dict[str, Any]) -> Vec:
        """Return the unit quaternion of an element's orientation attribute, by default identity."""
        given = [name for name in ORIENTATION if name in values]
        if len(given) > 1:
            raise node.error(f"<{node.tag}> has two orientations: {given[0]} and {given[1]}")
        if not given:
            return frames.IDENTITY
        numbers = values[given[0]]
        try:
            if given[0] == "axisangle":
                return frames.from_axis_angle(numbers[:3], self.radians(numbers[3]))
            if given[0] == "xyaxes":
                return frames.from_xy_axes(numbers[:3], numbers[3:])
            if given[0] == "zaxis":
                return frames.from_z_axis(numbers)
            if given[0] == "euler":
                return frames.from_euler([self.radians(a) for a in numbers], self.eulerseq)
            # A unit quaternion is not normalised again, so that writing and reading is exact.
            if abs(math.hypot(*numbers) - 1.0) <= 1e-15:
                return tuple(numbers)
            return frames.normalised(numbers, "the quaternion")
        except ValueError as error:
            raise bad(node, given[0], numbers, f"a direction: {error}") from None


Values = dict[str, Any]
MAIN = "main"
# Attributes of a class that name assets.
ASSETS = ("mesh", "hfield", "material")


def overlay(under: Values, over: Values) -> Values:
    """Return the values of `under`, overridden by those of `over`.

    A shorter vector replaces only its own entries. An orientation attribute replaces any other.
    """
    result = dict(under)
    if any(name in over for name in ORIENTATION):
        for name in ORIENTATION:
            result.pop(name, None)
    for name, value in over.items():
        old = result.get(name)
        if isinstance(value, tuple) and isinstance(old, tuple) and len(old) > len(value):
            value = value + old[len(value) :]
        result[name] = value
    return result


class Defaults:
    """The default classes of a model; `of` completes an element's attributes."""

    def __init__(self, sections: Iterable[Node]) -> None:
        self.classes: dict[str, dict[str, Values]] = {MAIN: {}}
        # The actuator gains of each class and the classes around it, the outermost first.
        self.chains: dict[str, gains.Chain] = {MAIN: (gains.ActuatorGains(),)}
        for section in sections:
            if section.attrs.get("class", MAIN) != MAIN:
                raise section.error('the outermost <default> has the class "main" and no other')
            self._read(section)

    def _read(self, section: Node) -> None:
        # A class's own elements are read before its nested classes, in any document order.
        pending = [(section, MAIN)]
        while pending:
            node, name = pending.pop()
            own = self.classes[name]
            for child in node.children:
                if child.tag != "default":
                    tag = "actuator" if child.tag in ACTUATORS else child.tag
                    own[tag] = overlay(own.get(tag, {}), child.values)
                    if tag == "actuator":
                        own[tag] = gains.without_range(own[tag], child)
                        chain = self.chains[name]
                        made = gains.inherited(chain, child)
                        self.chains[name] = (*chain[:-1], made)
                        own[tag] = gains.saturated(own[tag], made, child)
            inner = [child for child in node.children if child.tag == "default"]
            for child in inner:
                inner_name = child.attrs.get("class", "")
                if not inner_name:
                    raise child.error('a nested <default> needs class="…"')
                if inner_name in self.classes:
                    raise child.error(f'the default class "{inner_name}" is defined twice')
                self.classes[inner_name] = dict(own)
                self.chains[inner_name] = (*self.chains[name], self.chains[name][-1])
            pending += [(child, child.attrs["class"]) for child in reversed(inner)]

    def adopt(self, other: Defaults, prefix: str) -> dict[str, str]:
        """Add the classes of an attached model, with the prefix before class and asset names.

        Returns the new name of each class by its original name. If this model has a different class
        of the prefixed name, the new name gets an apostrophe.
        """
        names = {}
        for name, own in other.classes.items():
            new = {
                tag: {k: prefix + v if k in ASSETS else v for k, v in values.items()}
                for tag, values in own.items()
            }
            both = new, other.chains[name]
            here = prefix + name
            while here in self.classes and (self.classes[here], self.chains[here]) != both:
                here += "'"
            names[name] = here
            self.classes[here], self.chains[here] = both
        return names

    def known(self, node: Node, attribute: str) -> str | None:
        """Return the class that an attribute of a node names; None without the attribute."""
        name = node.attrs.get(attribute)
        if name is not None and name not in self.classes:
            raise node.error(f'unknown default class "{name}"{nearest(name, self.classes)}')
        return name

    def of(self, node: Node, childclass: str | None = None, kind: str = "") -> Values:
        """Return a node's values, completed from its class, else from `childclass`, else from main.

        kind: the tag in the default class if it differs from the node's tag: "actuator",
        "equality" or "tendon".
        """
        name = self.known(node, "class") or childclass or MAIN
        given = {key: value for key, value in node.values.items() if key != "class"}
        return overlay(self.classes[name].get(kind or node.tag, {}), given)

    def gains(self, node: Node) -> gains.ActuatorGains:
        return gains.inherited(self.chains[self.known(node, "class") or MAIN], node)
