"""A URDF as the MJCF that means the same, element by element, each with its line in the URDF.

A link is a body, a joint the joint of its child, a collision a geom, an inertial an inertial. What
MuJoCo makes of a URDF is made here: `effort` clamps what actuators put on a joint
(actuatorfrcrange), `mimic` is a joint equality, a planar joint is two slides and a hinge (named
_TX, _TY, _RZ), the root link stands on the world, and links on fixed joints are fused with what
carries them unless the file says fusestatic="false". Other than in MuJoCo, what a planar joint
moves in is the plane of its axis, as URDF says.
"""

from __future__ import annotations

import os
from collections.abc import Iterable
from typing import TypeVar

from stepcore.checks import cut, nearest
from stepcore.mjcf.nodes import MJCFError, Node
from stepcore.mjcf.notation import Spec
from stepcore.mjcf.refusals import Refusals
from stepcore.mjcf.validation import bad, values_of
from stepcore.scene import frames
from stepcore.urdf.file_paths import mesh_path
from stepcore.urdf.schema import DRAWS, FOREIGN, ROBOT, XACRO_ONLY

# A joint without an axis turns or slides along the first.
X, Y, Z = (1.0, 0.0, 0.0), (0.0, 1.0, 0.0), (0.0, 0.0, 1.0)
MOVES = {"revolute": "hinge", "continuous": "hinge", "prismatic": "slide", "floating": "free"}


def to_mjcf(root: Node, directory: str | None) -> tuple[Node, list[str], list[str]]:
    """The MJCF tree of a URDF, the lines for `Scene.ignored`, and those for `Scene.notes`.

    directory: the folder of the file, from which meshes are found; None for a text without one.

    Raises MJCFError with all errors of the file: what is unknown, links in a circle, several roots.
    """
    robot, tree, ignored = translated(Robot, ROBOT, root, directory)
    return tree, ignored, robot.notes()


def translated(
    kind: type[RobotT], schema: Spec, root: Node, directory: str | None
) -> tuple[RobotT, Node, list[str]]:
    refusals = Refusals()
    # Names of namespaces say nothing.
    root.attrs = {name: text for name, text in root.attrs.items() if not name.startswith("xmlns")}
    extension = [child for child in root.children if child.tag == "mujoco"]
    root.children = [child for child in root.children if child.tag != "mujoco"]
    ignored = validate(root, schema, refusals)
    refusals.raise_all()
    robot = kind(root, directory, extension)
    try:
        tree = robot.tree()
    except MJCFError as error:
        refusals.add(error)
    refusals.raise_all()
    return robot, tree, ignored


def validate(root: Node, schema: Spec, refusals: Refusals) -> list[str]:
    """Sets `values`, drops what is not read, and returns the lines for `Scene.ignored`."""
    ignored: list[str] = []
    pending: list[tuple[Node, Spec]] = [(root, schema)]
    while pending:
        node, spec = pending.pop()
        ignored += _strip(node, spec)
        try:
            node.values = values_of(node, spec)
        except MJCFError as error:
            refusals.add(error, node)
            continue
        kept = []
        for child in node.children:
            inner = spec.children.get(child.tag)
            if child.tag in XACRO_ONLY:
                ignored.append(child.listed("says nothing about the motion"))
            elif child.tag.startswith("xacro:"):
                text = f"<{child.tag}>: this is xacro, from which the program xacro makes URDF"
                refusals.add(child.error(text))
            elif inner is None and _lacks_shape(node, spec):
                near = nearest(child.tag, spec.children)
                refusals.add(child.error(f"unknown element <{child.tag}> in <{node.tag}>{near}"))
            elif inner is None:
                why = "only draws" if child.tag in DRAWS else "says nothing about the motion"
                ignored.append(child.listed(why))
            else:
                kept.append(child)
                pending.append((child, inner))
        for tag in spec.once:
            same = [child for child in kept if child.tag == tag]
            if len(same) > 1:
                refusals.add(same[1].error(f"a second <{tag}> in the same <{node.tag}>"))
        node.children = kept
    return ignored


def _lacks_shape(node: Node, spec: Spec) -> bool:
    """URDF is extended freely, but the shape of a geom must be one that is known."""
    return node.tag == "geometry" and not any(child.tag in spec.children for child in node.children)


def _strip(node: Node, spec: Spec) -> list[str]:
    """Drops what extends URDF, and limits that are infinite; returns the lines about the former."""
    if node.tag == "limit":
        pair = [node.attrs.get(name, "").strip().lower() for name in ("lower", "upper")]
        none = ("effort", "velocity") + (("lower", "upper") if _all_infinite(pair) else ())
        for name in none:
            if _all_infinite([node.attrs.get(name, "").strip().lower()]):
                del node.attrs[name]
    extra = [name for name in node.attrs if name not in spec.attrs]
    far = [name for name in extra if "nearest" not in nearest(name, spec.attrs)]
    foreign = [name for name in extra if name in far or name in FOREIGN]
    for name in foreign:
        del node.attrs[name]
    return [node.listed(f"{name} is no attribute of URDF") for name in foreign]


def _all_infinite(words: list[str]) -> bool:
    return all(word.lstrip("+-") in ("inf", "infinity") for word in words)


class Robot:
    """The links and joints of a URDF, and the tree that they make.

    extension: elements of MJCF in the file, `<mujoco><compiler …/></mujoco>`: MuJoCo's extension.
    """

    def __init__(self, root: Node, directory: str | None, extension: list[Node]) -> None:
        self.root, self.directory, self.extension = root, directory, extension
        self.links = _by_name(child for child in root.children if child.tag == "link")
        self.joints = _by_name(child for child in root.children if child.tag == "joint")
        if not self.links:
            raise root.error("a robot needs a link")
        # By link: the joint that moves it, and those that it carries.
        self.above: dict[str, Node] = {}
        self.below: dict[str, list[Node]] = {name: [] for name in self.links}
        for joint in self.joints.values():
            self._place(joint)
        self.meshes: dict[tuple[str, tuple[float, ...]], Node] = {}
        # The names of these, and the last number behind each.
        self.mesh_names: dict[str, int] = {}
        # What is noted: limits of velocity, and joints whose range is empty.
        self.with_velocity = 0
        self.unlimited: list[str] = []
        self.unfollowed: list[str] = []
        self.unnamed: list[str] = []
        self.shape_names: set[str] = set()

    def _place(self, joint: Node) -> None:
        for end in ("parent", "child"):
            link = inside(joint, end)
            if link is None:
                raise joint.error(f"<joint> needs a <{end}>")
            name = link.values["link"]
            if name not in self.links:
                near = nearest(name, sorted(self.links))
                raise link.error(f'<{end} link="{cut(name, 80)}">: no such link{near}')
        child = _text(joint, "child", "link")
        if child in self.above:
            raise joint.error(f'link "{cut(child, 80)}" has two joints to a parent')
        self.above[child] = joint
        self.below[_text(joint, "parent", "link")].append(joint)

    def tree(self) -> Node:
        """The whole model as MJCF."""
        roots = [name for name in self.links if name not in self.above]
        if not roots:
            raise self.root.error("the links make a circle: no link is the root")
        if len(roots) > 1:
            second = self.links[roots[1]]
            text = f'links "{cut(roots[0], 80)}" and "{cut(roots[1], 80)}" both have no parent'
            raise second.error(f"{text}: a robot has one root")
        world = mjcf_node("worldbody", self.root)
        equality = mjcf_node("equality", self.root)
        placed = self._bodies(roots[0], world, equality)
        lost = next((name for name in self.links if name not in placed), None)
        if lost is not None:
            raise self.links[lost].error(f'link "{cut(lost, 80)}" is in a circle of links')
        model = mjcf_node("mujoco", self.root, model=self.root.attrs.get("name", ""))
        compiler = mjcf_node("compiler", self.root, angle="radian", fusestatic="true")
        asset = mjcf_node("asset", self.root)
        asset.children = list(self.meshes.values())
        own = [child for node in self.extension for child in node.children]
        model.children = [compiler, *own, asset, world, equality]
        return model

    def _bodies(self, root: str, world: Node, equality: Node) -> set[str]:
        """Adds the bodies, parents first, and returns the names of their links."""
        placed: set[str] = set()
        pending: list[tuple[str, Node]] = [(root, world)]
        while pending:
            name, parent = pending.pop()
            placed.add(name)
            joint = self.above.get(name)
            if joint is not None and joint.values["type"] == "floating":
                if _text(joint, "parent", "link") != root:
                    raise joint.error("a floating joint needs the root link as its parent")
                # The root stands still at the world's origin.
                parent = world
            body = self._body(self.links[name], joint, equality)
            if name == root == "world":
                # It is the world, which has no mass.
                parent.children += [child for child in body.children if child.tag == "geom"]
                body = world
            else:
                parent.children.append(body)
            below = [(_text(joint, "child", "link"), body) for joint in self.below[name]]
            pending += reversed(below)
        return placed

    def _body(self, link: Node, joint: Node | None, equality: Node) -> Node:
        pose = {} if joint is None else _pose(joint)
        body = mjcf_node("body", link, name=link.values["name"], **pose)
        if joint is not None:
            body.children += self._joints(joint)
            equality.children += self._mimic(joint)
        inertial = inside(link, "inertial")
        if inertial is not None:
            body.children.append(_inertial(inertial))
        body.children += self._geoms(link)
        return body

    def _geoms(self, link: Node) -> list[Node]:
        return [self._geom(node) for node in link.children if node.tag == "collision"]

    def _joints(self, joint: Node) -> list[Node]:
        kind, name = joint.values["type"], joint.values["name"]
        axis = numbers_of(joint, "axis", "xyz", X)
        common = _dynamics(joint)
        if kind == "fixed":
            return []
        if kind == "floating":
            return [mjcf_node("joint", joint, name=name, type="free")]
        if not any(axis):
            raise bad(inside(joint, "axis") or joint, "xyz", axis, "an axis that is not zero")
        if kind == "planar":
            return _planar(joint, axis, common)
        common |= self._limits(joint, kind)
        return [
            mjcf_node("joint", joint, name=name, type=MOVES[kind], axis=written(axis), **common)
        ]

    def _limits(self, joint: Node, kind: str) -> dict[str, str]:
        limit = inside(joint, "limit")
        if limit is None:
            return {}
        values, found = limit.values, {}
        self.with_velocity += "velocity" in values
        low, high = values.get("lower", 0.0), values.get("upper", 0.0)
        if kind != "continuous" and low < high:
            found["range"] = written((low, high))
        elif kind != "continuous":
            self.unlimited.append(joint.values["name"])
        # MuJoCo takes the size of a negative one too.
        effort = abs(values.get("effort", 0.0))
        if effort > 0:
            found["actuatorfrcrange"] = written((-effort, effort))
        return found

    def _mimic(self, joint: Node) -> list[Node]:
        mimic = inside(joint, "mimic")
        if mimic is None:
            return []
        other = mimic.values["joint"]
        if other not in self.joints:
            near = nearest(other, sorted(self.joints))
            raise mimic.error(f'<mimic joint="{cut(other, 80)}">: no such joint{near}')
        for node in (joint, self.joints[other]):
            kind = node.values["type"]
            if MOVES.get(kind) not in ("hinge", "slide"):
                text = f'"{joint.values["name"]}" ("{node.values["name"]}" is {kind})'
                self.unfollowed.append(text)
                return []
        line = (mimic.values.get("offset", 0.0), mimic.values.get("multiplier", 1.0), 0.0, 0.0, 0.0)
        ends = {"joint1": joint.values["name"], "joint2": other}
        return [mjcf_node("joint", mimic, **ends, polycoef=written(line))]

    def _geom(self, collision: Node) -> Node:
        geometry = inside(collision, "geometry")
        if geometry is None or len(geometry.children) != 1:
            raise collision.error(f"<{collision.tag}> needs a <geometry> with one shape")
        shape = geometry.children[0]
        values = shape.values
        size: tuple[float, ...]
        more: dict[str, str] = {}
        if shape.tag == "box":
            size = tuple(side / 2 for side in values["size"])
        elif shape.tag == "sphere":
            size = (values["radius"],)
        elif shape.tag == "mesh":
            size, more = (), {"mesh": self._mesh(shape)}
        else:
            size = (values["radius"], values["length"] / 2)
        if any(number <= 0 for number in size):
            raise shape.error(f"<{shape.tag}> = {size}: sizes must be > 0")
        if size:
            more["size"] = written(size)
        name = collision.values.get("name", "")
        if name in self.shape_names:
            self.unnamed.append(f'"{name}"')
        elif name:
            self.shape_names.add(name)
            more["name"] = name
        return mjcf_node("geom", collision, type=shape.tag, **more, **_pose(collision))

    def _mesh(self, node: Node) -> str:
        """The name of the asset of a mesh, one for each file and scale."""
        scale = node.values.get("scale", (1.0, 1.0, 1.0))
        path = mesh_path(node, self.directory, bool(self.extension))
        if (path, scale) not in self.meshes:
            stem = os.path.splitext(os.path.basename(path))[0] or "mesh"
            name = self._unused(stem)
            own = {"name": name, "file": path, "scale": written(scale)}
            self.meshes[path, scale] = mjcf_node("mesh", node, **own)
        return self.meshes[path, scale].attrs["name"]

    def _unused(self, stem: str) -> str:
        """A name that no mesh has: the stem, or the stem with a number."""
        name = stem
        while name in self.mesh_names:
            self.mesh_names[stem] = self.mesh_names.get(stem, 1) + 1
            name = f"{stem}_{self.mesh_names[stem]}"
        self.mesh_names.setdefault(name, 1)
        return name

    def notes(self) -> list[str]:
        """What else a user should know of the translation."""
        place = f"{self.root.file}:{self.root.line}"
        found = []
        if self.with_velocity:
            found.append(
                f"{place}: velocity limits of {self.with_velocity} joints are not modelled"
            )
        if self.unlimited:
            names = cut(", ".join(self.unlimited), 200)
            found.append(
                f"{place}: joints whose lower limit is not below the upper have none: {names}"
            )
        if self.unfollowed:
            names = cut(", ".join(self.unfollowed), 200)
            found.append(
                f"{place}: <mimic> does nothing where a joint neither turns nor slides: {names}"
            )
        if self.unnamed:
            names = cut(", ".join(self.unnamed), 200)
            found.append(f"{place}: of collisions with one name only the first has it: {names}")
        if not any(joint.values["type"] == "floating" for joint in self.joints.values()):
            root = next(name for name in self.links if name not in self.above)
            found.append(
                f"{place}: the root link is fixed to the world; load(..., fuse=False) keeps it a "
                f'body, which scene.add_joint("{cut(root, 80)}", "free") sets free'
            )
        return found


RobotT = TypeVar("RobotT", bound=Robot)


def _by_name(nodes: Iterable[Node]) -> dict[str, Node]:
    found: dict[str, Node] = {}
    for node in nodes:
        name = node.values["name"]
        if name in found:
            raise node.error(f'{node.tag} "{cut(name, 80)}": the name is used twice')
        found[name] = node
    return found


def inside(node: Node, tag: str) -> Node | None:
    return next((child for child in node.children if child.tag == tag), None)


def _text(node: Node, tag: str, attribute: str) -> str:
    inner = inside(node, tag)
    assert inner is not None
    text: str = inner.values[attribute]
    return text


def numbers_of(node: Node, tag: str, attribute: str, default: frames.Vec) -> frames.Vec:
    inner = inside(node, tag)
    numbers: frames.Vec = default if inner is None else inner.values.get(attribute, default)
    return numbers


def written(numbers: Iterable[float]) -> str:
    return " ".join(map(repr, numbers))


def mjcf_node(tag: str, of: Node, **attrs: str) -> Node:
    """An element of MJCF that stands where an element of the URDF stands."""
    return Node(tag, attrs, of.file, of.line)


def _turn(node: Node) -> frames.Vec:
    """Fixed axes: about x, then y, then z of the parent."""
    return frames.from_euler(numbers_of(node, "origin", "rpy", frames.ORIGIN), "XYZ")


def _pose(node: Node) -> dict[str, str]:
    pos = numbers_of(node, "origin", "xyz", frames.ORIGIN)
    return {"pos": written(pos), "quat": written(_turn(node))}


def _inertial(node: Node) -> Node:
    """Mass, centre and inertia, in the axes of the link."""
    mass, inertia = inside(node, "mass"), inside(node, "inertia")
    if mass is None:
        raise node.error("<inertial> needs a <mass>")
    six = (0.0,) * 6
    if inertia is not None:
        words = ("ixx", "iyy", "izz", "ixy", "ixz", "iyz")
        six = tuple(inertia.values.get(word, 0.0) for word in words)
    own = {
        "pos": written(numbers_of(node, "origin", "xyz", frames.ORIGIN)),
        "mass": repr(mass.values["value"]),
        "fullinertia": written(frames.turned_inertia(_turn(node), six)),
    }
    return mjcf_node("inertial", node, **own)


def _planar(joint: Node, axis: frames.Vec, common: dict[str, str]) -> list[Node]:
    """Two slides across the axis and a hinge about it."""
    turn = frames.from_z_axis(axis)
    made = []
    for end, kind, own in (("_TX", "slide", X), ("_TY", "slide", Y), ("_RZ", "hinge", Z)):
        attrs = {"name": joint.values["name"] + end, "type": kind}
        attrs["axis"] = written(frames.rotated(turn, own))
        made.append(mjcf_node("joint", joint, **attrs, **common))
    return made


def _dynamics(joint: Node) -> dict[str, str]:
    dynamics = inside(joint, "dynamics")
    if dynamics is None:
        return {}
    found = {}
    for word, field in (("damping", "damping"), ("friction", "frictionloss")):
        if dynamics.values.get(word, 0.0) < 0:
            raise bad(dynamics, word, dynamics.values[word], ">= 0")
        if word in dynamics.values:
            found[field] = repr(dynamics.values[word])
    return found
