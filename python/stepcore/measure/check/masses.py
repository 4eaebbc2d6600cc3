"""Masses and inertias that no real thing has."""

from __future__ import annotations

import math
from collections.abc import Iterator

import numpy as np
from numpy.typing import NDArray

from stepcore.engine.model import Model
from stepcore.experiment.coordinates import Coordinates
from stepcore.experiment.sizes import Sizes
from stepcore.measure.findings.finding import Finding, others
from stepcore.report.units import metres, times
from stepcore.scene.elements import Geom
from stepcore.scene.layout import Layout

# [kg/m³]: of water, of steel; above osmium and below air there is nothing solid.
WATER, STEEL = 1000.0, 7850.0
DENSEST, LIGHTEST = 25_000.0, 1.0
# A body's radius of gyration is below its largest extent, and not far below: allowed factors.
TOO_FAR, TOO_NEAR = 3.0, 0.02
# Bodies that touch and whose masses differ by more are hard to solve with sweeps.
RATIO = 1e4


def about_masses(model: Model, sizes: Sizes) -> Iterator[Finding]:
    """Densities, inertias and mass ratios of the bodies that move."""
    layout = Layout(model.scene)
    moving = Coordinates(model).moving
    yield from _densities(model, layout, moving)
    yield from _repaired(model, layout, moving)
    yield from _inertias(model, layout, moving, sizes)
    yield from _ratios(model)


def volume(model: Model, geom: Geom, index: int) -> float:
    """The volume of a geom [m³]; of a mesh that of its hull, inf of planes and height fields."""
    if geom.type == "mesh":
        return _hull_volume(*model.geom_hull(index))
    if geom.type == "hfield":
        return math.inf
    a, b, c = geom.size
    ball = 4 / 3 * math.pi
    return {
        "plane": math.inf,
        "sphere": ball * a**3,
        "capsule": ball * a**3 + 2 * b * math.pi * a**2,
        "ellipsoid": ball * a * b * c,
        "cylinder": 2 * b * math.pi * a**2,
        "box": 8 * a * b * c,
    }[geom.type]


def _hull_volume(vertices: NDArray[np.float64], triangles: NDArray[np.int_]) -> float:
    """Of a closed surface, by tetrahedra from one of its points; inf where there is none."""
    if not len(triangles):
        return math.inf
    a, b, c = np.moveaxis(vertices[triangles] - vertices[0], 1, 0)
    return float(np.sum(a * np.cross(b, c))) / 6


def _geoms(layout: Layout, body: int, heavy: bool) -> list[Geom]:
    """A body's geoms; heavy: those that give it mass."""
    rules = layout.scene.mass_rules
    low, high = rules.inertiagrouprange
    own = [geom for geom in layout.geoms if geom.body is layout.bodies[body]]
    if not heavy:
        return own
    weighs = [geom.mass != 0 and (geom.mass or geom.density) > 0 for geom in own]
    return [g for g, has in zip(own, weighs, strict=True) if has and low <= g.group <= high]


def _densities(model: Model, layout: Layout, moving: list[int]) -> Iterator[Finding]:
    """Bodies whose mass comes from geoms, against their volume."""
    rules = model.scene.mass_rules
    index = {id(geom): k for k, geom in enumerate(layout.geoms)}
    dense, light = [], []
    for body in moving:
        if layout.bodies[body].mass is not None and not rules.inertiafromgeom:
            continue
        geoms = _geoms(layout, body, heavy=True)
        filled = sum(volume(model, geom, index[id(geom)]) for geom in geoms)
        mass = float(model.body_mass[body])
        if not filled or not math.isfinite(filled) or any(geom.shellinertia for geom in geoms):
            continue
        density = mass / filled
        if density > DENSEST:
            dense.append((density, body, mass))
        elif density < LIGHTEST:
            light.append((density, body, mass))
    for found, words in ((sorted(dense)[::-1], "denser"), (sorted(light), "lighter")):
        if not found:
            continue
        density, body, mass = found[0]
        names = [model.element_name("body", one[1]) for one in found]
        than = (
            f"{times(density / STEEL)} the density of steel and {times(density / WATER)} that of "
            "water"
            if words == "denser"
            else f"{density / WATER:.2g} of the density of water, lighter than air"
        )
        yield Finding(
            "density",
            "remark",
            names[0],
            f"{_capital(names[0])}{others(names, 'bodies')} has {mass:.3g} kg in its geoms, "
            f"{density:.3g} kg/m³: {than}; check mass, density and size of its geoms.",
            density,
            "kg/m³",
        )


def _repaired(model: Model, layout: Layout, moving: list[int]) -> Iterator[Finding]:
    """Inertias that balanceinertia repairs: without it, no scene with them is compiled."""
    if not model.scene.mass_rules.balanceinertia:
        return
    wrong = []
    for index in moving:
        body = layout.bodies[index]
        if body.mass is None:
            continue
        xx, yy, zz, xy, xz, yz = body.inertia
        moments = np.linalg.eigvalsh([[xx, xy, xz], [xy, yy, yz], [xz, yz, zz]])
        if moments[0] + moments[1] < moments[2] * (1 - 1e-9):
            wrong.append((index, moments))
    if wrong:
        index, (a, b, c) = wrong[0]
        names = [model.element_name("body", one) for one, _ in wrong]
        yield Finding(
            "inertia",
            "error",
            names[0],
            f"{_capital(names[0])}{others(names, 'bodies')} has principal moments {a:.3g}, {b:.3g} "
            f"and {c:.3g} kg·m²: no thing has one greater than the sum of the others; "
            "balanceinertia replaces them by their mean, so write those of the real body.",
            float(c),
            "kg·m²",
        )


def _inertias(model: Model, layout: Layout, moving: list[int], sizes: Sizes) -> Iterator[Finding]:
    """Inertias that are written, against the extent of the body."""
    # Where meshes were not read, nothing tells how far a body reaches.
    if any("only draws" in line for line in model.scene.ignored):
        return
    wrong = []
    for body in moving:
        mass, geoms = float(model.body_mass[body]), _geoms(layout, body, heavy=False)
        if layout.bodies[body].mass is None or not geoms or mass <= 0:
            continue
        index = {id(geom): k for k, geom in enumerate(layout.geoms)}
        ipos = np.asarray(model.body_ipos[body])
        reach = max(
            float(np.linalg.norm(np.asarray(g.pos) - ipos)) + sizes.reach[index[id(g)]]
            for g in geoms
        )
        trace = float(np.trace(np.asarray(model.body_inertia[body])))
        gyration = math.sqrt(max(trace, 0.0) / 2 / mass)
        if not math.isfinite(reach):
            continue
        if gyration > TOO_FAR * reach or 0 < gyration < TOO_NEAR * reach:
            wrong.append((gyration, reach, body, mass))
    if not wrong:
        return
    gyration, reach, body, mass = wrong[0]
    names = [model.element_name("body", one[2]) for one in wrong]
    what = "reaches only" if gyration > reach else "reaches"
    solid = 0.4 * mass * reach**2
    yield Finding(
        "inertia",
        "error" if gyration > reach else "warning",
        names[0],
        f"The inertia of {names[0]}{others(names, 'bodies')} belongs to mass {metres(gyration)} "
        f"from its centre, but the body {what} {metres(reach)}: a ball of its mass and size has "
        f"{solid:.2g} kg·m²; correct its <inertial>, or let it come from the geoms "
        '(inertiafromgeom="true").',
        gyration,
        "m",
    )


def _extremes(model: Model) -> list[list[int]]:
    """A geom of the lightest and one of the heaviest body that moves and has geoms."""
    owner = model.geom_body
    movers = [g for g in range(model.ngeom) if owner[g] and model.body_mass[owner[g]] > 0]
    if not movers:
        return []
    by_mass = sorted(movers, key=lambda geom: float(model.body_mass[owner[geom]]))
    return [[by_mass[0], by_mass[-1]]]


def _ratios(model: Model) -> Iterator[Finding]:
    """Bodies that can touch, one much heavier than the other."""
    worst, pair = 0.0, (0, 0)
    # In a heap any two bodies are taken to meet, as their extremes do.
    every = _extremes(model) if model.is_heap else model.pair_geoms
    for a, b in {tuple(sorted(model.geom_body[pair].tolist())) for pair in every}:
        light, heavy = sorted((a, b), key=lambda body: float(model.body_mass[body]))
        if a == 0 or float(model.body_mass[light]) <= 0:
            continue
        ratio = float(model.body_mass[heavy] / model.body_mass[light])
        if ratio > worst:
            worst, pair = ratio, (light, heavy)
    if worst > RATIO and model.settings.solver == "pgs":
        light, heavy = (model.element_name("body", body) for body in pair)
        yield Finding(
            "mass ratio",
            "remark",
            heavy,
            f"{_capital(heavy)} is {times(worst)} as heavy as {light}, which it can touch: sweeps "
            "converge slowly there; solver newton does not mind (laws solref only).",
            worst,
            "1",
        )


def _capital(name: str) -> str:
    return name[:1].upper() + name[1:]
