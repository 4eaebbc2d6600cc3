"""The section `<compiler>`: units of angles, orientations, limits, and mass rules."""

from __future__ import annotations

import math
import os
from collections.abc import Iterable
from typing import Any

from stepcore.mjcf.attributes import given
from stepcore.mjcf.nodes import Node
from stepcore.mjcf.notation import ORIENTATION
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
            self._check(node)
            for child in node.children:
                self.ranges |= child.values
        self.degrees = self.values.get("angle", "degree") == "degree"
        self.autolimits: bool = self.values.get("autolimits", True)
        self.eulerseq: str = self.values.get("eulerseq", "xyz")

    def _check(self, node: Node) -> None:
        if node.values.get("coordinate") == "global":
            raise bad(node, "coordinate", "global", "local: MuJoCo dropped global coordinates")
        sequence = node.values.get("eulerseq", "xyz")
        if len(sequence) != 3 or sequence.lower().strip("xyz"):
            raise bad(node, "eulerseq", sequence, "three letters of x, y, z, X, Y, Z")

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
        """Return the mass rules."""
        return MassRules(**given(MassRules, self.values))

    def lengthrange(self) -> LengthRange:
        """Return the settings for computing the length ranges of muscles."""
        return LengthRange(**self.ranges)

    def radians(self, angle: float) -> float:
        """Return an angle of the file in radians."""
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
