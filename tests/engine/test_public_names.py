"""What `import stepcore` gives: one path to each name, and every type that a user meets."""

import ast
import functools
import importlib
import importlib.util
import inspect
import subprocess
import sys

import pytest

import stepcore as sc


def fresh(code):
    """What a fresh interpreter prints."""
    command = [sys.executable, "-c", code]
    return subprocess.run(command, capture_output=True, text=True, check=True).stdout.split()


LOADED = "print(*(name for name in sys.modules if name.startswith(('stepcore', 'numpy.core'))))"


def test_importing_loads_the_table_alone():
    """And what says where the compiled module lies."""
    assert sorted(fresh(f"import sys, stepcore; {LOADED}")) == ["stepcore", "stepcore.vectors"]


def test_a_step_loads_the_scene_and_the_engine():
    """Not the reader, the measurements, the report or the executors."""
    code = (
        "import sys, stepcore as sc; scene = sc.Scene(); arm = scene.add_body(); "
        "scene.add_joint(arm, armature=1.0, damping=1.0); scene.add_geom(arm, size=0.1); "
        f"sim = sc.Sim(scene.compile()); sim.step(); sc.Batch(sim.model, 2).step(); {LOADED}"
    )
    loaded = fresh(code)
    assert "stepcore.engine.batch" in loaded
    allowed = ("_core", "vectors", "checks", "escapes", "files", "signatures", "engine", "scene")
    allowed += ("mjcf.nodes", "mjcf.mended", "mjcf.effects")
    rest = [name.removeprefix("stepcore.") for name in loaded if name.startswith("stepcore.")]
    assert [name for name in rest if not name.startswith(allowed)] == ["mjcf"]


@pytest.mark.parametrize("names", [["lesson"], ["reference"], sorted(sc.__all__)])
def test_names_work_in_a_fresh_interpreter(names):
    asked = "; ".join(f"sc.{name}" for name in names)
    assert fresh(f"import stepcore as sc; {asked}; print('found')") == ["found"]


def test_type_checkers_see_the_same_names():
    tree = ast.parse(inspect.getsource(sc))
    block = next(node for node in tree.body if isinstance(node, ast.If))
    seen = {
        alias.asname: node.module if node.module != "stepcore" else f"stepcore.{alias.name}"
        for node in block.body
        for alias in node.names
    }
    table = {name: module for module, names in sc._MODULES.items() for name in names}
    assert seen == table | {name: f"stepcore.{name}" for name in ("lesson", "reference")}


def test_no_name_is_a_function_and_a_module():
    modules = {name for name in sc.__all__ if importlib.util.find_spec(f"stepcore.{name}")}
    assert modules == {name for name in sc.__all__ if inspect.ismodule(getattr(sc, name))}


@functools.cache
def source_of(module):
    return ast.parse(inspect.getsource(importlib.import_module(module)))


def resolved(module, name):
    """The class that a name in an annotation means in a module; None for what is no class."""
    found = getattr(importlib.import_module(module), name, None)
    if found is None:
        for node in ast.walk(source_of(module)):
            if isinstance(node, ast.ImportFrom) and node.module.startswith("stepcore"):
                for alias in node.names:
                    if (alias.asname or alias.name) == name:
                        found = getattr(importlib.import_module(node.module), alias.name, None)
    return found if inspect.isclass(found) else None


def classes_in(module, annotation):
    """The classes of stepcore in an annotation."""
    for node in ast.walk(annotation):
        names = []
        if isinstance(node, ast.Name):
            names = [node.id]
        elif isinstance(node, ast.Constant) and isinstance(node.value, str):
            names = [node.value] if node.value.isidentifier() else []
        for name in names:
            found = resolved(module, name)
            if found is not None and found.__module__.startswith("stepcore"):
                yield found


def handed_out(thing):
    """The classes that a function returns, or that the public methods of a class return.

    A method that a class overrides counts as the class has it, not as its base does.
    """
    overridden = set()
    for kind in getattr(thing, "__mro__", (thing,)):
        module = kind.__module__
        if not module.startswith("stepcore."):
            continue
        definition = next(
            node
            for node in ast.walk(source_of(module))
            if getattr(node, "name", "") == kind.__name__
        )
        for node in [definition, *definition.body]:
            public = isinstance(node, ast.FunctionDef) and not node.name.startswith("_")
            if public and node.returns is not None and node.name not in overridden:
                yield from classes_in(module, node.returns)
        overridden |= {getattr(node, "name", "") for node in definition.body}


PUBLIC = [
    thing
    for thing in map(sc.__getattr__, sc._MODULE_OF)
    if thing.__module__.startswith("stepcore.")  # compiled classes have no source to read
]


@pytest.mark.parametrize("thing", PUBLIC, ids=lambda thing: thing.__name__)
def test_every_type_that_is_handed_out_can_be_imported(thing):
    """What public functions return, and methods of public classes: so their methods too."""
    types = {found.__name__: found for found in handed_out(thing)}
    missing = {name for name, found in types.items() if getattr(sc, name, None) is not found}
    assert missing == set()


def test_there_are_types_to_be_found():
    assert {found.__name__ for found in handed_out(sc.Sim)} >= {"Trajectory", "Energy", "BodyView"}
    assert [found.__name__ for found in handed_out(sc.predict)] == ["Predictability"]
