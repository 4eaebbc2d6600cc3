"""Values by path, "kind/name/field": what changes the motion can be varied, tendons too."""

import numpy as np
import pytest

import stepcore as sc

ROPE = """<mujoco><worldbody><site name="hook"/><body name="ball" pos="0 0 -1">
<joint name="fall" type="slide" axis="0 0 1"/><geom size="0.1" mass="1"/><site name="knot"/></body>
</worldbody><tendon><spatial name="rope" stiffness="100" damping="1"><site site="hook"/>
<site site="knot"/></spatial></tendon></mujoco>"""
PATH = "tendon/rope/stiffness"


def test_the_stiffness_of_a_tendon_is_a_value_of_the_model():
    """The ball falls to 2 m g/k below its start in half a period, π √(m/k)."""
    model = sc.loads(ROPE).compile().with_values({PATH: 400.0, "tendon/rope/damping": 0.0})
    assert model.scene.tendon("rope").stiffness == 400.0
    sim = sc.Sim(model, dt=1e-4, integrator="semi-implicit")
    sim.step(round(np.pi / 20.0 / 1e-4))
    assert sim.qpos[0] == pytest.approx(-2 * 9.81 / 400, rel=1e-3)


def test_a_batch_varies_the_stiffness_of_a_tendon():
    model, values = sc.loads(ROPE).compile(), [100.0, 200.0, 400.0]
    batch = sc.Batch(model, 3)
    batch.param[PATH] = values
    batch.step(50)
    for world, value in enumerate(values):
        sim = sc.Sim(model.with_values({PATH: value}))
        sim.step(50)
        assert np.array_equal(batch.qpos[world], sim.qpos)


def test_a_sweep_varies_the_stiffness_of_a_tendon():
    table = sc.sweep(sc.loads(ROPE), {PATH: [100.0, 400.0]}, lambda sim: float(sim.qpos[0]))
    assert "failure" not in table[0] and table[0] != table[1]


def test_a_map_varies_what_diagnose_names():
    """The element that limits dt, and the value that it advises to change, can be mapped."""
    scene = sc.loads(ROPE)
    advice = str(sc.diagnose(scene, dt=0.5, horizon=1.0))
    assert "rope" in advice
    result = sc.stability_map(scene, path=PATH, values=[100.0, 400.0], dts=[0.01, 0.1])
    assert result.path == PATH


@pytest.mark.parametrize(
    ("path", "text"),
    [
        ("tendon/rope/path", 'a tendon has no value "path"'),
        ("tendon/rope/stifness", 'a tendon has no value "stifness"; nearest: "stiffness"'),
        ("tendon/rop/stiffness", 'no tendon is named "rop"; nearest: "rope"'),
        ("joint/fall/body", 'a joint has no value "body"'),
        ("sensors/a/b", 'no kind of element is "sensors"'),
    ],
)
def test_what_is_no_value_is_refused_by_name(path, text):
    with pytest.raises(ValueError, match=text):
        sc.loads(ROPE).compile().with_values({path: 1.0})


def test_the_kind_of_a_row_is_not_cut_off():
    """ "tendon friction loss" is the longest."""
    text = ROPE.replace('stiffness="100"', 'frictionloss="1"')
    sim = sc.Sim(sc.loads(text))
    sim.step()
    assert sim.rows["kind"].tolist() == ["tendon friction loss"]


def test_elements_without_a_name_have_an_index():
    text = """<mujoco><asset><hfield name="h" nrow="2" ncol="3" size="2 2 1 .1"
    elevation="0 1 0 0 1 0"/></asset><worldbody><geom type="hfield" hfield="h"/>
    <body pos="0 0 3"><freejoint/><geom size=".2"/><site name="s"/></body>
    <geom type="plane" size="1 1 1" pos="0 0 -9"/></worldbody>
    <sensor><accelerometer site="s"/></sensor></mujoco>"""
    model = sc.loads(text).compile()
    values = {"geom/#2/size": 0.3, "hfield/h/size": (2, 2, 0.5, 0.1), "sensor/#0/cutoff": 5.0}
    scene = model.with_values(values).scene
    assert [geom.size[0] for geom in scene.geoms if geom.type == "sphere"] == [0.3]
    assert (scene.hfields[0].size[2], scene.sensors[0].cutoff) == (0.5, 5.0)
    batch = sc.Batch(model, 3)
    batch.param["geom/#2/size"] = [0.2, 0.3, 0.25]
    batch.param["hfield/#0/size"] = [[2, 2, 1.0, 0.1], [2, 2, 0.5, 0.1], [2, 2, 0.7, 0.1]]
    batch.step(200)
    sim = sc.Sim(model.with_values(values))
    sim.step(200)
    assert np.array_equal(batch.qpos[1], sim.qpos)
    with pytest.raises(ValueError, match="geom/#3/size: no geom has the index 3: there are 3"):
        model.with_values({"geom/#3/size": 1.0})


def test_a_body_of_a_scene_with_a_total_mass_has_a_mass_of_its_own():
    """MJCF's `settotalmass` grows by what the body gains; other bodies keep their masses."""
    text = """<mujoco><compiler settotalmass="14"/><worldbody>
    <body name="a"><joint name="a"/><geom size=".1 .2 .3" type="box"/>
    <body name="b" pos="0 0 .4"><joint name="b" axis="1 0 0"/><geom size=".1"/></body></body>
    <body name="c" pos="1 0 0"><joint name="c"/><geom size=".2"/></body></worldbody></mujoco>"""
    model = sc.loads(text).compile()
    values = {"body/a/mass": 5.0, "body/b/mass": 3.0}
    new = model.with_values(values)
    wanted = model.body_mass.copy()
    wanted[1:3] = 5.0, 3.0
    assert new.body_mass == pytest.approx(wanted, rel=1e-14)
    assert new.body_inertia[1] == pytest.approx(model.body_inertia[1] * 5.0 / model.body_mass[1])
    batch = sc.Batch(model, 4)
    batch.param.update({path: [value] * 4 for path, value in values.items()})
    batch.param["body/a/mass"] = [4.0, 5.0, 4.0, 6.0]
    sim = sc.Sim(new)
    batch.step(20)
    sim.step(20)
    assert np.array_equal(batch.qpos[1], sim.qpos)
    assert model.scene.mass_rules.settotalmass == 14.0
