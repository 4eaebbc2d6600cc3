"""The numpy reference by itself: its mechanics against MuJoCo, its solver against the problem."""

import mujoco
import numpy as np
import pytest
from engines import make
from oracle import Sim, solve

import stepcore as sc
from stepcore import lesson
from stepcore.scene.scene import Scene

KINDS = (
    # parent, joints of the body
    (0, ("free",)),
    (1, ("hinge", "slide", "hinge")),
    (2, ("slide", "ball")),
    (3, ("hinge",)),
    (1, ("ball", "slide")),
    (0, ("slide", "hinge")),
)

INERTIAL = '<inertial mass="2" pos=".1 0 0" diaginertia="1 1 1.5"/>'


def random_tree(rng):
    """The same random tree of every joint type as a Scene and as MuJoCo's model."""
    scene, spec = Scene(), mujoco.MjSpec()
    spec.compiler.degree = False
    bodies, theirs = [scene.world], [spec.worldbody]
    for parent, joints in KINDS:
        quat = rng.normal(size=4)
        turn = np.linalg.qr(rng.normal(size=(3, 3)))[0]
        inertia = turn @ np.diag(rng.uniform(0.5, 0.7, 3)) @ turn.T
        six = [inertia[i, j] for i, j in ((0, 0), (1, 1), (2, 2), (0, 1), (0, 2), (1, 2))]
        pos, ipos, mass = rng.normal(size=3), rng.normal(size=3), rng.uniform(0.5, 2)
        body = scene.add_body("", bodies[parent], pos, quat, mass=mass, ipos=ipos, inertia=six)
        other = theirs[parent].add_body(pos=pos, quat=quat, mass=mass, ipos=ipos)
        other.fullinertia, other.explicitinertial = six, True
        for kind in joints:
            ours = {"stiffness": 1.3, "damping": 0.4, "armature": 0.05}
            if kind != "free":
                ours["pos"] = rng.normal(size=3)
            if kind in ("slide", "hinge"):
                ours |= {"ref": rng.normal(), "springref": rng.normal(), "axis": rng.normal(size=3)}
            scene.add_joint(body, kind, **ours)
            made = other.add_joint(type=getattr(mujoco.mjtJoint, f"mjJNT_{kind.upper()}"))
            for name, value in ours.items():
                field = getattr(made, name)
                if isinstance(field, np.ndarray) and not np.ndim(value):
                    field[:] = [value] + [0.0] * (len(field) - 1)
                else:
                    setattr(made, name, value)
        bodies.append(body)
        theirs.append(other)
    return scene, spec.compile()


def test_mechanics_against_mujoco():
    """Poses, mass matrix, bias, springs, dampers and applied forces of a random tree, 1e-12."""
    rng = np.random.default_rng(5)
    scene, model = random_tree(rng)
    data = mujoco.MjData(model)
    sim = Sim(scene, law="lesson")
    assert sim.qpos == pytest.approx(model.qpos0, abs=1e-15)
    for _ in range(10):
        data.qpos[:], data.qvel[:] = rng.normal(size=model.nq), 3 * rng.normal(size=model.nv)
        mujoco.mj_normalizeQuat(model, data.qpos)
        data.xfrc_applied[1:] = rng.normal(size=(model.nbody - 1, 6))
        data.qfrc_applied[:] = rng.normal(size=model.nv)
        mujoco.mj_forward(model, data)
        sim.qpos[:], sim.qvel[:] = data.qpos, data.qvel
        sim.xfrc_applied[:], sim.qfrc_applied[:] = data.xfrc_applied, data.qfrc_applied
        sim.forward()
        full = np.zeros((model.nv, model.nv))
        mujoco.mj_fullM(model, data, full)
        for ours, theirs in (
            (sim.xpos, data.xpos),
            (sim.mass_matrix(), full),
            (sim.qacc, data.qacc),
        ):
            assert np.abs(ours - theirs).max() < 1e-12 * max(1.0, np.abs(theirs).max())
        mujoco.mj_energyPos(model, data)
        mujoco.mj_energyVel(model, data)
        assert sim.energy[::-1] == pytest.approx(data.energy, rel=1e-12)


@pytest.mark.parametrize("cone", ["elliptic", "pyramidal"])
@pytest.mark.parametrize("scale", [(1, 1), (1e-6, 1e6), (1, 0)])
def test_friction_block_is_the_minimum(cone, scale):
    """No point of the disc or box has a lower x A x/2 + g x than the one returned."""
    rng = np.random.default_rng(1)
    for _ in range(50):
        root = rng.normal(size=(2, 2)) * np.sqrt(scale)
        A, g, bound = root.T @ root, rng.normal(size=2) * np.sqrt(scale), rng.uniform(0.01, 3)
        x = (solve.in_disc if cone == "elliptic" else solve.in_box)(A, g, bound)
        norm = 2 if cone == "elliptic" else np.inf
        assert np.linalg.norm(x, norm) <= bound * (1 + 1e-15)
        trials = rng.uniform(-bound, bound, (2000, 2))
        trials = trials[np.linalg.norm(trials, norm, axis=1) <= bound]
        cost = 0.5 * np.einsum("ni,ij,nj->n", trials, A, trials) + trials @ g
        mine = 0.5 * x @ A @ x + g @ x
        assert mine <= cost.min() + 1e-12 * abs(mine)


@pytest.mark.parametrize("project", [solve.onto_round, solve.onto_box])
def test_projection_is_the_nearest_point(project):
    """p is in the cone, x - p is normal to p and makes no acute angle with the cone."""
    rng = np.random.default_rng(2)
    for _ in range(200):
        x, mu = rng.normal(size=3), rng.uniform(0.1, 2)
        p = project(x, mu)
        assert (x - p) @ p == pytest.approx(0, abs=1e-12)
        n = rng.uniform(0, 3, 200)
        side = rng.uniform(-1, 1, (200, 2))
        if project is solve.onto_round:
            side /= np.maximum(1, np.linalg.norm(side, axis=1))[:, None]
        points = np.column_stack([n, (mu * n)[:, None] * side])
        assert ((x - p) @ points.T).max() < 1e-12


def test_tolerance_and_residual():
    """A tolerance stops the sweeps once the residual is below it, and not one sweep sooner."""
    scene = lesson.stack(1000, "lesson", (1.0,) * 4)
    sim = make("numpy", scene, tolerance=1e-6)
    sim.qpos[:] = [-1e-5, -2e-5, -3e-5, -4e-5]
    sim.forward()
    done = sim.sweeps_done
    assert sim.residual <= 1e-6
    before = make("numpy", scene, sweeps=done - 1)
    before.qpos[:] = sim.qpos
    before.forward()
    assert before.residual > 1e-6


def test_residual_of_one_ball_is_its_velocity_error():
    """With no sweep at all the ball keeps the speed that the floor should have taken."""
    sim = make("numpy", lesson.drop(), sweeps=0, softness=0.0)
    sim.qpos[0], sim.qvel[0] = 0.0, -3.0
    sim.forward()
    assert sim.residual == pytest.approx(3.0 + 9.81 * 0.002, rel=1e-12)


def test_snapshot_continues_bit_for_bit():
    """A state taken after 7 steps and restored gives the same next 20 steps."""
    sim = make("numpy", lesson.grasp(), "start", sweeps=3, tolerance=0.0)
    sim.qvel[0] = 0.1
    sim.step(7)
    state = sim.state()
    sim.step(20)
    first = sim.qpos.copy()
    sim.restore(state)
    sim.step(20)
    assert np.array_equal(sim.qpos, first)
    assert sim.time == pytest.approx(27 * 0.002)


@pytest.mark.parametrize(
    ("setting", "value"),
    [("law", "solref"), ("integrator", "euler"), ("solver", "newton"), ("precision", "f32")],
)
def test_what_it_does_not_have_is_refused(setting, value):
    """The reference says what it has instead."""
    with pytest.raises(ValueError, match=f"{setting} '{value}': the reference has"):
        make("numpy", lesson.drop(), **{setting: value})


def test_unknown_shapes_are_refused_by_name():
    """A box on a box has no contact here: the pair is named before any step."""
    scene = Scene()
    scene.add_geom("world", "box", (1, 1, 1), name="floor")
    box = scene.add_body("box")
    scene.add_joint(box, "free")
    scene.add_geom(box, "box", (1, 1, 1), name="crate")
    with pytest.raises(ValueError, match="'floor' and 'crate'"):
        make("numpy", scene)


SOLIDS = {
    "box": (0.1, 0.15, 0.07),
    "cylinder": (0.1, 0.06),
    "ellipsoid": (0.1, 0.14, 0.06),
    "sphere": (0.1,),
}


def solids_on_a_slope():
    """Each on its own stretch of a tilted plane; the friction of one in all ways."""
    scene = Scene()
    scene.add_geom("world", "plane", (0, 0, 1), quat=(0.995, 0.07, -0.07, 0.0))
    for i, (kind, size) in enumerate(SOLIDS.items()):
        body = scene.add_body(kind, pos=(0.5 * i, 0, 0.25 - 0.07 * i))
        scene.add_joint(body, "free")
        condim = 6 if kind == "cylinder" else 3
        only_plane = {"contype": 2, "conaffinity": 1}
        friction = (0.4, 0.01, 0.005)
        scene.add_geom(
            body, kind, size, mass=1.0 + i, condim=condim, friction=friction, **only_plane
        )
    return scene


@pytest.mark.parametrize("cone", ["elliptic", "pyramidal"])
@pytest.mark.parametrize("law", ["rigid", "lesson", "relaxed", "penalty"])
def test_solids_tumble_on_a_plane_as_in_the_engine(law, cone):
    """The same contacts in the same order: the same state in each of 150 steps, warm started."""
    softness = 1e-3 if law in ("lesson", "relaxed") else 0.0
    settings = {"law": law, "cone": cone, "softness": softness, "sweeps": 8, "warm_start": True}
    sims = [make(engine, solids_on_a_slope(), **settings) for engine in ("rust", "numpy")]
    rng = np.random.default_rng(3)
    spin, rows = 2 * rng.normal(size=24), 0
    for sim in sims:
        sim.qvel[:] = spin
    for _ in range(150):
        for sim in sims:
            sim.step()
        assert sims[0].qpos == pytest.approx(sims[1].qpos, abs=1e-9)
        assert sims[0].qvel == pytest.approx(sims[1].qvel, abs=1e-7)
        rows = max(rows, len(sims[1].rows))
    assert law == "penalty" or rows >= 4 * 3


@pytest.mark.parametrize("kind", SOLIDS)
def test_contacts_on_a_plane_are_the_engines(kind):
    """Distances and points at a hundred poses, upright ones among them."""
    scene = Scene()
    scene.add_geom("world", "plane", (0, 0, 1), quat=(0.9, 0.3, -0.2, 0.1), pos=(0.1, 0.2, 0.3))
    body = scene.add_body("solid")
    scene.add_joint(body, "free")
    scene.add_geom(body, kind, SOLIDS[kind], pos=(0.01, 0.02, 0.03), quat=(0.9, 0.3, -0.2, 0.1))
    ours, theirs = Sim(scene, law="rigid"), sc.Sim(scene)
    rng = np.random.default_rng(4)
    for trial in range(100):
        turn = (1, 0, 0, 0) if trial % 10 == 0 else rng.normal(size=4)
        pose = np.concatenate([0.05 * rng.normal(size=3), turn / np.linalg.norm(turn)])
        ours.qpos[:] = theirs.qpos[:] = pose
        ours.forward()
        theirs.forward()
        mine = [c for c in ours.contacts if c.dist < 0]
        other = list(theirs.contacts)
        assert len(mine) == len(other)
        for a, b in zip(mine, other, strict=True):
            assert a.dist == pytest.approx(b["dist"], abs=1e-14)
            assert a.pos == pytest.approx(b["pos"], abs=1e-14)


def weighed(compiler="", geom="", inertial=""):
    """A body of two geoms; the reference's mass matrix and the engine's."""
    scene = sc.loads(
        f"""<mujoco><compiler {compiler}/><worldbody><geom size="1"/><body pos="0 0 3">
        <joint axis="0 1 0"/>{inertial}<geom size=".1" pos=".2 0 0" {geom}/>
        <geom type="box" size=".1 .2 .3" pos="0 0 .5" group="3"/></body></worldbody></mujoco>"""
    )
    return Sim(scene), sc.Sim(scene)


@pytest.mark.parametrize(
    "words",
    [
        {"compiler": 'settotalmass="5"'},
        {"compiler": 'inertiagrouprange="0 1"'},
        {"compiler": 'inertiagrouprange="4 5"', "inertial": INERTIAL},
        {"compiler": 'inertiafromgeom="true"', "inertial": INERTIAL},
        {"compiler": 'inertiafromgeom="true" inertiagrouprange="4 5"', "inertial": INERTIAL},
        {"compiler": 'inertiafromgeom="false" settotalmass="2"', "inertial": INERTIAL},
    ],
)
def test_mass_rules_of_the_reference_are_those_of_the_engine(words):
    ours, theirs = weighed(**words)
    assert ours.mass_matrix() == pytest.approx(theirs.mass_matrix(), rel=1e-13)
    assert ours.energy.potential == pytest.approx(theirs.energy.potential, rel=1e-13)


@pytest.mark.parametrize(
    "words, name",
    [
        ({"geom": 'shellinertia="true"'}, "shell_inertia"),
        ({"compiler": 'boundmass="3"'}, "bound_mass"),
        ({"compiler": 'boundinertia="2"'}, "bound_inertia"),
        ({"compiler": 'balanceinertia="true"'}, "balance_inertia"),
    ],
)
def test_mass_rules_that_the_reference_lacks_are_refused_by_name(words, name):
    with pytest.raises(ValueError, match=f"the reference has no {name}"):
        weighed(**words)


def test_the_mass_matrix_of_the_reference_follows_the_state():
    scene, _ = random_tree(np.random.default_rng(6))
    ours, theirs = Sim(scene), sc.Sim(scene)
    ours.qpos[:] = theirs.qpos[:] = ours.qpos + np.random.default_rng(7).normal(size=ours.qpos.size)
    mass = theirs.mass_matrix()
    assert ours.mass_matrix() == pytest.approx(mass, rel=1e-12, abs=1e-12 * mass.max())
