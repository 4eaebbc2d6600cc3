"""Files with `<flag sleep="enable"/>` sleep as MuJoCo's do.

Law: where both engines move alike, the same trees are asleep after every step, and positions and
velocities are MuJoCo's. Snapshots, batches and copies continue bit for bit.
"""

import copy

import mujoco
import numpy as np
import pytest

import stepcore as sc
from stepcore.mjcf.nodes import MJCFError
from stepcore.mjcf.option import SLEEP_NOTE, SLOW_STEPS

FLOOR = '<geom name="floor" type="plane" size="3 3 .1"/>'


def scene(world, after="", option="", flags=""):
    return f"""<mujoco><option {option}><flag sleep="enable" {flags}/></option>
      <worldbody>{FLOOR}{world}</worldbody>{after}</mujoco>"""


def box(name, x, z, more="", half=".1", inside=""):
    return (
        f'<body name="{name}" pos="{x} 0 {z}" {more}><freejoint/>'
        f'<geom name="{name}" type="box" size="{half} {half} {half}"/>{inside}</body>'
    )


def arm(name, x, more="", end=0.1):
    """A damped pendulum."""
    return (
        f'<body name="{name}" pos="{x} 0 1" {more}><joint name="{name}" axis="0 1 0" damping=".3"/>'
        f'<geom type="capsule" size=".03" fromto="0 0 0 {end} 0 -.3" contype="0" conaffinity="0"/>'
        f'<site name="{name}" pos="{end} 0 -.3"/></body>'
    )


def mocap_at(when, pos):
    """Moves the only mocap body in both engines before a step."""

    def poke(step, data, sim):
        if step == when:
            data.mocap_pos[:] = pos
            sim.mocap_pos[:] = pos

    return poke


def activate(step, data, sim):
    """Lets equalities tie what sleeps."""
    if step == 60:
        data.eq_active[:] = 1
        sim.eq_active[:] = 1


def drive_then_push(step, data, sim):
    """A control, which does not wake, then a force, which does."""
    if step == 1300:
        data.ctrl[:] = 0.3
        sim.ctrl[:] = 0.3
    force = 1e-3 * (step == 1340)
    data.qfrc_applied[0] = force
    sim.qfrc_applied[0] = force
    np.testing.assert_allclose(sim.act, data.act, atol=1e-12)


def push(when, body):
    """A force for one step, which a sleeping tree must feel."""

    def poke(step, data, sim):
        force = 0.5 * (step == when)
        data.xfrc_applied[body, 2] = force
        sim.xfrc_applied[body, 2] = force

    return poke


# (text, steps, what is done before each step)
SCENES = {
    "boxes side by side and on each other": (
        scene(box("a", 0, 0.101) + box("b", 0, 0.3015) + box("c", 1, 0.1)),
        500,
        None,
    ),
    "a ball wakes a tower": (
        scene(
            box("a", 0, 0.1)
            + box("b", 0, 0.3)
            + box("far", 1, 0.1)
            + '<body pos=".02 0 1.5"><freejoint/><geom size=".05"/></body>'
        ),
        700,
        None,
    ),
    "arms that come to rest": (scene(arm("a", 0) + arm("b", 1)), 1500, None),
    "a tolerance": (scene(arm("a", 0) + arm("b", 1), option='sleep_tolerance=".02"'), 900, None),
    "an actuator keeps one awake": (
        scene(arm("a", 0) + arm("b", 1), '<actuator><motor joint="a"/></actuator>'),
        1500,
        None,
    ),
    "an actuator that may sleep": (
        scene(arm("a", 0, 'sleep="allowed"'), '<actuator><motor joint="a"/></actuator>'),
        1500,
        None,
    ),
    "an actuator that may sleep, with an activation": (
        scene(
            arm("a", 0, 'sleep="allowed"', end=0),
            '<actuator><general joint="a" dyntype="filter" dynprm=".05"/></actuator>',
        ),
        1400,
        drive_then_push,
    ),
    "one that never sleeps keeps its island awake": (
        scene(box("a", 0, 0.1) + box("b", 0, 0.3, 'sleep="never"') + box("c", 1, 0.1)),
        300,
        None,
    ),
    "init in mid-air, hit from above": (
        scene(
            box("a", 0, 0.5, 'sleep="init"')
            + box("b", 0, 0.7001, 'sleep="init"')
            + box("c", 0.01, 1.2)
        ),
        400,
        None,
    ),
    "init where one of the island is awake": (
        scene(box("a", 0, 0.08, 'sleep="init"') + box("b", 0, 0.26)),
        100,
        None,
    ),
    "trees tied by an equality": (
        scene(
            arm("a", 0) + arm("b", 1) + arm("c", 2),
            '<equality><joint joint1="a" joint2="b" polycoef="0 -.5 0 0 0"/></equality>',
        ),
        1500,
        None,
    ),
    "an equality that begins to tie islands asleep": (
        scene(
            arm("a", 0, end=0) + arm("b", 1, end=0) + arm("c", 2, end=0),
            '<equality><joint joint1="a" joint2="b" polycoef=".3 1 0 0 0" active="false"/>'
            "</equality>",
        ),
        900,
        activate,
    ),
    "a spring between trees keeps both awake": (
        scene(
            arm("a", 0) + arm("b", 1) + arm("c", 2),
            '<tendon><spatial stiffness="3"><site site="a"/><site site="b"/></spatial></tendon>',
        ),
        1500,
        None,
    ),
    "a string that becomes taut wakes": (
        scene(
            box("a", 0.3, 1, 'sleep="init"', inside='<site name="a" pos="-.1 0 0"/>')
            + box("b", -0.3, 1, inside='<site name="b" pos=".1 0 0"/>'),
            '<tendon><spatial range="0 .6"><site site="a"/><site site="b"/></spatial></tendon>',
        ),
        190,
        None,
    ),
    "three trees on one tendon": (
        scene(
            arm("a", 0) + arm("b", 1) + arm("c", 2) + arm("d", 3),
            '<tendon><fixed range="-9 9"><joint joint="a" coef="1"/><joint joint="b" coef="1"/>'
            '<joint joint="c" coef="1"/></fixed></tendon>',
        ),
        1500,
        None,
    ),
    "a mocap body that is dragged in": (
        scene(
            '<body name="hand" mocap="true" pos="2 0 .1"><geom size=".1"/></body>'
            + box("a", 0, 0.1)
            + box("b", -1, 0.1)
        ),
        120,
        mocap_at(60, [0.18, 0, 0.1]),
    ),
    "a weld to a mocap body": (
        scene(
            '<body name="hand" mocap="true" pos=".1 0 .75"/>'
            + arm("a", 0, end=0)
            + arm("b", 1, end=0),
            '<equality><connect body1="hand" body2="a" anchor="0 0 0" active="false"/></equality>',
        ),
        900,
        activate,
    ),
    "a force": (scene(box("a", 0, 0.1) + box("b", 1, 0.1)), 200, push(50, 1)),
    "a box that a fluid stops": (
        scene(
            '<body pos="0 0 1"><joint type="slide" axis="1 0 0" stiffness="4"/>'
            '<joint type="ball"/><geom type="box" size=".1 .2 .3" pos=".03 .02 .01" mass="1"/>'
            "</body>",
            option='viscosity="10" integrator="implicitfast" gravity="0 0 -.2"',
        ),
        900,
        None,
    ),
    "elliptic cones": (
        scene(box("a", 0, 0.1005) + box("b", 0.05, 0.301), option='cone="elliptic" impratio="10"'),
        400,
        None,
    ),
}


def both(text):
    model = mujoco.MjModel.from_xml_string(text)
    return model, mujoco.MjData(model), sc.Sim(sc.loads(text).compile(), tolerance=0.0)


def by_tree(model, sim):
    return np.array(sim.asleep)[model.tree_bodyadr]


@pytest.mark.parametrize("name", SCENES)
def test_the_same_trees_sleep_after_every_step(name):
    text, steps, poke = SCENES[name]
    model, data, sim = both(text)
    np.testing.assert_array_equal(by_tree(model, sim), data.tree_asleep >= 0)
    changes, before = 0, data.tree_asleep >= 0
    for step in range(steps):
        if poke is not None:
            poke(step, data, sim)
        mujoco.mj_step(model, data)
        sim.step()
        asleep = data.tree_asleep >= 0
        np.testing.assert_array_equal(by_tree(model, sim), asleep, err_msg=f"step {step}")
        changes, before = changes + (asleep != before).sum(), asleep
        np.testing.assert_allclose(sim.qpos, data.qpos, atol=1e-6, err_msg=f"step {step}")
        np.testing.assert_allclose(sim.qvel, data.qvel, atol=1e-5, err_msg=f"step {step}")
        for tree in np.flatnonzero(asleep):
            first, count = model.tree_dofadr[tree], model.tree_dofnum[tree]
            assert not sim.qvel[first : first + count].any()
    # Something slept or woke, but where nobody may.
    assert (changes > 0) == (name != "init where one of the island is awake")


ROCKING = SCENES["a ball wakes a tower"][0]


def test_the_file_says_what_its_settings_become():
    loaded = sc.loads(scene(arm("a", 0), option='timestep=".004" sleep_tolerance=".01"'))
    settings = loaded.settings
    assert settings.sleep and settings.sleep_tolerance == 0.01
    assert settings.sleep_time == SLOW_STEPS * 0.004
    assert sum(SLEEP_NOTE in note for note in loaded.notes) == 1
    assert not sc.loads("<mujoco/>").settings.sleep


def test_under_rk4_nothing_sleeps_and_a_note_says_so():
    loaded = sc.loads(scene(arm("a", 0), option='integrator="RK4"'), name="m.xml")
    assert not loaded.settings.sleep
    assert 'm.xml:1: flag sleep="enable" is ignored under RK4: nothing sleeps' in loaded.notes
    sc.Sim(loaded.compile()).step(20)


BAD = {
    "sleep_tolerance": scene("", option='sleep_tolerance="-1"'),
    "sleep": scene('<body><freejoint/><geom size=".1"/><body name="b" sleep="init"/></body>'),
    "sleep = 'never'": scene('<body sleep="never"><geom size=".1"/></body>'),
}


@pytest.mark.parametrize("word", BAD)
def test_what_is_wrong_has_its_line(word):
    with pytest.raises(MJCFError, match=rf"m\.xml:\d: .*{word}"):
        sc.loads(BAD[word], name="m.xml")


@pytest.mark.parametrize(
    "change", [{}, {"sleep_time": 0.5}, {"dt": 0.001}, {"sleep": False}, {"sleep_tolerance": 2e-3}]
)
def test_a_scene_that_sleeps_is_written_and_read_back(change, tmp_path):
    loaded = sc.loads(SCENES["init in mid-air, hit from above"][0])
    loaded.options |= change
    again = sc.loads(loaded.to_mjcf())
    assert again == loaded and again.settings == loaded.settings
    loaded.save(tmp_path / "m.xml")
    assert sc.load(tmp_path / "m.xml").settings == loaded.settings
    made = sc.loads("<mujoco/>").with_settings({"sleep": True} | change)
    assert sc.loads(made.to_mjcf()).settings == made.settings


@pytest.mark.parametrize("steps", [0, 5, 40, 200, 330])
def test_a_snapshot_continues_bit_for_bit(steps):
    model = sc.loads(ROCKING).compile()
    one, other = sc.Sim(model), sc.Sim(model)
    one.step(steps)
    other.step(7)
    other.restore(one.state())
    third = copy.deepcopy(one)
    for _ in range(40):
        for sim in (one, other, third):
            sim.step(10)
        assert one.state() == other.state() == third.state()


INIT = SCENES["init in mid-air, hit from above"][0]


def test_worlds_of_a_batch_sleep_as_a_world_alone_from_the_start_and_after_a_reset():
    model = sc.loads(INIT).compile()
    sim, batch = sc.Sim(model), sc.Batch(model, 5, threads=2)
    start = sim.asleep
    assert start.tolist() == [False, True, True, False]
    assert (batch.asleep == start).all()
    sim.step(200)
    batch.step(200)
    assert not sim.asleep[1] and (batch.asleep == sim.asleep).all()
    assert (batch.qpos == sim.qpos).all() and (batch.qvel == sim.qvel).all()
    batch.reset(worlds=[1, 3])
    assert (batch.asleep == np.array([sim.asleep, start, sim.asleep, start, sim.asleep])).all()
    fresh = sc.Sim(model)
    sim.step(150)
    fresh.step(150)
    batch.step(150)
    for world, alone in enumerate([sim, fresh, sim, fresh, sim]):
        assert (batch.qpos[world] == alone.qpos).all()
    for each in (sim, batch):
        each.reset()
        assert (each.asleep == start).all()


def test_a_reset_leaves_no_count_of_slow_steps_behind():
    model = sc.loads(scene(box("a", 0, 0.1))).compile()
    batch, fresh = sc.Batch(model, 2), sc.Sim(model)
    batch.step(SLOW_STEPS - 1)
    batch.reset(worlds=[1])
    for _ in range(SLOW_STEPS + 1):
        batch.step(1)
        fresh.step()
        assert (batch.qpos[1] == fresh.qpos).all() and (batch.asleep[1] == fresh.asleep).all()


def test_a_keyframe_wakes_those_whom_it_moves():
    key = '<keyframe><key name="k" qpos="0 0 .6 1 0 0 0  1 0 .5 1 0 0 0"/></keyframe>'
    text = scene(box("a", 0, 0.5, 'sleep="init"') + box("b", 1, 0.5, 'sleep="init"'), key)
    model, data, sim = both(text)
    mujoco.mj_resetDataKeyframe(model, data, 0)
    sim.reset(key="k")
    for _ in range(30):
        mujoco.mj_step(model, data)
        sim.step()
        assert sim.asleep.tolist() == [False, False, True]
        np.testing.assert_array_equal(by_tree(model, sim), data.tree_asleep >= 0)


def test_a_scale_shows_what_sleeps_on_it():
    weight = 8 * 9.81  # Of a box of 20 cm with the density of water.
    inside = '<site name="a" type="box" size=".11 .11 .11"/>'
    text = scene(
        '<body pos="0 0 .05"><geom type="box" size=".2 .2 .05"/><site name="s"/></body>'
        + box("a", 0, 0.2, inside=inside),
        '<sensor><touch site="a"/><force site="s"/><accelerometer site="a"/></sensor>',
    )
    model, data, sim = both(text)
    mujoco.mj_step(model, data, 100)
    sim.step(100)
    assert sim.asleep[2] and data.tree_asleep[0] >= 0
    # Both fell asleep a little before they had settled.
    pressure, below = sim.sensordata[0], sim.sensordata[3]
    assert pressure == pytest.approx(weight, rel=1e-2)
    assert pressure == pytest.approx(data.sensordata[0], rel=1e-2)
    assert below - 16 * 9.81 == pytest.approx(pressure, rel=1e-9)
    assert sim.sensordata[4:] == pytest.approx([0, 0, 9.81], rel=1e-2, abs=1e-9)
    # What the next step does is not what reading solved.
    other = sc.Sim(sim.model)
    other.step(100)
    assert sim.state() == other.state()


def test_what_hangs_on_a_mocap_body_never_sleeps():
    """It moves where that is put, and where that stood before is no part of the state."""
    hung = arm("a", 0, 'sleep="init"', end=0).replace('pos="0 0 1"', "")
    world = f'<body name="hand" mocap="true" pos="0 0 1">{hung}</body>' + arm("b", 1, end=0)
    sim = sc.Sim(sc.loads(scene(world)).compile())
    sim.step(100)
    assert sim.asleep.tolist() == [False, False, False, True]
    other = sc.Sim(sim.model)
    sim.mocap_pos[0] = [0.2, 0, 1]
    other.restore(sim.state())
    sim.step(50)
    other.step(50)
    assert sim.state() == other.state()
    assert sim.asleep.tolist() == [False, False, False, True]
    assert sim.xpos[2].tolist() == pytest.approx([0.2, 0, 1])


def test_a_snapshot_of_another_model_of_the_same_size_leaves_all_awake():
    chain = arm("a", 0, end=0).replace("</body>", arm("b", 0, end=0) + "</body>")
    apart, linked = (
        sc.Sim(sc.loads(scene(world)).compile())
        for world in (arm("a", 0, end=0) + arm("b", 1, end=0), chain)
    )
    apart.step(20)
    assert apart.asleep.tolist() == [False, True, True]
    linked.restore(apart.state())
    linked.step(1)
    assert not linked.asleep.any()
    linked.step(20)
