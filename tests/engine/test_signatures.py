"""What `help` and `inspect.signature` say of the calls that take fields as keywords."""

import inspect
import pydoc
import re

import pytest

import stepcore as sc

MEASUREMENTS = [
    *("trade", "ablate", "converge", "diagnose", "predict", "check"),
    *("run", "stability_map"),
]
STARTS = (
    *("horizon", "starts", "seed", "key", "control", "ctrl", "control_dt"),
    *("interpolation", "kind", "follow"),
)
# The map runs one start, without controls; the others of these start at the keyframe alone.
LEFT_OUT = {
    **{name: {"starts"} for name in ("check", "diagnose", "run")},
    "stability_map": set(STARTS) - {"horizon", "key"},
}
TWELVE = [*MEASUREMENTS, "sweep", "plan", "Sim", "Batch", "Model"]
STEPPED = (sc.Sim, sc.Batch, sc.Model, sc.Model.with_settings, sc.Scene.with_settings)


def rendered(thing):
    return pydoc.plain(pydoc.render_doc(thing))


@pytest.mark.parametrize("name", MEASUREMENTS)
def test_measurements_list_the_fields_of_a_motion(name):
    measurement = getattr(sc, name)
    takes = inspect.signature(measurement).parameters
    assert list(takes)[:2] == ["model", "motion"]
    listed = [field for field in STARTS if field not in LEFT_OUT.get(name, ())]
    assert [field for field in takes if field in STARTS] == listed
    assert all(takes[field].default == getattr(sc.Motion, field) for field in listed)
    assert {"threads", "progress"} <= set(takes)
    assert "executor" in takes or name == "run"
    first = rendered(measurement).splitlines()[2]
    assert all(f" {field}: " in first for field in listed) and "fields" not in first


@pytest.mark.parametrize("name", TWELVE)
def test_help_explains_every_argument(name):
    """Fields of a Motion and of Settings are explained where these are."""
    call = getattr(sc, name)
    elsewhere = {*STARTS, *sc.Settings().as_dict()} - {"error"}
    text = inspect.getdoc(call)
    silent = {
        argument
        for argument in inspect.signature(call).parameters
        if argument not in elsewhere and not re.search(rf"\b{argument}\b[^:\n]*: ", text)
    }
    assert silent == set()


@pytest.mark.parametrize("call", STEPPED, ids=lambda call: call.__qualname__)
def test_calls_list_the_fields_of_settings(call):
    takes = inspect.signature(call).parameters
    fields = sc.Settings().as_dict()
    assert list(takes)[-len(fields) :] == list(fields)
    assert "dt: float = <the scene's>" in rendered(call)


def test_settings_and_threads_are_taken_alike():
    for call in (sc.Sim, sc.Batch):
        takes = inspect.signature(call).parameters
        assert takes["settings"].kind is inspect.Parameter.POSITIONAL_OR_KEYWORD
        assert takes["threads"].kind is inspect.Parameter.KEYWORD_ONLY


@pytest.mark.parametrize(
    "call, word, near",
    [
        (lambda **given: sc.Sim("lesson:drop", **given), "thread", "threads"),
        (lambda **given: sc.Batch("lesson:drop", 4, **given), "thread", "threads"),
        (lambda **given: sc.Batch("lesson:drop", 4, **given), "lane", "lanes"),
        (lambda **given: sc.Model(sc.lesson.drop(), **given), "integratr", "integrator"),
        (lambda **given: sc.lesson.drop().compile().with_settings(**given), "dts", "dt"),
        (lambda **given: sc.trade("lesson:drop", **given), "horizn", "horizon"),
        (lambda **given: sc.diagnose("lesson:drop", **given), "controls", "control"),
    ],
)
def test_an_unknown_argument_names_the_nearest(call, word, near):
    with pytest.raises(TypeError, match=rf'\(\) has no argument "{word}"; nearest: "{near}"'):
        call(**{word: 2})
