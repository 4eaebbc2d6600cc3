"""Values that no real thing has, by their closed forms; nothing in the same scene made right."""

import math

import menagerie
import numpy as np
import pytest
from test_check import arm, findings, key, kinds, the

import stepcore as sc
from stepcore.experiment.schedule import home
from stepcore.measure.check.described import Described
from stepcore.measure.check.plausible import alike, outside, plausibility

ROD = 'type="capsule" fromto="0 0 0 .3 0 0" size=".03"'
# A rod of 0.3 m with two half balls, 1 kg, about an axis across its middle [kg·m²].
FITS = 0.012


def link(x=0.15, y=0.0, inertia=FITS, more=""):
    """A rod on a hinge at one of its ends, with an explicit inertia."""
    inertial = f'<inertial pos="{x} {y} 0" mass="1" diaginertia="{inertia} {inertia} {inertia}"/>'
    return arm(geom=f"{ROD} {more}").replace("<geom", f"{inertial}<geom", 1)


# Inertia.


@pytest.mark.parametrize("inertia", [1e-9, FITS / 1000, 1000 * FITS])
def test_inertias_far_from_those_of_mass_and_size(inertia):
    """√(3 I / 2 m) is the radius of gyration; the rod reaches 0.18 m."""
    one = the(link(inertia=inertia), "inertia")
    assert one.value == pytest.approx(math.sqrt(1.5 * inertia), rel=1e-9)
    assert one.element == "body `arm`" and "180 mm" in one.text
    assert one.severity == ("error" if inertia > FITS else "warning")


def test_an_inertia_that_fits():
    assert kinds(link()) == []


def test_a_small_inertia_is_found_although_drawings_are_left_out():
    drawn = link(inertia=1e-9).replace(
        "</body>", f'<geom {ROD} contype="0" conaffinity="0" mass="0"/></body>'
    )
    assert kinds(drawn) == ["inertia"]


FINGERS = """<robot name="finger"><link name="palm"/><link name="f1"><inertial>
<mass value=".05"/><origin xyz=".03 0 0"/><inertia ixx="{0}" iyy="{1}" izz="{1}" ixy="0" ixz="0"
 iyz="0"/></inertial><collision><origin xyz=".03 0 0"/><geometry><box size=".06 .02 .02"/>
</geometry></collision></link>
<joint name="j1" type="revolute"><parent link="palm"/><child link="f1"/>
<axis xyz="0 1 0"/><limit lower="-.2" upper="1.2" effort="60" velocity="2"/></joint></robot>"""


@pytest.mark.parametrize(("unit", "found"), [(1e-3, ["inertia"]), (1.0, [])])
def test_inertias_of_a_urdf_in_the_wrong_unit(unit, found):
    """A box of 50 g: m (b² + c²)/12."""
    across, along = 0.05 * (0.02**2 + 0.02**2) / 12, 0.05 * (0.06**2 + 0.02**2) / 12
    assert kinds(FINGERS.format(across * unit, along * unit)) == found


# Centres of mass.


@pytest.mark.parametrize("y", [0.6, -0.4])
def test_a_centre_of_mass_outside_of_its_body(y):
    one = the(link(y=y, inertia=0.05), "centre of mass")
    assert one.value == pytest.approx(abs(y) - 0.03, rel=1e-2) and one.unit == "m"


def test_a_centre_of_mass_between_the_joints_of_a_link():
    """A link without geoms there still reaches to its child."""
    assert kinds(link(y=0.05, inertia=0.05)) == []
    child = '<body pos="0 .6 0"><joint axis="0 0 1"/><geom size=".05" contype="0"/></body></body>'
    far = link(y=0.4, inertia=0.05).replace("</body>", child)
    assert "centre of mass" not in kinds(far)


@pytest.mark.parametrize("seed", range(20))
def test_the_distance_from_a_hull(seed):
    """A box, turned and moved: max(|x| − a, 0) in its axes."""
    random = np.random.default_rng(seed)
    half, at = random.uniform(0.1, 1, 3), random.uniform(-3, 3, 3)
    turn = np.linalg.qr(random.normal(size=(3, 3)))[0]
    corners = np.stack(np.meshgrid(*[(-1, 1)] * 3), axis=-1).reshape(-1, 3) * half
    share, size = outside((corners - at) @ turn.T)
    away = float(np.linalg.norm(np.maximum(np.abs(at) - half, 0)))
    assert share * size == pytest.approx(away, rel=2e-3, abs=1e-3)


# The mass matrix.

GIMBAL = """<mujoco><worldbody><body><joint name="roll" axis="1 0 0"/>
<joint name="pitch" axis="0 1 0"/><joint name="yaw" axis="0 0 1" armature="{}"/>
<geom type="box" size=".1 .05 .02" mass="1"/></body></worldbody>{}</mujoco>"""


def test_a_gimbal_lock_is_named():
    """At a pitch of 90° roll and yaw turn about one axis."""
    lock = key(f"0 {math.pi / 2} 0")
    found = {one.kind: one for one in findings(GIMBAL.format(0, lock))}
    one = found["mass matrix"]
    names = [element.name for element in one.elements]
    assert sorted(names) == ["joint `roll`", "joint `yaw`"] and "keyframe `home`" in one.text
    assert "mass matrix" not in kinds(GIMBAL.format(0.01, lock))
    assert "mass matrix" not in kinds(GIMBAL.format(0, key("0 1.5 0")))


@pytest.mark.parametrize("pitch", [0.3, 1.2])
def test_the_smallest_eigenvalue_of_the_scaled_mass_matrix(pitch):
    """A ball: roll and yaw are coupled by I sin(pitch), so it is 1 − sin(pitch)."""
    text = GIMBAL.format(0, "").replace('type="box" size=".1 .05 .02"', 'size=".1"')
    share, dofs = alike(sc.Sim(sc.loads(text).compile()), np.array([0, pitch, 0]))
    assert share == pytest.approx(1 - math.sin(pitch), rel=1e-9) and sorted(dofs) == [0, 2]


# Public robots.


@menagerie.needed
@pytest.mark.parametrize("robot", [menagerie.SO101, menagerie.UR5E, menagerie.PANDA])
def test_healthy_robots_have_plausible_masses(robot):
    model = sc.load(robot).compile()
    assert list(plausibility(Described(model, home(model, None)[0], np.zeros(model.nu)))) == []
