"""What can be read of bodies, rays and inverse dynamics, against MuJoCo, at states in contact.

Law: the same numbers to 1e-9 of the largest (what depends on the solver, where both solve exactly).
"""

import pickle

import mujoco
import numpy as np
import peers
import pytest
import zoo
from fallen import compiled, states_of, strict

import stepcore as sc

GYM = ("hopper", "half_cheetah", "ant", "reacher")
SCENES = [name for name in zoo.ZOO if name not in zoo.HEAPS]
BODIES = ("subtree_com", "cinert", "cvel")
FORCES = ("cacc", "cfrc_ext", "cfrc_int")
EXACT = 1e-9


def theirs_at(name, state):
    theirs = strict(name)
    data = mujoco.MjData(theirs)
    state.to_mujoco(theirs, data)
    mujoco.mj_forward(theirs, data)
    mujoco.mj_rnePostConstraint(theirs, data)
    return theirs, data


@pytest.mark.parametrize("name", [*GYM, *SCENES])
def test_bodies(name):
    ours = compiled(name)
    sim = sc.Sim(ours, **peers.EXACT)
    states = states_of(name)
    batch = sc.Batch(ours, len(states), **peers.EXACT)
    worst, alike = peers.Worst(), 0
    for index, state in enumerate(states):
        _, data = theirs_at(name, state)
        state.to_stepcore(sim)
        for field, value in vars(state).items():
            getattr(batch, field)[index] = value
        for field in BODIES:
            worst.note(field, peers.apart(getattr(sim, field), getattr(data, field)), index)
        worst.note("site_xmat", peers.apart(sim.site_xmat, data.site_xmat.reshape(-1, 3, 3)), index)
        sim.forward()
        # Where contact sets differ, so do the forces.
        if peers.contacts_apart(sim, data) > 1e-10:
            continue
        alike += 1
        force = 1e-2 * max(1.0, np.abs(data.qfrc_smooth).max(initial=0.0))
        for field in FORCES:
            value = getattr(data, field)
            # What the world is exerted is not measured about one point by MuJoCo.
            ours, value = getattr(sim, field)[1:], value[1:]
            worst.note(field, peers.apart(ours, value, force), index)
    assert alike >= 0.9 * len(states)
    worst.check(dict.fromkeys((*BODIES, *FORCES, "site_xmat"), EXACT), name)
    batch.forward()
    for field in (*BODIES, *FORCES):
        assert np.array_equal(getattr(batch, field)[-1], getattr(sim, field)), field


@pytest.mark.parametrize("name", [*GYM, *SCENES])
def test_inverse(name):
    sim = sc.Sim(compiled(name), **peers.EXACT)
    rng = np.random.default_rng(3)
    worst = peers.Worst()
    for index, state in enumerate(states_of(name)):
        theirs, data = theirs_at(name, state)
        state.to_stepcore(sim)
        qacc = data.qacc + (index % 2) * rng.normal(size=theirs.nv)
        sim.forward()
        if peers.contacts_apart(sim, data) > 1e-10:
            continue
        data.qacc[:] = qacc
        mujoco.mj_inverse(theirs, data)
        force = 1e-2 * max(1.0, np.abs(data.qfrc_smooth).max(initial=0.0))
        worst.note("inverse", peers.apart(sim.inverse(qacc), data.qfrc_inverse, force), index)
    # Pyramids of friction 1e-5 have regularisers that turn the rounding of qacc into forces.
    worst.check({"inverse": 0.2 if name == "slippery" else EXACT}, name)


def test_inverse_of_a_solve_is_what_was_applied():
    """Law: forces → acceleration → forces."""
    sim = sc.Sim(compiled("ant"), **peers.EXACT)
    state = states_of("ant")[7]
    state.to_stepcore(sim)
    sim.forward()
    mass = sim.mass_matrix()
    applied = mass @ sim.qacc + sim.bias - sim.passive - sim.constraint_force
    assert sim.inverse() == pytest.approx(applied, abs=1e-9 * np.abs(applied).max())


@pytest.mark.parametrize("law", ["lesson", "rigid"])
def test_inverse_needs_rows_that_have_one(law):
    with pytest.raises(ValueError, match="solref"):
        sc.Sim(compiled("hopper"), law=law, solver="pgs").inverse()


RAYED = """
<mujoco>
  <asset>
    <hfield name="hills" nrow="6" ncol="9" size="1.5 1 0.6 0.2" elevation="{heights}"/>
    <mesh name="wedge" vertex="-.3 -.2 -.2  .4 -.2 -.2  .3 .3 -.1  -.2 .4 -.2  0 0 .5"/>
    <mesh name="bent" inertia="shell"
      vertex="0 0 0  .5 0 0  0 .5 .1  0 -.5 .2" face="0 1 2  0 3 1"/>
  </asset>
  <worldbody>
    <geom type="plane" size="3 2 1" pos="0 0 -1" euler="5 3 0"/>
    <geom type="hfield" hfield="hills" pos="0 0 -.8" euler="4 -3 20" group="1"/>
    <body name="a" pos="-1 .5 .6"><freejoint/>
      <geom type="box" size=".3 .2 .25" euler="10 20 30"/>
      <geom type="capsule" size=".1 .3" pos="0 .5 .2"/></body>
    <body name="b" pos=".8 .3 .7"><freejoint/>
      <geom type="cylinder" size=".25 .2" euler="30 20 0" group="2"/>
      <geom type="ellipsoid" size=".3 .15 .2" pos="-.6 -.4 .1"/></body>
    <body name="c" pos="0 -.6 .5"><freejoint/>
      <geom type="mesh" mesh="wedge" euler="3 50 10"/>
      <geom type="sphere" size=".2" pos="-.7 0 0" group="7"/></body>
    <body name="d" pos=".9 -.6 .9"><freejoint/>
      <geom type="mesh" mesh="bent" contype="0" conaffinity="0"/></body>
  </worldbody>
</mujoco>"""


@pytest.fixture(scope="module")
def rayed():
    rng = np.random.default_rng(4)
    heights = " ".join(f"{x:.6f}" for x in rng.uniform(size=54))
    text = RAYED.format(heights=heights)
    theirs = mujoco.MjModel.from_xml_string(text)
    return sc.Sim(sc.loads(text)), theirs, mujoco.MjData(theirs)


@pytest.mark.parametrize("options", [{}, {"static": False}, {"exclude": "b"}, {"groups": (1, 5)}])
def test_rays(rayed, options):
    """Distance, geom and normal of 3,000 rays, those of many directions, lengths and origins."""
    sim, theirs, data = rayed
    rng = np.random.default_rng(5)
    body = theirs.body(options["exclude"]).id if "exclude" in options else -1
    groups = options.get("groups")
    groups = None if groups is None else np.isin(range(6), groups).astype(np.uint8)
    seen, compared = set(), 0
    for _ in range(30):
        qpos = theirs.qpos0.copy()
        peers.nudge(theirs, qpos, rng, 0.2)
        sim.qpos[:] = data.qpos[:] = qpos
        mujoco.mj_kinematics(theirs, data)
        origin = rng.normal(size=(100, 3)) * (1.5, 1.2, 1.2)
        direction = rng.normal(size=(100, 3))
        hits = sim.ray(origin, direction, **options)
        geom, normal = np.zeros(1, dtype=np.int32), np.zeros(3)
        for k in range(100):
            static = options.get("static", True)
            dist = mujoco.mj_ray(
                theirs, data, origin[k], direction[k], groups, static, body, geom, normal
            )
            if geom[0] != hits.geom[k]:
                # Rays that graze an edge, to the rounding of MuJoCo's single-precision meshes.
                compared -= 1
                continue
            seen.add(int(geom[0]))
            compared += 1
            # MuJoCo keeps heights and vertices of meshes in single precision.
            single = geom[0] in (1, 6, 8)
            close = {"rel": 1e-6, "abs": 1e-7} if single else {"rel": 1e-9}
            assert hits.distance[k] == pytest.approx(dist, **close), geom
            if dist >= 0:
                assert hits.normal[k] == pytest.approx(normal, abs=1e-5 if single else 1e-8), geom
    assert compared >= 2990
    if not options:
        assert seen == set(range(-1, theirs.ngeom))


def test_rays_of_a_batch(rayed):
    """One origin for all, one for each world, and one for each ray: those of a Sim."""
    sim = rayed[0]
    batch = sc.Batch(sim.model, 3)
    rng = np.random.default_rng(6)
    batch.qpos[:, 2] += rng.normal(size=3)
    direction = rng.normal(size=(3, 5, 3))
    hits = batch.ray((0.1, 0.2, 2.0), direction)
    assert hits.distance.shape == hits.geom.shape == (3, 5) and hits.normal.shape == (3, 5, 3)
    for world in range(3):
        sim.qpos[:] = batch.qpos[world]
        single = sim.ray((0.1, 0.2, 2.0), direction[world])
        for mine, other in zip(hits, single, strict=True):
            assert np.array_equal(mine[world], other)
    assert batch.ray((0, 0, 2), (0, 0, -1)).distance.shape == (3,)


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        (((0, 0), (0, 0, 1)), "origin has shape"),
        (((0, 0, 0), (0, 0, 0)), "must have a length"),
        ((np.zeros((2, 3)), np.ones((3, 3))), "must have shapes that broadcast"),
        (((0, 0, np.nan), (0, 0, 1)), "finite"),
    ],
)
def test_bad_rays(rayed, arguments, words):
    with pytest.raises(ValueError, match=words):
        rayed[0].ray(*arguments)


def test_bad_ray_options(rayed):
    for options, words in (
        ({"exclude": "aa"}, "nearest"),
        ({"groups": (7,)}, "groups"),
        ({"static": 1}, "static"),
    ):
        with pytest.raises(ValueError, match=words):
            rayed[0].ray((0, 0, 0), (0, 0, 1), **options)


def test_jacobians_of_points_and_sites():
    """Against mj_jac and mj_jacSite."""
    name = "ant"
    theirs, data = theirs_at(name, states_of(name)[3])
    scene = sc.load(peers.gym_path(name))
    scene.add_site(scene.bodies[5], name="foot", pos=(0.1, -0.2, 0.3))
    sim = sc.Sim(scene)
    states_of(name)[3].to_stepcore(sim)
    site = sim.site("foot")
    jacp, jacr = np.zeros((3, theirs.nv)), np.zeros((3, theirs.nv))
    mujoco.mj_jac(theirs, data, jacp, jacr, site.xpos, 5)
    both = np.vstack([jacp, jacr])
    assert site.jacobian == pytest.approx(both, abs=1e-12)
    assert sim.jacobian(5, point=site.xpos) == pytest.approx(both, abs=1e-12)
    assert site.velocity == pytest.approx(both @ sim.qvel, abs=1e-12)
    with pytest.raises(ValueError, match="3 finite"):
        sim.jacobian(5, point=(1, 2))


def test_contacts_of_a_body():
    sim = sc.Sim(compiled("ant"))
    for state in states_of("ant")[:20]:
        state.to_stepcore(sim)
        sim.forward()
        for index in range(len(sim.model.body_names)):
            bodies = sim.model.geom_body
            want = [c for c in sim.contacts if index in (bodies[c["geom1"]], bodies[c["geom2"]])]
            got = sim.contacts_of(index)
            assert len(got) == len(want)
            assert all(np.array_equal(a, b) for a, b in zip(got, want, strict=True))
    with pytest.raises(ValueError, match="nearest"):
        sim.contacts_of("torsoo")


@pytest.mark.parametrize("integrator", ["euler", "implicitfast", "rk4"])
def test_forces_after_a_step_are_of_its_start(integrator):
    """As after mj_step: what belongs to the solve belongs to the state that the step came from."""
    name = "half_cheetah"
    ours = compiled(name)
    stepped, forward = (sc.Sim(ours, integrator=integrator, **peers.EXACT) for _ in range(2))
    for state in states_of(name)[:10]:
        for sim in (stepped, forward):
            state.to_stepcore(sim)
        forward.forward()
        stepped.step()
        for field in FORCES:
            assert getattr(stepped, field) == pytest.approx(getattr(forward, field), abs=1e-7)
        batch = sc.Batch(ours, 1, integrator=integrator, **peers.EXACT)
        for field, value in vars(state).items():
            getattr(batch, field)[0] = value
        batch.step()
        assert batch.cfrc_int[0] == pytest.approx(stepped.cfrc_int, abs=1e-7)


def test_before_any_solve_forces_are_those_of_the_present_state():
    """A Sim that was made, restored, unpickled or reset reads them at once."""
    ours = compiled("hopper")
    run, forward = sc.Sim(ours), sc.Sim(ours)
    run.step(20)
    # Bytes are a state and nothing of its last solve.
    for sim in (run, forward):
        sim.restore(bytes(run.state()))
    forward.forward()
    assert forward.cfrc_int.any() and not np.array_equal(forward.cacc, sc.Sim(ours).cacc)
    fresh, batch = pickle.loads(pickle.dumps(run)), sc.Batch(ours, 1)
    batch.restore([bytes(run.state())])
    for field in FORCES:
        want = getattr(forward, field)
        assert np.array_equal(getattr(run, field), want), field
        assert np.array_equal(getattr(fresh, field), want), field
        assert np.array_equal(getattr(batch, field)[0], want), field
    run.reset()
    run.qpos[1] = np.nan
    with pytest.raises(ValueError, match=r"qpos\[1\]"):
        _ = run.cacc


def test_reading_changes_no_bit():
    plain, read = (sc.Sim(compiled("ant")) for _ in range(2))
    for sim in (plain, read):
        states_of("ant")[2].to_stepcore(sim)
    for _ in range(50):
        plain.step()
        read.step()
        for field in (*BODIES, *FORCES):
            getattr(read, field)
        read.inverse()
        read.ray((0, 0, 3), (0, 0, -1))
    assert read.state() == plain.state()


def test_a_path_is_read(tmp_path):
    path = tmp_path / "ball.xml"
    path.write_text(zoo.ZOO[SCENES[0]].text)
    for source in (path, str(path)):
        assert sc.Sim(source, dt=0.001).model.scene == sc.load(path)
        assert len(sc.Batch(source, 2)) == 2
    assert sc.Sim("lesson:stack").model.nv == 2
    with pytest.raises(FileNotFoundError):
        sc.Sim(tmp_path / "none.xml")
    with pytest.raises(ValueError, match="path of an MJCF file"):
        sc.Sim(3)
