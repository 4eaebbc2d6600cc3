"""What the settings make of a model is said when a Sim is made: where it happens, only there."""

import warnings

import numpy as np
import pytest

import stepcore as sc
from stepcore.engine import pitfalls


def resting(shape, size, friction, cone):
    geom = f'<geom name="it" type="{shape}" size="{size}" friction="{friction}"/>'
    plane = '<geom type="plane" size="9 9 1"/>'
    body = f'<body pos="0 0 {size.split()[-1]}"><freejoint/>{geom}</body>'
    option = f'<option cone="{cone}"/>'
    return sc.loads(f"<mujoco>{option}<worldbody>{plane}{body}</worldbody></mujoco>")


def warned(make):
    pitfalls._warned_texts.clear()
    with warnings.catch_warnings(record=True) as said:
        warnings.simplefilter("always", sc.ModelWarning)
        result = make()
    return result, [str(each.message) for each in said if each.category is sc.ModelWarning]


@pytest.mark.parametrize("friction", [1, 4, 6, 8, 12])
@pytest.mark.parametrize(("shape", "size"), [("box", ".05 .05 .05"), ("sphere", ".05")])
@pytest.mark.parametrize("cone", ["pyramidal", "elliptic"])
def test_pyramids_that_sink_are_told(shape, size, friction, cone):
    """Half the thickness is the bound: what was told sinks that far, what was not does not."""
    sim, said = warned(lambda: sc.Sim(resting(shape, size, friction, cone)))
    start = sim.qpos[2]
    sim.step(3000)
    assert bool(said) == (start - sim.qpos[2] > 0.05)
    assert all("`it`" in text and "elliptic" in text for text in said)


def test_the_depth_that_is_told_is_that_of_the_run():
    _, (text,) = warned(lambda: sc.Sim(resting("box", ".05 .05 .05", 7, "pyramidal")))
    assert "sinks by about 60.1 mm" in text


@pytest.mark.parametrize("friction", ["1e155", "1e308"])
def test_a_friction_beyond_all_squares_sinks_without_end(friction):
    _, (text,) = warned(lambda: sc.Sim(resting("box", ".05 .05 .05", friction, "pyramidal")))
    assert "sinks without end" in text


STEEP = 'friction="20"'
GIVEN = {
    "a pair": ("", "", '<contact><pair geom1="f" geom2="b" friction="20 20"/></contact>', True),
    "the override": ("", "", "", True),
    "priority": ('priority="1" friction="20"', "", "", True),
    "less by priority": ('priority="1"', STEEP, "", False),
    "one way": (STEEP + ' condim="1"', STEEP + ' condim="1"', "", False),
    "excluded": (STEEP, STEEP, '<contact><exclude body1="world" body2="c"/></contact>', False),
}


@pytest.mark.parametrize("given", GIVEN)
def test_pyramids_are_those_of_the_pairs_that_meet(given):
    floor, box, contact, soft = GIVEN[given]
    option = '<option o_friction="20 20"><flag override="enable"/></option>'
    scene = sc.loads(
        f"""<mujoco>{option if given == "the override" else ""}<worldbody>
        <geom name="f" type="plane" size="9 9 1" {floor}/>
        <body name="c" pos="0 0 .1"><freejoint/><geom name="b" type="box" size=".1 .1 .1" {box}/>
        </body></worldbody>{contact}</mujoco>"""
    )
    _, said = warned(lambda: sc.Sim(scene))
    assert bool(said) == soft


def test_a_heap_is_told_of_its_floor():
    body = (
        '<body pos="0 0 {0}.1"><freejoint/><geom type="box" size=".1 .1 .1" friction="9"/></body>'
    )
    boxes = "".join(body.format(i) for i in range(80))
    text = f'<mujoco><worldbody><geom type="plane" size="9 9 1"/>{boxes}</worldbody></mujoco>'
    assert sc.loads(text).compile().is_heap
    assert "friction 9" in warned(lambda: sc.Sim(sc.loads(text)))[1][0]


# A plate on two slides, each damped, with connects between.
LOOP = """<mujoco><worldbody>
<body name="a"><joint name="left" type="slide" axis="0 0 1" damping="{0}"/>
<geom size=".02" mass="{1}" contype="0" conaffinity="0"/></body>
<body name="b" pos=".2 0 0"><joint name="right" type="slide" axis="0 0 1" damping="{2}"/>
<geom size=".02" mass="{1}" contype="0" conaffinity="0"/></body>
<body name="p" pos="0 0 .1"><joint type="slide" axis="0 0 1"/><joint type="hinge" axis="0 1 0"/>
<geom type="box" size=".2 .05 .01" pos=".1 0 0" mass="1" contype="0" conaffinity="0"/></body>
</worldbody><equality><connect body1="a" body2="p" anchor="0 0 .1"/>
<connect body1="b" body2="p" anchor="0 0 .1"/></equality></mujoco>"""


@pytest.mark.parametrize("integrator", ["euler", "implicitfast", "discrete", "semi-implicit"])
@pytest.mark.parametrize("mass", [0.001, 0.01])
@pytest.mark.parametrize("ratio", [0.1, 1, 30, 300])
def test_damping_that_undoes_the_rows_is_told(integrator, mass, ratio):
    """Told where it may diverge: without a word the loop stays closed."""
    dt = 0.002
    damping = ratio * mass / dt / 3
    scene = sc.loads(LOOP.format(damping, mass, 3 * damping))
    how = {"law": "rigid", "solver": "pgs", "sweeps": "auto", "integrator": integrator}
    sim, said = warned(lambda: sc.Sim(scene, dt=dt, **how))
    assert bool(said) == (ratio > 5 and integrator in ("euler", "implicitfast"))
    if said:
        assert "damping of joint `right`" in said[0]
        return
    if integrator != "semi-implicit" or ratio <= 1:
        sim.step(1000)
        assert np.isfinite(sim.qpos).all() and abs(sim.qpos[0] - sim.qpos[2]) < 2e-4


@pytest.mark.filterwarnings("ignore::stepcore.StiffnessWarning")
@pytest.mark.parametrize("integrator", ["euler", "implicitfast"])
@pytest.mark.parametrize(("ratio", "told"), [(1, False), (30, True)])
def test_a_damper_between_the_legs_of_a_loop_is_told(integrator, ratio, told):
    """`euler` damps tendons before the rows, `implicitfast` after them."""
    mass, dt = 0.001, 0.002
    damping = ratio * mass / dt / 2
    rope = f'<fixed name="rope" damping="{damping}"><joint joint="left" coef="1"/>'
    tendon = f'<tendon>{rope}<joint joint="right" coef="-1"/></fixed></tendon></mujoco>'
    scene = sc.loads(LOOP.format(0, mass, 0).replace("</mujoco>", tendon))
    how = {"law": "rigid", "solver": "pgs", "sweeps": "auto", "integrator": integrator}
    _, said = warned(lambda: sc.Sim(scene, dt=dt, **how))
    assert bool(said) == (told and integrator == "implicitfast")
    if said:
        assert "damping of tendon `rope`" in said[0]


def test_solref_is_not_warned_of():
    _, said = warned(lambda: sc.Sim(sc.loads(LOOP.format(50, 0.001, 150)), integrator="euler"))
    assert not said


CART = """
<mujoco><worldbody><geom type="plane" size="2 2 1"/>
  <body pos="0 0 .05"><joint type="slide" axis="0 0 1"/><joint type="slide" axis="1 0 0"/>
    <geom type="box" size=".1 .05 .01" pos="0 0 .04" mass="1"/>
    <body><joint name="wheel" axis="0 1 0" armature=".01" frictionloss=".1"/>
      <geom type="cylinder" quat="1 1 0 0" size=".05 .01" mass=".1" friction="1.5"/></body>
  </body>
</worldbody><actuator><velocity joint="wheel" kv="5"/></actuator></mujoco>"""


def test_of_what_a_measurement_tries_nothing_is_told():
    """Which element limits the step is found by softening each: then this wheel sinks."""
    diagnosis, said = warned(lambda: sc.diagnose(sc.loads(CART)))
    assert diagnosis.limit("euler") < 0.02 and not said
    _, said = warned(lambda: sc.diagnose(resting("box", ".05 .05 .05", 7, "pyramidal")))
    assert len(said) == 1
