"""`diagnose` names limits that a run confirms: the same one for every wanted dt, at steps between
those at which a motion holds by luck, and by elements that move the limit."""

import functools
import math
import re
from types import SimpleNamespace

import numpy as np
import pytest
from stiff import diagnosed

import stepcore as sc
from stepcore.engine.element import Element, ElementSlopes
from stepcore.experiment.passage import Passages
from stepcore.measure.diagnosis import held_elements, motion_limit, shares
from stepcore.measure.diagnosis.circulation import circulatory
from stepcore.measure.diagnosis.linear_motion import LinearMotion
from stepcore.measure.diagnosis.motion_check import Outcome

# Steps beyond a limit are run on purpose.
pytestmark = pytest.mark.filterwarnings("ignore::stepcore.EnergyWarning")


def run(scene, dt, seconds=1.0, integrator=None):
    """A Sim after a run from the first keyframe, or from the scene's pose."""
    sim = sc.Sim(scene.compile(), dt=dt, **({"integrator": integrator} if integrator else {}))
    if scene.keys:
        sim.reset(key=0)
    sim.step(round(seconds / dt))
    return sim


# --- one motion, one limit ------------------------------------------------------------------------

PENDULUM = """<mujoco><option timestep="0.002" integrator="implicitfast" gravity="0 0 0"/>
<worldbody><body><joint name="j" axis="0 0 1"/>
  <inertial pos="0 0 0" mass="1" diaginertia="1 1 .01"/></body></worldbody>
<actuator><position name="servo" joint="j" kp="400" kv="20" forcerange="-5 5"/></actuator>
<keyframe><key qpos="3" ctrl="0"/></keyframe></mujoco>"""


@functools.cache
def pendulum(dt):
    return diagnosed(sc.loads(PENDULUM), dt=dt, kind="hold")


def test_every_wanted_dt_names_the_same_limit():
    """Law: the limit belongs to the motion, so it does not depend on the step that is asked for."""
    every = [pendulum(dt) for dt in (0.0011, 0.02)]
    limits = [d.limit() for d in every]
    assert math.isfinite(limits[0]) and limits == [limits[0]] * len(limits)
    assert {d.stiffest() for d in every} == {"servo `servo`"}


def test_a_saturated_servo_is_said_to_be_so():
    """The frequency of the servo on its own has nothing to do with the limit of its chatter."""
    d = pendulum(0.02)
    assert d.limits["implicitfast"].outcome == "chatters"
    assert (
        f"servo `servo`, while saturated, limits dt to {1e3 * d.limit():.3g} ms" in d.sentences[0]
    )


class Window:
    """A judge of a motion that fails at steps of 18 to 27 ms alone."""

    longest = 0.125
    fine = SimpleNamespace(dt=1e-3, reached=1.0)
    real = SimpleNamespace(most=20_000)

    def outcome(self, integrator, dt, more):
        return Outcome("explodes" if 0.018 < dt < 0.027 else "holds", 1.0, 1.0)


@pytest.mark.parametrize("linear", [math.inf, 0.1])
def test_failures_between_steps_that_hold_are_found(linear):
    """A body that makes whole turns in a step holds at 62 and 125 ms, and fails at 20 ms."""
    search = motion_limit._Search(Window(), "euler", Window.longest)
    assert search.limit(linear, 0.002, decisive=True) == pytest.approx(0.018, rel=0.03)


# --- what is a failure, and what is not -----------------------------------------------------------


def stack(count=3):
    """Boxes that touch at rest, on a floor."""
    boxes = "".join(
        f'<body name="b{i}" pos="0 0 {0.05 + 0.1 * i}"><freejoint/>'
        '<geom type="box" size=".05 .05 .05" mass="1"/></body>'
        for i in range(count)
    )
    return sc.loads(
        '<mujoco><option timestep="0.005"/><worldbody><geom type="plane" size="2 2 .1"/>'
        f"{boxes}</worldbody></mujoco>"
    )


def test_a_stack_that_settles_has_not_exploded():
    """Law: a step of free fall gives a box ½ m (g dt)², before its contact can hold it. The stack
    comes to rest at 30 ms, stepped here, so no limit lies below."""
    scene = stack(2)
    assert run(scene, 0.03, 2.0).energy.kinetic < 1e-6
    assert diagnosed(scene).limit() > 0.03


def plate(height=0.3):
    """A ball that falls onto a thin plate high above nothing."""
    return sc.loads(f"""<mujoco><option timestep="0.002"/><worldbody>
    <geom name="plate" type="box" size=".5 .5 .005"/>
    <body name="ball" pos="0 0 {height}"><freejoint/><geom name="ball" size=".03" mass=".1"/></body>
    </worldbody></mujoco>""")


def test_a_ball_that_falls_through_a_plate_has_failed():
    """Stepped here: at 0.9 of the limit the ball ends on the plate, and at some step above, tried
    at small intervals up to twice the limit, below it."""
    scene = plate()
    d = diagnosed(scene, dt=0.004)
    limit = d.limits["euler"]
    assert limit.outcome == "passes" and d.stiffest() == "contact `ball`/`plate`"
    assert run(scene, 0.9 * limit.dt).xpos[1, 2] > 0
    beyond = [run(scene, part * limit.dt).xpos[1, 2] for part in np.geomspace(1.01, 2, 20)]
    assert min(beyond) < -0.1
    assert "lets one body pass through the other" in " ".join(d.sentences)


@pytest.mark.parametrize(("dt", "through"), [(0.001, False), (0.04, True)])
def test_a_passage_is_seen_where_the_centre_leaves_on_the_other_side(dt, through):
    sim = sc.Sim(plate(0.5).compile(), dt=dt)
    passages = Passages(sim)
    for _ in range(round(0.8 / dt)):
        sim.step()
        passages.observe(sim)
    assert (float(sim.xpos[1, 2]) < 0) == through == bool(passages.found)


def test_a_ball_deep_in_the_floor_has_not_passed():
    """A floor has nothing behind it: whatever sinks into it is in contact, and comes back."""
    sim = sc.Sim(
        sc.loads("""<mujoco><worldbody><geom type="plane" size="1 1 .1"/>
    <body pos="0 0 .01"><freejoint/><geom size=".1" mass="1"/></body></worldbody>
    <keyframe><key qpos="0 0 .01 1 0 0 0" qvel="0 0 -5 0 0 0"/></keyframe></mujoco>""").compile()
    )
    sim.reset(key=0)
    passages = Passages(sim)
    for _ in range(200):
        sim.step()
        passages.observe(sim)
    assert not passages.found


# --- spinning bodies ------------------------------------------------------------------------------


def near_cube(speed=180.0, dt=0.005):
    """A free body of nearly equal moments of inertia; Euler adds to its energy slowly."""
    return sc.loads(f"""<mujoco><option timestep="{dt}" gravity="0 0 0"/><worldbody>
    <body name="b"><freejoint/><geom type="box" size=".1 .1 .101" mass="1"/></body></worldbody>
    <keyframe><key qpos="0 0 0 1 0 0 0" qvel="0 0 0 60 0 {speed}"/></keyframe></mujoco>""")


def test_a_step_beyond_half_a_turn_is_not_called_stable():
    """Law: at ω a body makes half a turn in π/ω; its nutation alone would allow 57 ms."""
    d = diagnosed(near_cube())
    speed = math.hypot(60, 180)
    assert d.limit("euler") == pytest.approx(math.pi / speed, rel=0.02)
    assert d.limits["euler"].outcome == "turns"
    assert f"spin of body `b` (at {speed:.3g} rad/s, half a turn a step)" in d.sentences[0].lower()


def test_energy_that_an_integrator_adds_is_told_in_per_cent():
    """Against the same run, stepped here."""
    scene = near_cube(dt=0.015)
    d = diagnosed(scene, horizon=10)
    sim = sc.Sim(scene.compile())
    sim.reset(key=0)
    begun = sim.energy.total
    sim.step(round(10 / 0.015))
    gained = sim.energy.total / begun - 1
    assert gained > 0.01 and d.gained == pytest.approx(gained, rel=0.1)
    if d.limit() >= 0.015:
        assert "the integrator adds" in d.sentences[0]


# --- servos without an energy ---------------------------------------------------------------------


def turned(actuators, ctrl):
    return sc.loads(f"""<mujoco><option timestep="0.002" gravity="0 0 0"/><worldbody>
    <body name="link" pos="0 0 1"><joint name="ball" type="ball" damping=".05" armature="0.01"/>
    <geom type="box" size=".05 .1 .2" mass="1"/></body></worldbody>
    <actuator>{actuators}</actuator>
    <keyframe><key qpos="0.5403023 0.4858 0.4858 0.4858" ctrl="{ctrl}"/></keyframe></mujoco>""")


AXES = "".join(
    f'<position name="b{axis}" joint="ball" gear="{gear}" kp="20"/>'
    for axis, gear in (("x", "1 0 0"), ("y", "0 1 0"), ("z", "0 0 1"))
)


def test_servos_on_a_ball_joint_are_no_gradient():
    """newton 3699. Law: without the circulatory part of their stiffness nothing grows; with it the
    motion grows at every dt and under every integrator, stepped here at 0.2 ms, from rest at the
    target."""
    scene = turned(AXES, "1.1547 1.1547 1.1547")
    d = diagnosed(scene, kind="hold")
    assert [element.name for element in d.circulation.elements] == [
        "servo `bx`",
        "servo `by`",
        "servo `bz`",
    ]
    assert d.circulation.growth == pytest.approx(14.24, rel=1e-3) and d.circulation.without == 0
    assert d.sentences[0].startswith("The 3 servos `bx`, `by`, `bz` on the joint `ball` are no ")
    assert "at any dt" in d.sentences[0]
    for integrator in ("euler", "discrete"):
        assert run(scene, 2e-4, 1.5, integrator).energy.kinetic > 10


ORIENTATION = '<orientation name="b" joint="ball" kp="20"/>'


@pytest.mark.parametrize(("kind", "servo"), [("actuator", ORIENTATION), ("spring", AXES)])
def test_a_torque_with_an_energy_is_not_circulatory(kind, servo):
    """Law: a potential's torque on a ball joint has K − Kᵀ = −[τ]×, and no circulatory part."""
    scene = turned(servo, "0 0 0")
    scene.joints[0].stiffness = 3.0
    sim = sc.Sim(scene.compile())
    sim.reset(key=0)
    sim.forward()
    slopes = [s for element, s in sim.element_slopes().items() if element.kind == kind]
    stiffness = sum(s.stiffness for s in slopes)
    assert np.abs(stiffness - stiffness.T).max() > 1
    assert np.abs(sum(circulatory(sim.model, s) for s in slopes)).max() < 1e-9


def test_no_frequency_is_printed_where_a_state_blows_up():
    d = diagnosed(turned(AXES, "1.1547 1.1547 1.1547"), kind="hold", horizon=3)
    assert all((row["frequency"] or 0) < 1e9 for row in d.table)
    assert not re.search(r"e\+(0?9|\d{2,})\b", d.text(full=True).replace("e+0", "e"))


# --- who is named ---------------------------------------------------------------------------------


class Fixed:
    """A rise of the limit that only some elements together cause."""

    def __init__(self, needed):
        self.needed, self.motion = set(needed), SimpleNamespace(elements={})

    def without(self, elements):
        return 2.0 if self.needed and self.needed <= set(elements) else 1.0


def test_an_element_is_named_only_if_it_moves_the_limit(monkeypatch):
    monkeypatch.setattr(shares, "_equal", lambda *_: False)
    a, b, c = (Element("spring", i, -1, name, "spring") for i, name in enumerate("abc"))
    parts = {a: 0.5, b: 0.3, c: 0.2}
    named = [
        shares._effective(Fixed(needed), [a, b, c], [a, b, c], parts)
        for needed in ([b], [a, b], [])
    ]
    assert named == [(b,), (a, b), ()]


def test_what_holds_an_element_is_found_by_leaving_out_the_others():
    """Law: ω h < 2 for the spring alone; a strong damper, treated implicitly, holds it."""
    spring, damper, weak = (
        Element(kind, 0, -1, name, kind)
        for kind, name in (("spring", "s"), ("damper", "d"), ("actuator", "a"))
    )
    stiffness, damping = np.array([[1e6]]), np.array([[1e4]])
    parts = {
        spring: ElementSlopes.of(stiffness, 0 * stiffness),
        damper: ElementSlopes.of(0 * stiffness, damping),
        weak: ElementSlopes.of(stiffness / 1e6, 0 * stiffness),
    }
    rates = np.array([[0.0, 1.0], [-1e6 - 1.0, -1e4]])
    motion = LinearMotion(np.eye(1), rates, parts, {"euler": frozenset({damper})})
    assert held_elements._holder(motion, spring, "euler", 3e-3, 1.0) == damper
    assert held_elements._holder(motion.scaled([damper], 1e-3), spring, "euler", 3e-3, 1.0) is None
