"""Links on fixed joints become part of what carries them, as in MuJoCo's import of a URDF.

Law: bodies, masses, inertias, inverse weights, contacts and accelerations of random robots agree
with MuJoCo's own reading of the file, whether links are fused (by default) or kept.
"""

from __future__ import annotations

from argparse import ArgumentParser
from pathlib import Path
from random import Random

import mujoco
import numpy as np
import peers
import pytest

import stepcore as sc
from stepcore.cli.arguments import add_file, model_of

KINDS = ("fixed", "fixed", "revolute", "continuous", "prismatic")
KEPT = '<mujoco><compiler fusestatic="false"/></mujoco>'


class Maker:
    """Draws one robot from `chance`."""

    def __init__(self, chance: Random) -> None:
        self.chance = chance

    def numbers(self, count: int = 3, low: float = -0.5, high: float = 0.5) -> str:
        return " ".join(f"{self.chance.uniform(low, high):.4f}" for _ in range(count))

    def origin(self) -> str:
        return f'<origin xyz="{self.numbers()}" rpy="{self.numbers(3, -3, 3)}"/>'

    def inertial(self) -> str:
        own = " ".join(
            f'{axis}="{self.chance.uniform(0.1, 0.15):.4f}"' for axis in ("ixx", "iyy", "izz")
        )
        mass = self.chance.uniform(0.3, 3)
        return (
            f'<inertial>{self.origin()}<mass value="{mass:.3f}"/>'
            f'<inertia {own} ixy="0.01" ixz="-0.02" iyz="0.005"/></inertial>'
        )

    def link(self, name: str) -> str:
        ball = f'<sphere radius="{self.chance.uniform(0.05, 0.2):.3f}"/>'
        collision = f"<collision>{self.origin()}<geometry>{ball}</geometry></collision>"
        inside = self.chance.choice((self.inertial(), self.inertial() + collision, collision, ""))
        return f'<link name="{name}">{inside}</link>'

    def joint(self, kind: str, child: int) -> str:
        limit = '<limit lower="-1" upper="1" effort="9"/>' if kind != "continuous" else ""
        parent = self.chance.randrange(max(0, child - 3), child)
        return (
            f'<joint name="j{child}" type="{kind}"><parent link="l{parent}"/>'
            f'<child link="l{child}"/>{self.origin()}<axis xyz="{self.numbers(3, 0.1, 1)}"/>'
            f"{limit if kind != 'fixed' else ''}</joint>"
        )

    def robot(self, extension: str) -> str:
        box = '<origin xyz="0 0 -1"/><geometry><box size="9 9 2"/></geometry>'
        parts = [f'<link name="l0"><collision>{box}</collision></link>']
        for child in range(1, self.chance.randrange(4, 12)):
            kind = self.chance.choice(KINDS)
            # What a joint moves has mass.
            heavy = f'<link name="l{child}">{self.inertial()}</link>'
            inside = self.link(f"l{child}") if kind == "fixed" else heavy
            parts += [inside, self.joint(kind, child)]
        return f'<robot name="r">{extension}{"".join(parts)}</robot>'


@pytest.mark.parametrize("extension", ["", KEPT], ids=["fused", "kept"])
@pytest.mark.parametrize("seed", range(30))
def test_random_robots_are_mujocos(seed: int, extension: str) -> None:
    text = Maker(Random(seed)).robot(extension)
    theirs = peers.strict(mujoco.MjModel.from_xml_string(text))
    sim = sc.Sim(sc.loads(text), **peers.EXACT)
    ours, data = sim.model, mujoco.MjData(theirs)
    assert list(ours.body_names) == [theirs.body(i).name for i in range(theirs.nbody)]
    for name in ("body_mass", "body_invweight0", "dof_invweight0"):
        np.testing.assert_allclose(
            getattr(ours, name), getattr(theirs, name), rtol=1e-9, atol=1e-12
        )
    rng = np.random.default_rng(seed)
    for _ in range(3):
        data.qpos[:] = sim.qpos[:] = rng.normal(size=theirs.nq)
        data.qvel[:] = sim.qvel[:] = rng.normal(size=theirs.nv)
        mujoco.mj_forward(theirs, data)
        sim.forward()
        near = sim.contacts["dist"] < 0
        np.testing.assert_allclose(
            np.sort(sim.contacts["dist"][near]),
            np.sort(data.contact.dist[data.contact.dist < 0]),
            atol=1e-12,
        )
        np.testing.assert_allclose(sim.mass_matrix(), peers.mass_matrix(theirs, data), atol=1e-9)
        np.testing.assert_allclose(
            sim.qacc, data.qacc, rtol=1e-7, atol=1e-7 * np.abs(data.qacc).max(initial=1.0)
        )


ARM = """<robot name="arm"><link name="base"/><link name="upper">
  <inertial><mass value="2"/><inertia ixx=".1" iyy=".1" izz=".1" ixy="0" ixz="0" iyz="0"/>
  </inertial></link><link name="flange"/><link name="tool0">
  <inertial><mass value="1"/><inertia ixx=".1" iyy=".1" izz=".1" ixy="0" ixz="0" iyz="0"/>
  </inertial></link>
  <joint name="j" type="continuous"><parent link="base"/><child link="upper"/></joint>
  <joint name="k" type="fixed"><parent link="upper"/><child link="flange"/></joint>
  <joint name="m" type="fixed"><parent link="flange"/><child link="tool0"/></joint></robot>"""


def test_a_fused_link_is_named_with_what_it_is_part_of() -> None:
    scene = sc.loads(ARM)
    assert [body.name for body in scene.bodies] == ["world", "upper"]
    assert scene.fused == {"base": "world", "flange": "upper", "tool0": "upper"}
    said = 'named "tool0": nothing moves it against body "upper", of which it is a part'
    model = scene.compile()
    asks = [
        lambda: scene.body("tool0"),
        lambda: scene.add_site("tool0", name="tip"),
        lambda: scene.add_sensor("framepos", object="tool0", objtype="body"),
        lambda: model.index("body", "tool0"),
        lambda: sc.Sim(model).body("tool0"),
    ]
    for ask in asks:
        with pytest.raises(ValueError, match=said) as caught:
            ask()
        assert "load(..., fuse=False) keeps it" in str(caught.value)
    assert any("base, flange, tool0" in note and "fuse=False" in note for note in scene.notes)


def test_links_are_kept_where_that_is_asked_for(tmp_path: Path) -> None:
    """By `load`, by the file and on the command line; the word of `load` counts."""
    file = tmp_path / "arm.urdf"
    file.write_text(ARM)
    for scene in (sc.load(file, fuse=False), sc.loads(ARM.replace("<link", KEPT + "<link", 1))):
        assert [body.name for body in scene.bodies[1:]] == ["base", "upper", "flange", "tool0"]
        assert scene.fused == {} and scene.body("tool0").mass == 1.0
        scene.add_geom("base", "sphere", 0.1)
        scene.add_joint("base", "free")
        assert scene.compile().nv == 7
    fused = sc.loads(ARM.replace("<link", KEPT + "<link", 1), fuse=True)
    assert len(fused.bodies) == 2 and fused.compile().body_mass[1] == 3.0
    parser = ArgumentParser()
    add_file(parser)
    for option, bodies in ([], 2), (["--no-fuse"], 5):
        assert model_of(parser.parse_args([str(file), *option])).nbody == bodies
    with pytest.raises(ValueError, match="fuse = 1: must be True or False"):
        sc.load(file, fuse=1)


def test_mjcf_is_fused_where_that_is_asked_for() -> None:
    text = """<mujoco><worldbody><body name="arm"><joint/><geom size=".1"/>
      <body name="hand" pos="1 0 0"><geom size=".1"/></body></body></worldbody></mujoco>"""
    assert len(sc.loads(text).bodies) == 3
    scene = sc.loads(text, fuse=True)
    assert scene.fused == {"hand": "arm"} and scene.geoms[1].pos == (1.0, 0.0, 0.0)


@pytest.mark.parametrize("mass", ["0", "1e-16", "1e-14"])
def test_a_fused_link_without_mass_adds_no_inertia(mass: str) -> None:
    """The feet of bolt.urdf (example-robot-data) have none; below mjMINVAL MuJoCo drops theirs."""
    inertia = '<inertia ixx=".1" iyy=".1" izz=".1" ixy="0" ixz="0" iyz="0"/>'
    text = '<robot name="r"><link name="base"/>' + "".join(
        f'<link name="{name}"><inertial><mass value="{heavy}"/>{inertia}</inertial></link>'
        f'<joint name="{name}" type="{kind}"><origin xyz="1 0 0"/><axis xyz="0 1 0"/>'
        f'<parent link="{parent}"/><child link="{name}"/></joint>'
        for name, heavy, kind, parent in (
            ("leg", "1", "continuous", "base"),
            ("foot", mass, "fixed", "leg"),
        )
    )
    theirs = mujoco.MjModel.from_xml_string(text + "</robot>")
    model = sc.loads(text + "</robot>").compile()
    assert np.diag(model.body_inertia[1]) == pytest.approx(theirs.body_inertia[1], rel=1e-12)
