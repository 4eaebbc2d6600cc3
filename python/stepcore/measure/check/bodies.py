"""Checks for implausible masses and inertias, and for numbers that look like another unit."""

from __future__ import annotations

import math
from collections.abc import Iterator

import numpy as np
from numpy.typing import NDArray

from stepcore.engine.actuator import actuators
from stepcore.engine.coordinates import Coordinates
from stepcore.engine.element import Element
from stepcore.engine.model import Model
from stepcore.experiment.sizes import Sizes
from stepcore.measure.monitors.finding import Finding, Next, listed, named
from stepcore.report.units import metres, times
from stepcore.scene.elements import Geom
from stepcore.scene.layout import Layout

# Plausible gravity in m/s², and the least value that looks like mm/s².
EARTH, MILLI = (1.0, 50.0), 500.0
# Sizes of moving bodies above which millimetres are likely, and below which metres are likely [m].
LARGE, SMALL = 10.0, 5.0
# Inertia below which units are too large [kg·m²]: ten times MuJoCo's mjMINVAL. A worm of 2e-15
# fails there with a rank-deficient Hessian, one of 2e-13 trains well (MuJoCo's issue 1086).
TINY = 1e-14
# Radians read as degrees [°] are at most one turn of 2π, and seldom less than this.
LEAST = 0.5
# How far a control range may be from its joint's range in degrees, relative to it.
NEAR = 0.1
# Densities of water and steel [kg/m³]; then bounds: above osmium and below air nothing is solid.
WATER, STEEL = 1000.0, 7850.0
DENSEST, LIGHTEST = 25_000.0, 1.0
# Bounds of the radius of gyration, relative to the body's extent.
TOO_FAR, TOO_NEAR = 3.0, 0.02
LIST = (Next("plan", "every body, geom and row that a step computes", ("--all",)),)


def about_bodies(model: Model, sizes: Sizes) -> Iterator[Finding]:
    """Yield findings on units, and on densities and inertias of moving bodies."""
    layout, moving = Layout(model.scene), Coordinates(model).moving
    yield from _lengths(model, moving, sizes)
    yield from _tiny(model, moving)
    yield from _angles(model)
    yield from _controls(model)
    yield from _densities(model, layout, moving)
    yield from _inertias(model, layout, moving, sizes)


# Units.


def _units(
    severity: str,
    problem: str,
    cure: str,
    elements: tuple[Element, ...],
    value: float,
    unit: str,
) -> Finding:
    return Finding("units", severity, problem, cure, elements, value, unit, LIST)


def _lengths(model: Model, moving: list[int], sizes: Sizes) -> Iterator[Finding]:
    reaches = [
        reach
        for reach, body in zip(sizes.reach, model.geom_body.tolist(), strict=True)
        if body in moving and math.isfinite(reach)
    ]
    gravity = float(np.linalg.norm(model.scene.gravity)) if model.scene.features.gravity else 0.0
    if not reaches or not gravity:
        return
    typical = float(np.median(reaches))
    if EARTH[0] < gravity < EARTH[1] and typical >= LARGE:
        problem = (
            f"Half of the geoms that move are larger than {metres(typical)}, under a gravity of "
            f"{gravity:.3g} m/s², so sizes and positions look like mm"
        )
        cure = (
            "divide lengths by 1000 (masses that come from density fall by 1e9), or check that the "
            "scene is meant to be so large"
        )
        yield _units("error", problem, cure, (), typical, "m")
    if gravity > MILLI and typical < SMALL:
        problem = (
            f"Gravity is {gravity:.4g} m/s² while half of the geoms that move are smaller than "
            f"{metres(typical)}, so gravity looks like mm/s²"
        )
        cure = 'write gravity="0 0 -9.81" where lengths are in m'
        yield _units("error", problem, cure, (), gravity, "m/s²")


def _tiny(model: Model, moving: list[int]) -> Iterator[Finding]:
    """Yield bodies whose inertia is lost in rounding, or refused by MuJoCo."""
    least = {
        body: float(np.linalg.eigvalsh(np.asarray(model.body_inertia[body]))[0])
        for body in moving
        if model.body_mass[body] > 0
    }
    tiny = sorted(
        (body for body, value in least.items() if 0 < value < TINY), key=least.__getitem__
    )
    if tiny:
        bodies, value = named(model, "body", tiny), least[tiny[0]]
        problem = (
            f"{listed(bodies, 'bodies')} has an inertia of {value:.2g} kg·m²; MuJoCo refuses less "
            "than 1e-15, and its solver loses rank near that"
        )
        cure = (
            "write lengths in mm and masses in g, with gravity and lengths × 1e3, masses × 1e3, "
            "and gains, stiffness, damping and torques of hinges × 1e9"
        )
        yield _units("warning", problem, cure, bodies, value, "kg·m²")


def _angles(model: Model) -> Iterator[Finding]:
    """Yield hinge ranges that look like radians read as degrees."""
    joints: list[int] = []
    if model.scene.features.limit:
        finite = np.isfinite(model.jnt_range).all(axis=1)
        joints = [k for k, kind in enumerate(model.jnt_type) if kind == "hinge" and finite[k]]
    most = max((float(np.abs(np.degrees(model.jnt_range[k])).max()) for k in joints), default=0.0)
    if LEAST <= most <= 2 * math.pi * 1.001:
        small, (low, high) = named(model, "joint", joints), np.degrees(model.jnt_range[joints[0]])
        problem = (
            f"the range of {listed(small, 'joints')} is {low:.4g} to {high:.4g} degrees, as if "
            "radians were meant"
        )
        yield _units("warning", problem, 'write <compiler angle="radian"/>', small, most, "deg")


def _controls(model: Model) -> Iterator[Finding]:
    """Yield servos whose control range is the joint's range in degrees; MuJoCo keeps degrees."""
    wrong = []
    for of in actuators(model):
        if not of.holds or of.joint is None or model.jnt_type[of.joint] != "hinge":
            continue
        bounds, limits = model.actuator_ctrlrange[of.index], model.jnt_range[of.joint]
        if not np.isfinite([*bounds, *limits]).all():
            continue
        ratio = float(np.abs(bounds).max() / np.abs(limits).max())
        if abs(ratio * math.pi / 180 - 1) < NEAR:
            wrong.append(of.index)
    if wrong:
        servos, (low, high) = named(model, "actuator", wrong), model.actuator_ctrlrange[wrong[0]]
        problem = (
            f"the ctrlrange of {listed(servos, 'servos')} is {low:.4g} to {high:.4g} rad, its "
            "joint's range in degrees"
        )
        cure = (
            "control ranges are in radians whatever the compiler's angle; multiply degrees by π/180"
        )
        yield _units("error", problem, cure, servos, float(max(abs(low), abs(high))), "rad")


# Masses.


def volume(model: Model, geom: Geom, index: int) -> float:
    """Return the volume of a geom [m³]; a mesh's hull counts; inf for planes and height fields."""
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
    """Return the volume of a closed surface by tetrahedra [m³]; inf without a surface."""
    if not len(triangles):
        return math.inf
    a, b, c = np.moveaxis(vertices[triangles] - vertices[0], 1, 0)
    return float(np.sum(a * np.cross(b, c))) / 6


def _geoms(layout: Layout, body: int, heavy: bool) -> dict[int, Geom]:
    """Return a body's geoms by index; heavy: only the geoms that give the body mass."""
    rules = layout.scene.mass_rules
    low, high = rules.inertiagrouprange
    return {
        index: geom
        for index, geom in enumerate(layout.geoms)
        if geom.body is layout.bodies[body]
        and (
            not heavy
            or (geom.mass != 0 and (geom.mass or geom.density) > 0 and low <= geom.group <= high)
        )
    }


def _densities(model: Model, layout: Layout, moving: list[int]) -> Iterator[Finding]:
    """Yield bodies whose geoms give them an implausible density."""
    dense, light = [], []
    for body in moving:
        if layout.bodies[body].mass is not None and not model.scene.mass_rules.inertiafromgeom:
            continue
        geoms = _geoms(layout, body, heavy=True)
        filled = sum(volume(model, geom, index) for index, geom in geoms.items())
        hollow = any(geom.shellinertia for geom in geoms.values())
        if not filled or not math.isfinite(filled) or hollow:
            continue
        density = float(model.body_mass[body]) / filled
        if density > DENSEST:
            dense.append((density, body))
        elif density < LIGHTEST:
            light.append((density, body))
    for wrong in (sorted(dense)[::-1], sorted(light)):
        if not wrong:
            continue
        density, body = wrong[0]
        bodies = named(model, "body", [body for _, body in wrong])
        than = f"{density / WATER:.2g} of the density of water, lighter than air"
        if density > DENSEST:
            steel, water = times(density / STEEL), times(density / WATER)
            than = f"{steel} the density of steel and {water} that of water"
        problem = (
            f"{listed(bodies, 'bodies')} has {float(model.body_mass[body]):.3g} kg in its geoms, "
            f"{density:.3g} kg/m³, which is {than}"
        )
        cure = "check mass, density and size of its geoms"
        yield Finding("density", "remark", problem, cure, bodies, density, "kg/m³", commands=LIST)


def _inertias(model: Model, layout: Layout, moving: list[int], sizes: Sizes) -> Iterator[Finding]:
    """Yield explicit inertias that do not fit the extent of the body."""
    # Without the meshes, the extent of a body is unknown.
    if any("only draws" in line for line in model.scene.ignored):
        return
    wrong = []
    for body in moving:
        mass, geoms = float(model.body_mass[body]), _geoms(layout, body, heavy=False)
        if layout.bodies[body].mass is None or not geoms or mass <= 0:
            continue
        ipos = np.asarray(model.body_ipos[body])
        reach = max(
            float(np.linalg.norm(np.asarray(geom.pos) - ipos)) + sizes.reach[index]
            for index, geom in geoms.items()
        )
        trace = float(np.trace(np.asarray(model.body_inertia[body])))
        gyration = math.sqrt(max(trace, 0.0) / 2 / mass)
        if not math.isfinite(reach):
            continue
        if gyration > TOO_FAR * reach or 0 < gyration < TOO_NEAR * reach:
            wrong.append((gyration, reach, body, mass))
    if not wrong:
        return
    gyration, reach, _, mass = wrong[0]
    bodies = named(model, "body", [body for _, _, body, _ in wrong])
    large = gyration > reach
    problem = (
        f"the inertia of {listed(bodies, 'bodies')} belongs to mass {metres(gyration)} from its "
        f"centre, but the body reaches {'only ' * large}{metres(reach)} (a ball of its mass and "
        f"size has {0.4 * mass * reach**2:.2g} kg·m²)"
    )
    cure = 'correct its <inertial>, or let it come from the geoms (inertiafromgeom="true")'
    severity = "error" if large else "warning"
    yield Finding("inertia", severity, problem, cure, bodies, gyration, "m", LIST)
