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
