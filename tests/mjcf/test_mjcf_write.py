"""A scene written as MJCF is read back as the same scene, and is MuJoCo's same model.

The laws: `loads(scene.to_mjcf()) == scene`, settings and every bit of every number included;
MuJoCo compiles the written text and the original to the same masses, inertias and dofs (1e-12).
"""

import random
from pathlib import Path
from typing import Any

import mujoco
import numpy as np
import pytest
from zoo import ZOO

from stepcore import Scene, Settings, load, loads
from stepcore.loading import find_asset
from stepcore.mjcf.nodes import MJCFError

GYM = (
    *("inverted_pendulum", "inverted_double_pendulum", "reacher", "hopper", "walker2d"),
    *("half_cheetah", "ant"),
)
LESSON = ("spring", "drop", "stack", "grasp")
# What two compiled models have in common if they move alike.
SAME = (
    *("body_mass", "body_ipos", "body_pos", "body_quat", "dof_armature", "dof_damping"),
    *("dof_frictionloss", "dof_invweight0", "body_invweight0", "jnt_stiffness", "jnt_range"),
    *("jnt_axis", "jnt_pos", "jnt_solref", "jnt_solimp", "qpos0", "qpos_spring", "geom_friction"),
    *("geom_solref", "geom_solimp", "geom_margin", "geom_condim", "geom_contype"),
    *("geom_conaffinity", "eq_data", "eq_solref", "actuator_gear", "actuator_ctrlrange"),
    *("tendon_length0", "tendon_lengthspring", "tendon_invweight0", "tendon_range"),
    *("tendon_margin", "tendon_stiffness", "tendon_stiffnesspoly", "tendon_damping"),
    *("tendon_dampingpoly", "tendon_armature", "tendon_frictionloss", "tendon_solref_lim"),
    *("tendon_solimp_lim", "tendon_solref_fri", "tendon_solimp_fri", "tendon_actfrcrange"),
    *("actuator_forcerange", "actuator_gainprm", "actuator_biasprm", "key_qpos", "key_ctrl"),
)


def inertias(model: Any) -> np.ndarray:
    """Inertia of every body in its own axes, whatever principal axes were chosen."""
    turn = np.empty((model.nbody, 9))
    for i, quat in enumerate(model.body_iquat):
        mujoco.mju_quat2Mat(turn[i], quat)
    turn = turn.reshape(-1, 3, 3)
    return turn @ (model.body_inertia[:, :, None] * np.swapaxes(turn, 1, 2))


def assert_same_model(text: str, original: Any) -> None:
    model = mujoco.MjModel.from_xml_string(text)
    kept = original.ngeom == model.ngeom
    for name in SAME:
        if kept or not name.startswith("geom_"):
            ours, theirs = getattr(model, name), getattr(original, name)
            np.testing.assert_allclose(ours, theirs, rtol=1e-12, atol=1e-12, err_msg=name)
    scale = np.abs(original.body_inertia).max(initial=1e-3)
    np.testing.assert_allclose(inertias(model), inertias(original), rtol=1e-12, atol=1e-12 * scale)
    for name in ("timestep", "integrator", "solver", "iterations", "cone", "impratio"):
        assert getattr(model.opt, name) == getattr(original.opt, name), name
    np.testing.assert_array_equal(model.opt.gravity, original.opt.gravity)


@pytest.mark.parametrize("name", ZOO)
def test_the_zoo_comes_back(name: str) -> None:
    scene = loads(ZOO[name].text)
    text = scene.to_mjcf()
    assert loads(text) == scene
    assert loads(text).to_mjcf() == text
    assert_same_model(text, mujoco.MjModel.from_xml_string(ZOO[name].text))


def test_principal_moments_come_back() -> None:
    """One of these inertias is not what the moments that are computed back from it turn into, nor
    their neighbours; the short numbers of the file are."""
    chance = random.Random(2)
    for _ in range(300):
        axis = " ".join(f"{chance.uniform(-1, 1):.4f}" for _ in range(3))
        inertial = f'<inertial mass="1" pos="0 0 0" zaxis="{axis}" diaginertia=".02 .03 .04"/>'
        scene = loads(
            f"<mujoco><worldbody><body><freejoint/>{inertial}</body></worldbody></mujoco>"
        )
        assert loads(scene.to_mjcf()) == scene


@pytest.mark.parametrize("name", GYM)
def test_models_that_people_know_come_back(name: str) -> None:
    path = find_asset("gymnasium", name)
    scene = load(path)
    assert loads(scene.to_mjcf()) == scene
    assert_same_model(scene.to_mjcf(), mujoco.MjModel.from_xml_path(str(path)))


@pytest.mark.parametrize("name", LESSON)
def test_scenes_under_the_lessons_laws_come_back(name: str) -> None:
    scene = load(f"lesson:{name}")
    again = loads(scene.to_mjcf())
    assert again == scene
    assert again.settings == scene.settings
    mujoco.MjModel.from_xml_string(scene.to_mjcf())


def drawn(seed: int) -> Scene:
    """A scene with every kind of element, its numbers drawn with all their digits."""
    rng = random.Random(seed)
    normal = rng.gauss

    def vec(n: int, scale: float = 1.0) -> list[float]:
        return [normal(0, scale) for _ in range(n)]

    def named(word: str) -> str:
        return rng.choice(["", f'{word} & <"{rng.random()}">\n\té', f"{word}{rng.random()}"])

    scene = Scene(gravity=vec(3), name=named("scene"))
    for i in range(6):
        parent = rng.choice(scene.bodies)
        body = scene.add_body(named("body"), parent, vec(3), vec(4))
        kinds = ["hinge", "slide", "ball"] + ["free"] * (parent is scene.world)
        kind = rng.choice(kinds)
        limits = None if kind == "free" else (0.0 if kind == "ball" else -rng.random(), 1 / 3)
        scene.add_joint(
            *(body, kind),
            **{"name": named("joint"), "pos": vec(3), "axis": vec(3), "range": limits},
            **{"ref": normal(0, 1), "springref": normal(0, 1), "stiffness": rng.random()},
            **{"damping": rng.random(), "armature": rng.random(), "frictionloss": rng.random()},
            **{"solreflimit": (-1 / 3, -0.1), "margin": rng.random(), "solimpfriction": (0.1, 0.7)},
        )
        if i % 2:
            body.mass, body.ipos = rng.random() + 1, tuple(vec(3))
            body.inertia = (2.1, 2.2, 2.3, *vec(3, 0.1)) if i == 1 else (2.1, 2.2, 2.3, 0, 0, 0)
        for kind in ("sphere", "capsule", "box", "ellipsoid", "cylinder"):
            scene.add_geom(
                *(body, kind, [rng.random() + 0.1 for _ in range(3)]),
                **{"name": named(kind), "pos": vec(3), "quat": vec(4), "group": i % 3},
                **{"mass": rng.choice([None, 0.7]), "density": 1e3 * rng.random()},
                **{"contype": rng.choice([0, 2**32 - 1, 2**31]), "conaffinity": 0, "condim": 1},
                **{"priority": 2, "friction": (rng.random(), 1e-3), "solref": (1 / 3, 1e-5)},
                **{"gap": 1e-17, "solmix": 3e-9, "shellinertia": i == 2},
            )
        scene.add_site(body, name=named("site"), pos=vec(3), quat=vec(4))
    scene.add_geom("world", "plane", contype=0, conaffinity=0)
    moving = [joint.body for joint in scene.joints]
    scene.add_equality("connect", moving[0], "world", vec(3), active=False, solimp=(0.2, 0.3))
    scene.add_equality("connect", moving[1], moving[2], vec(3), name=named("connect"))
    scene.exclude(moving[3], scene.world)
    for joint in scene.joints[:3]:
        scene.add_actuator(joint, name=named("motor"), gear=vec(6), ctrlrange=(-1 / 3, 2))
    servos: list[dict[str, Any]] = [
        *({"type": "position", "kp": rng.random()}, {"type": "position", "kv": 1 / 3}),
        *({"type": "position", "kp": 2.0, "dampratio": 0.7}, {"type": "velocity", "kv": 1e-3}),
        *({"type": "position"}, {"type": "velocity"}, {"type": "general"}),
        {"type": "general", "gainprm": -1 / 3, "biasprm": vec(3)},
        {"type": "general", "gainprm": 3.0, "biasprm": (0.1, -3.0, 0.5)},
    ]
    for servo in servos:
        joint = scene.add_joint(scene.add_body(named("servo")), rng.choice(["hinge", "slide"]))
        scene.add_geom(joint.body, "sphere", 0.1, contype=0, conaffinity=0)
        scene.add_actuator(joint, name=named("servo"), forcerange=(-1 / 3, 1), **servo)
    scene.add_key(named("key"), time=1 / 3, ctrl=vec(len(scene.actuators)))
    scene.mass_rules.boundmass = 1e-7
    scene.mass_rules.inertiafromgeom = rng.choice([None, False])
    scene.features.damper = False
    scene.features.limit = rng.random() < 0.5
    scene.options = {"dt": 1e-3 / 3, "precision": "f32", "sweeps": 2**32 - 1, "beta": 1 / 3}
    scene.options |= {"integrator": rng.choice(["midpoint", "rk4", "explicit", "euler"])}
    return scene


@pytest.mark.parametrize("seed", range(20))
def test_anything_a_scene_can_hold_comes_back(seed: int) -> None:
    scene = drawn(seed)
    again = loads(scene.to_mjcf())
    assert again == scene
    assert again.settings == scene.settings
    # Elements that others refer to had to be named in the file, and are unnamed again.
    assert [body.name for body in again.bodies].count("") == [
        body.name for body in scene.bodies
    ].count("")


def test_every_setting_comes_back() -> None:
    """One by one, away from its default."""
    other = {
        **{"dt": 0.1, "integrator": "semi-implicit", "solver": "pgs", "acceleration": "momentum"},
        **{"sweeps": 7, "tolerance": 1e-7, "warm_start": False, "precision": "f32", "beta": 0.3},
        **{"max_contacts": 9, "law": "penalty", "softness": 0.5, "restitution": 0.1, "slop": 1e-4},
        **{"penalty_stiffness": 1e3, "penalty_damping_ratio": 0.7, "cone": "elliptic"},
        **{"impratio": 3.0, "refsafe": False, "noslip_iterations": 5, "noslip_tolerance": 1e-4},
        **{"cost_tolerance": 1e-6},
    }
    for name, value in Settings().as_dict().items():
        changed = Settings(**{name: other.get(name, not value if value in (0, 1) else value)})
        scene = Scene().with_settings(changed)
        assert loads(scene.to_mjcf()).settings == changed, name


def test_what_only_draws_is_left_out_and_counted() -> None:
    text = '<mujoco><visual/><worldbody><light/><geom size="1"/></worldbody></mujoco>'
    written = loads(text).to_mjcf()
    assert "Left out: 2 elements" in written
    assert loads(written) == loads(text)
    assert loads(written).ignored == []


BAD = {
    "integrater=rk4": 'has an unknown name "integrater"; nearest: "integrator"',
    "integrator=rk5": "integrator = 'rk5'",
    "dt=-1": "dt = -1",
    "sweeps=1.5": "sweeps = 1.5",
    "dt": "must be name=value",
    "dt=1 dt=2": "has dt twice",
    "unnamed=body/nobody": 'no body is named "nobody"',
    "unnamed=light/x": 'unnamed=light/x: must be one of "geom/name", ',
    "law=lesson solver=newton": "'newton' with law 'lesson'",
}


@pytest.mark.parametrize("data", BAD)
def test_a_bad_word_in_the_text_is_an_error_with_its_line(data: str) -> None:
    text = f'<mujoco>\n<custom>\n<text name="stepcore" data="{data}"/></custom></mujoco>'
    with pytest.raises(MJCFError) as caught:
        loads(text, name="m.xml")
    assert str(caught.value).startswith("m.xml:3: ")
    assert BAD[data] in str(caught.value)


def test_a_second_text_is_an_error() -> None:
    one = '<custom><text name="stepcore" data="beta=.5"/></custom>'
    with pytest.raises(MJCFError, match=":1: a second"):
        loads(f"<mujoco>{one}{one}</mujoco>")


def test_what_no_file_can_say_is_refused() -> None:
    scene = Scene(name="bell \a")
    with pytest.raises(ValueError, match="XML does not allow this character"):
        scene.to_mjcf()
    scene = Scene()
    scene.world.mass = 1.0
    with pytest.raises(ValueError, match="no mass"):
        scene.to_mjcf()


# A file of the user's own: an include, comments, a mesh, the option in a form of its own.
OWN = """<?xml version="1.0"?>
<!-- my robot -->
<mujoco model = 'mine'>
  <include file="parts.xml"/>
  {option}
  <asset><mesh file="shell.stl"/></asset>
  <worldbody>
    <!-- the arm -->
    <body name="arm"><joint/><geom size=".1"/>
      <geom type="mesh" mesh="shell" contype="0" conaffinity="0" mass="0"/></body>
  </worldbody>
</mujoco>
"""
OPTIONS = {
    "none": "",
    "empty": "<option/>",
    "closed": "<option timestep = '0.01'  integrator=\"RK4\"  />",
    "with a flag": '<option timestep="0.01"><flag gravity="disable"/></option>',
    "open": '<option timestep="0.01"><!-- > --></option>',
    "two": '<option timestep="0.01"/><option timestep="0.02" cone="elliptic"/>',
    "in the text": '<custom><text name="stepcore" data="integrator=midpoint beta=.7"/></custom>',
}


@pytest.mark.parametrize("option", OPTIONS)
def test_a_file_keeps_its_own_text(tmp_path: Path, option: str) -> None:
    path = tmp_path / "mine.xml"
    path.write_text(OWN.format(option=OPTIONS[option]))
    (tmp_path / "parts.xml").write_text('<x><option impratio="2"/><default/></x>')
    scene = load(path)
    scene.save(tmp_path / "same.xml")
    assert (tmp_path / "same.xml").read_text() == path.read_text()
    for settings in (
        {"dt": 0.002},
        {"dt": 0.003, "integrator": "implicitfast", "warm_start": False, "solver": "pgs"},
        {"integrator": "midpoint", "precision": "f32", "impratio": 5.0},
        {"integrator": "euler", "beta": 0.2},
    ):
        better = scene.with_settings(settings)
        better.save(tmp_path / "better.xml")
        text = (tmp_path / "better.xml").read_text()
        assert load(tmp_path / "better.xml") == better
        assert "<!-- my robot -->" in text and 'file="shell.stl"' in text and "parts.xml" in text
        # Saving again changes nothing more.
        load(tmp_path / "better.xml").save(tmp_path / "again.xml")
        assert (tmp_path / "again.xml").read_text() == text


def test_elsewhere_a_text_that_names_files_is_written_whole(tmp_path: Path) -> None:
    path = tmp_path / "mine.xml"
    path.write_text(OWN.format(option=OPTIONS["closed"]))
    (tmp_path / "parts.xml").write_text('<x><default/><option impratio="2"/></x>')
    scene = load(path)
    (tmp_path / "far").mkdir()
    scene.save(tmp_path / "far/mine.xml")
    text = (tmp_path / "far/mine.xml").read_text()
    assert "parts.xml" not in text
    assert load(tmp_path / "far/mine.xml") == scene
    mujoco.MjModel.from_xml_path(str(tmp_path / "far/mine.xml"))


def test_a_changed_model_is_written_whole(tmp_path: Path) -> None:
    scene = loads("<mujoco><!-- mine --><worldbody><geom size='1'/></worldbody></mujoco>")
    scene.save(tmp_path / "a.xml")
    assert "mine" in (tmp_path / "a.xml").read_text()
    scene.geoms[0].size = 2.0
    scene.save(tmp_path / "a.xml")
    assert "mine" not in (tmp_path / "a.xml").read_text()
    assert load(tmp_path / "a.xml") == scene


def test_a_packages_model_keeps_its_text_and_gets_its_name(tmp_path: Path) -> None:
    scene = load("gymnasium:ant").with_settings(integrator="semi-implicit", sweeps=20)
    scene.save(tmp_path / "ant.xml")
    assert load(tmp_path / "ant.xml") == scene
    assert "<asset>" in (tmp_path / "ant.xml").read_text()
