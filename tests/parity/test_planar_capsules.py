"""Round geoms of planar chains keep the friction of both tangents where they are in one place.

Law: contacts and accelerations are MuJoCo's in random states of planar chains of capsules and
spheres, those included in which two axes cross exactly: the contact's normal then stands across the
plane, and both its tangents lie in it.
"""

from __future__ import annotations

from random import Random

import mujoco
import numpy as np
import peers
import pytest

import stepcore as sc

AXES = ("1 0 0", "0 1 0", "0 0 1")


def chain(chance: Random, axis: str) -> str:
    """Links of a chain, each a capsule that begins near its joint; some with a ball there."""
    text, end = "", ""
    for link in range(chance.randrange(2, 4)):
        place = offset(chance, axis, 0.2 if link == 0 else 0.3)
        radius = chance.uniform(0.02, 0.06)
        ends = f"{offset(chance, axis, 0.05)} {offset(chance, axis, 0.5)}"
        text += (
            f'<body pos="{place}"><joint axis="{axis}" damping=".1"/>'
            f'<geom type="capsule" size="{radius:.3f}" fromto="{ends}" mass="1"/>'
        )
        if chance.random() < 0.3:
            text += f'<geom size="{radius:.3f}" mass=".3"/>'
        end += "</body>"
    return text + end


def offset(chance: Random, axis: str, size: float) -> str:
    places = iter([f"{chance.uniform(-size, size):.3f}" for _ in range(2)])
    return " ".join("0" if word == "1" else next(places) for word in axis.split())


@pytest.mark.parametrize("cone", ["pyramidal", "elliptic"])
@pytest.mark.parametrize("axis", AXES)
def test_random_chains_are_mujocos(axis: str, cone: str) -> None:
    compared = crossing = 0
    for seed in range(12):
        chance = Random(seed)
        chains = "".join(chain(chance, axis) for _ in range(2))
        text = (
            f'<mujoco><option cone="{cone}"/><compiler angle="degree"/>'
            f"<worldbody>{chains}</worldbody></mujoco>"
        )
        model = peers.strict(mujoco.MjModel.from_xml_string(text))
        sim, data = sc.Sim(sc.loads(text), **peers.EXACT), mujoco.MjData(model)
        rng = np.random.default_rng(seed)
        for _ in range(4):
            data.qpos[:] = sim.qpos[:] = rng.normal(0, 0.7, model.nq)
            data.qvel[:] = sim.qvel[:] = rng.normal(size=model.nv)
            mujoco.mj_forward(model, data)
            sim.forward()
            normals = data.contact.frame.reshape(-1, 9)[:, :3]
            out = np.abs(normals @ np.array(axis.split(), float))
            if ((out > 1e-9) & (out < 1 - 1e-9)).any() or different(sim, data):
                # Of axes that cross up to rounding MuJoCo's normal is that rounding.
                continue
            compared += 1
            crossing += bool((out > 0.5).any())
            np.testing.assert_allclose(
                sim.qacc, data.qacc, rtol=1e-6, atol=1e-7 * np.abs(data.qacc).max()
            )
    assert compared > 15 and crossing > 5


def different(sim: sc.Sim, data: mujoco.MjData) -> bool:
    """A contact has another normal here than there."""
    ours = sim.contacts["normal"]
    theirs = data.contact.frame.reshape(-1, 9)[:, :3]
    return ours.shape != theirs.shape or not np.allclose(np.abs(ours), np.abs(theirs), atol=1e-9)


BALL, ROD = (
    '<geom size=".1" mass="1"/>',
    '<geom type="capsule" size=".05" fromto="0 0 0 {}" mass="1"/>',
)
HELD = '<body><joint axis="0 1 0"/>{}<geom size=".1" pos="{}" mass="1"/></body>'
ALONG = '<body><joint type="slide" axis="{}"/><geom size=".1" mass="1" euler="{}"/></body>'
TOGETHER = {
    "ball on the end of a capsule": HELD.format(ROD.format(".5 0 0"), "0 0 .6")
    + HELD.format(BALL, ".3 0 -.5"),
    "two balls": HELD.format(BALL, "0 0 .6") + HELD.format(BALL, ".3 0 -.5"),
    "balls that slide across each other": ALONG.format("1 0 0", "0 0 0")
    + ALONG.format("0 0 1", "30 0 0"),
    "balls that slide along one line": ALONG.format("1 0 0", "0 0 0") * 2,
}


@pytest.mark.parametrize("case", TOGETHER)
def test_geoms_in_one_place_are_mujocos(case: str) -> None:
    """Two bodies of one place, whose geoms lie in one another in every state, or in the first."""
    text = f"<mujoco><worldbody>{TOGETHER[case]}</worldbody></mujoco>"
    model = peers.strict(mujoco.MjModel.from_xml_string(text))
    sim, data = sc.Sim(sc.loads(text), **peers.EXACT), mujoco.MjData(model)
    rng = np.random.default_rng(3)
    for _ in range(5):
        data.qpos[:] = sim.qpos[:] = rng.normal(0, 0.03 if "slide" in case else 0.5, model.nq)
        data.qvel[:] = sim.qvel[:] = rng.normal(size=model.nv)
        mujoco.mj_forward(model, data)
        sim.forward()
        assert len(sim.contacts) == data.ncon > 0
        np.testing.assert_allclose(sim.qacc, data.qacc, rtol=1e-9)
