"""Ranges of muscles' lengths that are found by simulation, against MuJoCo's compiler.

Law: the same pulls in the same steps find the same lengths, to 1e-6 of the range.
"""

import mujoco
import peers
import pytest

import stepcore as sc

TEXT = """
<mujoco>
  <compiler>{compiler}</compiler>
  <option density="3"/>
  <worldbody>
    <site name="wall" pos="0 .1 .6"/>
    <body pos="0 0 .5" gravcomp="1">
      <joint name="a" axis="0 1 0" range="-80 90" damping="1" stiffness="3" frictionloss=".1"/>
      <geom name="upper" type="cylinder" fromto="0 0 0 .3 0 0" size=".04"/>
      <geom name="drum" type="cylinder" size=".05 .1" pos=".3 0 0" euler="90 0 0"/>
      <site name="s" pos=".1 0 .04"/>
      <body pos=".3 0 0"><joint name="b" axis="0 1 0" range="-60 50" armature=".01"/>
        <geom type="capsule" fromto="0 0 0 .3 0 0" size=".03"/>
        <site name="t" pos=".15 0 .03" euler="10 20 30"/></body></body>
    <body pos="0 1 1"><joint name="ball" type="ball" range="0 40"/>
      <geom type="box" size=".1 .2 .05" pos=".1 0 0"/></body>
  </worldbody>
  <tendon>
    <spatial name="rope" damping="1">
      <site site="wall"/><geom geom="drum"/><site site="t"/></spatial>
    <fixed name="both" range="-.4 .6"><joint joint="a" coef=".5"/><joint joint="b" coef="-1"/>
    </fixed>
  </tendon>
  <actuator>{muscles}<motor joint="a"/></actuator>
</mujoco>
"""
MUSCLES = {
    "a joint": '<muscle joint="b"/>',
    "a gear": '<muscle joint="b" gear="-2"/>',
    "a tendon round a geom": '<muscle tendon="rope"/>',
    "a fixed tendon": '<muscle tendon="both" gear="2" force="3"/>',
    "a slider-crank": '<muscle cranksite="t" slidersite="wall" cranklength=".9"/>',
    "a ball": '<muscle joint="ball" gear="0 1 0"/>',
    "many": "".join(f"<muscle {what}/>" for what in ('joint="a"', 'joint="b"', 'tendon="rope"')),
    "one that gives it": '<muscle tendon="rope" lengthrange=".3 .9"/><muscle joint="a"/>',
}
COMPILERS = {
    "limits": '<lengthrange uselimit="true"/>',
    "all anew": '<lengthrange useexisting="false"/>',
    "weakly": '<lengthrange maxforce=".5" accel="40"/>',
    "otherwise": '<lengthrange timeconst=".5" timestep=".005" inttotal="8" interval="1"/>',
    "mode": '<lengthrange mode="all"/>',
}


def check(text):
    theirs = mujoco.MjModel.from_xml_string(text)
    scene = sc.loads(text)
    ours = [actuator["lengthrange"] for actuator in scene.to_dict()["actuators"]]
    for index in range(theirs.nu - 1):
        want = theirs.actuator_lengthrange[index]
        assert ours[index] == pytest.approx(want, abs=1e-6 * (want[1] - want[0]))
    assert sc.loads(scene.to_mjcf()) == scene
    return theirs, scene


@pytest.mark.parametrize("muscles", MUSCLES)
def test_ranges(muscles):
    check(TEXT.format(compiler="", muscles=MUSCLES[muscles]))


@pytest.mark.parametrize("compiler", COMPILERS)
def test_rules(compiler):
    check(TEXT.format(compiler=COMPILERS[compiler], muscles=MUSCLES["one that gives it"]))


def test_forces():
    """A muscle pulls as MuJoCo's does over the range that was found."""
    theirs, scene = check(TEXT.format(compiler="", muscles=MUSCLES["many"]))
    data, sim = mujoco.MjData(theirs), sc.Sim(scene, **peers.EXACT)
    for _ in range(50):
        for one in (data, sim):
            one.ctrl[:3] = 0.7, 0.2, 0.9
        mujoco.mj_step(theirs, data)
        sim.step()
        want = data.actuator_force
        assert sim.actuator_force == pytest.approx(want, abs=1e-5 * max(1, abs(want).max()))
    assert sim.qpos == pytest.approx(data.qpos, abs=1e-5)


def test_what_is_not_held_is_an_error():
    text = TEXT.format(compiler="", muscles='<muscle name="m" joint="a"/>')
    text = text.replace('range="-80 90"', "").replace('range="-.4 .6"', "")
    with pytest.raises(ValueError, match="did not converge"):
        mujoco.MjModel.from_xml_string(text)
    with pytest.raises(ValueError, match=r"24: actuator \"m\": its range of lengths was not found"):
        sc.loads(text).compile()


def test_none_refuses():
    text = TEXT.format(compiler='<lengthrange mode="none"/>', muscles=MUSCLES["a joint"])
    with pytest.raises(ValueError, match=r"lengthrange = None.*mode"):
        sc.loads(text).compile()


@pytest.mark.parametrize("value", ['mode="some"', 'accel="-1"', 'timestep="x"', 'useexisting="2"'])
def test_bad_values(value):
    text = TEXT.format(compiler=f"<lengthrange {value}/>", muscles="")
    with pytest.raises(ValueError, match=value.partition("=")[0]):
        sc.loads(text)
