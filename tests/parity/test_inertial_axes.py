"""The principal axes of an inertia, which equal moments leave open, are those of the file.

Law: a fluid's drag (the box of the inertia), sensors of frames of type "body" and `body_iquat` are
MuJoCo's, whether the moments are equal, in which order they stand, and by which rule they became
equal; the writer's file has the same bits.
"""

import mujoco
import numpy as np
import pytest

import stepcore as sc

MOMENTS = ("1 1 1", "1 1 .5", ".9 .5 .5", ".5 1 1", "1 .7 .5", ".5 .7 1", ".7 .5 1")
TURNS = ("", 'quat="1 .3 .4 .2"', 'euler="30 -50 20"')
SENSED = "".join(
    f'<{kind} name="{kind}" objtype="body" objname="b"/>'
    for kind in ("framequat", "framexaxis", "frameyaxis", "framezaxis")
)
BODY = (
    """<mujoco><compiler {rules}/><option density="10" viscosity=".1"/><worldbody>
<body name="b" euler="0 20 0"><freejoint/>{inertia}</body></worldbody>
<sensor>{sensed}<framepos name="p" objtype="geom" objname="g" reftype="body" refname="b"/></sensor>
</mujoco>"""
).replace("{sensed}", SENSED)
INERTIAL = (
    '<inertial pos=".1 0 .2" {turn} mass="1" diaginertia="{moments}"/><geom name="g" size=".1"/>'
)
LONG = '<geom name="g" type="box" size=".3 .2 .1" euler="10 20 30"/><geom size=".1" pos=".2 .1 0"/>'


def agree(text):
    """Both engines at a moving state: drag and sensors, after a step too."""
    theirs = mujoco.MjModel.from_xml_string(text)
    data = mujoco.MjData(theirs)
    scene = sc.loads(text)
    for ours in (scene, sc.loads(scene.to_mjcf())):
        sim = sc.Sim(ours)
        mujoco.mj_resetData(theirs, data)
        sim.qvel[:] = data.qvel[:] = 0.3, -0.5, 0.7, 0.2, 0.9, -0.4
        sim.forward()
        mujoco.mj_forward(theirs, data)
        assert sim.passive == pytest.approx(data.qfrc_passive, abs=1e-13)
        assert not sim.model.scene.ignored
        assert sim.sensordata == pytest.approx(data.sensordata, abs=1e-12)
        turn = np.abs(np.sum(sim.model.body_iquat * theirs.body_iquat, axis=1))
        assert turn == pytest.approx(1.0, abs=1e-12)
        for body, again in zip(scene.bodies, ours.bodies, strict=True):
            assert again.values() | {"parent": None} == body.values() | {"parent": None}


@pytest.mark.parametrize("turn", TURNS)
@pytest.mark.parametrize("moments", MOMENTS)
def test_axes_are_those_of_the_inertial(moments, turn):
    agree(BODY.format(rules="", inertia=INERTIAL.format(turn=turn, moments=moments)))


@pytest.mark.parametrize(
    "rules", ('boundinertia="9"', 'balanceinertia="true"', 'boundinertia=".8"')
)
def test_axes_stay_when_a_rule_makes_moments_equal(rules):
    agree(BODY.format(rules=rules, inertia=LONG))
    inertial = INERTIAL.format(turn=TURNS[1], moments=".5 .3 1.9")
    if "balance" in rules:
        agree(BODY.format(rules=rules, inertia=inertial))


def test_axes_are_a_field_of_bodies():
    """Checked, written and mirrored by the same name as in MuJoCo."""
    scene = sc.Scene()
    fields = {"mass": 1.0, "inertia": (1.0, 2.0, 2.5)}
    body = scene.add_body("b", **fields, iquat=(0.0, 1.0, 0.0, 0.0))
    scene.add_joint(body, "free")
    assert scene.compile().body_iquat[1] == pytest.approx([0, 1, 0, 0])
    body.iquat = None
    # The largest moment, which is about z, comes first.
    w, x, y, z = scene.compile().body_iquat[1]
    assert abs(2 * (x * z - w * y)) == pytest.approx(1.0)
    body.iquat = (0.9, 0.1, 0.3, 0.0)
    with pytest.raises(ValueError, match=r"body 'b' iquat = .*: must be the principal axes"):
        scene.compile()
    with pytest.raises(ValueError, match="mass = None: must be given where ipos, inertia or iquat"):
        sc.Scene().add_body("c", iquat=(1, 0, 0, 0))


def test_a_body_without_mass_hangs_by_its_own_axes_under_bounds():
    agree(
        BODY.format(rules='boundmass="5" boundinertia=".1"', inertia='<geom name="g" size=".1"/>')
        .replace('size=".1"', 'size=".1" mass="0"')
        .replace('euler="0 20 0"', 'pos=".3 0 1" euler="30 20 0"')
    )


@pytest.mark.parametrize("moments", MOMENTS)
def test_another_inertia_has_axes_of_its_own(moments):
    """Scaled it keeps them; with other axes they are found, and `iquat` says so."""
    inertia = INERTIAL.format(turn='euler="30 -50 20"', moments=moments)
    scene = sc.loads(BODY.format(rules="", inertia=inertia))
    body, model = scene.body("b"), scene.compile()
    axes, old = body.iquat, np.array(body.inertia)
    beside = old + np.array([0, 0, 0, 0.01, 0, 0])
    for other in (beside, old * [1.1, 1, 1, 1, 1, 1], 2 * old):
        changed = model.with_values({"body/b/inertia": other})
        six = [(0, 0), (1, 1), (2, 2), (0, 1), (0, 2), (1, 2)]
        assert [changed.body_inertia[1][place] for place in six] == pytest.approx(other)
        batch = sc.Batch(model, 2)
        batch.param["body/b/inertia"] = np.array([old, other])
        assert batch.model_of(1).body_inertia[1] == pytest.approx(changed.body_inertia[1])
    body.inertia = 2 * old
    assert body.iquat == axes
    body.inertia = beside
    assert body.iquat is None
    body.inertia, body.mass = (0,) * 6, None
