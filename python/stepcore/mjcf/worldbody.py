"""The section `<worldbody>`: bodies, frames, joints, geoms and sites."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import partial
from typing import TYPE_CHECKING, Any, TypeVar

from stepcore.mjcf.assets import Assets
from stepcore.mjcf.defaults import Compiler, Defaults
from stepcore.mjcf.nodes import Node, Refusals, inside, sections
from stepcore.mjcf.schema import NOT_IN_WORLD, given
from stepcore.mjcf.validation import bad
from stepcore.scene import frames
from stepcore.scene.elements import Body, Element, Geom, Joint, Key, MassRules
from stepcore.scene.elements.body import SITE_SIZE
from stepcore.scene.frames import Vec

if TYPE_CHECKING:
    from stepcore.scene.scene import Scene

T = TypeVar("T")
# Fields of a joint and of a geom that are not copied from attributes.
_OF_JOINT = ("name", "type", "pos", "axis", "range", "actuatorfrcrange", "ref", "springref")
_OF_GEOM = ("name", "type", "size", "pos", "quat", "mesh", "hfield")
AT_ORIGIN = (frames.ORIGIN, frames.IDENTITY)


class EmptyRange(str):
    """The note on an empty range of the file: its lower bound is not below its upper bound."""

    where: str
    field: str
    bounds: tuple[float, ...]

    @classmethod
    def of(cls, where: str, field: str, bounds: tuple[float, ...]) -> EmptyRange:
        note = cls(f"{where}: {field} = {bounds[0]:g} {bounds[1]:g} is empty: no limit")
        note.where, note.field, note.bounds = where, field, bounds
        return note


@dataclass(frozen=True)
class Place:
    """The place of an element: its body, the pose of its frame in that body, and its childclass."""

    body: Body
    pose: tuple[Vec, Vec] = AT_ORIGIN
    childclass: str | None = None


@dataclass(frozen=True)
class Shape:
    """A geom of the file.

    heavy: whether the geom gives mass to a body without an inertial.
    fluid: whether the geom has a fluid shape.
    values: the attributes, completed from the default class.
    """

    node: Node
    geom: Geom
    collides: bool
    heavy: bool
    fluid: bool
    values: dict[str, Any]


class WorldReader:
    """The reader of the kinematic tree, with the records that later sections and passes need.

    Elements and nodes are identified by their ``id``.

    nodes: the node of each element.
    elements: the element of each node.
    names: the names that later sections can refer to, by kind.
    references: (node, kind, name) of each reference to a material or mesh.
    shapes: the geoms, with the data that decides whether they are needed.
    written: for each body inside a frame, the pose that the file gives.
    ranges: for each joint or tendon, limited or not, the range that servos can inherit.
    lights: the lights, each with its place.
    mesh_sites: the names of sites whose volume is a mesh.
    open_keys: keyframes of attached models, with the joints whose positions they give.
    only_drawn: geoms that only draw, if they are kept for drawing (`Assets.drawn`).
    settled: whether one set of mass rules applies to all bodies (`masses.settle_masses`).
    """

    def __init__(
        self,
        scene: Scene,
        root: Node,
        compiler: Compiler,
        defaults: Defaults,
        assets: Assets,
        refusals: Refusals,
    ) -> None:
        self.scene = scene
        self.root = root
        self.main = self.compiler = compiler
        self.defaults = defaults
        self.assets = assets
        self.refusals = refusals
        self.nodes: dict[int, Node] = {}
        self.elements: dict[int, Element] = {}
        self.names: dict[str, set[str]] = {"body": {"world"}, "geom": set(), "camera": set()}
        self.references: list[tuple[Node, str, str]] = []
        self.shapes: list[Shape] = []
        self.written: dict[int, tuple[Vec, Vec]] = {}
        self.ranges: dict[int, tuple[float, ...]] = {}
        self.mesh_sites: set[str] = set()
        self.lights: list[tuple[Node, Place]] = []
        self.open_keys: list[tuple[Key, set[int]]] = []
        self.only_drawn: set[int] = set()
        self.settled = False
        # Geoms of explicit pairs collide regardless of their masks.
        pairs = [node for node in inside(root, "contact") if node.tag == "pair"]
        self.paired = {pair.attrs.get(end, "") for pair in pairs for end in ("geom1", "geom2")}
        options = {k: v for section in sections(root, "option") for k, v in section.values.items()}
        self.disabled_groups = frozenset(options.get("actuatorgroupdisable", ()))

    def read(self, world: Node) -> None:
        """Read a worldbody section in document order, without recursion."""
        pending = [(child, Place(self.scene.world)) for child in reversed(world.children)]
        while pending:
            node, place = pending.pop()
            inner = self.at(node, partial(self._element, place))
            if inner is not None:
                pending += [(child, inner) for child in reversed(node.children)]

    def at(self, node: Node, read: Callable[[Node], T]) -> T | None:
        """Read an element with the compiler settings of its own model, and collect its errors."""
        self.compiler = node.compiler or self.main
        return self.refusals.at(node, read)

    def rules_of(self, body: Body) -> MassRules:
        """Return the mass rules of a body: the compiler settings of the model that defines it."""
        node = self.nodes.get(id(body))
        compiler = None if node is None or self.settled else node.compiler
        return self.scene.mass_rules if compiler is None else compiler.mass_rules()

    def _element(self, place: Place, node: Node) -> Place | None:
        """Read an element; return the place of its children, or None to skip them."""
        name = node.attrs.get("name", "")
        if place.body is self.scene.world and node.tag in NOT_IN_WORLD:
            raise node.error(f"<{node.tag}> cannot be in the world")
        if node.tag in ("body", "frame"):
            return self._body(node, place) if node.tag == "body" else self._frame(node, place)
        if node.tag == "inertial":
            self._inertial(node, place)
        elif node.tag == "geom":
            self._geom(node, place)
        elif node.tag == "site":
            self._site(node, place)
        elif node.tag == "camera":
            self.names["camera"].add(name)
        elif node.tag == "light":
            self.lights.append((node, place))
        elif node.tag == "freejoint":
            self.keep(node, self.scene.add_joint(place.body, "free", name=name))
        elif node.tag == "joint":
            self._joint(node, place)
        return None

    def keep(self, node: Node, element: Element) -> None:
        self.nodes[id(element)] = node
        self.elements[id(node)] = element
        # setattr would refuse `place`, because it is not a field.
        element.__dict__["place"] = f"{node.file}:{node.line}"

    def _pose(self, node: Node, values: dict[str, Any], place: Place) -> tuple[Vec, Vec]:
        pos = values.get("pos", frames.ORIGIN)
        return _within(place.pose, pos, self.compiler.orientation(node, values))

    def _body(self, node: Node, place: Place) -> Place:
        values = node.values
        pos, quat = self._pose(node, values, place)
        fields = given(Body, values, "name", "pos", "quat")
        body = self.scene.add_body(values.get("name", ""), place.body, pos, quat, **fields)
        self.keep(node, body)
        if place.pose != AT_ORIGIN:
            self.written[id(body)] = self._pose(node, values, Place(place.body))
        self.names["body"].add(body.name)
        childclass = self.defaults.known(node, "childclass") or place.childclass
        return Place(body, childclass=childclass)

    def _frame(self, node: Node, place: Place) -> Place:
        values = node.values
        scales = {*values.get("scale", ()), values.get("massscale") or 1.0}
        if scales != {1.0}:
            raise node.unbuilt("scaling the contents of a frame (scale, massscale)")
        childclass = self.defaults.known(node, "childclass") or place.childclass
        return replace(place, pose=self._pose(node, values, place), childclass=childclass)

    def _inertial(self, node: Node, place: Place) -> None:
        values = node.values
        orientations = [name for name in values if name not in ("pos", "mass", "fullinertia")]
        if "fullinertia" in values and orientations:
            raise node.error(f"<inertial> has both fullinertia and {orientations[0]}")
        if "fullinertia" not in values and "diaginertia" not in values and values["mass"] > 0:
            raise node.error("<inertial> needs diaginertia or fullinertia")
        if place.body.mass is not None:
            raise node.error("a second <inertial> in the same <body>")
        place.body.ipos, turn = self._pose(node, values, place)
        inertia, axes = values.get("fullinertia"), None
        if inertia is None:
            xx, yy, zz = values.get("diaginertia", frames.ORIGIN)
            # The engine's own principal axes put the largest moment first.
            axes = None if turn == frames.IDENTITY and xx >= yy >= zz else turn
            inertia = (xx, yy, zz, 0.0, 0.0, 0.0)
        place.body.inertia = frames.turned_inertia(turn, inertia)
        place.body.mass, place.body.iquat = values["mass"], axes

    def _joint(self, node: Node, place: Place) -> None:
        values = self.defaults.of(node, place.childclass)
        kind = values.get("type", "hinge")
        if values.get("springyield", 0) != 0 and kind != "free":
            raise node.unbuilt("a spring that yields (springyield)", "springyield")
        convert = self.compiler.radians if kind in ("hinge", "ball") else float
        limits, forces = None, None
        if kind != "free":
            limits = self.limits(node, values, "limited", "range", lo_free=kind != "ball")
        scalar = kind in ("hinge", "slide")
        turn = place.pose[1]
        pos = frames.composed(place.pose, values.get("pos", frames.ORIGIN), frames.IDENTITY)[0]
        axis = values.get("axis", (0.0, 0.0, 1.0)) if scalar else (0.0, 0.0, 1.0)
        angles = tuple(convert(bound) for bound in values.get("range", ()))
        if scalar:
            forces = self.limits(node, values, "actuatorfrclimited", "actuatorfrcrange")
        joint = self.scene.add_joint(
            place.body,
            kind,
            name=values.get("name", ""),
            pos=pos if kind != "free" else frames.ORIGIN,
            axis=frames.rotated(turn, axis),
            range=limits and tuple(convert(bound) for bound in limits),
            actuatorfrcrange=forces,
            ref=convert(values.get("ref", 0.0)) if scalar else 0.0,
            springref=convert(values.get("springref", 0.0)) if scalar else 0.0,
            **given(Joint, values, *_OF_JOINT),
        )
        self.keep(node, joint)
        if angles:
            # As in MuJoCo, only the range of a limited joint is converted to radians.
            self.ranges[id(joint)] = angles if limits else values["range"]

    def limits(
        self, node: Node, values: dict[str, Any], switch: str, field: str, lo_free: bool = True
    ) -> tuple[float, ...] | None:
        """Return the range `field` if `switch` or autolimits enables it, else None."""
        state = values.get(switch, "auto")
        bounds: tuple[float, ...] | None = values.get(field)
        if state is False:
            return None
        if state == "auto":
            if bounds is None:
                return None
            if not self.compiler.autolimits:
                raise node.error(f'{field} without {switch}="true", and autolimits is "false"')
            if bounds[0] >= bounds[1]:
                if any(bounds):
                    where = f"{node.file}:{node.line}"
                    self.scene.notes.append(EmptyRange.of(where, field, bounds))
                return None
        bounds = bounds or (0.0, 0.0)
        # A ball joint may be limited to angle 0.
        if bounds[0] >= bounds[1] and (lo_free or tuple(bounds) != (0.0, 0.0)):
            raise bad(node, field, bounds, f'two numbers, the first smaller, with {switch}="true"')
        if not lo_free and bounds[0] != 0:
            raise bad(node, field, bounds, '"0 angle" for a ball joint')
        return bounds

    def _geom(self, node: Node, place: Place) -> None:
        values = self.defaults.of(node, place.childclass)
        kind = values.get("type", "sphere")
        name = values.get("name", "")
        if "material" in values:
            self.references.append((node, "material", values["material"]))
        if name in self.names["geom"] and name:
            raise node.error(f'geom "{name}": the name is used twice')
        self.names["geom"].add(name)
        contype, conaffinity = values.get("contype", 1), values.get("conaffinity", 1)
        collides = contype != 0 or conaffinity != 0 or (name != "" and name in self.paired)
        if kind == "sdf":
            raise node.unbuilt("a geom of type sdf")
        if kind in ("mesh", "hfield") and kind not in values:
            raise node.error(f'<geom type="{kind}"> names no {kind}')
        assets: dict[str, Any] = {
            word: self.assets.of(self.scene, node, word, values[word])
            for word in ("mesh", "hfield")
            if word in values
        }
        if kind != "hfield":
            # As in MuJoCo, only geoms of type hfield use the attribute.
            assets.pop("hfield", None)
        if assets and "fromto" in values:
            raise node.error(f"<geom> has both {next(iter(assets))} and fromto")
        heavy = values.get("mass", values.get("density", 1000.0)) != 0 and kind != "hfield"
        size, pose = self._shape(node, values, kind, place)
        if assets:
            size = frames.ORIGIN
        # Only a primitive fitted to a mesh uses the scale.
        fields = given(Geom, values, *_OF_GEOM, *(() if assets else ("fitscale",)))
        if self.assets.unseen(values):
            fields["hidden"] = True
        pos, quat = pose
        geom = self.scene.add_geom(
            place.body, kind, size, name=name, pos=pos, quat=quat, **assets, **fields
        )
        self.keep(node, geom)
        fluid = values.get("fluidshape", "none") != "none"
        self.shapes.append(Shape(node, geom, collides, heavy, fluid, values))

    def _shape(
        self, node: Node, values: dict[str, Any], kind: str, place: Place
    ) -> tuple[Vec, tuple[Vec, Vec]]:
        """Return (size, pose) of a primitive geom; unused sizes are 0."""
        size = values.get("size", (0.0,))
        if "fromto" in values:
            if any(values.get("pos", ())):
                raise node.error(f"<{node.tag}> has both pos and fromto")
            ends = values["fromto"]
            size, pos, quat = frames.from_to(kind, ends, size[0])
            return size, _within(place.pose, pos, quat)
        used = {"sphere": 1, "capsule": 2, "cylinder": 2}.get(kind, 3)
        return size[:used], self._pose(node, values, place)

    def _site(self, node: Node, place: Place) -> None:
        values = self.defaults.of(node, place.childclass)
        named = [kind for kind in ("material", "mesh") if kind in values]
        self.references += [(node, kind, values[kind]) for kind in named]
        kind = values.get("type", "sphere")
        size: Vec = values.get("size", ())
        values = values | {"size": size + SITE_SIZE[len(size) :]}
        size, (pos, quat) = self._shape(node, values, kind, place)
        name = values.get("name", "")
        fields: dict[str, Any] = {"name": name, "pos": pos, "quat": quat}
        if kind == "mesh":
            self.mesh_sites.add(name)
        else:
            fields |= {"type": kind, "size": size}
        self.keep(node, self.scene.add_site(place.body, **fields))


def _within(outer: tuple[Vec, Vec], pos: Vec, quat: Vec) -> tuple[Vec, Vec]:
    return (pos, quat) if outer == AT_ORIGIN else frames.composed(outer, pos, quat)
