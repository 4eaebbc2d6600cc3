"""Every cell of law × solver × integrator × precision × element, in lanes and alone, for two steps.

What is reported as forces is what changed the velocity; ways to compute the same agree. Each
element shares an island with a contact and two limits, so that none is tried alone.
"""

import itertools

import numpy as np
import pytest
from covering import every_pair

import stepcore as sc

LAWS = ("solref", "penalty", "lesson", "relaxed", "rigid")
INTEGRATORS = (
    *("explicit", "semi-implicit", "euler", "implicitfast", "implicit", "discrete"),
    *("midpoint", "rk4"),
)
# Whose one stage changes the velocity by dt·M̂⁻¹ of the forces at its begin.
ONE_STAGE = INTEGRATORS[:6]

# A leg on the floor with both joints beyond their limits, and beside it a body of each kind.
LEG = """<body name="leg" pos="0 0 .3"><joint name="hip" axis="0 1 0" range="5 40" {hip}/>
  <geom type="capsule" size=".02" fromto="0 0 0 .2 0 -.1"/><site name="thigh" pos=".1 0 -.05"/>
  <body name="shin" pos=".2 0 -.1"><joint name="knee" axis="0 1 0" range="5 40" {knee}/>
    <geom name="foot" type="capsule" size=".05" fromto="0 0 0 .2 0 -.17" {foot}/>
    <site name="tip" pos=".1 0 -.09"/></body></body>"""
BALL = """<body name="ball" pos=".57 0 .098"><freejoint/>
  <geom name="ball" type="{shape}" size=".1 .1 .1" mass="2" {ball}/></body>"""
ADHERES = '<actuator><adhesion body="ball" ctrlrange="0 1" gain="60"/></actuator>'
TIED = """<tendon><fixed {}><joint joint="hip" coef="1"/><joint joint="knee" coef="-.5"/></fixed>
  </tendon>"""


def cell(extra="", floor="", shape="sphere", **parts):
    text = LEG + BALL
    given = {"hip": "", "knee": "", "foot": "", "ball": "", "shape": shape} | parts
    world = f'<geom name="floor" type="plane" size="2 2 .1" {floor}/>{text.format(**given)}'
    return f'<mujoco><option timestep=".002"/><worldbody>{world}</worldbody>{extra}</mujoco>'


SCENES = {
    "contacts and limits": cell(),
    "no friction": cell(ball='condim="1"', foot='condim="1"', floor='condim="1"'),
    "all ways of friction": cell(ball='condim="6"', foot='condim="6"'),
    "box": cell(shape="box"),
    "cylinder": cell(shape="cylinder"),
    "friction loss": cell(hip='frictionloss="3"', knee='frictionloss="40"'),
    "weld": cell("<equality><weld body1='shin' body2='ball'/></equality>"),
    "connect": cell("<equality><connect body1='shin' body2='ball' anchor='.3 0 0'/></equality>"),
    "coupled joints": cell("<equality><joint joint1='hip' joint2='knee'/></equality>"),
    "tendon limit": cell(TIED.format("range='-.1 .1'")),
    "tendon friction": cell(TIED.format("frictionloss='5'")),
    "tendon armature": cell(TIED.format("armature='.5'")),
    "adhesion of an actuator": cell(ADHERES, ball='gap=".05"'),
    "adhesion of a cylinder": cell(ADHERES, shape="cylinder", ball='gap=".05"'),
    "motor": cell("<actuator><motor joint='knee' gear='30'/></actuator>"),
    "bounded servo": cell(
        "<actuator><position joint='knee' kp='4000' forcerange='-20 20'/></actuator>"
    ),
    "muscle": cell("<actuator><muscle joint='knee' lengthrange='-.5 .9' force='200'/></actuator>"),
    "filtered motor": cell(
        "<actuator><general joint='knee' dyntype='filter' dynprm='.01' gainprm='30'/></actuator>"
    ),
    "springs": cell(hip='stiffness="400"', knee='stiffness="900" damping="7"'),
    "tendon spring": cell(TIED.format("stiffness='300' damping='4'")),
    "gravity compensation": cell().replace('name="shin"', 'name="shin" gravcomp=".7"'),
    "belt": cell(floor='surfacevel="0 0 0 .5 .2 0"'),
}
STICKS = {
    "adhesion of a geom": cell(ball='gap=".05" adhesion="30"'),
    "adhesion of a box": cell(shape="box", ball='gap=".05" adhesion="30"', foot='adhesion="5"'),
}
MODELS: dict[str, sc.Model] = {}


def model_of(name):
    if name not in MODELS:
        MODELS[name] = sc.loads((SCENES | STICKS)[name]).compile()
    return MODELS[name]


def settings_of(law, solver, integrator, precision="f64"):
    exact = {"tolerance": 1e-13 if precision == "f64" else 0.0, "sweeps": 4000}
    if precision == "f32":
        exact["sweeps"] = 1500
    return {"law": law, "solver": solver, "integrator": integrator, "precision": precision} | exact


def start(model, worlds):
    """Some worlds on the floor, some within the gap, some fast: the first is the scene as it is."""
    rng = np.random.default_rng(3)
    qpos = np.tile(model.qpos0, (worlds, 1))
    qvel = np.zeros((worlds, model.nv))
    for world in range(1, worlds):
        qpos[world, 4] += (0.0, 0.01, 0.045)[world % 3]
        qvel[world, :5] = rng.normal(size=5) * (0.1, 1.0, 4.0)[world % 3]
    return qpos, qvel, np.full(model.nu, 0.8)


def put(world, qpos, qvel, ctrl):
    world.qpos[:], world.qvel[:], world.ctrl[:] = qpos, qvel, ctrl


def balance(sim):
    """What is missing in M Δv/dt + bias = Σ forces, by element and in the terms of MuJoCo's sum.

    And where contacts are where they act: what their forces and torques miss of those of elements.
    All relative to the largest force.
    """
    sim.forward()
    mass, bias, before = sim.mass_matrix(), sim.bias.copy(), sim.qvel.copy()
    passive, nothing = sim.passive.copy(), np.zeros(sim.model.nv)
    by = kinds(sim)
    wrenches = by_wrenches(sim) - by.get("contact", nothing)
    if sim.settings.law not in ("solref", "penalty"):
        wrenches = nothing
    size = max(np.abs(force).max() for force in by.values()) + 1.0
    sim.step()
    gained = mass @ (sim.qvel - before) / sim.settings.dt
    by = kinds(sim)
    given = sum(by.values()) - by.pop("gravity", 0.0)
    total = sim.constraint_force + passive + by.get("actuator", nothing)
    return np.abs([gained + bias - given, total - given, wrenches]).max(axis=1) / size


def kinds(sim):
    """The forces of all elements of each kind."""
    by = {}
    for (kind, _), force in sim.element_forces().items():
        by[kind] = by.get(kind, 0.0) + force
    return by


def by_wrenches(sim):
    """The contacts' forces and torques, as each says them, on the dofs."""
    force, bodies = np.zeros(sim.model.nv), sim.model.geom_body
    for contact in sim.contacts:
        wrench = np.concatenate([contact["force"], contact["torque"]])
        for geom, side in (("geom1", -1.0), ("geom2", 1.0)):
            jacobian = sim.jacobian(int(bodies[contact[geom]]), contact["pos"])
            force += side * jacobian.T @ wrench
    return force


def taken(law, integrator, name):
    """Laws on the guess refuse the adhesion of geoms."""
    return name not in STICKS or law in ("solref", "penalty")


# Rows that penalty makes as hard as can be, which Newton's method refuses.
HARD = {"friction loss", "weld", "connect", "coupled joints", "tendon friction"}


def solvers(law, name):
    newton = law == "solref" or (law == "penalty" and name not in HARD)
    return ("newton", "pgs") if newton else ("pgs",)


@every_pair(taken, law=LAWS, integrator=INTEGRATORS, name=[*SCENES, *STICKS])
def test_a_cell(law, integrator, name):
    model, worlds = model_of(name), 11
    qpos, qvel, ctrl = start(model, worlds)
    ends = {}
    for solver, precision in itertools.product(solvers(law, name), ("f64", "f32")):
        settings = settings_of(law, solver, integrator, precision)
        runs = []
        for lanes in (False, True):
            batch = sc.Batch(model, worlds, threads=1, lanes=lanes, **settings)
            put(batch, qpos, qvel, ctrl)
            failed = ""
            try:
                batch.step(2)
            except sc.SimulationError as error:
                # Where midpoint's iteration does not converge, it does not in lanes either.
                failed = f"{error.step} {error.world}"
                assert integrator == "midpoint" and "does not converge" in str(error)
            runs.append((failed, batch.qpos.tobytes(), batch.qvel.tobytes()))
        assert runs[0] == runs[1], f"{solver} {precision}: lanes have other bits"
        if not failed:
            ends[solver, precision] = batch.qvel.copy()
    if ("pgs", "f64") not in ends:
        return
    scale = np.abs(ends["pgs", "f64"]).max(axis=1, keepdims=True) + 1.0
    for (solver, precision), end in ends.items():
        most = 1e-6 if precision == "f64" else 2e-2
        apart = (np.abs(end - ends["pgs", "f64"]) / scale).max()
        assert apart < most, f"{solver} {precision}: other velocities by {apart}"


@every_pair(taken, law=LAWS, integrator=INTEGRATORS[:2], name=[*SCENES, *STICKS])
def test_what_is_reported_is_what_moved(law, integrator, name):
    model = model_of(name)
    qpos, qvel, ctrl = start(model, 4)
    for solver, world in itertools.product(solvers(law, name), range(4)):
        sim = sc.Sim(model, **settings_of(law, solver, integrator))
        put(sim, qpos[world], qvel[world], ctrl)
        for _ in range(2):
            missing = balance(sim)
            assert missing.max() < 1e-9, (solver, world, missing)


# Without dampers, springs and servos all integrators of one stage have one velocity.
UNDAMPED = [
    *("contacts and limits", "no friction", "box", "friction loss", "weld", "coupled joints"),
    *("tendon limit", "adhesion of an actuator", "motor", "gravity compensation", "belt"),
]


@every_pair(name=UNDAMPED, law=LAWS)
def test_integrators_of_one_stage_agree_where_nothing_is_damped(law, name):
    model = model_of(name)
    qpos, qvel, ctrl = start(model, 4)
    qvel[:, :2] = 0.0
    ends = {}
    for integrator in ONE_STAGE:
        batch = sc.Batch(model, 4, threads=1, **settings_of(law, "pgs", integrator))
        put(batch, qpos, qvel, ctrl)
        batch.step()
        ends[integrator] = batch.qvel.copy()
    for integrator, end in ends.items():
        assert end == pytest.approx(ends["semi-implicit"], rel=1e-9, abs=1e-9), integrator
