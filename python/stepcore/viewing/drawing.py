"""`Drawing`: the shapes of a model in the frames of its bodies, with the colours of its file."""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from stepcore.mjcf.appearance import GREY, Look, Looks, read_looks
from stepcore.report.plot.style import BODIES, VIEW, rgb
from stepcore.scene import frames
from stepcore.scene.frames import Vec
from stepcore.scene.layout import Layout
from stepcore.viewing import surfaces

if TYPE_CHECKING:
    from stepcore.engine.model import Model
    from stepcore.engine.world import World

# MuJoCo's viewers show geoms of these groups; other geoms are most often for collisions.
SHOWN_GROUPS = (0, 1, 2)
# The length of the arrow of a force equal to the weight, as a share of the extent of the scene.
ARROW = 0.35
GROUND = (*rgb(VIEW["ground"]), 1.0)


@dataclass(frozen=True)
class Shape:
    """One drawn geom.

    body: the index of the body that carries it. kind: "plane", "sphere", "capsule", "ellipsoid",
    "cylinder", "box" or "triangles". size: as `Geom.size`. pos, quat: in the body's frame.
    rgba: its colour. shown: whether it is drawn by default. surface: of "triangles". name: of the
    geom. squares: the colours of the squares of a checked surface.
    """

    body: int
    kind: str
    size: Vec
    pos: Vec
    quat: Vec
    rgba: Vec
    shown: bool = True
    surface: surfaces.Surface | None = None
    name: str = ""
    squares: tuple[Vec, Vec] | None = None

    @property
    def checks(self) -> tuple[Vec, Vec]:
        """The colours of a plane's squares, which make motion over it visible.

        Their contrast is low, so that bodies on the plane are brighter.
        """
        if self.squares is None:
            return self.rgba, (*(0.86 * c for c in self.rgba[:3]), self.rgba[3])
        first, other = (np.array(rgba) for rgba in self.squares)
        half = np.clip((first - other) / 2, -0.07, 0.07)
        mean = (first + other) / 2
        return tuple((mean + half).tolist()), tuple((mean - half).tolist())

    def triangles(self, reach: float) -> surfaces.Surface:
        """Return the triangles in the shape's frame; reach: half size of an endless plane [m]."""
        return self.surface or surfaces.of_primitive(self.kind, self.size, reach)


@dataclass(frozen=True)
class Drawing:
    """The appearance of a model.

    name: of the scene. shapes: of all its geoms. bodies: names of the bodies, the world first.
    moving: whether each body can move. extent: the size of the bodies together [m].
    weight: of all moving bodies [N]; 0 without gravity. notes: differences from the file.
    """

    name: str
    shapes: list[Shape]
    bodies: tuple[str, ...]
    moving: NDArray[np.bool_]
    extent: float
    weight: float
    notes: list[str] = field(default_factory=list)

    @property
    def reach(self) -> float:
        """Half the size in which an endless plane is drawn [m]."""
        return 20 * self.extent

    @property
    def cell(self) -> float:
        """The size of a square of a plane [m]."""
        return float(2.0 ** np.round(np.log2(self.extent / 2)))

    @property
    def followed(self) -> NDArray[np.bool_]:
        """The bodies that a camera looks at: the moving ones, or all bodies if none moves."""
        return self.moving if self.moving.any() else ~self.moving

    def middle(self, xpos: NDArray[Any]) -> NDArray[Any]:
        """Return the middle of these bodies [m], shape (3,)."""
        middle: NDArray[Any] = xpos[self.followed].mean(axis=0)
        return middle


def drawing_of(model: Model, world: World) -> Drawing:
    """Return the drawing of a model.

    world: a Sim of the model at any state; its geoms are read where the engine has them.
    """
    scene = model.scene
    looks = Looks(colours=[Look(GREY)] * model.ngeom)
    try:
        looks = read_looks(scene) or looks
    except (ValueError, OSError) as error:
        looks.notes.append(f"colours and visual geoms were not read: {error}")
    layout = Layout(scene)
    moving = np.array([body.mocap or layout.moving(body) for body in layout.bodies])
    shapes = _shapes(model, world, looks, moving)
    shapes = [shape for shape in shapes if shape.rgba[3] > 0]
    # A body without visible geoms (it has a skin, or only collision geoms) is shown whole.
    seen = {shape.body for shape in shapes if shape.shown}
    shapes = [shape if shape.body in seen else replace(shape, shown=True) for shape in shapes]
    heavy = float(np.sum(model.body_mass[moving]))
    weight = heavy * float(np.linalg.norm(scene.gravity)) if scene.features.gravity else 0.0
    return Drawing(
        scene.name,
        shapes,
        model.body_names,
        moving,
        extent=_extent(shapes, world, moving),
        weight=weight,
        notes=looks.notes,
    )


def _shapes(model: Model, world: World, looks: Looks, moving: NDArray[np.bool_]) -> list[Shape]:
    """Return the geoms of the engine, then the geoms for drawing only, which it does not have."""
    coloured = [*zip(model.geom_body.tolist(), looks.colours, strict=True)]
    coloured += [(body, look) for body, _, look in looks.geoms]
    # Nothing but the ground has a colour.
    plain = all(look.rgba == GREY for body, look in coloured if body)
    shapes = []
    for index, geom in enumerate(Layout(model.scene).geoms):
        body = int(model.geom_body[index])
        kind, size = model.geom_type[index], tuple(model.geom_size[index].tolist())
        rgba, squares = looks.colours[index]
        if rgba == GREY and (plain or kind == "plane"):
            rgba = _own_colour(kind, body, moving)
        surface = surfaces.of_geom(geom) if kind in ("mesh", "hfield") else None
        pos, quat = tuple(geom.pos), tuple(geom.quat)
        if surface is None:
            turn = world.xmat[body]
            pos = tuple((turn.T @ (world.geom_xpos[index] - world.xpos[body])).tolist())
            quat = quat_of(turn.T @ world.geom_xmat[index])
            if kind == "mesh":
                surface = model.geom_hull(index)
        shown = geom.group in SHOWN_GROUPS
        drawn = "triangles" if surface is not None else kind
        shapes.append(Shape(body, drawn, size, pos, quat, rgba, shown, surface, geom.name, squares))
    for body, geom, look in looks.geoms:
        surface = surfaces.of_geom(geom)
        if surface is None and (geom.type in ("mesh", "hfield") or geom.mesh is not None):
            continue
        kind = geom.type if surface is None else "triangles"
        rgba = _own_colour(kind, body, moving) if plain and look.rgba == GREY else look.rgba
        pos, quat, size = tuple(geom.pos), tuple(geom.quat), tuple(geom.size)
        shown = geom.group in SHOWN_GROUPS
        shapes.append(Shape(body, kind, size, pos, quat, rgba, shown, surface, geom.name))
    return shapes


def _own_colour(kind: str, body: int, moving: NDArray[np.bool_]) -> Vec:
    if kind == "plane":
        return GROUND
    return (*rgb(BODIES[body % len(BODIES)] if moving[body] else VIEW["fixed"]), 1.0)


def quat_of(matrix: NDArray[Any]) -> Vec:
    """Return the quaternion w x y z of a rotation matrix."""
    x, y, _ = matrix.T.tolist()
    return frames.from_xy_axes(x, y)


def corners(shape: Shape) -> NDArray[Any]:
    """Return points that bound a shape in the frame of its body, shape (n, 3); none for a plane."""
    if shape.kind == "plane":
        return np.empty((0, 3))
    if shape.surface is not None:
        points = shape.surface[0]
        box = np.array([points.min(axis=0), points.max(axis=0)])
    else:
        r, h, *_ = (*shape.size, 0.0, 0.0)
        half = {
            "sphere": (r, r, r),
            "capsule": (r, r, r + h),
            "cylinder": (r, r, h),
        }.get(shape.kind, shape.size)
        box = np.array([np.negative(half), half], float)
    all_corners = np.stack(np.meshgrid(*box.T, indexing="ij"), axis=-1).reshape(-1, 3)
    return all_corners @ np.array(frames.matrix(shape.quat)).T + shape.pos


def _extent(shapes: list[Shape], world: World, moving: NDArray[np.bool_]) -> float:
    """Return the diagonal of the box around all moving bodies, or all bodies if none moves."""
    chosen = [shape for shape in shapes if moving[shape.body]] or shapes
    points = [corners(s) @ world.xmat[s.body].T + world.xpos[s.body] for s in chosen]
    if not any(map(len, points)):
        return 1.0
    every = np.concatenate(points)
    return float(np.linalg.norm(np.ptp(every, axis=0))) or 1.0
