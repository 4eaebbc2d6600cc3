"""The oracle itself: exact arithmetic, closed forms, and a covering of all directions."""

from decimal import Decimal, localcontext
from fractions import Fraction
from itertools import product as pairs_of
from math import sqrt

import numpy as np
import pytest
from contact_oracle.convex import Convex, Posed
from contact_oracle.cover import upper_bound
from contact_oracle.poses import STYLES, rotation, trial
from contact_oracle.search import search

KINDS = ("sphere", "capsule", "ellipsoid", "cylinder", "box", "mesh")
PAIRS = [(a, b) for i, a in enumerate(KINDS) for b in KINDS[i:]]


def exact_rotation(w, x, y, z):
    """The matrix of an integer quaternion, in fractions."""
    n = Fraction(w * w + x * x + y * y + z * z)
    return [
        [1 - 2 * (y * y + z * z) / n, 2 * (x * y - w * z) / n, 2 * (x * z + w * y) / n],
        [2 * (x * y + w * z) / n, 1 - 2 * (x * x + z * z) / n, 2 * (y * z - w * x) / n],
        [2 * (x * z - w * y) / n, 2 * (y * z + w * x) / n, 1 - 2 * (x * x + y * y) / n],
    ]


def cross(a, b):
    return [a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]]


def dot(a, b):
    return sum(x * y for x, y in zip(a, b, strict=True))


def exact_boxes(half1, half2, offset, turn):
    """The signed distance of two boxes along the fifteen directions, each exact in fractions but
    for its one square root: of boxes that overlap the distance."""
    axes1 = [[Fraction(int(i == j)) for j in range(3)] for i in range(3)]
    axes2 = [list(column) for column in zip(*turn, strict=True)]
    tried = axes1 + axes2 + [cross(a, b) for a, b in pairs_of(axes1, axes2)]
    best = None
    for n in tried:
        square = dot(n, n)
        if square:
            reach = sum(h * abs(dot(n, a)) for h, a in zip(half1, axes1, strict=True))
            reach += sum(h * abs(dot(n, a)) for h, a in zip(half2, axes2, strict=True))
            gap = float(abs(dot(n, offset)) - reach) / sqrt(square)
            best = gap if best is None else max(best, gap)
    return best


def test_overlapping_boxes_in_exact_arithmetic():
    rng = np.random.default_rng(3)
    checked = 0
    for _ in range(300):
        half1, half2 = rng.integers(1, 64, (2, 3)).tolist()
        quat = rng.integers(-4, 5, 4).tolist()
        offset = rng.integers(-40, 41, 3).tolist()
        if not any(quat):
            continue
        exact = exact_boxes(half1, half2, [Fraction(x) for x in offset], exact_rotation(*quat))
        if exact >= 0:
            continue
        one, two = Convex("box", tuple(half1)), Convex("box", tuple(half2))
        turn = rotation(np.array([quat], float))
        found = search(Posed(one, two, np.array([offset], float), turn)).dist[0]
        assert found == pytest.approx(exact, rel=0, abs=1e-13 * (max(half1 + half2)))
        checked += 1
    assert checked > 150


def height(shape, u):
    """How far a shape reaches along u, in decimals."""
    x, y, z = (Decimal(size) for size in shape.size)
    across, length = (u[0] ** 2 + u[1] ** 2).sqrt(), dot(u, u).sqrt()
    match shape.kind:
        case "sphere":
            return x * length
        case "capsule":
            return x * length + y * abs(u[2])
        case "cylinder":
            return x * across + y * abs(u[2])
        case "ellipsoid":
            return sum((s * c) ** 2 for s, c in zip((x, y, z), u, strict=True)).sqrt()
        case "box":
            return sum(s * abs(c) for s, c in zip((x, y, z), u, strict=True))
    return max(dot([Decimal(c) for c in vertex], u) for vertex in shape.vertices.tolist())


@pytest.mark.parametrize("pair", PAIRS, ids="-".join)
def test_bounds_in_fifty_digits(pair):
    """g at the direction that was found: the lower bound is one to a few units of rounding."""
    rng = np.random.default_rng(9)
    for style in ("generic", "needles", "large"):
        posed = trial(rng, pair, style, 12).posed
        found = search(posed)
        with localcontext() as context:
            context.prec = 50
            for k, dist in enumerate(found.dist):
                n = [Decimal(c) for c in found.normal[k].tolist()]
                turn = [[Decimal(c) for c in row] for row in posed.turn[k].tolist()]
                toward = [-dot(n, column) for column in zip(*turn, strict=True)]
                gap = dot(n, [Decimal(c) for c in posed.offset[k].tolist()])
                gap -= height(posed.a, n) + height(posed.b, toward)
                error = float(abs(gap / dot(n, n).sqrt() - Decimal(dist)))
                assert error < 1e-14 * posed.scale[k]


def test_closed_forms():
    """Balls; a ball in a cube, in an ellipsoid's middle, at a cylinder's rim; crossed capsules."""
    one = np.eye(3)[None]

    def dist(a, b, offset, turn=one):
        return search(Posed(a, b, np.array([offset], float), turn)).dist[0]

    ball, cube = Convex("sphere", (0.5, 0, 0)), Convex("box", (1, 1, 1))
    assert dist(ball, ball, (3, 4, 0)) == pytest.approx(4, abs=1e-14)
    assert dist(ball, cube, (0.25, 0, 0)) == pytest.approx(-1.25, abs=1e-14)
    assert dist(ball, Convex("ellipsoid", (3, 1, 2)), (0, 0, 0)) == pytest.approx(-1.5, abs=1e-14)
    # The nearest point of the rim, radius 1 at height 1, is (1, 0, 1).
    rim = dist(ball, Convex("cylinder", (1, 1, 0)), (-4, 0, -5))
    assert rim == pytest.approx(sqrt(9 + 16) - 0.5, abs=1e-14)
    quarter = rotation(np.array([[1.0, 1, 0, 0]]))
    rod = Convex("capsule", (0.1, 2, 0))
    assert dist(rod, rod, (0.15, 0, 0), quarter) == pytest.approx(-0.05, abs=1e-14)


@pytest.mark.parametrize("pair", PAIRS, ids="-".join)
def test_no_direction_is_better(pair):
    """Of overlapping shapes: a covering of the sphere leaves no room above what was found."""
    rng = np.random.default_rng(5)
    for style in ("generic", "slabs", "needles", "aligned"):
        posed = trial(rng, pair, style, 16).posed
        found = search(posed)
        overlap = found.dist < 0
        bound = upper_bound(posed.take(overlap), found.dist[overlap], tolerance=1e-7, cells=8000)
        room = (bound - found.dist[overlap]) / posed.scale[overlap]
        # A circle of best directions (a ball on an axis) needs many triangles: a wider bound.
        assert np.quantile(room, 0.9) < 1.01e-7
        assert room.max() < 1e-4


@pytest.mark.parametrize("pair", PAIRS, ids="-".join)
def test_either_shape_may_come_first(pair):
    rng = np.random.default_rng(7)
    for style in STYLES:
        posed = trial(rng, pair, style, 10).posed
        back = posed.turn.transpose(0, 2, 1)
        offset = -(back @ posed.offset[..., None])[..., 0]
        other = search(Posed(posed.b, posed.a, offset, back)).dist
        assert np.abs(search(posed).dist - other).max() < 1e-12 * posed.scale.max()
