"""Where contacts differ from MuJoCo's (docs/robots.md): the oracle's verdict, case by case."""

import mujoco
import numpy as np
import peers
import pytest
import verdict

import stepcore as sc

CASES = {
    # Two of a leg of the Go2: the thin one's rim is in the thick one's side.
    "rims of cylinders": (
        '<geom name="a" type="cylinder" size=".046 .02"/>'
        '<body pos="-.0675 -.019 -.0155" quat=".596 -.596 -.381 .381"><freejoint/>'
        '<geom name="b" type="cylinder" size=".011 .0325"/></body>',
        "stepcore right",
    ),
    # A foot on flat ground near a seam of the prisms that MuJoCo makes of it.
    "a seam of a flat field": (
        '<geom name="a" type="hfield" hfield="flat"/>'
        '<body pos=".989 -.467 .0667"><freejoint/><geom name="b" type="sphere" size=".08"/></body>',
        "stepcore right",
    ),
    # A mesh of more corners than MuJoCo keeps of it on a plane.
    "a prism on a plane": (
        '<geom name="a" type="plane" size="1 1 .1"/>'
        '<body pos="0 0 .049"><freejoint/><geom name="b" type="mesh" mesh="prism"/></body>',
        "both right, other points",
    ),
}
ANGLES = np.arange(6) * np.pi / 3
PRISM = np.array([[0.1 * np.cos(a), 0.1 * np.sin(a), z] for a in ANGLES for z in (-0.05, 0.05)])
ASSETS = (
    '<asset><hfield name="flat" nrow="21" ncol="21" size="3 3 1 .1" '
    f'elevation="{"0 " * 441}"/><mesh name="prism" '
    f'vertex="{" ".join(map(repr, PRISM.ravel().tolist()))}"/></asset>'
)


def judged(body):
    """Both engines' answers about two geoms, and the judge."""
    text = f"<mujoco>{ASSETS}<worldbody>{body}</worldbody></mujoco>"
    model = peers.strict(mujoco.MjModel.from_xml_string(text))
    data, sim = mujoco.MjData(model), sc.Sim(sc.loads(text), **peers.EXACT)
    mujoco.mj_forward(model, data)
    sim.forward()
    judge = verdict.Judge(sim, model, data, peers.kept_geoms(sim, model))
    ours, theirs = verdict.listed(sim, judge.geoms), verdict.listed_by_mujoco(data)
    return judge, ours[0, 1], theirs[0, 1]


@pytest.mark.parametrize("case", CASES)
def test_who_is_right(case):
    body, expected = CASES[case]
    judge, ours, theirs = judged(body)
    assert verdict.elsewhere(ours, theirs, judge.size((0, 1)))
    who, off, _ = judge.pair((0, 1), ours, theirs)
    assert who == expected
    assert off < 1e-9


def test_a_wrong_claim_of_ours_would_be_told():
    """The judge trusts neither: with the two engines' answers changed over, MuJoCo is right."""
    judge, ours, theirs = judged(CASES["a seam of a flat field"][0])
    assert judge.pair((0, 1), theirs, ours)[0] == "MuJoCo right"
