"""Values that MuJoCo refuses in what holds, drives and senses are refused here, by name."""

import mujoco
import pytest

import stepcore as sc

TEXT = """<mujoco><worldbody><body name="a"><joint name="j"/><geom name="g" size=".1"/>
  <site name="s"/><site name="u" pos=".1 0 0"/></body>
  <body name="b" pos="1 0 0"><freejoint/><geom size=".1"/><site name="x"/></body></worldbody>
  <tendon><spatial name="t"><site site="s"/><geom geom="g"/><site site="x"/></spatial></tendon>
  <equality>{equality}</equality><actuator>{actuator}</actuator><sensor>{sensor}</sensor></mujoco>"""
MUSCLE = '<muscle joint="j" lengthrange="-1 1" {}/>'
GENERAL = '<general joint="j" lengthrange="-1 1" gaintype="muscle" gainprm="{}"/>'
BAD = {
    "a muscle without scale": ("actuator", MUSCLE.format('scale="0"'), "scale"),
    "a muscle without speed": ("actuator", MUSCLE.format('vmax="0"'), "vmax"),
    "a muscle without fpmax": ("actuator", MUSCLE.format('fpmax="0"'), "fpmax"),
    "a muscle without fvmax": ("actuator", MUSCLE.format('fvmax="0"'), "fvmax"),
    "a muscle never short": ("actuator", MUSCLE.format('lmin="1"'), "lmin"),
    "a muscle never long": ("actuator", MUSCLE.format('lmax=".9"'), "lmax"),
    "a muscle whose range falls": ("actuator", MUSCLE.format('range="1 .5"'), "range"),
    "a muscle with one time": ("actuator", MUSCLE.format('timeconst=".1"'), "timeconst"),
    "muscle gain without curves": ("actuator", GENERAL.format("0.7 1"), "gainprm"),
    "a cylinder with one bias": ("actuator", '<cylinder joint="j" bias="1"/>', "bias"),
    "armature round a geom": ("actuator", '<motor tendon="t" armature=".1"/>', "armature"),
    "a cutoff below zero": ("sensor", '<jointpos joint="j" cutoff="-1"/>', "cutoff"),
}


@pytest.mark.parametrize("name", BAD)
def test_what_mujoco_refuses(name):
    section, element, field = BAD[name]
    parts = {"equality": "", "actuator": "", "sensor": ""} | {section: element}
    text = TEXT.format(**parts)
    with pytest.raises(ValueError):
        mujoco.MjModel.from_xml_string(text)
    with pytest.raises(ValueError, match=field):
        sc.loads(text).compile()


NEGATIVE = ('range="-1 1.2"', 'range=".6 -2"', 'timeconst="-1 .2"')
NUMBERS = ("force", "scale", "lmin", "lmax", "vmax", "fpmax", "fvmax")


@pytest.mark.parametrize("given", [*NEGATIVE, *(f'{word}="-3"' for word in NUMBERS)])
def test_a_muscle_keeps_its_number_for_a_negative_one(given):
    text = TEXT.format(equality="", actuator=MUSCLE.format(given), sensor="")
    model = mujoco.MjModel.from_xml_string(text)
    data, sim = mujoco.MjData(model), sc.Sim(sc.loads(text))
    for name in ("act", "ctrl", "qvel"):
        getattr(data, name)[:] = 0.7
        getattr(sim, name)[:] = 0.7
    mujoco.mj_forward(model, data)
    sim.forward()
    assert sim.actuator_force == pytest.approx(data.actuator_force, rel=1e-12)
    mujoco.mj_step(model, data)
    sim.step(1)
    assert sim.act == pytest.approx(data.act, rel=1e-12)


@pytest.mark.filterwarnings("ignore::UserWarning")
def test_what_is_refused_here():
    """Numbers that overflow, and sites that cannot move against each other."""
    parts = {"equality": "", "actuator": "", "sensor": ""}
    wide = TEXT.format(**parts | {"actuator": '<cylinder joint="j" diameter="1e300"/>'})
    with pytest.raises(ValueError, match="area"):
        sc.loads(wide).compile()
    one = TEXT.format(**parts | {"equality": '<connect site1="s" site2="u"/>'})
    with pytest.raises(ValueError, match='site "s" to site "u", of the same body'):
        sc.loads(one)


def test_the_speed_of_an_adhesion_is_listed():
    text = TEXT.format(
        equality="",
        actuator='<adhesion name="grip" body="b" ctrlrange="0 1"/>',
        sensor='<actuatorvel actuator="grip"/><clock/>',
    )
    scene = sc.loads(text)
    assert any("adhesion" in str(one) for one in scene.ignored)
    assert sc.Sim(scene).sensordata.shape == (1,)


def test_an_equality_is_active_or_not():
    """eq_active takes truths, and numbers that are 0 or 1."""
    text = TEXT.format(equality='<weld body1="a" body2="b"/>', actuator="", sensor="")
    sim = sc.Sim(sc.loads(text))
    sim.eq_active = [False]
    sim.step(1)
    assert not sim.eq_active.any()
    for bad in (0.5, 2.0, -1.0):
        sim.eq_active[:] = bad
        with pytest.raises(ValueError, match=r"eq_active\[0\] = .*0 or 1"):
            sim.step(1)
