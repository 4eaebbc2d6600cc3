"""Contact parameters as MuJoCo makes them: mixing, explicit pairs, the override, noslip."""

from __future__ import annotations

import mujoco
import numpy as np
import pytest
from covering import every_pair, every_value

import stepcore as sc

CONES = ("pyramidal", "elliptic")


def numbers(values) -> str:
    return " ".join(repr(float(x)) for x in np.atleast_1d(values))


def solref(rng) -> str:
    if rng.random() < 0.3:
        return numbers([-rng.uniform(500, 3000), -rng.uniform(5, 80)])
    return numbers([rng.uniform(0.005, 0.05), rng.uniform(0.4, 1.5)])


def solimp(rng) -> str:
    low, high = np.sort(rng.uniform(0.5, 0.97, 2))
    return numbers([low, high, rng.uniform(1e-4, 0.02), rng.uniform(0.2, 0.8), rng.uniform(1, 3)])


def geom_words(rng) -> str:
    return (
        f'condim="{rng.choice([1, 3, 4, 6])}" priority="{rng.integers(0, 2)}" '
        f'solref="{solref(rng)}" '
        f'solimp="{solimp(rng)}" solmix="{rng.choice([0, 0.3, 1, 2])}" '
        f'friction="{numbers(rng.uniform(0, 1.2, 3))}" '
        f'margin="{numbers(rng.uniform(0, 0.02))}" gap="{numbers(rng.uniform(0, 0.02))}"'
    )


def pair_words(rng) -> str:
    friction = numbers(rng.uniform(0, 1.2, 5))
    words = f'condim="{rng.choice([1, 3, 4, 6])}" friction="{friction}" '
    words += f'solref="{solref(rng)}" solimp="{solimp(rng)}" '
    words += f'margin="{numbers(rng.uniform(0, 0.02))}" gap="{numbers(rng.uniform(0, 0.02))}"'
    if rng.random() < 0.5:
        words += f' solreffriction="{solref(rng)}"'
    return words


def scene_text(seed: int, cone: str, option: str = "", extra: str = "", kin: bool = True) -> str:
    """A floor, a ball and a capsule on it, a ball on both, and one jointed to the capsule.

    kin: the last two can be an explicit pair.
    """
    rng = np.random.default_rng(seed)
    pairs = {
        ("floor", "ball"): 0.3,
        ("ball", "top"): 0.4,
        ("capsule", "top"): 0.4,
        ("capsule", "child"): 0.7 * kin,
        ("child", "floor"): 0.3,
    }
    explicit = "".join(
        f'<pair geom1="{a}" geom2="{b}" {pair_words(rng)}/>'
        if rng.random() < 0.5
        else f'<pair geom1="{b}" geom2="{a}" {pair_words(rng)}/>'
        for (a, b), share in pairs.items()
        if rng.random() < share
    )
    exclude = '<exclude body1="ball" body2="top"/>' if rng.random() < 0.3 else ""
    impratio = numbers(rng.choice([0.3, 1, 10]))
    return f"""<mujoco><option timestep="0.004" cone="{cone}" impratio="{impratio}" solver="Newton"
      tolerance="0" iterations="200" ls_iterations="200" {option}>{extra}</option><worldbody>
      <geom name="floor" type="plane" size="5 5 1" {geom_words(rng)}/>
      <body name="ball" pos="0 0 0.095"><freejoint/>
        <geom name="ball" size="0.1" mass="1" {geom_words(rng)}/></body>
      <body name="capsule" pos="0.21 0 0.098" quat="0.7 0.1 0.7 0"><freejoint/>
        <geom name="capsule" type="capsule" size="0.1 0.1" mass="2" {geom_words(rng)}/>
        <body name="child" pos="0 0.17 0"><joint axis="1 0 0"/>
          <geom name="child" size="0.1" mass="0.5" {geom_words(rng)}/></body></body>
      <body name="top" pos="0.1 0 0.255"><freejoint/>
        <geom name="top" size="0.09" mass="0.7" {geom_words(rng)}/></body>
      </worldbody><contact>{explicit}{exclude}</contact></mujoco>"""


def both(text: str, seed: int, **settings):
    """Our Sim and MuJoCo at one state of this model, in motion."""
    model = mujoco.MjModel.from_xml_string(text)
    data = mujoco.MjData(model)
    rng = np.random.default_rng(seed + 1000)
    data.qvel[:] = rng.normal(0, 0.3, model.nv)
    mujoco.mj_forward(model, data)
    sim = sc.Sim(sc.loads(text).compile(), sweeps=500, tolerance=1e-14, **settings)
    sim.qvel = data.qvel
    sim.forward()
    return sim, model, data


def assert_forces_are(sim, data, rel=1e-9) -> None:
    size = max(np.abs(data.qacc).max(), 1.0)
    assert sim.qacc == pytest.approx(data.qacc, rel=rel, abs=rel * size)
    size = max(np.abs(data.qfrc_constraint).max(), 1.0)
    assert sim.constraint_force == pytest.approx(data.qfrc_constraint, rel=rel, abs=rel * size)


@every_value(seed=range(40), cone=CONES)
def test_parameters_and_forces_are_mujocos(seed, cone):
    """Which contacts act, and every force, to 1e-9: mixed, explicit and excluded pairs."""
    sim, _, data = both(scene_text(seed, cone), seed)
    listed = [tuple(c.geom) for c in data.contact]
    assert listed
    assert [tuple(c) for c in sim.contacts[["geom1", "geom2"]]] == listed
    assert_forces_are(sim, data)


@every_pair(seed=range(10), cone=CONES)
def test_the_override_is_mujocos(seed, cone):
    """o_margin, o_solref, o_solimp and o_friction in place of all others, while the flag is on."""
    rng = np.random.default_rng(seed)
    option = (
        f'o_margin="0.015" o_solref="{solref(rng)}" o_solimp="{solimp(rng)}" '
        f'o_friction="{numbers(rng.uniform(0.1, 1, 5))}"'
    )
    on = '<flag override="enable"/>'
    for extra in ("", on):
        sim, _, data = both(scene_text(seed, cone, option, extra), seed)
        assert_forces_are(sim, data)


@every_pair(
    seed=range(10),
    cone=CONES,
    **{"iterations, tolerance": [(1, 0), (3, 0), (20, 0), (60, 1e-3), (60, 1e-6)]},
)
def test_noslip_is_mujocos(seed, cone, iterations, tolerance):
    """After the same number of sweeps over friction, given or as many as the tolerance asks.

    Without the pair between which a hinge lets nothing move along one tangent: there MuJoCo keeps
    the friction of the main solve (a determinant below 1e-10), and noslip here solves the rest.
    """
    option = f'noslip_iterations="{iterations}" noslip_tolerance="{tolerance}"'
    sim, _, data = both(scene_text(seed, cone, option, kin=False), seed)
    assert sim.settings.noslip_iterations == iterations
    assert sim.settings.noslip_tolerance == tolerance
    assert_forces_are(sim, data, rel=1e-8)
