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
    '<pid joint="b" input="vel" kp="2" dampratio=".6" gear="2" armature=".1"/>',
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
# Of a nominal point the motor's own damping takes its part, where a constant is left.
NOMINAL = [
    '<dcmotor joint="a" nominal="12 3 20" damping=".1" gear="2"/>',
    '<dcmotor joint="b" nominal="12 3 20" damping=".3"/>',
    '<dcmotor joint="a" nominal="12 3 20" damping=".01 .02" resistance="2"/>',
    '<dcmotor joint="b" nominal="12 3 20" damping=".1" resistance="2"/>',
    '<dcmotor tendon="t" nominal="12 3 20" damping=".05" motorconst=".5"/>',
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
N = 'nominal="12 3 20"'
# What remembers: integrals, targets that move, currents, temperatures, bristles.
STATES = [
    '<pid joint="a" input="pos" kp="5" kv=".3" ki="2" imax=".02"/>',
    '<pid joint="b" kp="5" kv=".3" ki="2" slewmax="3" forcerange="-1 2" gear="2"/>',
    '<pid tendon="t" input="pos vel ff" kp="2" dampratio=".7" slewmax="1" ffrange="-.5 .4"/>',
    '<pid joint="a" delay=".01" nsample="3" kp="1" kv=".2" posrange="-.5 .5"/>',
    f'<dcmotor joint="a" {N} inductance=".01" saturation="2 0 5"/>',
    f'<dcmotor joint="b" {N} inductance="0 .02" input="pos vel" controller="2 1 .1 0 .01"/>',
    f'<dcmotor joint="a" {N} thermal="2 30 0 .004 20 25" input="vel ff" controller="0 0 .2 9"/>',
    f'<dcmotor joint="b" {N} lugre="10 .1 .2 .3 .1" cogging=".1 7 .3"/>',
    f'<dcmotor tendon="t" {N} lugre="10 .1 .2 .3" saturation=".1"/>',
    f'<dcmotor joint="b" {N} input="pos vel ff voltage" controller="5 2 .2 3 .5 9" '
    'inductance=".01" thermal="2 30 0 .04 20 25" lugre="5 .1 .2 .3 .1" cogging=".1 7 .3" '
    'saturation="20 0 90"/>',
    '<pid joint="ball" kp="3" kv=".1" gear="0 0 1" forcerange="-1 1"/>',
    f'<dcmotor joint="ball" {N} gear="0 1 .5" inductance=".01" cogging=".1 3 0"/>',
]
TURNS = [
    '<orientation joint="ball" kp="3" kv=".1"/>',
    '<orientation name="o" joint="ball" kp="2" dampratio=".6" input="quat"/>',
    '<orientation joint="ball" kp="2" ctrlrange="-.3 .2" delay=".01" nsample="3"/>',
    '<motor joint="a"/>',
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
    '<pid kp="3" ki="2" imax=".1" slewmax="2" input="pos"/>': '<pid class="c" joint="a"/>'
    '<pid class="c" joint="b" ki="0"/><pid class="c" joint="b" slewmax="0" imax="0"/>',
    '<orientation kp="3" kv=".2" input="quat"/>': '<orientation class="c" joint="ball"/>'
    '<orientation class="c" joint="ball" kp="1" input="expmap"/>'
    '<position class="c" joint="a"/>',
    '<general gainprm="4" ctrlrange="-.2 .3"/>': '<orientation class="c" joint="ball"/>',
    '<pid imax=".001" input="pos"/>': '<pid class="c" joint="a" ki="3"/>',
    '<dcmotor nominal="12 3 20" inductance=".01" thermal="2 3 0 .04 20 25" lugre="9 .1 .2 .3 .1" '
    'cogging=".1 3 0" controller="3 1 .2 2 .1 7" saturation="3 0 90" input="pos"/>': "".join(
        f'<dcmotor class="c" joint="{joint}" {own}/>'
        for joint, own in (
            ("a", ""),
            ("b", 'inductance="0 0" thermal="0 0 0" lugre="0" cogging="0" controller="1 0"'),
            ("a", 'resistance="7" saturation="0 2" thermal="4"'),
            ("b", 'inductance="0 .1" lugre="7 .2" cogging=".3"'),
        )
    ),
    '<dcmotor nominal="12 3 20" controller="5 0 .2" input="pos"/>': '<dcmotor class="c" joint="a"/>'
    '<dcmotor class="c" joint="b" controller="2"/>',
}
LISTS = {
    **{"pid": PIDS, "dcmotor": MOTORS, "nominal": NOMINAL, "several": SEVERAL, "states": STATES},
    "turns": TURNS,
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
        want, found = data.actuator_force, peers.owned_forces(sim, theirs)
        assert found == pytest.approx(want, abs=1e-9 * max(1, abs(want).max()))
        for field in ("qpos", "qvel", "act"):
            assert getattr(sim, field) == pytest.approx(getattr(data, field), abs=1e-9)
    assert sc.loads(scene.to_mjcf()) == scene


@pytest.mark.parametrize("integrator", INTEGRATORS)
@pytest.mark.parametrize("actuators", LISTS.values(), ids=LISTS)
def test_runs(actuators, integrator):
    option = f'integrator="{integrator}"'
    check(TEXT.format(option=option, default="", actuators="".join(actuators)))


@pytest.mark.parametrize("integrator", INTEGRATORS)
@pytest.mark.parametrize("actuators", LISTS.values(), ids=LISTS)
def test_runs_of_what_is_disabled(actuators, integrator):
    """Law: the bristles of a disabled motor keep moving, and nothing else does."""
    option = f'integrator="{integrator}" actuatorgroupdisable="0"'
    check(TEXT.format(option=option, default="", actuators="".join(actuators)))


@pytest.mark.parametrize(
    "actuators",
    [
        '<pid joint="a" kp="5" kv=".3" ki="9"/>',
        f'<dcmotor joint="a" {N} inductance=".05" thermal="2 .03 0 .04 20 25" cogging=".1 7 .3" '
        'input="pos voltage" controller="4 9 .2"/>',
    ],
    ids=["pid", "dcmotor"],
)
def test_midpoint_keeps_its_order(actuators):
    scene = sc.loads(TEXT.format(option="", default="", actuators=actuators))

    def end(halvings):
        sim = sc.Sim(scene, integrator="midpoint", dt=0.2 / 2**halvings)
        sim.ctrl[:], sim.qvel[:2] = 0.5, (1, 2)
        sim.step(2**halvings)
        return np.concatenate([sim.qpos, sim.qvel, sim.act])

    best = end(12)
    errors = [abs(end(halvings) - best).max() for halvings in (7, 8)]
    assert np.log2(errors[0] / errors[1]) == pytest.approx(2, abs=0.1)


CANONICAL = [actuator for actuators in LISTS.values() for actuator in actuators]


@pytest.mark.parametrize("actuator", CANONICAL, ids=range(len(CANONICAL)))
def test_what_mujoco_saves_as_general_is_the_same(actuator, tmp_path):
    text = TEXT.format(option="", default="", actuators=actuator)
    text = text.replace("<mujoco>", '<mujoco><compiler savecanonical="true"/>')
    path = tmp_path / "saved.xml"
    mujoco.mj_saveLastXML(str(path), mujoco.MjModel.from_xml_string(text))
    assert "<general " in path.read_text()
    check(path.read_text(), 20)


@pytest.mark.parametrize(
    ("general", "words"),
    [
        ('joint="a" gaintype="pid" biastype="affine" actearly="true"', "actearly"),
        ('joint="a" gaintype="dcmotor" biastype="affine"', "biastype"),
        ('joint="a" gaintype="dcmotor" biastype="dcmotor" actearly="false"', "actearly"),
        ('site="s" refsite="r" gaintype="so3" biastype="so3" biasprm="0 -1 0"', "turns a site"),
    ],
)
def test_what_is_not_built_of_them_is_refused_by_name(general, words):
    text = TEXT.format(option="", default="", actuators=f"<general {general}/>")
    text = text.replace("<worldbody>", '<worldbody><site name="s"/><site name="r"/>')
    with pytest.raises(ValueError, match=words):
        sc.loads(text)


def test_inputs_have_controls_in_mujocos_order_and_are_named():
    text = TEXT.format(option="", default="", actuators="".join(SEVERAL[:2]))
    sensors = '<sensor><actuatorfrc actuator="p"/><actuatorpos actuator="p"/></sensor></mujoco>'
    scene = sc.loads(text.replace("</mujoco>", sensors))
    assert [actuator.name for actuator in scene.actuators] == ["p", "p/vel", "", "", ""]
    assert any('the input vel of actuator "p"' in note for note in scene.notes)
    sim, theirs = sc.Sim(scene), mujoco.MjModel.from_xml_string(scene.to_mjcf())
    data = mujoco.MjData(theirs)
    data.ctrl[:] = sim.ctrl[:] = np.linspace(-1, 1, 5)
    mujoco.mj_forward(theirs, data)
    assert sim.sensordata == pytest.approx(data.sensordata, abs=1e-12)


@pytest.mark.parametrize("integrator", ["Euler", "RK4"])
def test_torques_of_orientations_are_bounded_by_their_length(integrator):
    # MuJoCo's implicit integrators drop the damping at the bound where rounding has them see it.
    turns = '<orientation joint="ball" kp="3" kv=".1" forcerange="0 .5"/>'
    check(TEXT.format(option=f'integrator="{integrator}"', default="", actuators=turns))


def test_the_orientation_of_a_control_is_reached():
    text = '<orientation name="o" joint="ball" kp="30" kv="4"/>'
    scene = sc.loads(TEXT.format(option='gravity="0 0 0"', default="", actuators=text))
    assert [actuator.name for actuator in scene.actuators] == ["o", "o/y", "o/z"]
    sim = sc.Sim(scene, integrator="implicitfast")
    sim.ctrl[:] = want = [0.3, -1.2, 2.1]
    sim.step(4000)
    assert sim.actuator_length == pytest.approx(want, abs=1e-9)
    assert sim.actuator_force == pytest.approx(np.zeros(3), abs=1e-7)


@pytest.mark.parametrize("default", CLASSES)
def test_classes(default):
    check(TEXT.format(option="", default=default, actuators=CLASSES[default]))


@pytest.mark.parametrize(
    ("actuator", "words"),
    [
        ('<dcmotor joint="a" nominal="12 3 20" input="none"/>', "no input"),
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
        '<dcmotor joint="a" nominal="12 3 20" inductance="-1"/>',
        '<dcmotor joint="a" nominal="12 3 20" thermal="2 0 0 .004"/>',
        '<dcmotor joint="a" nominal="12 3 20" input="vel" controller="0 1"/>',
        '<dcmotor joint="a" nominal="12 3 20" controller="0 0 0 1"/>',
        '<general joint="a" gaintype="pid" biastype="affine"/>',
        '<orientation joint="a"/>',
        '<orientation joint="ball" forcerange="-1 2"/>',
        '<orientation joint="ball" kv="-1"/>',
        '<orientation joint="ball" kv="1" dampratio="1"/>',
        '<pid joint="a" slewmax="-1"/>',
        '<pid joint="a" imax="-1" ki="1"/>',
        '<pid joint="a" input="vel" ki="1"/>',
        '<pid joint="a" input="ff" slewmax="1"/>',
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
        ({"type": "orientation"}, "a ball joint for an orientation"),
        ({"type": "pid", "input": "vel pos"}, "in this order"),
        ({"type": "pid", "input": "pos vel"}, "one actuator of type 'input' that feeds 'vel'"),
        ({"type": "pid", "input": "vel", "ki": 2}, "ki = 2"),
        ({"type": "pid", "input": "ff", "slewmax": 2}, "slewmax = 2"),
        ({"type": "pid", "input": "pos", "imax": -1}, "imax = -1"),
        ({"type": "motor", "ki": 1}, "ki = 1"),
        ({"type": "dcmotor", "motorconst": 1, "resistance": 1, "ki": 2}, "ki = 2"),
        ({"type": "dcmotor", "motorconst": 1, "resistance": 1, "inductance": -1}, "inductance"),
        ({"type": "dcmotor", "motorconst": 1, "resistance": 1, "lugre": (1, -1)}, "lugre"),
        ({"type": "dcmotor", "motorconst": 1, "resistance": 1, "thermal": (0,) * 5}, "thermal"),
        ({"type": "pid"}, "input = None"),
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
