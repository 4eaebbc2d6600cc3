"""A scene is compiled once: the model made to warn of a time step is the one that is stepped."""

import warnings

import pytest

import stepcore as sc
from stepcore.engine import compilation

# Stiff enough that loading has to look at the step itself.
STIFF = """<mujoco><option timestep="0.002"/><worldbody><body><joint name="a" stiffness="{}"/>
<geom name="ball" size="0.1" mass="1"/></body></worldbody></mujoco>"""


@pytest.fixture
def compiled(monkeypatch):
    """The scenes that the engine compiles with all that acts in them.

    The warning linearises the step of a variant without constraints too.
    """
    seen, compile_scene = [], compilation.compile_data

    def counted(scene, data):
        if scene.features.constraint:
            seen.append(scene)
        return compile_scene(scene, data)

    monkeypatch.setattr(compilation, "compile_data", counted)
    return seen


def loaded():
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        return sc.loads(STIFF.format(1e5))


def test_loading_compiling_and_stepping_compile_once(compiled):
    scene = loaded()
    assert len(compiled) == 1
    model = scene.compile()
    sc.Sim(scene).step()
    sc.Batch(model, 2, dt=1e-3).step()
    assert len(compiled) == 1
    assert model.core is scene.compile().core


@pytest.mark.parametrize(
    "edit",
    [
        lambda scene: setattr(scene.joint("a"), "stiffness", 3.0),
        lambda scene: scene.add_body("more"),
        lambda scene: setattr(scene, "gravity", (0, 0, 0)),
    ],
)
def test_an_edited_scene_is_compiled_again(compiled, edit):
    scene = loaded()
    before = scene.compile()
    edit(scene)
    assert scene.compile().core is not before.core
    assert len(compiled) == 2


def test_settings_alone_need_no_other_compilation_and_are_those_of_the_scene(compiled):
    scene = loaded()
    scene.options["timestep"] = 0.1
    del scene.options["timestep"]
    scene.options["dt"] = 1e-4
    assert scene.compile().settings.dt == 1e-4


def test_a_copied_or_pickled_scene_has_nothing_compiled_with_it():
    import copy
    import pickle

    scene = loaded()
    assert scene._compiled is not None
    assert copy.deepcopy(scene)._compiled is None
    assert pickle.loads(pickle.dumps(scene))._compiled is None


def test_a_sim_reads_a_file_whatever_was_imported_first():
    from stepcore.engine.sim import Sim

    assert Sim("lesson:drop").model.nv == 1
