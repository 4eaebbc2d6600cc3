"""Read the sections of a file: first `<worldbody>`, then those that refer to the tree."""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import partial
from typing import TYPE_CHECKING, Any

from stepcore.mjcf.assets import Assets
from stepcore.mjcf.defaults import CONTROLLERS, ActuatorGains, Model, saturated_motor
from stepcore.mjcf.nodes import Node, Refusals, options, section_nodes, sections
from stepcore.mjcf.schema import NOT_IN_WORLD, class_fields
from stepcore.mjcf.validation import REFERENCES, bad
from stepcore.scene import frames
from stepcore.scene.elements import (
    Body,
    Element,
    Equality,
    Geom,
    Joint,
    Pair,
    Sensor,
    Tendon,
)
from stepcore.scene.elements.actuator import BIASES, DYNAMICS, GAINS, Actuator
from stepcore.scene.elements.body import SITE_SIZE
from stepcore.scene.elements.sensor import ADHERES, ENDS, MOST_NUMBERS
from stepcore.scene.elements.sensor import OBJECTS as TYPES
from stepcore.scene.elements.tendon import STOPS, Stop
from stepcore.scene.frames import Vec
from stepcore.scene.layout import Layout

if TYPE_CHECKING:
    from stepcore.scene.scene import Scene

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
    values: the attributes, completed from the default class.
    """

    node: Node
    geom: Geom
    collides: bool
    heavy: bool
    values: dict[str, Any]


class WorldReader:
    """The reader of the kinematic tree, with the records that later sections and passes need.

    Elements and nodes are identified by their ``id``.

    nodes: the node of each element.
    names: the names that later sections can refer to, by kind.
    references: (node, kind, name) of each reference to a material or mesh.
    shapes: the geoms, with the data that decides whether they are needed.
    written: for each body inside a frame, the pose that the file gives.
    ranges: for each joint or tendon, limited or not, the range that servos can inherit.
    mesh_sites: the names of sites whose volume is a mesh.
    only_drawn: geoms that only draw, if they are kept for drawing (`Assets.drawn`).
    """

    def __init__(self, scene: Scene, model: Model, assets: Assets, refusals: Refusals) -> None:
        self.scene, self.assets, self.refusals = scene, assets, refusals
        self.root, self.defaults = model.root, model.defaults
        self.compiler = model.compiler
        self.nodes: dict[int, Node] = {}
        self.names: dict[str, set[str]] = {"body": {"world"}, "geom": set(), "camera": set()}
        self.references: list[tuple[Node, str, str]] = []
        self.shapes: list[Shape] = []
        self.written: dict[int, tuple[Vec, Vec]] = {}
        self.ranges: dict[int, tuple[float, ...]] = {}
        self.mesh_sites: set[str] = set()
        self.only_drawn: set[int] = set()
        # Geoms of explicit pairs collide regardless of their masks.
        pairs = [node for node in section_nodes(self.root, "contact") if node.tag == "pair"]
        self.paired = {pair.attrs.get(end, "") for pair in pairs for end in ("geom1", "geom2")}
        self.disabled_groups = frozenset(options(self.root).get("actuatorgroupdisable", ()))

    def read(self, world: Node) -> None:
        """Read a worldbody section in document order, without recursion."""
        pending = [(child, Place(self.scene.world)) for child in reversed(world.children)]
        while pending:
            node, place = pending.pop()
            inner = self.refusals.at(node, partial(self._element, place))
            if inner is not None:
                pending += [(child, inner) for child in reversed(node.children)]

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
        elif node.tag == "freejoint":
            self.keep(node, self.scene.add_joint(place.body, "free", name=name))
        elif node.tag == "joint":
            self._joint(node, place)
        return None

    def keep(self, node: Node, element: Element) -> None:
        self.nodes[id(element)] = node
        # setattr would refuse `place`, because it is not a field.
        element.__dict__["place"] = f"{node.file}:{node.line}"

    def _pose(self, node: Node, values: dict[str, Any], place: Place) -> tuple[Vec, Vec]:
        pos = values.get("pos", frames.ORIGIN)
        return _within(place.pose, pos, self.compiler.orientation(node, values))

    def _body(self, node: Node, place: Place) -> Place:
        values = node.values
        pos, quat = self._pose(node, values, place)
        fields = class_fields(Body, values, "name", "pos", "quat")
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
        # As in MuJoCo, what has no joint may be a point.
        moves = {"joint", "freejoint"} & {
            child.tag for child in self.nodes[id(place.body)].children
        }
        if moves and not {"fullinertia", "diaginertia"} & {*values} and values["mass"] > 0:
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
            **class_fields(Joint, values, *_OF_JOINT),
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
        fields = class_fields(Geom, values, *_OF_GEOM, *(() if assets else ("fitscale",)))
        if self.assets.unseen(values):
            fields["hidden"] = True
        pos, quat = pose
        geom = self.scene.add_geom(
            place.body, kind, size, name=name, pos=pos, quat=quat, **assets, **fields
        )
        self.keep(node, geom)
        self.shapes.append(Shape(node, geom, collides, heavy, values))

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
        if kind == "plane":
            # MuJoCo draws a plane of negative size as one without end, which it is in any case.
            size = tuple(max(value, 0.0) for value in size)
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


def contact(world: WorldReader, node: Node) -> None:
    if node.tag == "pair":
        world.keep(node, world.scene.add_pair(**class_fields(Pair, world.defaults.of(node))))
    else:
        world.scene.exclude(node.values["body1"], node.values["body2"])


def tendon(world: WorldReader, node: Node) -> None:
    """Read a fixed or a spatial tendon."""
    values = world.defaults.of(node, kind="tendon")
    if values.get("springyield", 0) > 0:
        raise node.unbuilt("a spring that yields (springyield)", "springyield")
    if "material" in values:
        world.references.append((node, "material", values["material"]))
    fields = class_fields(Tendon, values, "name", "range", "actuatorfrcrange", "springlength")
    if "springlength" in values:
        # A single number gives both ends, even if a default class has a second number.
        springlength: Any = node.values.get("springlength", values["springlength"])
        fields["springlength"] = springlength[0] if len(springlength) == 1 else springlength
    added = world.scene.add_tendon(
        values.get("name", ""),
        path=[_stop(world, child) for child in node.children],
        range=world.limits(node, values, "limited", "range"),
        actuatorfrcrange=world.limits(node, values, "actuatorfrclimited", "actuatorfrcrange"),
        **fields,
    )
    world.keep(node, added)
    if "range" in values:
        world.ranges[id(added)] = values["range"]


def _stop(world: WorldReader, node: Node) -> Stop:
    try:
        parts = {
            name: value if name not in REFERENCES else getattr(world.scene, REFERENCES[name])(value)
            for name, value in node.values.items()
        }
    except ValueError as error:
        raise node.error(str(error)) from None
    stop: Stop = parts["site"] if node.tag == "site" else STOPS[node.tag](**parts)
    return stop


def equality(world: WorldReader, node: Node) -> None:
    values = world.defaults.of(node, kind="equality")
    if node.tag in ("connect", "weld") and not {"body1", "site1", "site2"} & set(values):
        raise node.error(f"<{node.tag}> needs body1, or site1 and site2")
    if node.tag == "connect" and "body1" in values and "anchor" not in values:
        raise node.error("<connect> needs body1 and anchor")
    world.keep(node, world.scene.add_equality(node.tag, **class_fields(Equality, values)))


def sensor(world: WorldReader, node: Node) -> None:
    """Read a sensor, or list it in `Scene.ignored` with the reason if it is not computed."""
    values = node.values
    if node.tag not in TYPES:
        # The validation has already listed this sensor as ignored.
        return
    why = _not_computed(world, node)
    if why:
        world.scene.ignored.append(node.ignored_line(f"only senses; {why}"))
        return
    fields = class_fields(Sensor, values)
    if node.tag == "user":
        if not 0 < values["dim"] <= MOST_NUMBERS:
            raise bad(node, "dim", values["dim"], f"1 to {MOST_NUMBERS}")
        fields["num"] = values["dim"]
    world.keep(node, world.scene.add_sensor(node.tag, **_ends(world, node), **fields))


def _not_computed(world: WorldReader, node: Node) -> str:
    """Return the reason why a sensor is not computed; "" if it is."""
    values = node.values
    site = values.get("site", "")
    for attribute in ("objtype", "reftype"):
        if values.get(attribute) == "camera" and node.tag != "user":
            return f"its {attribute} is a camera"
    if "camera" in values:
        return "it needs a camera"
    if values.get("delay", 0) > 0 or any(values.get("interval", ())):
        return "readings that are late or rare (delay, interval) are not computed"
    if node.tag == "actuatorvel" and world.scene.actuator(values["actuator"]).body is not None:
        return ADHERES
    read = node.tag in ("actuatorpos", "actuatorvel", "actuatorfrc")
    if read and world.scene.actuator(values["actuator"]).type == "orientation":
        return "an orientation has three lengths and forces, each of an actuator"
    if values.get("enclosed"):
        return "how far an object juts out of a site (enclosed) is not computed"
    if node.tag in ("touch", "contact", "insidesite") and site in world.mesh_sites:
        return "its site is a mesh"
    return ""


def _ends(world: WorldReader, node: Node) -> dict[str, Any]:
    """Return the object and the reference of a sensor, as fields of `Sensor`.

    A body also has a type, which distinguishes its frame, inertial frame or subtree.
    """
    values = node.values
    ends: dict[str, Any] = {}

    def put(field: str, kind: str, attribute: str, word: str) -> None:
        element = getattr(world.scene, kind)(values[attribute])
        if field in ends:
            raise node.error(f"<{node.tag}> names two things as its {field}")
        ends[field] = element
        if word:
            ends["objtype" if field == "object" else "reftype"] = word

    for attribute, (field, kind, word) in ENDS.items():
        if attribute in values:
            inside = node.tag == "insidesite" and attribute == "site"
            put("reference" if inside else field, kind, attribute, word)
    for field, prefix in (("object", "obj"), ("reference", "ref")):
        kind = values.get(f"{prefix}type", "")
        if not kind:
            if f"{prefix}name" in values:
                raise node.error(f"<{node.tag}> has {prefix}name without {prefix}type")
            continue
        if f"{prefix}name" not in values:
            raise node.error(f"<{node.tag}> has {prefix}type without {prefix}name")
        body = kind in ("body", "xbody")
        if node.tag == "user" and not body and kind not in TYPES["user"][0]:
            why = f"read, but not what it is attached to: the {kind}"
            world.scene.ignored.append(node.ignored_line(f"{why} {values['objname']}"))
            continue
        put(field, "body" if body else kind, f"{prefix}name", kind if body else "")
    return ends


TRANSMISSIONS = ("joint", "jointinparent", "tendon", "slidersite", "site", "body")
# Attributes of a transmission between two sites.
BESIDE = {"site": ("refsite",), "slidersite": ("cranksite", "cranklength")}
# Fields of an actuator that are copied from attributes.
COPIED = ("gear", "damping", "armature", "interp", "delay", "nsample", "lengthrange")
STATEFUL = ("actlimited", "actrange")


def actuator(world: WorldReader, node: Node) -> None:
    """Read an actuator."""
    values = world.defaults.of(node, kind="actuator")
    target = _transmission(node, values)
    gains = world.defaults.gains(node)
    _refuse(node, values, gains)
    values = saturated_motor(values, gains, node)
    ctrlrange, actrange = _ranges(world, node, values, gains, target)
    fields: dict[str, Any] = {
        **target,
        **class_fields(Actuator, {name: values[name] for name in COPIED if name in values}),
        **gains.fields,
    }
    added = world.scene.add_actuator(
        type=gains.tag,
        name=values.get("name", ""),
        ctrlrange=ctrlrange,
        forcerange=world.limits(node, values, "forcelimited", "forcerange"),
        actrange=actrange,
        actearly=values.get("actearly", False) and gains.tag not in CONTROLLERS,
        enabled=values.get("group", 0) not in world.disabled_groups,
        **fields,
    )
    dim, count = values.get("actdim", -1), added.law.states
    if dim not in (-1, count):
        raise bad(node, "actdim", dim, f"-1 or {count}, how many activations it has")
    world.keep(node, added)
    for word in added.inputs[1:]:
        _add_input(world, node, added, word)


def _add_input(world: WorldReader, node: Node, owner: Actuator, word: str) -> None:
    """Add a further input of a controller as an actuator; its control follows the owner's."""
    values = world.defaults.of(node, kind="actuator")
    bounds: Bounds = owner.ctrlrange
    if owner.type == "pid":
        bounds = values.get(f"{word}range")
        bounds = bounds if bounds and bounds[0] < bounds[1] else None
    world.scene.add_actuator(
        type="input",
        feeds=owner,
        input=word,
        name=f"{owner.name}/{word}" if owner.name else "",
        ctrlrange=bounds,
        enabled=owner.enabled,
        **{name: getattr(owner, name) for name in ("delay", "nsample", "interp")},
    )
    separate = f"the input {word} of {owner} is an actuator of its own, with a control of its own"
    world.scene.notes.append(f"{node.file}:{node.line}: {separate}")


def _transmission(node: Node, values: dict[str, Any]) -> dict[str, Any]:
    """Return the transmission, as fields of `Actuator` with names of elements."""
    used = [name for name in TRANSMISSIONS if name in values]
    if not used:
        raise node.error(f'<{node.tag}> needs joint="…"')
    if len(used) > 1:
        raise node.error(f"<{node.tag}> has two transmissions: {used[0]} and {used[1]}")
    if used == ["slidersite"]:
        if "cranksite" not in values:
            raise node.error(f'<{node.tag}> needs cranksite="…" beside slidersite')
        if values.get("cranklength", 0.0) <= 0:
            raise bad(node, "cranklength", values.get("cranklength", 0.0), "> 0")
    fields = (*used, *BESIDE.get(used[0], ()))
    return {name: values[name] for name in fields if name in values}


def _refuse(node: Node, values: dict[str, Any], gains: ActuatorGains) -> None:
    if values.get("delay", 0.0) > 0 and values.get("nsample", 0) <= 0:
        raise bad(node, "nsample", values.get("nsample", 0), "> 0 with a delay")
    if gains.tag == "orientation" and "joint" not in values:
        raise node.unbuilt("an <orientation> that turns a site", "site")
    several = gains.tag in (*CONTROLLERS, "orientation")
    if not several and node.values.get("input", "") not in ("", "pos", "vel", "pressure"):
        raise bad(node, "input", node.values["input"], "pos, vel or pressure")
    fields = gains.values
    for name, built in (("dyntype", DYNAMICS), ("gaintype", GAINS), ("biastype", BIASES)):
        if gains.tag == "general" and fields[name] not in built:
            raise node.unbuilt(f'<general> {name}="{fields[name]}"')
    if gains.tag in CONTROLLERS and fields["input"] in ("none", ""):
        raise node.unbuilt(f'a <{gains.tag}> of no input (input="{fields["input"]}")', "input")
    voltage = gains.tag == "dcmotor" and fields["input"] == "voltage"
    if voltage and (fields["kp"] or fields["kv"] or fields["ki"] or fields["slewmax"]):
        controller = node.values.get("controller", (0.0, 0.0 - fields["kp"], 0.0 - fields["kv"]))
        raise bad(node, "controller", controller, "0 without one of the inputs pos, vel and ff")


Bounds = tuple[float, ...] | None


def _ctrlrange(
    world: WorldReader, node: Node, values: dict[str, Any], gains: ActuatorGains
) -> Bounds:
    """Return the range of the actuator's first control; for a <pid> MuJoCo names it by input."""
    if gains.tag in ("damper", "adhesion"):
        # MuJoCo limits these regardless of ctrllimited and autolimits.
        values = values | {"ctrllimited": True}
    if gains.tag != "pid":
        return world.limits(node, values, "ctrllimited", "ctrlrange")
    first = gains.inputs[0]
    if first == "pos":
        ranges = [
            n for source in (node.values, values) for n in ("posrange", "ctrlrange") if n in source
        ]
        return world.limits(node, values, "ctrllimited", (*ranges, "posrange")[0])
    bounds: Bounds = values.get(f"{first}range")
    return bounds if bounds and bounds[0] < bounds[1] else None


def _ranges(
    world: WorldReader,
    node: Node,
    values: dict[str, Any],
    gains: ActuatorGains,
    target: dict[str, Any],
) -> tuple[Bounds, Bounds]:
    """Return the ranges of control and activation; one may be inherited from joint or tendon."""
    if gains.tag == "intvelocity":
        # MuJoCo limits this actuator regardless of actlimited.
        values = {name: value for name, value in values.items() if name != "actlimited"}
    actrange: Bounds = None
    if gains.activates != "none":
        actrange = world.limits(node, values, "actlimited", "actrange")
    elif stateful := [n for n in STATEFUL if values.get(n, False) not in (False, "auto")]:
        text = f"<{node.tag}> inherits {stateful[0]}, but a {node.tag} has no activation"
        raise node.error(text)
    integrates = gains.activates == "integrator"
    if gains.inheritrange <= 0 or not gains.is_position:
        return _ctrlrange(world, node, values, gains), actrange
    handed_down = _inherited(world, node, values, gains, target)
    switch = "actlimited" if integrates else "ctrllimited"
    if values.get(switch, "auto") == "auto" and not world.compiler.autolimits:
        problem = f'inheritrange without {switch}="true", and autolimits is "false"'
        raise node.error(f"<{node.tag}> {problem}")
    if integrates:
        ctrlrange = world.limits(node, values, "ctrllimited", "ctrlrange")
        return ctrlrange, None if values.get("actlimited", "auto") is False else handed_down
    return None if values.get("ctrllimited", "auto") is False else handed_down, actrange


def _inherited(
    world: WorldReader,
    node: Node,
    values: dict[str, Any],
    gains: ActuatorGains,
    target: dict[str, Any],
) -> tuple[float, float]:
    takes_over = node.values.get("inheritrange", 0.0) > 0
    if gains.tag == "position" and "ctrlrange" in values and not takes_over:
        raise node.error("<position> inherits both ctrlrange and inheritrange")
    kind, name = next(iter(target.items()))
    element = getattr(world.scene, REFERENCES[kind])(name)
    bounds = world.ranges.get(id(element))
    if bounds is None or bounds[0] == bounds[1]:
        raise node.error(f"<{node.tag}> inheritrange: {element} has no range")
    radians = "tendon" in target or element.range is not None or element.type != "hinge"
    if not radians and world.compiler.degrees:
        note = f"the range of {element} is inherited unconverted, as radians, as MuJoCo does"
        world.scene.notes.append(f"{node.file}:{node.line}: {note}: the joint is not limited")
    middle, half = (bounds[0] + bounds[1]) / 2, gains.inheritrange * (bounds[1] - bounds[0]) / 2
    return middle - half, middle + half


def keyframes(world: WorldReader) -> None:
    """Read the keyframes, completed from the default state, and those of ``<size nkey>``."""
    layout = Layout(world.scene)
    mocaps = [body for body in layout.bodies if body.mocap]
    rest = {
        "qpos": layout.qpos0(),
        "qvel": [0.0] * layout.nv,
        "act": [0.0] * layout.na,
        "ctrl": [0.0] * len(layout.scene.actuators),
        "mpos": [x for body in mocaps for x in body.pos],
        "mquat": [x for body in mocaps for x in body.quat],
    }
    for node in section_nodes(world.root, "keyframe"):
        world.refusals.at(node, partial(_keyframe, world, layout, rest))
    world.refusals.raise_all()
    count = 0
    for node in sections(world.root, "size"):
        count = node.values.get("nkey", count)
        if count > 100_000:
            raise bad(node, "nkey", count, "at most 100000")
    while len(world.scene.keys) < count:
        world.scene.add_key()


def _keyframe(world: WorldReader, layout: Layout, rest: dict[str, list[float]], node: Node) -> None:
    values = node.values
    if values.get("plastic"):
        raise bad(node, "plastic", values["plastic"], "empty: the model has no plastic")
    fields: dict[str, Any] = {}
    for name, default in rest.items():
        numbers = list(values.get(name, ()))
        if len(numbers) > len(default):
            raise bad(
                node, name, tuple(numbers), f"at most {len(default)} numbers, not {len(numbers)}"
            )
        if numbers:
            fields[name] = numbers + default[len(numbers) :]
    if "qpos" in fields:
        fields["qpos"] = layout.unit_quaternions(fields["qpos"])
    added = world.scene.add_key(values.get("name", ""), time=values.get("time", 0.0), **fields)
    world.keep(node, added)
