"""`Drawing`: the shapes of a model in the frames of its bodies, with the colours of its file."""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from stepcore.mjcf.appearance import GREY, Headlight, Light, Look, Looks, read_looks
from stepcore.scene import frames
from stepcore.scene.elements import Geom
from stepcore.scene.frames import Vec
from stepcore.scene.layout import Layout
from stepcore.viewing import surfaces

if TYPE_CHECKING:
    from stepcore.engine.model import Model
    from stepcore.engine.world import World

# MuJoCo's viewers show geoms of these groups; others are most often what collides.
SHOWN_GROUPS = (0, 1, 2)
# Bodies of a scene without colours, by their index; fixed ones are grey.
PALETTE = ((0.27, 0.51, 0.71), (0.93, 0.60, 0.24), (0.35, 0.63, 0.40), (0.72, 0.36, 0.50))
# Colours of runs that are laid over another, which keeps its own.
TINTS = ((0.95, 0.45, 0.1), (0.2, 0.55, 0.95), (0.6, 0.3, 0.8))
# How long the arrow of a force is that bears all the weight, of the extent of the scene.
ARROW = 0.35
# Half the difference of the squares of a plane.
CONTRAST = 0.07
GROUND = (0.62, 0.66, 0.70, 1.0)


@dataclass(frozen=True)
class Shape:
    """One drawn geom.

    body: the index of the body that carries it. kind: "plane", "sphere", "capsule", "ellipsoid",
    "cylinder", "box" or "triangles". size: as `Geom.size`. pos, quat: in the body's frame.
    rgba: its colour. shown: whether it is drawn unless someone asks for all. surface: of
    "triangles". name: of the geom. squares: the colours of the squares of a checked surface.
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

        Their contrast is low, so that what stands on the plane stays brighter.
        """
        if self.squares is None:
            return self.rgba, (*(0.86 * c for c in self.rgba[:3]), self.rgba[3])
        one, other = (np.array(rgba) for rgba in self.squares)
        half = np.clip((one - other) / 2, -CONTRAST, CONTRAST)
        mean = (one + other) / 2
        return tuple((mean + half).tolist()), tuple((mean - half).tolist())


@dataclass(frozen=True)
class Drawing:
    """The appearance of a model.

    name: of the scene. shapes: of all its geoms. bodies: names of the bodies, the world first.
    moving: whether each body can move. extent: a length by which the bodies together are as large
    [m].
    weight: of all that moves [N]; 0 without gravity. notes: what is not drawn as the file says.
    lights: those of the file, and headlight: the one at the camera; without any of them a view has
    its own.
    """

    name: str
    shapes: list[Shape]
    bodies: tuple[str, ...]
    moving: NDArray[np.bool_]
    extent: float
    weight: float
    notes: list[str] = field(default_factory=list)
    lights: list[Light] = field(default_factory=list)
    headlight: Headlight = field(default_factory=Headlight)


def drawing_of(model: Model, world: World) -> Drawing:
    """Return the drawing of a model.

    world: a Sim of the model at any state; its geoms are read where the engine has them.
    """
    scene = model.scene
    try:
        looks = read_looks(scene)
        notes = [] if looks is None else looks.notes
    except (ValueError, OSError) as error:
        looks, notes = None, [f"colours and visual geoms were not read: {error}"]
    moving = np.array(
        [bool(mocap) or bool(moves) for mocap, moves in zip(*_what_moves(model), strict=True)]
    )
    plain = looks is None or _plain(model, looks)
    shapes = _colliding(model, world, looks, moving, plain)
    if looks is not None:
        visual = _visual(looks, moving, plain)
        for index in looks.covered:
            shapes[index] = replace(shapes[index], shown=False)
        shapes += visual
    shapes = [shape for shape in shapes if shape.rgba[3] > 0]
    # A body of which nothing would be seen (it has a skin, or only what collides) is shown whole.
    seen = {shape.body for shape in shapes if shape.shown}
    shapes = [shape if shape.body in seen else replace(shape, shown=True) for shape in shapes]
    heavy = float(np.sum(model.body_mass[moving]))
    weight = heavy * float(np.linalg.norm(scene.gravity)) if scene.features.gravity else 0.0
    extent = _extent(shapes, world, moving)
    names = model.body_names
    drawing = Drawing(scene.name, shapes, names, moving, extent, weight, notes)
    if looks is None:
        return drawing
    return replace(drawing, lights=looks.lights, headlight=looks.headlight)


def _what_moves(model: Model) -> tuple[list[bool], list[bool]]:
    jointed = set(model.jnt_body.tolist())
    moves = [False] * model.nbody
    for body in range(1, model.nbody):
        moves[body] = body in jointed or moves[int(model.body_parent[body])]
    by_name = [body.mocap for body in _in_order(model)]
    return by_name, moves


def _in_order(model: Model) -> list[Any]:
    return Layout(model.scene).bodies


def _plain(model: Model, looks: Looks) -> bool:
    """Return whether nothing but the ground has a colour."""
    pairs = [*zip(looks.colours, model.geom_body, strict=True)]
    pairs += [(look, body) for body, _, look in looks.geoms]
    return all(look.rgba == GREY for look, body in pairs if body)


def _colliding(
    model: Model,
    world: World,
    looks: Looks | None,
    moving: NDArray[np.bool_],
    plain: bool,
) -> list[Shape]:
    """Return the geoms of the engine, including primitives that only draw."""
    shapes = []
    colours = [Look(GREY)] * model.ngeom if looks is None else looks.colours
    for index, geom in enumerate(Layout(model.scene).geoms):
        body = int(model.geom_body[index])
        kind, size = model.geom_type[index], tuple(model.geom_size[index].tolist())
        rgba, squares = colours[index]
        if rgba == GREY and (plain or kind == "plane"):
            rgba = _own_colour(kind, body, moving)
        surface = _surface(geom) if kind in ("mesh", "hfield") else None
        if surface is None:
            pos, quat = _in_body(world, body, index)
            if kind == "mesh":
                surface = model.geom_hull(index)
        else:
            pos, quat = tuple(geom.pos), tuple(geom.quat)
        shown = geom.group in SHOWN_GROUPS
        drawn = "triangles" if surface is not None else kind
        shapes.append(Shape(body, drawn, size, pos, quat, rgba, shown, surface, geom.name, squares))
    return shapes


def _visual(looks: Looks, moving: NDArray[np.bool_], plain: bool) -> list[Shape]:
    """Return the geoms that only draw and are not in the engine."""
    shapes = []
    for body, geom, look in looks.geoms:
        surface = _surface(geom)
        if surface is None and (geom.type in ("mesh", "hfield") or geom.mesh is not None):
            continue
        kind = geom.type if surface is None else "triangles"
        pos, quat, shown = tuple(geom.pos), tuple(geom.quat), geom.group in SHOWN_GROUPS
        size = tuple(geom.size)
        rgba = _own_colour(kind, body, moving) if plain and look.rgba == GREY else look.rgba
        shapes.append(Shape(body, kind, size, pos, quat, rgba, shown, surface, geom.name))
    return shapes


def _own_colour(kind: str, body: int, moving: NDArray[np.bool_]) -> Vec:
    if kind == "plane":
        return GROUND
    return (*PALETTE[body % len(PALETTE)], 1.0) if moving[body] else (0.55, 0.55, 0.55, 1.0)


def _surface(geom: Geom) -> surfaces.Surface | None:
    if geom.type == "mesh" and geom.mesh is not None:
        return surfaces.of_mesh(geom.mesh)
    if geom.type == "hfield" and geom.hfield is not None:
        return surfaces.of_hfield(geom.hfield)
    return None


def _in_body(world: World, body: int, geom: int) -> tuple[Vec, Vec]:
    """Return the pose of a geom in the frame of its body."""
    turn = world.xmat[body]
    pos = turn.T @ (world.geom_xpos[geom] - world.xpos[body])
    return tuple(pos.tolist()), quat_of(turn.T @ world.geom_xmat[geom])


def quat_of(matrix: NDArray[Any]) -> Vec:
    """Return the quaternion w x y z of a rotation matrix (Shepperd's method)."""
    m = matrix
    trace = np.trace(m)
    # Four times the square of each entry of the quaternion.
    squares = 1 + np.array([trace, *(2 * np.diag(m) - trace)])
    k = int(np.argmax(squares))
    w = [squares[0], m[2, 1] - m[1, 2], m[0, 2] - m[2, 0], m[1, 0] - m[0, 1]]
    x = [w[1], squares[1], m[1, 0] + m[0, 1], m[0, 2] + m[2, 0]]
    y = [w[2], x[2], squares[2], m[2, 1] + m[1, 2]]
    z = [w[3], x[3], y[3], squares[3]]
    quat = np.array((w, x, y, z)[k]) / (2 * np.sqrt(squares[k]))
    return tuple(float(entry) for entry in quat / np.linalg.norm(quat))


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
    """Return the diagonal of the box around what moves, or around everything if nothing moves."""
    chosen = [shape for shape in shapes if moving[shape.body]] or shapes
    points = [corners(s) @ world.xmat[s.body].T + world.xpos[s.body] for s in chosen]
    if not any(map(len, points)):
        return 1.0
    every = np.concatenate(points)
    return float(np.linalg.norm(np.ptp(every, axis=0))) or 1.0
