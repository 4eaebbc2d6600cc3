"""Inverse weights under the armature of tendons are MuJoCo's.

Law: `body_invweight0`, `dof_invweight0` and `tendon_invweight0` of random trees of all kinds of
joints, with fixed and spatial tendons of random armature, agree with MuJoCo's to 1e-9 of the
largest of each. Among the trees are many of bodies that only slide: those MuJoCo weighs by their
mass alone, unless a tendon with armature has one in its path.
"""

from __future__ import annotations

from random import Random

import mujoco
import numpy as np
import pytest

import stepcore as sc

KINDS = ("slide", "slide", "slide", "hinge", "ball", "free")
TABLES = ("body_invweight0", "dof_invweight0", "tendon_invweight0")
AXES = ("1 0 0", "0 1 0", "0 0 1", "1 1 1")


class Maker:
    """Draws one model from `chance`."""

    def __init__(self, chance: Random) -> None:
        self.chance = chance
        self.joints: list[str] = []
        self.sites = ["fixed"]
        self.bodies = self.count = 0

    def numbers(self, count: int = 3) -> str:
        return " ".join(f"{self.chance.uniform(-1, 1):.3f}" for _ in range(count))

    def joint(self, kind: str, axis: str) -> str:
        if kind == "free":
            return "<freejoint/>"
        self.count += 1
        name = f"j{self.count}"
        if kind != "ball":
            self.joints.append(name)
        axis = "" if kind == "ball" else f'axis="{axis}"'
        place = "" if self.chance.random() < 0.7 else f'pos="{self.numbers()}"'
        armature = self.chance.choice(("0", "0.3"))
        return f'<joint name="{name}" type="{kind}" {axis} {place} armature="{armature}"/>'

    def body(self, depth: int) -> str:
        kinds = [self.chance.choice(KINDS)]
        if depth:
            kinds = [self.chance.choice((*KINDS[:-1], ""))]
        if kinds[0] == "slide":
            kinds += ["slide"] * self.chance.randrange(3)
        # Joints of one body along different axes.
        axes = self.chance.sample(AXES, len(kinds))
        joints = "".join(
            self.joint(kind, axis) for kind, axis in zip(kinds, axes, strict=True) if kind
        )
        self.bodies += 1
        self.sites.append(site := f"s{self.bodies}")
        within = "" if self.chance.random() < 0.6 else f'pos="{self.numbers()}"'
        inner = ""
        if depth < 2 and self.chance.random() < 0.4:
            inner = self.body(depth + 1)
        mass = self.chance.uniform(0.2, 2)
        return (
            f'<body pos="{self.numbers()}">{joints}<site name="{site}" pos="{self.numbers()}"/>'
            f'<geom type="box" size=".1 .2 .3" mass="{mass:.3f}" {within}/>{inner}</body>'
        )

    def tendon(self) -> str:
        armature = self.chance.choice((0, 0.5, 5))
        if self.joints and self.chance.random() < 0.5:
            some = self.chance.sample(self.joints, min(len(self.joints), 2))
            stops = "".join(f'<joint joint="{name}" coef="{self.numbers(1)}"/>' for name in some)
            return f'<fixed armature="{armature}">{stops}</fixed>'
        some = self.chance.sample(self.sites, min(len(self.sites), 3))
        stops = "".join(f'<site site="{name}"/>' for name in some)
        return f'<spatial armature="{armature}">{stops}</spatial>'

    def model(self) -> str:
        bodies = "".join(self.body(0) for _ in range(self.chance.randrange(1, 4)))
        tendons = "".join(self.tendon() for _ in range(self.chance.randrange(1, 3)))
        return (
            f'<mujoco><worldbody><site name="fixed" pos="{self.numbers()}"/>{bodies}</worldbody>'
            f"<tendon>{tendons}</tendon></mujoco>"
        )


@pytest.mark.parametrize("seed", range(120))
def test_weights_of_random_trees(seed: int) -> None:
    text = Maker(Random(seed)).model()
    theirs, ours = mujoco.MjModel.from_xml_string(text), sc.loads(text).compile()
    for name in TABLES:
        want = getattr(theirs, name)
        np.testing.assert_allclose(
            getattr(ours, name), want, rtol=0, atol=1e-9 * np.abs(want).max(initial=0), err_msg=name
        )


@pytest.mark.parametrize(
    "tendon",
    [
        '<fixed armature="5"><joint joint="j" coef="1"/></fixed>',
        '<spatial armature="5"><site site="a"/><site site="b"/></spatial>',
    ],
)
def test_limit_of_a_slide_under_a_heavy_tendon(tendon: str) -> None:
    """1 kg and 5 kg along one line: an inverse weight of 1/6; at 0.05 m beyond it −125 m/s²."""
    text = f"""<mujoco><worldbody><site name="a" pos="-1 0 0"/><body>
      <joint name="j" type="slide" axis="1 0 0" limited="true" range="-1 0"/>
      <geom size=".1" mass="1"/><site name="b"/></body></worldbody>
      <tendon>{tendon}</tendon></mujoco>"""
    sim = sc.Sim(sc.loads(text))
    sim.qpos = [0.05]
    sim.forward()
    assert sim.model.dof_invweight0[0] == pytest.approx(1 / 6, rel=1e-14)
    assert sim.qacc[0] == pytest.approx(-125, rel=1e-12)


@pytest.mark.parametrize("mocap", ["", 'mocap="true"'])
def test_a_slide_on_a_body_that_its_user_moves(mocap: str) -> None:
    """The inverse weight of its mass alone, as on any body that nothing moves."""
    text = f"""<mujoco><worldbody><body pos="5 0 0" {mocap}><geom size=".1"/><body pos="0 0 2">
      <joint type="slide"/><geom size=".1" mass="3"/></body></body></worldbody></mujoco>"""
    theirs, ours = mujoco.MjModel.from_xml_string(text), sc.loads(text).compile()
    assert ours.body_invweight0.tolist() == theirs.body_invweight0.tolist()
    assert ours.body_invweight0[2].tolist() == [1 / 3, 0.0]
