"""`Model` and `Settings`: tables, copies with other values, and what settings come first."""

import copy
import pickle

import numpy as np
import pytest
from small import pendulum

import stepcore as sc


@pytest.fixture(scope="module")
def model():
    return pendulum().compile()


def test_model_pickles_and_copies(model):
    for twin in (pickle.loads(pickle.dumps(model)), copy.deepcopy(model), copy.copy(model)):
        assert twin.settings == model.settings
        assert twin.names == model.names
        assert (twin.body_inertia == model.body_inertia).all()
        assert sc.Sim(twin).state() == sc.Sim(model).state()


def test_settings_pickle_copy_compare_and_show_what_is_special():
    settings = sc.Settings(dt=0.01, solver="pgs")
    assert repr(settings) == "Settings(dt=0.01, solver='pgs')"
    assert settings.replace(dt=0.002, solver="newton") == sc.Settings()
    assert settings != sc.Settings()
    assert settings != "pgs"
    assert len({settings, sc.Settings(solver="pgs", dt=0.01)}) == 1
    assert pickle.loads(pickle.dumps(settings)) == copy.deepcopy(settings) == settings
    assert sc.Settings(**settings.as_dict()) == settings


def test_overrides_come_before_the_scenes_own_settings():
    scene = pendulum(dt=0.01, sweeps=7)
    sim = sc.Sim(scene, sweeps=9)
    assert (sim.settings.dt, sim.settings.sweeps) == (0.01, 9)
    assert sc.Sim(scene, sc.Settings(), dt=0.5).settings == sc.Settings(dt=0.5)
    assert sc.Sim(scene.compile(), cone="elliptic").settings.dt == 0.01


def test_model_tables(model):
    assert (model.nq, model.nv, model.nu, model.nbody) == (2, 2, 1, 3)
    assert (model.njnt, model.ngeom, model.nsite) == (2, 3, 1)
    assert model.body_names == ("world", "upper", "lower")
    assert model.body_mass == pytest.approx([0, 1.0, 0.5])
    assert model.jnt_type == ("hinge", "hinge")
    assert model.jnt_range.tolist() == [[-np.inf, np.inf], [-1.0, 1.0]]
    assert model.geom_type == ("plane", "capsule", "capsule")
    assert ("floor", "tip") in model.pairs
    assert model.actuator_gear[0, 0] == 2.0
    assert model.keys[0].qpos.tolist() == [0.3, -0.5]
    with pytest.raises(ValueError, match="read-only"):
        model.body_mass[1] = 3.0


def test_with_values_changes_a_copy(model):
    changed = model.with_values(
        {"body/lower/mass": 2.0, "joint/shoulder/damping": 0.5, "geom/tip/friction": 0.25}
    )
    assert model.body_mass[2] == 0.5
    assert changed.body_mass[2] == pytest.approx(2.0)
    assert changed.body_inertia[2] == pytest.approx(4.0 * model.body_inertia[2])
    assert changed.body_ipos[2] == pytest.approx(model.body_ipos[2])
    assert changed.scene.geom("tip").friction == (0.25, 0.005, 0.0001)
    assert changed.scene.joint("shoulder").damping == 0.5
    assert model.with_values({"gravity": (0, 0, 0)}).scene.gravity == (0, 0, 0)


@pytest.mark.parametrize(
    ("values", "text"),
    [
        ({"body/lowr/mass": 1.0}, 'nearest: "lower"'),
        ({"bodies/lower/mass": 1.0}, 'nearest: "body"'),
        ({"body/lower/mas": 1.0}, 'nearest: "mass"'),
        ({"body/lower/mass": -1.0}, "mass = -1.0: must be"),
        ({"body/lower/mass": np.nan}, "mass = nan: must be"),
        ({"geom/tip/condim": 2}, "condim = 2: must be one of"),
        ({"gravity": (0, 0)}, "gravity"),
        ({"mass": 1.0}, "kind/name/field"),
        ({"lower": 1.0}, 'nearest: "body/lower/field"'),
        ({"lower/mass": 1.0}, 'nearest: "body/lower/mass"'),
        ("gravity", "must be a dict"),
    ],
)
def test_with_values_refuses(model, values, text):
    with pytest.raises(ValueError, match=text):
        model.with_values(values)
