"""`align` and `alignfree`: free bodies whose frame becomes that of their inertia.

MuJoCo documentation, XML reference, freejoint/align. As there, only a body without bodies in it is
aligned; what is given in its frame elsewhere (anchors of equalities, keyframes) is not changed.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

from stepcore.mjcf.masses import six, weights
from stepcore.mjcf.principal import principal_axes
from stepcore.scene import frames
from stepcore.scene.elements import Body, Geom, Site
from stepcore.scene.frames import Vec

if TYPE_CHECKING:
    from stepcore.mjcf.worldbody import Shape, WorldReader

Pose = tuple[Vec, Vec]


def align(world: WorldReader) -> None:
    """Aligns the free bodies for which the file asks for it."""
    scene = world.scene
    parents = {id(body.parent) for body in scene.bodies}
    bodies = [j.body for j in scene.joints if id(j) in world.aligned and id(j.body) not in parents]
    if not bodies:
        return
    known = weights(scene)
    on: dict[int, list[Geom | Site]] = {}
    placed: list[Geom | Site] = [*scene.geoms, *scene.sites]
    for element in placed:
        on.setdefault(id(element.body), []).append(element)
    shapes: dict[int, list[Shape]] = {}
    for shape in world.shapes:
        shapes.setdefault(id(shape.geom.body), []).append(shape)
    for body in bodies:
        weight = known[id(body)]
        # Those of the inertia before a rule for masses made its moments equal.
        quat = _axes(world, body, shapes.get(id(body), [])) or weight.iquat
        if quat is None:
            quat = principal_axes(weight.inertia)[0]
        pose = (tuple(map(float, weight.ipos)), quat)
        for element in on.get(id(body), []):
            element.pos, element.quat = _seen_in(pose, element.pos, element.quat)
        if body.mass is not None:
            back = _inverse(pose)
            own = weight.seen_from(*back)
            body.ipos, body.inertia = frames.ORIGIN, (*six(own.inertia)[:3], 0.0, 0.0, 0.0)
            body.iquat = frames.IDENTITY
        body.pos, body.quat = frames.composed((body.pos, body.quat), *pose)


def _axes(world: WorldReader, body: Body, shapes: list[Shape]) -> Vec | None:
    """The axes that the file itself gives an inertia: those of its element, or of an only geom."""
    rules = world.rules_of(body)
    if body.mass is not None and rules.inertiafromgeom is not True:
        return body.iquat
    low, high = rules.inertiagrouprange
    geoms = [shape.geom for shape in shapes if shape.heavy and low <= shape.geom.group <= high]
    # A mesh has axes of its own.
    return geoms[0].quat if len(geoms) == 1 and geoms[0].mesh is None else None


def _inverse(pose: Pose) -> Pose:
    pos, (w, x, y, z) = pose
    back = (w, -x, -y, -z)
    return tuple(-a for a in frames.rotated(back, pos)), back


def _seen_in(pose: Pose, pos: Vec, quat: Vec) -> Pose:
    """A pose of the outer frame in the frame that has the pose `pose` there."""
    return frames.composed(_inverse(pose), pos, quat)
