"""`diagnose`: its advice is true, its face, the warning at load, the command."""

import json
import math
import warnings
from pathlib import Path

import pytest
import stiff

import stepcore as sc
from stepcore.cli import main
from stepcore.engine.linear_maps import INTEGRATORS

# Runs beyond their limits are what these tests make.
pytestmark = pytest.mark.filterwarnings("ignore::stepcore.EnergyWarning")


def diagnosed(scene, **options):
    options = {"horizon": 0.1, "threads": 1, "progress": False} | options
    return sc.diagnose(scene, **options)


# --- advice -------------------------------------------------------------------------------------


def test_advice_is_true():
    """Every value named is stable at 1.5 times the wanted dt on the real step, the margin of fixes,
    and 3 % less change is not."""
    scene = stiff.chain((50.0, 20.0, 4e4, 20.0), dt=1e-3, integrator="semi-implicit")
    d = diagnosed(scene, dt=5e-3)
    assert d.limit() < 5e-3
    met = {advice.what: advice for advice in d.advice if advice.met}
    assert {"stiffness", "armature", "integrator"} <= met.keys()
    value = met["stiffness"].values[0]
    assert value.owner == "spring of joint `joint2`" and value.before == (4e4,)
    model = scene.compile()
    changed = model.with_values({"joint/joint2/stiffness": value.after[0]})
    assert stiff.stays(changed, "semi-implicit", 7.4e-3)
    nearly = model.with_values({"joint/joint2/stiffness": 1.03 * value.after[0]})
    assert not stiff.stays(nearly, "semi-implicit", 7.5e-3)
    value = met["armature"].values[0]
    changed = model.with_values({"joint/joint2/armature": value.after[0]})
    assert stiff.stays(changed, "semi-implicit", 7.4e-3)
    assert not stiff.stays(
        model.with_values({"joint/joint2/armature": 0.95 * value.after[0]}), "semi-implicit", 7.5e-3
    )
    assert "Any one of these changes makes 5 ms stable with a margin of 1.5×" in d.text()


def test_two_stiff_springs_are_changed_together():
    scene = stiff.chain((4e5, 20.0, 4e4, 20.0), dt=8e-3, integrator="euler")
    d = diagnosed(scene)
    stiffness = next(a for a in d.advice if a.what == "stiffness")
    assert stiffness.met
    assert {value.owner for value in stiffness.values} == {
        "spring of joint `joint0`",
        "spring of joint `joint2`",
    }
    values = {f"joint/{v.owner.split('`')[1]}/stiffness": v.after[0] for v in stiffness.values}
    assert stiff.stays(scene.compile().with_values(values), "euler", 8e-3)


def test_a_scene_without_anything_stiff_says_so():
    d = diagnosed(stiff.slider(0.0, 0.0))
    assert all(math.isinf(d.limit(name)) for name in INTEGRATORS)
    answer = "No element limits dt below 10 ms under euler, judged over 100 ms of motion."
    assert d.sentences[0] == answer and len(d.sentences) == 2
    assert d.stiffest("euler") == ""


# --- the face -----------------------------------------------------------------------------------


def test_a_result_is_short_to_look_at_and_equals_itself_alone():
    d = diagnosed(stiff.slider(0.0, 0.0))
    assert repr(d) == f"<Diagnosis: {d.title}>"
    assert d == d and d != diagnosed(stiff.slider(0.0, 0.0))


def test_softened_elements_are_named_whole():
    """Six limits that act at the start, all of the default solref: four, and two more."""
    scene = stiff.chain((20.0,) * 6)
    for joint in scene.joints:
        joint.range = (0.1, 1.0)
        joint.name = f"a rather long name of {joint.name}"
    note = next(
        n
        for n in diagnosed(scene).notes
        if n.startswith("above dt 10 ms the setting refsafe (MuJoCo's) softens")
    )
    assert note.count("limit of joint `a rather long name of joint") == 4
    assert note.count("`") == 8 and " and 2 more; refsafe=False" in note


def test_it_prints_exports_and_plots(tmp_path):
    d = diagnosed(stiff.chain((50.0, 4000.0), dt=5e-3, integrator="semi-implicit"))
    for width in (60, 80, 160):
        assert all(len(line) <= width for line in d.text(width).splitlines() if "(not" not in line)
    data = d.to_dict()
    assert data["limits"]["semi-implicit"]["stiffest"] == "spring of joint `joint1`"
    assert data["limits"]["midpoint"]["held"] is None
    axes = d.plot(tmp_path / "bars.png").axes[0]
    assert (tmp_path / "bars.png").stat().st_size > 0
    assert axes.get_yticklabels()[0].get_text() == "semi-implicit"
    page = d.to_html(tmp_path / "page.html")
    assert page == (tmp_path / "page.html").read_text("utf-8") and "explodes" in page


@pytest.mark.parametrize(
    ("options", "text"),
    [
        ({"dt": 0}, "dt = 0: must be"),
        ({"horizon": -1}, "horizon = -1: must be"),
        ({"executor": 3}, "executor = 3: must be"),
        ({"key": "away"}, 'no key is named "away"'),
    ],
)
def test_bad_input_is_refused(options, text):
    with pytest.raises(ValueError, match=text):
        diagnosed(stiff.slider(1.0), **options)


def test_an_unknown_integrator_is_refused():
    with pytest.raises(ValueError, match=r"integrator = 'eulr'.*nearest: \"euler\""):
        diagnosed(stiff.slider(1.0)).limit("eulr")


def test_what_cannot_move_is_refused():
    with pytest.raises(ValueError, match="nothing in"):
        sc.diagnose(sc.Scene())


# --- at load ------------------------------------------------------------------------------------

KNEE = """<mujoco><option timestep="{dt}" integrator="{integrator}"/><worldbody><body>
<joint name="knee" type="slide" stiffness="1e6"/><geom size=".1" mass="1"/></body></worldbody>
</mujoco>"""


def test_a_stiff_scene_warns_once_with_the_name():
    told = "dt 5 ms may be unstable under euler: spring of joint `knee`"
    with pytest.warns(sc.StiffnessWarning, match=told) as caught:
        sc.loads(KNEE.format(dt=0.005, integrator="Euler"))
    assert len(caught) == 1
    assert caught[0].filename == __file__
    assert "\n" not in str(caught[0].message)


ROPE = """<mujoco><option timestep="{dt}" integrator="implicitfast" gravity="0 0 0"/>
<worldbody><body><joint name="a" type="slide"/><geom size=".1" mass="1"/></body>
<body pos="1 0 0"><joint name="b" type="slide"/><geom size=".1" mass="3"/></body></worldbody>
<tendon><fixed name="rope" {rope}><joint joint="a" coef="1"/><joint joint="b" coef="-1"/></fixed>
</tendon><actuator>{servo}</actuator></mujoco>"""


@pytest.mark.parametrize(
    ("rope", "servo", "name"),
    [
        ('stiffness="1e5"', "", "tendon spring `rope`"),
        ("", '<position name="winch" tendon="rope" kp="1e5"/>', "servo `winch`"),
        ('stiffness="1e5" springlength="-.1 .1"', "", ""),
    ],
)
def test_a_stiff_tendon_warns_from_its_limit_on(rope, servo, name):
    """Two masses have 2/ω, ω² = k (1/m + 1/M); a slack rope gives no message."""
    limit = 2 / (1e5 * (1 + 1 / 3)) ** 0.5
    for share in (0.98, 1.02):
        with warnings.catch_warnings(record=True) as caught:
            warnings.simplefilter("always")
            scene = sc.loads(ROPE.format(dt=share * limit, rope=rope, servo=servo))
        assert [name in str(told.message) for told in caught] == [True] * bool(name and share > 1)
        sim = sc.Sim(scene)
        sim.qpos[0] = 1e-6
        with warnings.catch_warnings():
            warnings.simplefilter("ignore", sc.EnergyWarning)
            sim.step(600)
        assert (abs(sim.qpos[0]) > 1e-3) == bool(name and share > 1)


def test_a_file_warns_as_a_text_does(tmp_path):
    path = tmp_path / "knee.xml"
    path.write_text(KNEE.format(dt=0.005, integrator="Euler"))
    with pytest.warns(sc.StiffnessWarning, match="spring of joint `knee`") as caught:
        sc.load(path)
    assert caught[0].filename == __file__


def test_a_scene_with_a_stability_margin_of_two_is_silent():
    """A warning would be an error here."""
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        sc.loads(KNEE.format(dt=0.0009, integrator="Euler"))
        for name in ("ant", "half_cheetah", "hopper", "inverted_pendulum", "reacher", "walker2d"):
            sc.load(f"gymnasium:{name}")


def test_a_scene_that_does_not_compile_loads_as_before():
    text = KNEE.format(dt=0.005, integrator="Euler").replace('mass="1"', 'mass="0"')
    scene = sc.loads(text)
    with pytest.raises(ValueError):
        scene.compile()


# --- the command --------------------------------------------------------------------------------

ARM = str(Path(__file__).parents[2] / "docs" / "arm.xml")


def test_the_command_tells_names_and_data(tmp_path, capsys):
    out = tmp_path / "arm.json"
    command = ["diagnose", ARM, "--dt", "0.001", "--horizon", "0.05", "--json", str(out)]
    assert main([*command, "--plot", str(tmp_path / "arm.png")]) == 0
    told = capsys.readouterr()
    said = " ".join(told.out.split())
    assert "servo `elbow`" in said and "stability margin of 1.07×" in said
    # A warning at load is reported in full.
    assert told.err == ""
    data = json.loads(out.read_text())
    assert data["wanted"] == 0.001
    assert data["limits"]["implicitfast"]["stiffest"] == "servo `elbow`"
    assert data["rows"][0]["element"] == "servo `elbow`"
    assert (tmp_path / "arm.png").read_bytes().startswith(b"\x89PNG")


def test_other_commands_warn_in_one_line(capsys):
    with warnings.catch_warnings():
        warnings.simplefilter("default")
        assert main(["run", ARM, "--horizon", "0"]) == 0
    told = capsys.readouterr().err
    assert told.count("\n") == 1
    assert told.startswith("stepcore: dt 5 ms may be unstable under implicitfast: servo `elbow`")


@pytest.mark.parametrize(
    ("options", "text"),
    [(["--dt", "0"], "dt = 0"), (["--key", "away"], "no key"), (["--plot", "a.xyz"], "extension")],
)
def test_the_command_refuses_in_one_line(options, text, capsys):
    assert main(["diagnose", ARM, *options]) == 2
    told = capsys.readouterr().err
    assert text in told and told.count("\n") == 1


def test_a_point_of_a_contact_that_is_about_to_open_is_no_stiff_one():
    """A capsule on the floor, one end 2e-4 m deep, the other 5e-7 m and then 1e-4 m: the forces of
    the second jump when it opens, which is no stiffness of the contact."""
    found = []
    for shallow in (5e-7, 1e-4):
        scene = sc.Scene(gravity=(0.0, 0.0, 0.0)).with_settings(dt=0.002)
        scene.add_geom("world", "plane", (5.0, 5.0, 0.1), name="floor")
        foot = scene.add_body("foot")
        scene.add_joint(foot, "slide", axis=(0.0, 0.0, 1.0))
        scene.add_joint(foot, "hinge", axis=(0.0, 1.0, 0.0))
        ends = (-0.2, 0.0, 0.0, 0.2, 0.0, 0.0)
        scene.add_geom(foot, "capsule", 0.05, fromto=ends, mass=1.0, name="sole")
        tilt = math.asin((2e-4 - shallow) / 0.4)
        scene.add_key(qpos=[0.05 - (2e-4 + shallow) / 2, tilt])
        d = diagnosed(scene, horizon=0.004)
        found.append(d.element("contact `floor`/`sole`").omega / (2 * math.pi))
    # The solref of the default is a time constant of 20 ms: about 8 Hz at damping ratio 1.
    assert found[0] == pytest.approx(found[1], rel=0.2) and 4 < found[0] < 16


@pytest.mark.parametrize("rate", [10.0, 30.0, 40.0])
def test_a_thin_plate_is_named_at_every_rate(rate):
    """Its nutation is as fast as its spin: two equal eigenvalues, which no vectors separate."""
    scene = sc.Scene(gravity=(0.0, 0.0, 0.0)).with_settings(dt=0.02, integrator="explicit")
    plate = scene.add_body("plate")
    scene.add_joint(plate, "free")
    scene.add_geom(plate, "box", (0.5, 0.5, 0.005), mass=1.0)
    spin = (0.0, 0.0, 0.0, 0.01, 0.0, rate)
    scene.add_key(qpos=(0.0, 0.0, 1.0, 1.0, 0.0, 0.0, 0.0), qvel=spin)
    d = diagnosed(scene)
    for name in ("explicit", "semi-implicit", "rk4", "midpoint"):
        assert d.stiffest(name) == "spin of body `plate`"
