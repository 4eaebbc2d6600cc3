"""Translate a URDF to equivalent MJCF; each element keeps its line number in the URDF.

Format documentation: wiki.ros.org/urdf/XML. A link becomes a body, a joint the joint of its child
body, a collision a geom, and an inertial an inertial. As in MuJoCo, `effort` limits the actuator
force on a joint (actuatorfrcrange), and `mimic` becomes a joint equality. A planar joint becomes
two slides and a hinge (named _TX, _TY, _RZ). The root link is fixed to the world. Links on fixed
joints are fused with their parent unless the file sets fusestatic="false". Unlike in MuJoCo, a
planar joint moves in the plane normal to its axis, as URDF specifies. With `free` the base has a
free joint.
"""

from __future__ import annotations

import os
from collections.abc import Iterable
from typing import Any

from stepcore.checks import cut, nearest
from stepcore.mjcf.nodes import MJCFError, Node, Refusals
from stepcore.mjcf.schema import Spec, spec
from stepcore.mjcf.validation import bad, values_of
from stepcore.scene import frames
from stepcore.scene.frames import Vec

ORIGIN = spec("xyz:3 rpy:3")
GEOMETRY = spec(
    "",
    {
        "box": spec("size!:3"),
        "sphere": spec("radius!:1"),
        "cylinder": spec("radius!:1 length!:1"),
        "capsule": spec("radius!:1 length!:1"),
        "mesh": spec("filename! scale:3"),
    },
)


def once_each(attrs: str, children: dict[str, Spec]) -> Spec:
    return spec(attrs, children, once=tuple(children))


INERTIA = spec("ixx!:1 iyy!:1 izz!:1 ixy:1 ixz:1 iyz:1")
SHAPE = {"origin": ORIGIN, "geometry": GEOMETRY}
LINK = {
    "inertial": once_each("", {"origin": ORIGIN, "mass": spec("value!:1"), "inertia": INERTIA}),
    "collision": once_each("name group", SHAPE),
}
JOINT = once_each(
    "name! type!:revolute|continuous|prismatic|spherical|fixed|floating|planar",
    {
        "origin": ORIGIN,
        "parent": spec("link!"),
        "child": spec("link!"),
        "axis": spec("xyz:3"),
        "limit": spec("lower:1 upper:1 effort:1 velocity:1"),
        "dynamics": spec("damping:1 friction:1"),
        "mimic": spec("joint! multiplier:1 offset:1"),
    },
)
ROBOT = spec("name version", {"link": spec("name! type", LINK, once=("inertial",)), "joint": JOINT})
DRAWS = ("visual", "material")
# An attribute of another program (Bullet) that resembles `name` and `scale`.
FOREIGN = ("concave",)
# Elements of MJCF, which have an effect inside <mujoco> only.
PASTED = ("compiler", "contact", "default", "equality", "exclude", "keyframe", "option")
# The program xacro may leave these elements in its output; they have no effect.
XACRO_ONLY = ("xacro:property", "xacro:arg")
MESHES = (".stl", ".obj", ".msh", ".dae")


def child_of(node: Node, tag: str) -> Node | None:
    return next((child for child in node.children if child.tag == tag), None)


def validate(root: Node, schema: Spec, refusals: Refusals) -> list[str]:
    """Set `values`, remove unread elements and attributes, and return lines for `Scene.ignored`.

    Errors are collected in `refusals`.
    """
    ignored: list[str] = []
    pending: list[tuple[Node, Spec]] = [(root, schema)]
    while pending:
        node, spec = pending.pop()
        ignored += _drop_attributes(node, spec)
        try:
            node.values = values_of(node, spec)
        except MJCFError as error:
            refusals.add(error, node)
            continue
        name = str(node.values.get("filename", ""))
        if node.tag == "mesh" and not name.lower().endswith(MESHES):
            text = f"meshes are read from {', '.join(MESHES)}; save it as one"
            refusals.add(node.error(f'<mesh filename="{name}">: {text}'))
        # Unknown elements are common in URDF files, but the shape of a geom must be known.
        shapeless = node.tag == "geometry" and not any(
            child.tag in spec.children for child in node.children
        )
        kept = []
        for child in node.children:
            if child.tag in spec.children:
                kept.append(child)
                pending.append((child, spec.children[child.tag]))
            elif child.tag.startswith("xacro:") and child.tag not in XACRO_ONLY:
                text = f"<{child.tag}>: this is xacro, from which the program xacro makes URDF"
                refusals.add(child.error(text))
            elif node is root and child.tag in PASTED:
                text = f"<{child.tag}> is of MJCF, which a URDF has inside <mujoco>"
                refusals.add(child.error(text))
            elif shapeless and child.tag not in XACRO_ONLY:
                near = nearest(child.tag, spec.children)
                refusals.add(child.error(f"unknown element <{child.tag}> in <{node.tag}>{near}"))
            else:
                why = "only draws" if child.tag in DRAWS else "says nothing about the motion"
                ignored.append(child.ignored_line(why))
        for tag in spec.once:
            same = [child for child in kept if child.tag == tag]
            if len(same) > 1:
                refusals.add(same[1].error(f"a second <{tag}> in the same <{node.tag}>"))
        node.children = kept
    return ignored


def _drop_attributes(node: Node, spec: Spec) -> list[str]:
    """Remove attributes outside URDF and infinite limits; return lines about the attributes."""
    if node.tag == "limit":
        words = {name: text.strip().lower().lstrip("+-") for name, text in node.attrs.items()}
        infinite = [name for name, word in words.items() if word in ("inf", "infinity")]
        # A joint may be unlimited on both sides, but not on one side.
        free = {"lower", "upper"} if {"lower", "upper"} <= {*infinite} else set()
        for name in {*infinite} & {"effort", "velocity", *free}:
            del node.attrs[name]
    # A misspelled attribute is missing. An attribute that resembles only given ones belongs to
    # another program.
    missing = [name for name in spec.attrs if name not in node.attrs]
    extra = [name for name in node.attrs if name not in spec.attrs]
    far = [name for name in extra if "nearest" not in nearest(name, missing)]
    foreign = [name for name in extra if name in far or name in FOREIGN]
    for name in foreign:
        del node.attrs[name]
    return [node.ignored_line(f"{name} is no attribute of URDF") for name in foreign]


def file_path(node: Node, directory: str | None, extended: bool) -> str:
    """Return the path of the file that a mesh names, or the name if there is no file.

    The name is ``package://name/…``, ``file://…``, or a path.
    extended: whether the URDF has MuJoCo's extension. The extension's meshdir and strippath then
        determine the path of a file that is not found here.
    """
    name = node.values["filename"].replace("\\", "/")
    scheme, separator, rest = name.partition("://")
    if not separator:
        scheme, rest = "", name
    if scheme == "package":
        place = _in_package(rest, directory)
    elif scheme in ("", "file", "model"):
        place = os.path.join(directory or "", rest)
    else:
        raise node.error(f'<{node.tag} filename="{name}">: {scheme}:// is not known; package:// is')
    if place and os.path.exists(place):
        return os.path.abspath(place)
    return os.path.basename(rest) if extended else rest


def _in_package(name: str, directory: str | None) -> str:
    """Return the path of a file of a package; "" if none.

    Packages are searched on ROS_PACKAGE_PATH (ROS 1), in ``share`` of the folders of
    AMENT_PREFIX_PATH (ROS 2), and in the folders that contain the URDF.
    """
    package, _, rest = name.partition("/")
    roots = _folders("ROS_PACKAGE_PATH")
    roots += [os.path.join(prefix, "share") for prefix in _folders("AMENT_PREFIX_PATH")]
    above = None if directory is None else os.path.abspath(directory)
    while above is not None:
        roots.append(above)
        parent = os.path.dirname(above)
        if os.path.basename(above) == package:
            roots.append(parent)
        above = parent if parent != above else None
    for root in roots:
        for place in (os.path.join(root, package, rest), os.path.join(root, rest)):
            if os.path.exists(place) and package in place.split(os.sep):
                return place
    return ""


def _folders(variable: str) -> list[str]:
    return [folder for folder in os.environ.get(variable, "").split(os.pathsep) if folder]


MOVES = {"revolute": "hinge", "continuous": "hinge", "prismatic": "slide", "spherical": "ball"}


def to_mjcf(root: Node, directory: str | None, free: bool = False) -> Robot:
    """Translate a URDF to MJCF.

    directory: the folder of the file, for relative mesh paths; None for a text without a folder.
    free: whether the base has a free joint.

    Raises MJCFError with all errors of the file: unknown shapes and attributes, a circle of links,
    several roots.
    """
    refusals = Refusals()
    # Namespace declarations have no meaning here.
    root.attrs = {name: text for name, text in root.attrs.items() if not name.startswith("xmlns")}
    extension = [child for child in root.children if child.tag == "mujoco"]
    root.children = [child for child in root.children if child.tag != "mujoco"]
    ignored = validate(root, ROBOT, refusals)
    refusals.raise_all()
    robot = Robot(root, directory, extension, free)
    robot.ignored = ignored
    try:
        robot.tree = robot.translated()
    except MJCFError as error:
        refusals.add(error)
    refusals.raise_all()
    return robot


class Robot:
    """The links and joints of a URDF, and their translation.

    extension: the MJCF elements of the file, `<mujoco><compiler …/></mujoco>`.
    free: whether the base has a free joint.
    tree: the MJCF tree.
    ignored: the lines for `Scene.ignored`.
    """

    tree: Node
    ignored: list[str]

    def __init__(
        self, root: Node, directory: str | None, extension: list[Node], free: bool
    ) -> None:
        self.root, self.directory, self.extension, self.free = root, directory, extension, free
        self.links = _by_name(child for child in root.children if child.tag == "link")
        self.joints = _by_name(child for child in root.children if child.tag == "joint")
        if not self.links:
            raise root.error("a robot needs a link")
        # For each link: the joint to its parent, and the joints to its children.
        self.above: dict[str, Node] = {}
        self.below: dict[str, list[Node]] = {name: [] for name in self.links}
        for joint in self.joints.values():
            self._place(joint)
        # `meshes`: nodes by file and scale. `mesh_names`: the last number appended to each name.
        self.meshes: dict[tuple[str, Vec], Node] = {}
        self.mesh_names: dict[str, int] = {}
        # Data for the notes: velocity limits, joints with an empty range, and so on.
        self.with_velocity = 0
        self.unlimited: list[str] = []
        self.unfilled: list[str] = []
        self.unfollowed: list[str] = []
        self.unnamed: list[str] = []
        self.shape_names: set[str] = set()
        # Paths of meshes that were not found, with their package.
        self.unfound: dict[str, str] = {}

    def _place(self, joint: Node) -> None:
        for end in ("parent", "child"):
            link = child_of(joint, end)
            if link is None:
                raise joint.error(f"<joint> needs a <{end}>")
            name = link.values["link"]
            if name not in self.links:
                near = nearest(name, sorted(self.links))
                raise link.error(f'<{end} link="{cut(name, 80)}">: no such link{near}')
        child = _value(joint, "child", "link")
        if child in self.above:
            raise joint.error(f'link "{cut(child, 80)}" has two joints to a parent')
        self.above[child] = joint
        self.below[_value(joint, "parent", "link")].append(joint)

    def translated(self) -> Node:
        """Return the whole model as MJCF."""
        roots = [name for name in self.links if name not in self.above]
        if not roots:
            raise self.root.error("the links make a circle: no link is the root")
        if len(roots) > 1:
            second = self.links[roots[1]]
            text = f'links "{cut(roots[0], 80)}" and "{cut(roots[1], 80)}" both have no parent'
            raise second.error(f"{text}: a robot has one root")
        world = _element("worldbody", self.root)
        equality = _element("equality", self.root)
        base = self._base(roots[0]) if self.free else ""
        placed = self._bodies(roots[0], base, world, equality)
        lost = next((name for name in self.links if name not in placed), None)
        if lost is not None:
            raise self.links[lost].error(f'link "{cut(lost, 80)}" is in a circle of links')
        model = _element("mujoco", self.root, model=self.root.attrs.get("name", ""))
        compiler = _element("compiler", self.root, angle="radian", fusestatic="true")
        asset = _element("asset", self.root)
        asset.children = [*self.meshes.values()]
        extended = [child for node in self.extension for child in node.children]
        for child in extended:
            # Visual geoms are not read.
            child.attrs.pop("discardvisual", None)
        model.children = [compiler, *extended, asset, world, equality]
        return model

    def _base(self, root: str) -> str:
        """Return the link that gets a free joint: the root, or the link fixed to a root "world"."""
        floating = [j for j in self.joints.values() if j.values["type"] == "floating"]
        if floating:
            name = cut(floating[0].values["name"], 80)
            raise floating[0].error(f'free: the floating joint "{name}" is a free base already')
        if root != "world":
            return root
        fixed = [j for j in self.below[root] if j.values["type"] == "fixed"]
        if len(fixed) != 1:
            why = f'{len(fixed)} links are fixed to the root link "world": must be 1'
            raise self.links[root].error(f"free: {why}")
        return str(_value(fixed[0], "child", "link"))

    def _bodies(self, root: str, base: str, world: Node, equality: Node) -> set[str]:
        """Add the bodies, parents first, and return the names of their links.

        base: the link that gets a free joint, or "".
        """
        placed: set[str] = set()
        pending: list[tuple[str, Node]] = [(root, world)]
        while pending:
            name, parent = pending.pop()
            placed.add(name)
            joint = self.above.get(name)
            if (
                joint is not None
                and joint.values["type"] == "floating"
                and _value(joint, "parent", "link") != root
            ):
                raise joint.error("a floating joint needs the root link as its parent")
            body = self._body(self.links[name], joint, equality)
            if name == base:
                joint_name = name if name not in self.joints else f"{name}_free"
                body.children.insert(0, _element("freejoint", self.links[name], name=joint_name))
            if name == root == "world":
                # A root link named "world" is the world, which has no mass.
                parent.children += [child for child in body.children if child.tag == "geom"]
                body = world
            else:
                parent.children.append(body)
            below = [(_value(joint, "child", "link"), body) for joint in self.below[name]]
            pending += reversed(below)
        return placed

    def _body(self, link: Node, joint: Node | None, equality: Node) -> Node:
        pose = {} if joint is None else _pose(joint)
        body = _element("body", link, name=link.values["name"], **pose)
        if joint is not None:
            body.children += self._joints(joint)
            equality.children += self._mimic(joint)
        inertial = child_of(link, "inertial")
        if inertial is not None:
            body.children.append(_inertial(inertial))
        body.children += [self._geom(node) for node in link.children if node.tag == "collision"]
        return body

    def _joints(self, joint: Node) -> list[Node]:
        kind, name = joint.values["type"], joint.values["name"]
        axis = _value(joint, "axis", "xyz", (1.0, 0.0, 0.0))
        common = {}
        for word, field in (("damping", "damping"), ("friction", "frictionloss")):
            number = _value(joint, "dynamics", word)
            if number is not None:
                if number < 0:
                    raise bad(child_of(joint, "dynamics") or joint, word, number, ">= 0")
                common[field] = repr(number)
        if kind == "fixed":
            return []
        if kind == "floating":
            return [_element("joint", joint, name=name, type="free", **common)]
        if not any(axis):
            raise bad(child_of(joint, "axis") or joint, "xyz", axis, "an axis that is not zero")
        if kind == "planar":
            turn = frames.from_z_axis(axis)
            # The images of the three axes are the columns of the rotation.
            x, y, z = zip(*frames.matrix(turn), strict=True)
            parts = [("_TX", "slide", x), ("_TY", "slide", y), ("_RZ", "hinge", z)]
        else:
            parts = [("", MOVES[kind], axis)]
            common |= self._limits(joint, kind)
        return [
            _element("joint", joint, name=name + end, type=type, axis=_written(way), **common)
            for end, type, way in parts
        ]

    def _limits(self, joint: Node, kind: str) -> dict[str, str]:
        limit = child_of(joint, "limit")
        if limit is None:
            return {}
        attrs = {}
        self.with_velocity += "velocity" in limit.values
        low, high = limit.values.get("lower", 0.0), limit.values.get("upper", 0.0)
        if kind != "continuous" and low < high:
            attrs["range"] = _written((low, high))
        elif kind != "continuous":
            self.unlimited.append(joint.values["name"])
        # As in MuJoCo, a negative effort counts by its absolute value.
        effort = abs(limit.values.get("effort", 0.0))
        if not effort and not limit.values.get("velocity"):
            self.unfilled.append(joint.values["name"])
        if effort > 0:
            attrs["actuatorfrcrange"] = _written((-effort, effort))
        return attrs

    def _mimic(self, joint: Node) -> list[Node]:
        mimic = child_of(joint, "mimic")
        if mimic is None:
            return []
        other = mimic.values["joint"]
        if other not in self.joints:
            near = nearest(other, sorted(self.joints))
            raise mimic.error(f'<mimic joint="{cut(other, 80)}">: no such joint{near}')
        name = joint.values["name"]
        for node in (joint, self.joints[other]):
            kind = node.values["type"]
            if MOVES.get(kind) not in ("hinge", "slide"):
                self.unfollowed.append(f'"{name}" ("{node.values["name"]}" is {kind})')
                return []
        line = (mimic.values.get("offset", 0.0), mimic.values.get("multiplier", 1.0), 0.0, 0.0, 0.0)
        return [_element("joint", mimic, joint1=name, joint2=other, polycoef=_written(line))]

    def _geom(self, collision: Node) -> Node:
        geometry = child_of(collision, "geometry")
        if geometry is None or len(geometry.children) != 1:
            raise collision.error(f"<{collision.tag}> needs a <geometry> with one shape")
        shape = geometry.children[0]
        values = shape.values
        size: Vec = ()
        attrs = {"type": shape.tag}
        if shape.tag == "mesh":
            attrs["mesh"] = self._mesh(shape)
        elif shape.tag == "box":
            size = tuple(side / 2 for side in values["size"])
        elif shape.tag == "sphere":
            size = (values["radius"],)
        else:
            size = (values["radius"], values["length"] / 2)
        if any(number <= 0 for number in size):
            raise shape.error(f"<{shape.tag}> = {size}: sizes must be > 0")
        if size:
            attrs["size"] = _written(size)
        name = collision.values.get("name", "")
        if name in self.shape_names:
            self.unnamed.append(f'"{name}"')
        elif name:
            self.shape_names.add(name)
            attrs["name"] = name
        return _element("geom", collision, **attrs, **_pose(collision))

    def _mesh(self, node: Node) -> str:
        scale = node.values.get("scale", (1.0, 1.0, 1.0))
        path = file_path(node, self.directory, bool(self.extension))
        scheme, _, rest = node.values["filename"].replace("\\", "/").partition("://")
        if scheme == "package" and not os.path.isabs(path):
            self.unfound[path] = rest.partition("/")[0]
        if (path, scale) not in self.meshes:
            name = stem = os.path.splitext(os.path.basename(path))[0] or "mesh"
            while name in self.mesh_names:
                self.mesh_names[stem] = self.mesh_names.get(stem, 1) + 1
                name = f"{stem}_{self.mesh_names[stem]}"
            self.mesh_names.setdefault(name, 1)
            self.meshes[path, scale] = _element(
                "mesh", node, name=name, file=path, scale=_written(scale)
            )
        return self.meshes[path, scale].attrs["name"]

    def missing(self, error: FileNotFoundError) -> FileNotFoundError:
        """Return the error about a missing mesh, with the places where its package is searched."""
        text = str(error)
        package = next((name for path, name in self.unfound.items() if path in text), None)
        if package is None:
            return error
        return FileNotFoundError(
            f'{text}; the package "{cut(package, 80)}" is searched in the folders that contain the '
            "URDF, on ROS_PACKAGE_PATH, and in share of the folders of AMENT_PREFIX_PATH"
        )

    def notes(self) -> list[str]:
        """Return the notes about the translation for the user."""
        lists = (
            ("joints whose lower limit is not below the upper have none", self.unlimited),
            ("<mimic> does nothing where a joint neither turns nor slides", self.unfollowed),
            ("of collisions with one name only the first has it", self.unnamed),
        )
        notes = [f"{text}: {cut(', '.join(names), 200)}" for text, names in lists if names]
        if n := self.with_velocity:
            notes.insert(0, f"velocity limits of {n} joint{'s' * (n > 1)} are not modelled")
        root = next(name for name in self.links if name not in self.above)
        floats = any(joint.values["type"] == "floating" for joint in self.joints.values())
        # A root called world is the world.
        if not floats and root != "world" and not self.free:
            notes.append(
                "the root link is fixed to the world; load(..., free=True), or --free, gives it a "
                "free joint"
            )
        return [f"{self.root.file}:{self.root.line}: {note}" for note in notes]


def _by_name(nodes: Iterable[Node]) -> dict[str, Node]:
    named: dict[str, Node] = {}
    for node in nodes:
        name = node.values["name"]
        if name in named:
            raise node.error(f'{node.tag} "{cut(name, 80)}": the name is used twice')
        named[name] = node
    return named


def _value(node: Node, tag: str, attribute: str, default: Any = None) -> Any:
    child = child_of(node, tag)
    return default if child is None else child.values.get(attribute, default)


def _written(numbers: Iterable[float]) -> str:
    return " ".join(map(repr, numbers))


def _element(tag: str, source: Node, **attrs: str) -> Node:
    """Return an MJCF element with the file and line of the URDF element `source`."""
    return Node(tag, attrs, source.file, source.line)


def _turn(node: Node) -> Vec:
    return frames.from_euler(_value(node, "origin", "rpy", frames.ORIGIN), "XYZ")


def _pose(node: Node) -> dict[str, str]:
    pos = _value(node, "origin", "xyz", frames.ORIGIN)
    return {"pos": _written(pos), "quat": _written(_turn(node))}


def _inertial(node: Node) -> Node:
    """Return mass, centre of mass and inertia, in the axes of the link."""
    mass = child_of(node, "mass")
    if mass is None:
        raise node.error("<inertial> needs a <mass>")
    six = [
        _value(node, "inertia", word, 0.0) for word in ("ixx", "iyy", "izz", "ixy", "ixz", "iyz")
    ]
    return _element(
        "inertial",
        node,
        pos=_written(_value(node, "origin", "xyz", frames.ORIGIN)),
        mass=repr(mass.values["value"]),
        fullinertia=_written(frames.turned_inertia(_turn(node), tuple(six))),
    )
