"""`<pid>` and `<dcmotor>`, against MuJoCo.

Law: forces and steps are MuJoCo's to 1e-9 under every integrator that both have.
"""

import mujoco
import numpy as np
import peers
import pytest

import stepcore as sc

TEXT = """
<mujoco>
  <option timestep=".004" {option}/>
  <default><default class="c">{default}</default></default>
  <worldbody>
    <body><joint name="a" axis="0 1 0" damping=".1" range="-90 60"/>
      <geom type="capsule" fromto="0 0 0 .3 0 0" size=".03"/>
      <body pos=".3 0 0"><joint name="b" axis="0 0 1"/>
        <geom type="capsule" fromto="0 0 0 .3 0 0" size=".03"/></body></body>
    <body pos="0 1 0"><joint name="ball" type="ball"/>
      <geom type="box" size=".1 .2 .05" pos=".1 0 0"/></body>
  </worldbody>
  <tendon><fixed name="t"><joint joint="a" coef=".7"/><joint joint="b" coef="-1.2"/></fixed>
  </tendon>
  <actuator>{actuators}</actuator>
</mujoco>
"""
PIDS = [
    '<pid joint="a" input="pos" kp="5" kv=".3"/>',
    '<pid joint="b" input="vel" kp="2" kv=".3" gear="2"/>',
    '<pid tendon="t" input="ff" kp="4" dampratio=".5"/>',
    '<pid joint="a" input="pos" kp="7" dampratio=".7" forcerange="-.5 2" posrange="-.3 .4"/>',
    '<pid joint="b" input="vel" kv=".5" velrange="-.1 .1" ctrlrange="-9 9"/>',
    '<pid joint="b" input="ff" kp="0" ffrange="-.1 .2"/>',
    '<pid joint="a" input="pos" inheritrange=".8" kp="3"/>',
    '<pid joint="ball" input="pos" kp="3" kv=".1" gear="0 0 1"/>',
    '<pid joint="a" input="pos" kp="3" nsample="3" delay=".01"/>',
]
MOTORS = [
    '<dcmotor joint="a" nominal="12 3 20"/>',
    '<dcmotor joint="b" motorconst=".5 .8" resistance="2" gear="3"/>',
    '<dcmotor joint="a" motorconst="0 .7" resistance="2" ctrlrange="-1 .5"/>',
    '<dcmotor joint="b" nominal="12 3 20" motorconst="1" saturation="0 .2 0"/>',
    '<dcmotor tendon="t" nominal="12 3 20" resistance="1" saturation=".3"/>',
    '<dcmotor joint="a" nominal="12 3 20" input="pos" controller="5 0 .2"/>',
    '<dcmotor joint="b" nominal="12 3 20" input="vel" controller="2 0 .2" ctrlrange="-1 1"/>',
    '<dcmotor joint="b" nominal="12 3 20" input="ff"/>',
    '<dcmotor joint="ball" nominal="12 3 20" gear="0 1 .5"/>',
]
# Of several inputs, each of which is an actuator with a control of its own.
SEVERAL = [
    '<pid name="p" joint="a" kp="5" kv=".3"/>',
    '<pid joint="b" input="pos vel ff" kp="2" kv=".3" gear="2" posrange="-.3 .4"/>',
    '<pid tendon="t" input="vel ff" kv=".2" velrange="-.1 .1" ffrange="-.5 .4"/>',
    '<pid joint="a" input="pos ff" dampratio=".7" inheritrange=".8"/>',
    '<pid joint="ball" kp="3" kv=".1" gear="0 0 1" damping=".1"/>',
    '<dcmotor joint="a" nominal="12 3 20" input="pos vel" controller="5 0 .2"/>',
    '<dcmotor joint="b" nominal="12 3 20" input="pos vel ff voltage" controller="2 0 .2" '
    'ctrlrange="-1 1"/>',
    '<dcmotor joint="b" nominal="12 3 20" input="ff voltage" gear="2"/>',
]
CLASSES = {
    '<pid kp="7" kv="1" input="pos"/>': '<pid class="c" joint="a"/>'
    '<pid class="c" joint="b" kp="2"/>',
    '<pid input="vel" dampratio="1"/>': '<pid class="c" joint="a" kv="3"/>',
    '<position kp="7" kv="1"/>': '<pid class="c" joint="a" input="pos"/>',
    '<general forcerange="-.1 .1" ctrlrange="-.5 .5"/>': '<pid class="c" joint="a" input="pos"/>'
    '<dcmotor class="c" joint="a" nominal="12 3 20"/>'
    '<dcmotor class="c" joint="b" nominal="12 3 20" saturation="0"/>',
    '<dcmotor nominal="12 3 20" saturation="1"/>': '<dcmotor class="c" joint="a"/>'
    '<dcmotor class="c" joint="a" motorconst="1"/><dcmotor class="c" joint="a" nominal="24 3 20"/>'
    '<dcmotor class="c" joint="b" resistance="1" motorconst="0 2" saturation="0 2"/>'
    '<position class="c" joint="b" kp="3"/>',
    '<dcmotor nominal="12 3 20" controller="5 0 .2" input="pos"/>': '<dcmotor class="c" joint="a"/>'
    '<dcmotor class="c" joint="b" controller="2"/>',
}
INTEGRATORS = ("Euler", "implicitfast", "implicit", "RK4", "discrete")


def check(text, steps=40):
    theirs, scene = mujoco.MjModel.from_xml_string(text), sc.loads(text)
    data, sim = mujoco.MjData(theirs), sc.Sim(scene, **peers.EXACT)
    rng = np.random.default_rng(2)
    for _ in range(steps):
        ctrl = rng.normal(size=theirs.nu)
        for one in (data, sim):
            one.ctrl[:] = ctrl
        mujoco.mj_step(theirs, data)
        sim.step()
        # MuJoCo's is one number for all inputs of an actuator.
        inputs = np.repeat(np.arange(len(theirs.actuator_ctrlnum)), theirs.actuator_ctrlnum)
        want, found = data.actuator_force, np.bincount(inputs, sim.actuator_force)
        assert found == pytest.approx(want, abs=1e-9 * max(1, abs(want).max()))
        for field in ("qpos", "qvel"):
            assert getattr(sim, field) == pytest.approx(getattr(data, field), abs=1e-9)
    assert sc.loads(scene.to_mjcf()) == scene


@pytest.mark.parametrize("integrator", INTEGRATORS)
@pytest.mark.parametrize("actuators", [PIDS, MOTORS, SEVERAL], ids=["pid", "dcmotor", "several"])
def test_runs(actuators, integrator):
    option = f'integrator="{integrator}"'
    check(TEXT.format(option=option, default="", actuators="".join(actuators)))


def test_inputs_have_controls_in_mujocos_order_and_are_named():
    text = TEXT.format(option="", default="", actuators="".join(SEVERAL[:2]))
    sensors = '<sensor><actuatorfrc actuator="p"/><actuatorpos actuator="p"/></sensor></mujoco>'
    scene = sc.loads(text.replace("</mujoco>", sensors))
    assert [actuator.name for actuator in scene.actuators] == ["p", "p/vel", "", "", ""]
    assert any('the input vel of actuator "p"' in note for note in scene.notes)
    assert any("several actuators" in ignored for ignored in scene.ignored)


@pytest.mark.parametrize("default", CLASSES)
def test_classes(default):
    check(TEXT.format(option="", default=default, actuators=CLASSES[default]))


@pytest.mark.parametrize(
    ("actuator", "words"),
    [
        ('<pid joint="a" forcerange="-1 1"/>', "several inputs with forcerange"),
        ('<pid joint="a" delay=".01" nsample="3"/>', "several inputs with delay"),
        ('<pid joint="a" dampratio="1"/>', "several inputs with dampratio"),
        ('<pid joint="a" input="pos" ki="1"/>', "integral"),
        ('<pid joint="a" input="pos" slewmax="1"/>', "rate"),
        ('<dcmotor joint="a" nominal="12 3 20" input="none"/>', "no input"),
        ('<dcmotor joint="a" nominal="12 3 20" inductance=".1"/>', "inductance"),
        ('<dcmotor joint="a" nominal="12 3 20" cogging=".1 3 0"/>', "cogging"),
        ('<dcmotor joint="a" nominal="12 3 20" input="pos" controller="1 1"/>', "integral"),
        ('<dcmotor joint="a" nominal="12 3 20" input="pos" controller="1 0 0 0 0 9"/>', "voltage"),
    ],
)
def test_what_is_not_built_is_refused_by_name(actuator, words):
    mujoco.MjModel.from_xml_string(TEXT.format(option="", default="", actuators=actuator))
    with pytest.raises(ValueError, match="not built yet") as caught:
        sc.loads(TEXT.format(option="", default="", actuators=actuator))
    assert words in str(caught.value)


@pytest.mark.parametrize(
    "actuator",
    [
        '<pid joint="a" input="vel pos"/>',
        '<pid joint="a" input="voltage"/>',
        '<pid joint="a" input="pos" kv="-1"/>',
        '<pid joint="a" input="pos" kv="1" dampratio="1"/>',
        '<dcmotor joint="a"/>',
        '<dcmotor joint="a" motorconst="1"/>',
        '<dcmotor joint="a" resistance="1"/>',
        '<dcmotor joint="a" motorconst="-1" resistance="1"/>',
        '<dcmotor joint="a" nominal="12 0 20"/>',
        '<dcmotor joint="a" nominal="12 3 20" controller="2"/>',
        '<dcmotor joint="a" nominal="12 3 20" forcerange="-1 1"/>',
    ],
)
def test_what_mujoco_refuses_is_refused(actuator):
    text = TEXT.format(option="", default="", actuators=actuator)
    with pytest.raises(ValueError):
        mujoco.MjModel.from_xml_string(text)
    with pytest.raises(ValueError, match=":15:"):
        sc.loads(text)


@pytest.mark.parametrize(
    ("fields", "words"),
    [
        ({"type": "pid"}, "input = None"),
        ({"type": "pid", "input": "vel", "dampratio": 1}, "dampratio"),
        ({"type": "dcmotor", "resistance": 1}, "motorconst = None"),
        ({"type": "dcmotor", "motorconst": 1, "resistance": 0}, "resistance = 0"),
        ({"type": "dcmotor", "motorconst": 1, "resistance": 1, "kp": 2}, "kp = 2"),
        ({"type": "motor", "input": "pos"}, "input = 'pos'"),
    ],
)
def test_bad_fields(fields, words):
    scene = sc.loads(TEXT.format(option="", default="", actuators=""))
    with pytest.raises(ValueError, match=words):
        scene.add_actuator("a", **fields)
        scene.compile()
