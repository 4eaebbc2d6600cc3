"""Tendons whose sites lie on the surface of what they go round, or within rounding of it.

Law: the length is MuJoCo's to 1e-6 of the radius, or shorter: where an end lies on the surface,
MuJoCo may lead the tendon along it although the straight line only touches there, or the long way
round. It is never longer. In a frame that is turned by any angle rounding decides whether a point
of the surface is within it, differently in both engines: there points are 1e-9 outside.
"""

from __future__ import annotations

from random import Random

import mujoco
import pytest
from covering import every_pair

import stepcore as sc

# Points of circles whose distance from the centre is exact, or rounds to either side.
ROUND = {
    0.5: ((0.3, 0.4), (0.4, 0.3), (0.5, 0.0), (0.0, 0.5)),
    0.25: ((0.15, 0.2), (0.07, 0.24), (0.24, 0.07), (0.25, 0.0)),
    0.65: ((0.25, 0.6), (0.39, 0.52), (0.33, 0.56), (0.16, 0.63)),
}
TURNS = ("", "90 0 0", "0 90 0", "20 30 40")
NEAR = (1.0, 1.0, 1 + 1e-12, 1 + 1e-9, 2.0)
MODEL = """<mujoco><worldbody><body pos="{place}" euler="{turn}">
<geom name="g" type="{kind}" size="{radius} .5" contype="0" conaffinity="0"/>
<site name="side" pos="{side}"/><site name="a" pos="{a}"/><site name="b" pos="{b}"/></body>
<body><joint type="slide"/><geom size=".01"/></body></worldbody>
<tendon><spatial><site site="a"/><geom geom="g" {uses}/><site site="b"/></spatial></tendon>
</mujoco>"""


def lengths(text: str) -> tuple[float, float]:
    model = mujoco.MjModel.from_xml_string(text)
    data = mujoco.MjData(model)
    mujoco.mj_forward(model, data)
    sim = sc.Sim(sc.loads(text))
    sim.forward()
    return float(sim.ten_length[0]), float(data.ten_length[0])


def opposite(one: tuple[float, float, float], two: tuple[float, float, float]) -> bool:
    cross = one[0] * two[1] - one[1] * two[0]
    return abs(cross) < 1e-6 and one[0] * two[0] + one[1] * two[1] < 0


@every_pair(kind=["sphere", "cylinder"], uses=["none", "inside", "on", "outside"])
def test_lengths_are_mujocos(kind: str, uses: str) -> None:
    chance, same = Random(f"{kind} {uses}"), 0
    for _ in range(120):
        radius = chance.choice(list(ROUND))

        def point(share: float, radius: float = radius) -> tuple[float, float, float]:
            x, y = chance.choice(ROUND[radius])
            rise = chance.choice((0.0, 0.1)) if kind == "cylinder" else 0.0
            return chance.choice((-1, 1)) * x * share, chance.choice((-1, 1)) * y * share, rise

        def written(point: tuple[float, float, float]) -> str:
            return " ".join(map(repr, point))

        turn = chance.choice(TURNS)
        least = 1 + 1e-9 if turn == TURNS[-1] else 1.0
        shares = [max(least, chance.choice(NEAR)) for _ in range(2)]
        a, b = (point(share) for share in shares)
        side = point({"none": 0.0, "inside": 0.3, "on": least, "outside": 2.0}[uses])
        if opposite(a, side) or opposite(b, side):
            # Either way round leads over the side.
            continue
        text = MODEL.format(
            kind=kind,
            radius=radius,
            turn=turn,
            place=written((0.0, 0.0, chance.choice((0.0, 1.0)))),
            a=written(a),
            b=written(b),
            side=written((*side[:2], 0.0)),
            uses="" if uses == "none" else 'sidesite="side"',
        )
        ours, theirs = lengths(text)
        assert ours <= theirs + 1e-6 * radius, text
        same += abs(ours - theirs) <= 1e-6 * radius
        if min(shares) > 1.5:
            assert ours == pytest.approx(theirs, abs=1e-9), text
    assert same > 60


# Three, four and five, of which no square is exact.
SIDES = ((0.03, 0.04, 0.05), (0.06, 0.08, 0.1), (0.25, 0.6, 0.65), (0.14, 0.48, 0.5))


@every_pair(kind=["sphere", "cylinder"], reach=[1, 2], **{"x, y, radius": SIDES})
def test_a_site_on_the_surface_is_on_the_side_that_it_is_in_mujoco(
    kind: str, x: float, y: float, radius: float, reach: int
) -> None:
    """A side site there, and ends on the surface or beyond: round, through or straight."""
    for one, two in ((-x, y), (y, -x)), ((-y, x), (x, -y)), ((x, -y), (-y, -x)):
        text = MODEL.format(
            kind=kind,
            radius=radius,
            turn="",
            place="0 0 0",
            a=f"{reach * one[0]!r} {reach * one[1]!r} 0",
            b=f"{reach * two[0]!r} {reach * two[1]!r} 0",
            side=f"{x} {y} 0",
            uses='sidesite="side"',
        )
        ours, theirs = lengths(text)
        assert ours == pytest.approx(theirs, abs=1e-7 * radius)


def test_ends_at_one_angle_do_not_go_all_round() -> None:
    """Along the cylinder, with the side site across it: MuJoCo's straight line."""
    text = MODEL.format(
        kind="cylinder",
        radius=0.25,
        turn="",
        place="0 0 0",
        a="0 -.25 .18",
        b="0 -.25 0",
        side="0 .5 0",
        uses='sidesite="side"',
    )
    assert lengths(text) == pytest.approx((0.18, 0.18), abs=1e-15)
