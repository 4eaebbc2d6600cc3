"""MJCF becomes the scene that MuJoCo compiles: every field compared with its MjModel.

The law: a field read from a file differs from MuJoCo's compiled one by rounding at most (1e-14
relative); names, types, indices and switches are equal.
"""

from pathlib import Path
from typing import Any

import mujoco
import numpy as np
import pytest

from stepcore import load, loads
from stepcore.loading import find_asset
from stepcore.mjcf.nodes import MJCFError
from stepcore.scene.scene import Scene

MODELS = (
    *("inverted_pendulum", "inverted_double_pendulum", "reacher", "hopper", "walker2d"),
    *("half_cheetah", "ant"),
)
GEOMS = {0: "plane", 2: "sphere", 3: "capsule", 4: "ellipsoid", 5: "cylinder", 6: "box"}
JOINTS = ("free", "ball", "slide", "hinge")
USED_SIZES = {"sphere": 1, "capsule": 2, "cylinder": 2}
FLAGS = {
    **{name: f"mjDSBL_{name.upper()}" for name in ("constraint", "equality", "frictionloss")},
    **{name: f"mjDSBL_{name.upper()}" for name in ("limit", "contact", "spring", "damper")},
    **{name: f"mjDSBL_{name.upper()}" for name in ("gravity", "clampctrl", "actuation")},
    **{name: f"mjDSBL_{name.upper()}" for name in ("filterparent", "eulerdamp")},
}


def asset(model: str) -> Path:
    return find_asset("gymnasium", model)


def close(ours: Any, theirs: Any, what: str) -> None:
    np.testing.assert_allclose(ours, theirs, rtol=1e-14, atol=1e-15, err_msg=what)


def assert_same(scene: Scene, model: Any) -> None:
    """Every field of the scene against the compiled model."""
    plain = scene.to_dict()
    assert plain["name"] == model.names[: model.names.index(b"\0")].decode() or not scene.name
    same_bodies(plain, model)
    same_joints(plain, model)
    same_geoms(plain, model)
    assert len(plain["sites"]) == model.nsite
    for i, site in enumerate(plain["sites"]):
        assert (site["name"], site["body"]) == (model.site(i).name, model.site_bodyid[i])
        close(site["pos"], model.site_pos[i], "site pos")
        close(site["quat"], model.site_quat[i], "site quat")
    same_rest(plain, model)
    same_options(scene, plain, model)


def same_bodies(plain: dict, model: Any) -> None:
    assert len(plain["bodies"]) == model.nbody
    for i, body in enumerate(plain["bodies"]):
        assert (body["name"], body["parent"]) == (model.body(i).name, model.body_parentid[i])
        close(body["pos"], model.body_pos[i], "body pos")
        close(body["quat"], model.body_quat[i], "body quat")
        given = body["inertial"]
        if given is not None and plain["mass_rules"]["from_geoms"] is None:
            close(given["mass"], model.body_mass[i], "mass")
            close(given["pos"], model.body_ipos[i], "ipos")
            xx, yy, zz, xy, xz, yz = given["inertia"]
            turn = np.zeros(9)
            mujoco.mju_quat2Mat(turn, model.body_iquat[i])
            turn = turn.reshape(3, 3)
            theirs = turn @ np.diag(model.body_inertia[i]) @ turn.T
            ours = np.array([[xx, xy, xz], [xy, yy, yz], [xz, yz, zz]])
            np.testing.assert_allclose(ours, theirs, rtol=1e-12, atol=1e-12)


def same_joints(plain: dict, model: Any) -> None:
    assert len(plain["joints"]) == model.njnt
    for i, joint in enumerate(plain["joints"]):
        assert joint["name"] == model.jnt(i).name
        assert joint["body"] == model.jnt_bodyid[i]
        assert joint["kind"] == JOINTS[model.jnt_type[i]]
        dof, q = model.jnt_dofadr[i], model.jnt_qposadr[i]
        scalar = joint["kind"] in ("hinge", "slide")
        assert (joint["range"] is not None) == (
            bool(model.jnt_limited[i]) and joint["kind"] != "free"
        )
        if joint["range"] is not None:
            close(joint["range"], model.jnt_range[i], "range")
        if joint["kind"] != "free":
            close(joint["pos"], model.jnt_pos[i], "joint pos")
        if scalar:
            close(joint["axis"], model.jnt_axis[i], "axis")
            close(joint["reference"], model.qpos0[q], "ref")
            close(joint["springref"], model.qpos_spring[q], "springref")
        close(joint["margin"], model.jnt_margin[i], "margin")
        close(joint["stiffness"][0], np.ravel(model.jnt_stiffness[i])[0], "stiffness")
        close(joint["damping"][0], np.ravel(model.dof_damping[dof])[0], "damping")
        close(joint["armature"], model.dof_armature[dof], "armature")
        close(joint["frictionloss"], model.dof_frictionloss[dof], "frictionloss")
        close(joint["limit"]["solref"], model.jnt_solref[i], "solreflimit")
        close(joint["limit"]["solimp"], model.jnt_solimp[i], "solimplimit")
        close(joint["friction"]["solref"], model.dof_solref[dof], "solreffriction")
        close(joint["friction"]["solimp"], model.dof_solimp[dof], "solimpfriction")


def same_geoms(plain: dict, model: Any) -> None:
    # A mesh is not in the scene; the rest is, in MuJoCo's order.
    theirs = [i for i in range(model.ngeom) if model.geom_type[i] in GEOMS]
    assert len(plain["geoms"]) == len(theirs)
    for geom, i in zip(plain["geoms"], theirs, strict=True):
        assert geom["name"] == model.geom(i).name
        assert geom["kind"] == GEOMS[model.geom_type[i]]
        ints = {"body": "bodyid", "condim": "condim", "priority": "priority", "group": "group"}
        for ours, name in ints.items():
            assert geom[ours] == getattr(model, f"geom_{name}")[i], ours
        assert geom["contype"] == int(model.geom_contype[i]) % 2**32
        assert geom["conaffinity"] == int(model.geom_conaffinity[i]) % 2**32
        used = USED_SIZES.get(geom["kind"], 3)
        close(geom["size"][:used], model.geom_size[i][:used], "size")
        for field in ("pos", "quat", "friction", "margin", "gap", "solmix"):
            close(geom[field], getattr(model, f"geom_{field}")[i], field)
        close(geom["soft"]["solref"], model.geom_solref[i], "solref")
        close(geom["soft"]["solimp"], model.geom_solimp[i], "solimp")


def same_rest(plain: dict, model: Any) -> None:
    assert len(plain["actuators"]) == model.nu
    for i, actuator in enumerate(plain["actuators"]):
        assert actuator["name"] == model.actuator(i).name
        assert next(iter(actuator["target"].values())) == model.actuator_trnid[i, 0]
        close(actuator["gear"], model.actuator_gear[i], "gear")
        for field in ("ctrl", "force"):
            limited = bool(getattr(model, f"actuator_{field}limited")[i])
            assert (actuator[f"{field}range"] is not None) == limited
            if limited:
                theirs = getattr(model, f"actuator_{field}range")[i]
                close(actuator[f"{field}range"], theirs, field)
    assert len(plain["equalities"]) == model.neq
    for i, equality in enumerate(plain["equalities"]):
        assert equality["name"] == model.equality(i).name
        assert (equality["first"], equality["second"]) == _tied(model, i)
        assert equality["active"] == bool(model.eq_active0[i])
        if equality["kind"] == "joint":
            close(equality["polycoef"], model.eq_data[i, :5], "polycoef")
        elif model.eq_objtype[i] == mujoco.mjtObj.mjOBJ_BODY:
            given = "frame1" if equality["kind"] == "connect" else "frame2"
            close(equality[given]["pos"], model.eq_data[i, :3], "anchor")
        close(equality["soft"]["solref"], model.eq_solref[i], "solref")
        close(equality["soft"]["solimp"], model.eq_solimp[i], "solimp")
    theirs = sorted((s >> 16, s & 0xFFFF) for s in map(int, model.exclude_signature))
    assert sorted(tuple(sorted(pair)) for pair in plain["excludes"]) == theirs
    assert len(plain["keys"]) == model.nkey
    for i, key in enumerate(plain["keys"]):
        assert (key["name"], key["time"]) == (model.key(i).name, model.key_time[i])
        defaults = {"qpos": model.qpos0, "qvel": np.zeros(model.nv), "ctrl": np.zeros(model.nu)}
        for field, default in defaults.items():
            ours = default if key[field] is None else key[field]
            close(ours, getattr(model, f"key_{field}")[i], field)


def _tied(model: Any, equality: int) -> tuple[int, int | None]:
    """The two bodies or joints of an equality of MuJoCo's."""
    ends = [int(model.eq_obj1id[equality]), int(model.eq_obj2id[equality])]
    if model.eq_objtype[equality] == mujoco.mjtObj.mjOBJ_SITE:
        ends = [int(model.site_bodyid[site]) for site in ends]
    return ends[0], None if ends[1] < 0 else ends[1]


def same_options(scene: Scene, plain: dict, model: Any) -> None:
    close(plain["gravity"], model.opt.gravity, "gravity")
    bits = mujoco.mjtDisableBit
    for feature, bit in FLAGS.items():
        disabled = bool(model.opt.disableflags & getattr(bits, bit))
        assert plain["features"][feature] == (not disabled), feature
    options = scene.options
    assert options.get("dt", 0.002) == model.opt.timestep
    assert options.get("impratio", 1.0) == model.opt.impratio
    assert options.get("sweeps", 100) == model.opt.iterations
    assert options.get("cone", "pyramidal") == ("pyramidal", "elliptic")[model.opt.cone]
    integrators = {0: "euler", 1: "rk4", 2: "implicit", 3: "implicitfast", 4: "discrete"}
    assert options.get("integrator", "euler") == integrators[model.opt.integrator]
    assert options.get("solver", "newton") == ("pgs", "newton", "newton")[model.opt.solver]
    warm = not model.opt.disableflags & bits.mjDSBL_WARMSTART
    safe = not model.opt.disableflags & bits.mjDSBL_REFSAFE
    assert (options.get("warm_start", True), options.get("refsafe", True)) == (warm, safe)


@pytest.mark.parametrize("name", MODELS)
def test_real_models_are_what_mujoco_compiles(name: str) -> None:
    path = asset(name)
    assert_same(load(path), mujoco.MjModel.from_xml_path(str(path)))


DEFAULTS = """
<default>
  <default class="inner"><geom gap=".2" friction="2 3"/><joint damping="7"/></default>
  <geom margin=".1" friction=".7 .1 .1" solref=".05" solimp=".8 .9" euler="0 0 90"/>
  <joint armature=".3" solreflimit="-100 -5"/>
  <general gear="3 4" ctrlrange="-2 2"/>
  <equality solref=".1 3" solimp=".1"/>
  <site pos="1 2 3"/>
</default>"""

WORLDS = {
    "defaults": f"""<mujoco>{DEFAULTS}
      <default><geom margin=".5" /></default>
      <worldbody>
        <geom name="a" size="1" friction=".9"/>
        <body name="b" childclass="inner">
          <joint name="j"/><joint name="k" class="main" axis="1 1 0"/>
          <geom name="c" size="1" quat="0 3 0 4"/><geom name="d" class="main" size="1"/>
          <site name="s"/>
          <body name="e"><joint type="slide" damping="1"/><geom size="1" friction="4 5 6"/>
            <body name="f" childclass="main"><joint/><geom size="1"/></body></body>
        </body>
      </worldbody>
      <equality><connect name="c" body1="b" anchor="1 2 3" solref=".5"/>
        <connect body1="e" body2="b" anchor="0 0 0" active="false"/></equality>
      <actuator><motor joint="j" gear="5"/><motor joint="k" ctrllimited="false"/>
        <motor name="m" jointinparent="j" ctrlrange="0 1" forcerange="-3 1"/></actuator>
      <contact><exclude body1="b" body2="e"/><exclude body1="f" body2="world"/></contact>
    </mujoco>""",
    "poses": """<mujoco model="poses"><compiler eulerseq="zYx" autolimits="false"/>
      <worldbody>
        <geom size="1" axisangle="1 2 3 40"/><geom size="1" xyaxes="1 1 0 0 2 1"/>
        <geom size="1" zaxis="0 0 -2"/><geom size="1" zaxis="1 2 3"/>
        <geom size="1" euler="10 20 30"/><geom size="1" xyaxes="-1 0 0 0 1 0"/>
        <geom size="1" xyaxes="-1 .1 0 0 -1 .1"/><geom size="1" xyaxes=".1 -1 .2 -1 0 .3"/>
        <geom type="capsule" size=".1" fromto="0 0 0 1 2 3"/>
        <geom type="box" size=".1" fromto="1 0 0 -1 0 0"/>
        <geom type="cylinder" size=".1 .2 .3" fromto="0 0 0 0 0 5"/>
        <geom type="ellipsoid" size=".1" fromto="0 0 5 0 1 -3"/>
        <site type="capsule" size=".1" fromto="0 0 5 0 1 -3"/>
        <body pos="1 2 3" euler="-10 400 3">
          <joint range="-1 90" limited="true" ref="30" springref="-20" margin=".1"/>
          <joint type="slide" range="-1 90" limited="true" ref="30" springref="-20"/>
          <joint axis="1 2 3" limited="false" range="3 4"/>
          <inertial pos="1 2 3" mass="2" diaginertia="1 2 2.5" euler="10 20 30"/>
          <body><joint type="ball" limited="true"/><geom size=".1"/></body>
          <body><joint type="ball" range="0 60" limited="true" ref="4" damping="2"/>
            <inertial pos="0 0 1" mass="1" fullinertia="3 4 5 .1 .2 .3"/></body>
        </body>
      </worldbody></mujoco>""",
    "radians and frames": """<mujoco><compiler angle="radian"/><worldbody>
        <geom name="first" size="1"/>
        <frame pos="1 0 0" euler="0 0 1.5" childclass="soft"><geom name="x" size="1" pos="1 0 0"/>
          <body name="b1" pos="0 1 0"><freejoint/><geom size="1"/>
            <frame pos="0 0 1"><geom type="capsule" size="1" fromto="0 0 0 1 1 1"/></frame></body>
          <frame pos="0 1 0" axisangle="1 0 0 1"><site name="s" pos="0 1 0"/>
            <body name="b2" euler=".1 .2 .3"><frame pos="1 0 0" euler="0 0 .5">
              <joint pos="0 1 0" axis="1 0 0" range="-1 1" ref=".5"/>
              <inertial pos="0 0 1" mass="1" diaginertia="1 2 2.5" euler=".1 .2 .3"/></frame>
            </body></frame>
        </frame>
        <geom name="last" size="1"/><body name="b3"/>
      </worldbody><default><default class="soft"><geom solref=".3"/></default></default>
      <size nkey="4"/><keyframe><key name="home" time="2" qpos="1 2 3 2 0 0 0"/>
        <key qvel="1 2" qpos="0 0 0 0 0 0 0 .7"/></keyframe></mujoco>""",
    "options": """<mujoco><option timestep=".1" gravity="1 2 3" solver="PGS" iterations="7"
        integrator="implicitfast" cone="elliptic" impratio="10" noslip_iterations="0"
        density="0" wind="1 2 3" magnetic="1 2 3" jacobian="dense">
        <flag constraint="disable" limit="disable" warmstart="disable" refsafe="disable"
          gravity="disable" filterparent="disable" eulerdamp="disable" energy="enable"/></option>
      <option timestep=".2"><flag limit="enable" contact="disable"/></option>
      <worldbody/></mujoco>""",
    "what only draws": """<mujoco><asset>
        <mesh file="never/read.stl"/><mesh name="tetra" vertex="0 0 0 1 0 0 0 1 0 0 0 1"/>
        <material name="red"/></asset>
      <visual><map znear=".1"/></visual><statistic extent="2"/>
      <worldbody><light/><camera name="eye"/>
        <body name="b"><joint name="j"/><geom size="1" material="red"/>
          <geom type="mesh" mesh="tetra" contype="0" conaffinity="0" mass="0"/>
          <geom name="decal" size="1" contype="0" conaffinity="0" density="0"/></body>
        <body name="static"><geom type="mesh" mesh="tetra" contype="0" conaffinity="0"
          mass="0"/></body>
      </worldbody>
      <sensor><jointpos joint="j"/></sensor><custom><numeric name="n" data="1"/></custom>
      </mujoco>""",
}


@pytest.mark.parametrize("name", WORLDS)
def test_every_way_to_say_it(name: str) -> None:
    text = WORLDS[name]
    # MuJoCo would read the mesh file, which does not exist.
    theirs = text.replace('<mesh file="never/read.stl"/>', "")
    assert_same(loads(text), mujoco.MjModel.from_xml_string(theirs))


def test_masses_come_with_their_rules() -> None:
    text = """<mujoco><compiler inertiafromgeom="true" inertiagrouprange="1 2" boundmass=".1"
      boundinertia=".2" balanceinertia="true" settotalmass="14" fitaabb="true"/><worldbody>
      <body><joint/><geom size="1" mass="3" group="1" shellinertia="true"/>
        <geom size="1" density="7"/></body></worldbody></mujoco>"""
    plain = loads(text).to_dict()
    assert plain["mass_rules"] == {
        "from_geoms": True,
        "group_range": [1, 2],
        "bound_mass": 0.1,
        "bound_inertia": 0.2,
        "balance_inertia": True,
        "total_mass": 14,
        "fit_aabb": True,
    }
    first, second = plain["geoms"]
    assert (first["mass"], first["shell_inertia"], first["density"]) == (3, True, 1000)
    assert (second["mass"], second["density"]) == (None, 7)


def test_what_is_ignored_or_translated_is_listed() -> None:
    scene = loads(WORLDS["what only draws"], name="m.xml")
    assert scene.ignored == [
        "m.xml:2: <mesh> (only draws)",
        'm.xml:2: <mesh> "tetra" (only draws)',
        'm.xml:3: <material> "red" (only draws)',
        "m.xml:4: <visual> (only draws)",
        "m.xml:4: <statistic> (only draws)",
        "m.xml:5: <light> (only draws)",
        'm.xml:5: <camera> "eye" (only draws)',
        "m.xml:7: <geom> (only draws: no collisions, no mass)",
        'm.xml:8: <geom> "decal" (only draws: no collisions, no mass)',
        "m.xml:9: <geom> (only draws: no collisions, no mass)",
        'm.xml:12: <numeric> "n" (data that the simulation does not use)',
    ]
    flag = '<flag midphase="disable"/>'
    text = f'<mujoco>\n<option solver="CG" ls_tolerance="1">{flag}</option></mujoco>'
    assert loads(text, name="m.xml").notes == [
        "m.xml:2: solver CG -> newton (the same minimum)",
        "m.xml:2: ls_tolerance is ignored: the line search is exact",
        'm.xml:2: flag midphase="disable" has no effect: it decides how pairs are found, not which',
    ]
    text = '<mujoco><worldbody><body><joint range="2 1"/></body></worldbody></mujoco>'
    assert loads(text).notes == ["<string>:1: range = 2 1 is empty: no limit"]


def test_includes_are_put_in_place(tmp_path: Path) -> None:
    (tmp_path / "sub").mkdir()
    (tmp_path / "main.xml").write_text(
        '<mujoco><include file="sub/parts.xml"/><worldbody><body><include file="geom.xml"/>'
        "</body></worldbody></mujoco>"
    )
    # Looked for beside the main file first, then beside the file that includes it.
    (tmp_path / "sub/parts.xml").write_text('<mujoco><include file="dt.xml"/></mujoco>')
    (tmp_path / "sub/dt.xml").write_text('<mujoco><option timestep=".5"/></mujoco>')
    (tmp_path / "geom.xml").write_text('<x><joint/><geom size="1"/><geom size="2"/></x>')
    path = tmp_path / "main.xml"
    scene = load(path)
    assert scene.options == {"dt": 0.5}
    assert_same(scene, mujoco.MjModel.from_xml_path(str(path)))
    assert loads(path.read_text(), base=tmp_path) == scene
    with pytest.raises(MJCFError, match="needs loads"):
        loads(path.read_text())


def test_a_negative_mask_is_its_32_bits() -> None:
    """contype = -1 means all 32 bits."""
    scene = loads('<mujoco><worldbody><geom size="1" contype="-1"/></worldbody></mujoco>')
    assert scene.geoms[0].contype == 2**32 - 1
