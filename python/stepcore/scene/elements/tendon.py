"""`Tendon`, and the stops of its path."""

from __future__ import annotations

import itertools
from collections.abc import Iterable
from dataclasses import dataclass
from typing import Annotated, Any, NamedTuple

from stepcore import checks
from stepcore.scene.element import ENGINE_NAMES, Element, FieldType, Places, place_of
from stepcore.scene.elements import field_types as of
from stepcore.scene.elements.body import Joint, Site
from stepcore.scene.elements.geom import Geom


class Share(NamedTuple):
    """A joint of a fixed tendon; the joint adds coef × its position to the length."""

    joint: Joint
    coef: float


class Around(NamedTuple):
    """A sphere or cylinder that a tendon wraps around where the geom obstructs its path.

    sidesite: the site on the side where the tendon wraps. If the site is inside the geom, the
        tendon passes through the geom instead.
    """

    geom: Geom
    sidesite: Site | None = None


class Pulley(NamedTuple):
    """The start of a branch of a tendon; the length of the branch is divided by `divisor`, > 0."""

    divisor: float


Stop = Share | Around | Pulley | Site
# The stops by the tag of MJCF; their fields are its attributes.
STOPS: dict[str, Any] = {"joint": Share, "geom": Around, "pulley": Pulley}


class Path(tuple[Stop, ...]):
    """The stops of a tendon in order."""

    __slots__ = ()

    @property
    def fixed(self) -> bool:
        """Whether the path runs over joints."""
        return bool(self) and isinstance(self[0], Share)


def tendon_path(owner: Any, field: str, value: object) -> Path:
    """Return the path of joints with coefficients, or of sites, geoms and pulleys."""
    stops = value if isinstance(value, (list, tuple)) else None
    if stops is None:
        raise checks.refuse(owner, field, value, "a list of joints, or of sites, geoms and pulleys")
    return Path(_stop(owner, f"{field}[{i}]", stop) for i, stop in enumerate(stops))


def _stop(owner: Any, field: str, stop: object) -> Stop:
    if isinstance(stop, Site):
        return stop
    if isinstance(stop, Geom):
        return Around(stop)
    if isinstance(stop, Pulley):
        return Pulley(checks.real(above=0)(owner, f"{field}.divisor", stop.divisor))
    match stop:
        case (Joint() as joint, coef):
            return Share(joint, checks.real()(owner, f"{field}.coef", coef))
        case (Geom() as geom, Site() | None as sidesite):
            return Around(geom, sidesite)
    limit = "a (Joint, coef), a Site, a Geom, a (Geom, Site) or a Pulley"
    raise checks.refuse(owner, field, stop, limit)


def spring_length(owner: Any, field: str, value: object) -> tuple[float, ...]:
    """Return (low, high) from one length or from two lengths in ascending order."""
    number = checks.number(value)
    pair = (number, number) if number is not None else value
    low, high = checks.vector(2)(owner, field, pair)
    if high < low:
        raise checks.refuse(owner, field, value, "1 length, or 2 of which the second is not less")
    return low, high


SpringLength = Annotated[tuple[float, ...], FieldType(spring_length, "Numbers", "1-2")]


@dataclass(eq=False, repr=False, kw_only=True)
class Tendon(Element):
    """A length, with limits and forces along it.

    A fixed tendon runs over hinges and slides; its length is the sum of coef × position. A spatial
    tendon takes the shortest path through sites and around geoms; its length is that of the path
    [m]. A positive force lengthens the tendon. A tendon without a force, a limit or an actuator
    does not slow down the step.

    name: unique among tendons, or "".
    path: for a fixed tendon, a list of (joint, coef). For a spatial tendon, a list of stops: a
        `Site`, a `Geom` (a sphere or an infinite cylinder), a (geom, side site) or a `Pulley`.
        Every branch begins and ends with a site, and has sites between its geoms.
    range: (shortest, longest) length, or None for no limit.
    margin: distance from a limit at which the limit starts to act.
    springlength: length at which the spring is relaxed, or (low, high) between which it is slack;
        (-1, -1): the length where joints are at their springref.
    stiffness: stiffness of the spring [N/m].
    stiffnesspoly: b and c of a spring with the restoring force (stiffness + b x + c x²) x at a
        stretch x.
    damping: [N·s/m].
    dampingpoly: b and c of a damper with the force (damping + b |v| + c v²) v.
    armature: inertia against a change of length [kg], >= 0.
    frictionloss: dry friction [N], >= 0.
    actuatorfrcrange: bounds of the sum of actuator forces on the tendon [N], or None.
    solreflimit, solimplimit: softness of the limit.
    solreffriction, solimpfriction: softness of the dry friction.
    """

    name: of.Text = ""
    path: Annotated[Path, FieldType(tendon_path, "Iterable[Any]", refers=("Joint", "Site", "Geom"))]
    range: Annotated[of.Range, "m"] = None
    margin: Annotated[of.Real, "m"] = 0.0
    springlength: Annotated[SpringLength, "m"] = (-1.0, -1.0)
    stiffness: Annotated[of.Real, "N/m"] = 0.0
    stiffnesspoly: of.Poly = (0.0, 0.0)
    damping: Annotated[of.Real, "N·s/m"] = 0.0
    dampingpoly: of.Poly = (0.0, 0.0)
    armature: Annotated[of.NonNegative, "kg"] = 0.0
    frictionloss: Annotated[of.NonNegative, "N"] = 0.0
    actuatorfrcrange: Annotated[of.Range, "N"] = None
    solreflimit: of.SolRef = of.SOLREF
    solimplimit: of.SolImp = of.SOLIMP
    solreffriction: of.SolRef = of.SOLREF
    solimpfriction: of.SolImp = of.SOLIMP

    @property
    def fixed(self) -> bool:
        """Whether the tendon runs over joints, not through sites."""
        return self.path.fixed

    @property
    def sprung(self) -> bool:
        """Whether the tendon has a spring."""
        return any((self.stiffness, *self.stiffnesspoly))

    @property
    def damped(self) -> bool:
        """Whether the tendon has a damper."""
        return any((self.damping, *self.dampingpoly))

    def elements(self) -> Iterable[Joint | Site | Geom]:
        """Yield the joints, sites and geoms that the tendon refers to."""
        for stop in self.path:
            ends = stop_parts(stop).values()
            yield from (end for end in ends if isinstance(end, (Joint, Site, Geom)))

    def check(self, places: Places) -> None:
        """Raise ElementError unless the path is one, of elements of the scene."""
        for element in self.elements():
            places.needed(self, element)
        if self.fixed:
            self._check_fixed()
        else:
            self._check_spatial()

    def _check_fixed(self) -> None:
        seen: set[int] = set()
        for stop in self.path:
            if not isinstance(stop, Share):
                raise self._bad("passes a joint, so it passes nothing but joints")
            joint = stop.joint
            if joint.type not in ("hinge", "slide"):
                raise self._bad(f"passes {joint}, which is no hinge or slide")
            if id(joint) in seen:
                raise self._bad(f"passes {joint} twice")
            seen.add(id(joint))

    def _check_spatial(self) -> None:
        """Raise unless every branch begins and ends with a site and has sites between geoms."""
        branches: list[list[Stop]] = [[]]
        for at, stop in enumerate(self.path):
            if isinstance(stop, Share):
                raise self._bad(f"passes {stop.joint}, and other things than joints")
            if not isinstance(stop, Pulley):
                branches[-1].append(stop)
            elif at:
                branches.append([])
        for branch in branches:
            if sum(isinstance(stop, Site) for stop in branch) < 2:
                raise self._bad("a branch of its path needs at least two sites")
            if not (isinstance(branch[0], Site) and isinstance(branch[-1], Site)):
                raise self._bad("a branch of its path must begin and end with a site")
            for stop, following in itertools.pairwise(branch):
                if isinstance(stop, Around) and isinstance(following, Around):
                    raise self._bad("two geoms of its path need a site between them")
                if isinstance(stop, Around) and stop.geom.type not in ("sphere", "cylinder"):
                    raise self._bad(
                        f"goes round {stop.geom}, which is a {stop.geom.type}: a sphere or a "
                        "cylinder can be gone round",
                    )

    def _bad(self, text: str) -> checks.ElementError:
        return checks.ElementError(self, text)

    def plain(self, places: Places) -> dict[str, Any]:
        """Return the tendon as the engine reads it, with each stop of the path as a dict."""
        stops = [
            {
                ENGINE_NAMES.get(name, name): (
                    place_of(places, part) if isinstance(part, Element) else part
                )
                for name, part in stop_parts(stop).items()
            }
            for stop in self.path
        ]
        return self.record("path") | {"path": stops}


def stop_parts(stop: Stop) -> dict[str, Any]:
    """Return the parts of a stop by their names in MJCF."""
    return {"site": stop} if isinstance(stop, Site) else stop._asdict()


SomeTendon = Annotated[Tendon | None, of.optional(of.element("Tendon"))]
