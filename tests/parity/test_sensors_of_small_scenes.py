"""Sensors in small scenes of their own, against MuJoCo: rays, users' sensors, still bodies."""

import mujoco
import peers
import pytest

import stepcore as sc


def test_rangefinders_see_what_only_draws_but_not_what_is_clear():
    source = """
    <mujoco>
      <asset><material name="clear" rgba="1 1 1 0"/>
        <mesh name="roof" vertex="-1 -1 0  1 -1 0  0 1 0  0 0 1"/></asset>
      <worldbody>
        <site name="eye"/>
        <geom type="sphere" size=".1" pos="0 0 1" rgba="1 0 0 0"/>
        <geom type="sphere" size=".1" pos="0 0 1.5" material="clear"/>
        <geom type="mesh" mesh="roof" pos="0 0 3" contype="0" conaffinity="0"/>
        <body><joint/><geom size=".1" pos="5 0 0"/></body>
      </worldbody>
      <sensor><rangefinder site="eye"/></sensor>
    </mujoco>"""
    theirs = mujoco.MjModel.from_xml_string(source)
    data = mujoco.MjData(theirs)
    mujoco.mj_forward(theirs, data)
    scene = sc.loads(source)
    sim = sc.Sim(scene)
    sim.forward()
    assert sim.sensordata == pytest.approx(data.sensordata, abs=1e-6)
    assert sc.loads(scene.to_mjcf()) == scene


def test_a_sensor_of_its_user_has_its_place_and_zeros():
    """As MuJoCo's without a callback, and it is written as it was read."""
    text = """<mujoco><worldbody><body name="b"><joint name="j"/><geom size="1"/></body>
      </worldbody><sensor><jointpos joint="j"/><user name="mine" dim="3" noise=".1"/>
      <user dim="2" objtype="body" objname="b" needstage="acc" datatype="real"/><clock/></sensor>
      </mujoco>"""
    model = mujoco.MjModel.from_xml_string(text)
    data = mujoco.MjData(model)
    scene = sc.loads(text)
    sim = sc.Sim(scene)
    data.qpos[:] = sim.qpos[:] = 0.3
    mujoco.mj_step(model, data)
    sim.step(1)
    assert sim.sensordata.tolist() == data.sensordata.tolist()
    assert sim.sensor("mine").data.tolist() == [0.0, 0.0, 0.0]
    assert sc.loads(scene.to_mjcf()) == scene


USER = """<mujoco><worldbody><camera name="eye"/><body name="b">
  <joint name="j"/><geom name="g" size="1"/><site name="s"/></body></worldbody>
  <tendon><fixed name="t"><joint joint="j" coef="1"/></fixed></tendon>
  <actuator><motor name="a" joint="j"/></actuator>
  <sensor><user dim="2" {}/><clock/></sensor></mujoco>"""


@pytest.mark.parametrize(
    "attached",
    ["body b", "xbody b", "body world", "joint j", "geom g", "site s", "tendon t", "actuator a"],
)
def test_a_sensor_of_its_user_keeps_what_it_is_attached_to(attached):
    kind, name = attached.split()
    text = USER.format(f'objtype="{kind}" objname="{name}"')
    scene = sc.loads(text)
    assert scene.sensors[0].object.name == name
    again = mujoco.MjModel.from_xml_string(scene.to_mjcf())
    first = mujoco.MjModel.from_xml_string(text)
    assert again.sensor_objtype.tolist() == first.sensor_objtype.tolist()
    assert again.sensor_objid.tolist() == first.sensor_objid.tolist()
    assert sc.loads(scene.to_mjcf()) == scene
    assert sc.Sim(scene).sensordata.tolist() == [0.0, 0.0, 0.0]


def test_a_sensor_of_its_user_without_its_camera_is_listed():
    """It keeps its place among the readings; a scene has no cameras."""
    scene = sc.loads(USER.format('objtype="camera" objname="eye"'))
    assert sc.Sim(scene).sensordata.shape == (3,)
    line = "<user> (read, but not what it is attached to: the camera eye)"
    assert any(entry.endswith(line) for entry in scene.ignored)


@pytest.mark.parametrize(
    ("attributes", "text"),
    [
        ('objtype="body" objname="nope"', 'no body is named "nope"'),
        ('objtype="body"', "objtype without objname"),
        ('objname="b"', "objname without objtype"),
    ],
)
def test_what_a_sensor_of_its_user_is_attached_to_is_checked(attributes, text):
    with pytest.raises(ValueError):
        mujoco.MjModel.from_xml_string(USER.format(attributes))
    with pytest.raises(sc.MJCFError, match=text):
        sc.loads(USER.format(attributes))


@pytest.mark.parametrize(
    "sensor",
    [
        '<force site="mount"/>',
        '<torque site="mount"/>',
        '<subtreecom body="hand"/>',
        '<subtreelinvel body="hand"/>',
        '<subtreeangmom body="hand"/>',
        "<e_potential/>",
        '<framepos objtype="body" objname="palm"/>',
        '<framepos objtype="site" objname="mount" reftype="body" refname="palm"/>',
    ],
)
def test_what_only_draws_on_a_body_that_stands_still_weighs(sensor):
    """A hand by itself: its palm is fixed, and has the mass of its visual mesh, as in MuJoCo.

    The mesh has three different axes, so that there is one inertial frame.
    """
    text = f"""<mujoco><asset><mesh name="m" builtin="sphere" params="2" scale=".1 .2 .15"/></asset>
      <worldbody><body name="hand"><site name="mount"/><body name="palm" pos=".1 .2 .3">
        <geom type="mesh" mesh="m" pos=".3 0 0" contype="0" conaffinity="0" group="1"/>
        <body pos=".5 0 0"><joint axis="0 1 0"/><geom size=".1"/></body></body></body></worldbody>
      <sensor>{sensor}</sensor></mujoco>"""
    model = peers.strict(mujoco.MjModel.from_xml_string(text))
    data, sim = mujoco.MjData(model), sc.Sim(sc.loads(text), **peers.EXACT)
    data.qvel[:] = sim.qvel[:] = 0.7
    mujoco.mj_forward(model, data)
    sim.forward()
    # MuJoCo keeps the vertices of meshes in single precision.
    assert sim.sensordata == pytest.approx(data.sensordata, rel=1e-6, abs=1e-6)
