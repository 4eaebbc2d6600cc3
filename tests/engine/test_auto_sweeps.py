"""`sweeps="auto"`: a solve stops on its residual, at most after 10 000 sweeps."""

import copy
import pickle

import numpy as np
import pytest
from engines import ENGINES, make

import stepcore as sc
from stepcore import lesson
from stepcore.cli import main


def cold(engine, masses, **settings):
    """A tower that touches, solved once from nothing."""
    sim = make(
        engine, lesson.tower(masses), solver="pgs", law="rigid", warm_start=False, **settings
    )
    sim.qvel[:] = -0.1 * np.arange(1, len(masses) + 1)
    sim.forward()
    return sim


@pytest.mark.parametrize("engine", ENGINES)
def test_it_stops_on_the_residual(engine):
    """Two balls, error factor r/(1 + r) a sweep: a thousandth of it takes ln 1000 / ln(1 + 1/r)."""
    first = cold(engine, (1.0, 10.0), sweeps=20, tolerance=0.0).residual
    done = cold(engine, (1.0, 10.0), sweeps="auto", tolerance=1e-3 * first)
    assert done.residual <= 1e-3 * first
    expected = 20 + np.log(1e3) / np.log(1.1)
    assert done.sweeps_done == pytest.approx(expected, abs=2)
    # It is the tolerance that decides: with as many sweeps by number, the same bits.
    same = cold(engine, (1.0, 10.0), sweeps=done.sweeps_done, tolerance=0.0)
    assert np.array_equal(same.rows["impulse"], done.rows["impulse"])


@pytest.mark.parametrize("engine", ENGINES)
def test_it_sweeps_ten_thousand_times_at_most(engine):
    """The reference gives up there; the engine goes on with what is left, to rounding."""
    sim = cold(engine, (1.0, 1e6), sweeps="auto", tolerance=1e-14)
    assert sim.sweeps_done == 10_000
    swept = cold(engine, (1.0, 1e6), sweeps=10_000, tolerance=0.0)
    if engine == "rust":
        assert swept.residual > 1e-6 and sim.residual < 1e-14
    else:
        assert np.array_equal(sim.impulses, swept.impulses) and sim.residual > 1e-14


@pytest.mark.parametrize("precision", ["f32", "f64"])
@pytest.mark.parametrize("law", ["rigid", "lesson"])
def test_rounding_is_as_good_as_it_gets(precision, law):
    """A tolerance that the numbers cannot reach ends where they are, at any scale of speeds."""
    eps = {"f32": 2.0**-23, "f64": 2.0**-52}[precision]
    for scale in (1.0, 2.0**-20):
        model = sc.Model(
            lesson.tower((1.0, 3.0, 0.5, 2.0), radius=0.125, gravity=9.81 * scale),
            **{"law": law, "solver": "pgs", "precision": precision, "softness": 0.1},
            **{"sweeps": "auto", "tolerance": 1e-300, "warm_start": False},
        )
        sim = sc.Sim(model)
        sim.qvel[:] = -0.1 * scale * np.arange(1, 5)
        sim.forward()
        assert 10 < sim.sweeps_done < 400
        assert sim.residual < 64 * eps * 2 * scale


def test_settings_carry_it():
    """repr, dict, replace, pickle, copy, hash, equality and the scene's options."""
    settings = sc.Settings(sweeps="auto", solver="pgs", tolerance=1e-7)
    assert settings.sweeps == "auto"
    assert "sweeps='auto'" in repr(settings)
    assert eval(repr(settings), {"Settings": sc.Settings}) == settings
    assert sc.Settings(**settings.as_dict()) == settings
    assert pickle.loads(pickle.dumps(settings)) == settings == copy.deepcopy(settings)
    assert hash(settings) == hash(settings.replace())
    assert settings.replace(sweeps=7).sweeps == 7
    assert settings.replace(dt=0.01).sweeps == "auto"
    scene = lesson.drop().with_settings(settings)
    assert scene.settings == settings == scene.compile().settings


def test_what_it_refuses():
    with pytest.raises(ValueError, match=r"tolerance = 0: must be > 0 m/s"):
        sc.Settings(sweeps="auto", tolerance=0.0)
    with pytest.raises(ValueError, match=r"tolerance.*'auto'"):
        sc.Settings(tolerance=0.0).replace(sweeps="auto")
    for bad in ("Auto", "", -1, 2.5, True, None):
        with pytest.raises(ValueError, match="sweeps = "):
            sc.Settings(sweeps=bad)


def test_every_face_takes_it(capsys):
    """A Batch, Newton, and the command line."""
    model = lesson.stack("auto", "lesson", (1.0, 3.0), tolerance=1e-9).compile()
    sim, batch = sc.Sim(model), sc.Batch(model, 3)
    for one in (sim, batch):
        one.reset(key="start")
        one.step(50)
    assert np.array_equal(batch.qpos, [sim.qpos] * 3)
    assert 0 < sim.residual <= 1e-9
    assert (
        sc.Sim(lesson.drop("solref"), solver="newton", sweeps="auto", tolerance=1e-9).step() is None
    )
    ask = ["run", "lesson:stack", "--horizon", "0.02", "--set", "sweeps=auto"]
    assert main(ask) == 2
    assert "tolerance = 0: must be > 0 m/s with sweeps = 'auto'" in capsys.readouterr().err
    assert main([*ask, "--set", "tolerance=1e-9"]) == 0
    assert "sweeps='auto'" in capsys.readouterr().out


def test_what_tries_settings_knows_it():
    """A trade of a scene that ships it, and one that tries it beside a number."""
    scene = lesson.stack("auto", "lesson", (1.0, 3.0), tolerance=1e-9)
    some = {"horizon": 0.04, "starts": 1, "dts": [0.002, 0.004], "progress": False}
    assert sc.trade(scene, **some).shipped.settings.sweeps == "auto"
    scene.options["sweeps"] = 5
    tried = {row.settings.sweeps for row in sc.trade(scene, sweeps=[5, "auto"], **some).rows}
    assert tried == {5, "auto"}
