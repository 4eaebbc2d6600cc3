"""What `import stepcore` gives: one path to each name, and every type that a user meets."""

import ast
import functools
import importlib
import importlib.util
import inspect
import re
import subprocess
import sys
from pathlib import Path

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
    """Not the reader, the measurements, reports or executors; only how numbers are written."""
    code = (
        "import sys, stepcore as sc; scene = sc.Scene(); arm = scene.add_body(); "
        "scene.add_joint(arm, armature=1.0, damping=1.0); scene.add_geom(arm, size=0.1); "
        f"sim = sc.Sim(scene.compile()); sim.step(); sc.Batch(sim.model, 2).step(); {LOADED}"
    )
    loaded = fresh(code)
    assert "stepcore.engine.batch" in loaded
    allowed = (
        "_core",
        "vectors",
        "checks",
        "escapes",
        "files",
        "signatures",
        "engine",
        "scene",
        "report.units",
    )
    allowed += ("mjcf.nodes", "mjcf.refusal_texts")
    rest = [name.removeprefix("stepcore.") for name in loaded if name.startswith("stepcore.")]
    assert [name for name in rest if not name.startswith(allowed)] == ["needs", "report", "mjcf"]


@pytest.mark.parametrize("names", [["lesson"], sorted(sc.__all__)])
def test_names_work_in_a_fresh_interpreter(names):
    asked = "; ".join(f"sc.{name}" for name in names)
    assert fresh(f"import stepcore as sc; {asked}; print('found')") == ["found"]


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


def documented():
    """The things in the pages of the API, each imported by the path that stands there."""
    for page in (Path(__file__).parents[2] / "docs" / "api").glob("*.md"):
        for path in re.findall(r"^::: ([\w.]+)$", page.read_text(encoding="utf-8"), re.MULTILINE):
            module, _, name = path.rpartition(".")
            yield getattr(importlib.import_module(module), name)


DOCUMENTED = list(documented())
PUBLIC = [
    thing
    for thing in map(sc.__getattr__, sc._MODULES)
    if not (inspect.ismodule(thing) or inspect.isbuiltin(thing))
    and thing.__module__.startswith("stepcore.")  # compiled classes have no source to read
]


@pytest.mark.parametrize("thing", PUBLIC, ids=lambda thing: thing.__name__)
def test_every_type_that_is_handed_out_is_documented_where_it_can_be_imported(thing):
    """What public functions return, and methods of public classes: so their methods too.

    Names that a user writes stand at the top; what only types a part of a result is documented
    under the module that defines it.
    """
    assert {found.__name__ for found in handed_out(thing) if found not in DOCUMENTED} == set()


def test_there_are_types_to_be_found():
    assert {found.__name__ for found in handed_out(sc.Sim)} >= {"Trajectory", "Energy", "BodyView"}
    assert [found.__name__ for found in handed_out(sc.predict)] == ["Predictability"]
