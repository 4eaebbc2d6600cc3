"""Imports go one way: no circle of files, and no layer that knows one above it.

Every import counts, at the top of a file or within a function. Those under TYPE_CHECKING are
never executed: they may name a type of a layer above, and are held to a list of their own.
"""

import ast
import functools
from pathlib import Path

import stepcore

ROOT = Path(stepcore.__file__).parent

# From the ground up. A file belongs to the entry with the longest matching prefix.
LAYERS = (
    ("_core", "checks", "deadline", "escapes", "files", "needs", "signatures", "vectors"),
    ("report",),
    ("executors",),
    ("scene",),
    ("mjcf", "urdf"),
    ("viewing",),
    ("engine",),
    # The class Scene reads, writes and compiles itself, so it stands on all three.
    ("scene.scene",),
    ("lesson.scenes", "loading"),
    ("experiment",),
    ("measure",),
    ("lesson",),
    ("gymnasium", "testing", "torch", "jax"),
    ("cli", "__main__"),
)
# Layers in whose files TYPE_CHECKING may name types of layers above: what they are handed.
HANDED = (
    "report.plot",
    "executors",
    "scene",
    "mjcf",
    "viewing",
    "engine",
    "experiment",
    "_core",
)
# Types may tie files of these to each other: a Model gives the plan of a Sim, which has its Model;
# a view has its world, which gives views; a Sim opens the page that shows it; `Scene.compile` gives
# a Model, which has its Scene; a Scene is handed to what lays it out, reads and writes it.
TIED = ("engine.", "viewing.", "scene.", "mjcf.", "urdf.")


def name_of(file):
    parts = file.relative_to(ROOT).with_suffix("").parts
    return ".".join(parts[:-1] if parts[-1] == "__init__" else parts)


FILES = {name_of(file): file for file in [*ROOT.rglob("*.py"), ROOT / "_core.pyi"]}


def imports(file):
    """(module, only for types) of each import in a file, as names below stepcore."""
    package = name_of(file) if file.name == "__init__.py" else name_of(file).rpartition(".")[0]

    def visit(node, types):
        for child in ast.iter_child_nodes(node):
            inner = types
            if isinstance(child, ast.If) and "TYPE_CHECKING" in ast.unparse(child.test):
                inner = True
            if isinstance(child, ast.Import):
                for alias in child.names:
                    yield alias.name, inner
            elif isinstance(child, ast.ImportFrom):
                module = child.module or ""
                if child.level:
                    up = f"stepcore.{package}".split(".")
                    up = up[: len(up) - child.level + 1]
                    module = ".".join([*up, module]).rstrip(".")
                for alias in child.names:
                    full = f"{module}.{alias.name}"
                    is_file = full.removeprefix("stepcore.") in FILES
                    yield (full if is_file else module), inner
            yield from visit(child, inner)

    for module, types in visit(ast.parse(file.read_text()), file.suffix == ".pyi"):
        if module == "stepcore" or module.startswith("stepcore."):
            yield module.removeprefix("stepcore").removeprefix("."), types


@functools.cache
def edges():
    return {name: set(imports(file)) for name, file in FILES.items()}


def running():
    """The imports that are not for types alone."""
    return {name: {to for to, types in found if not types} for name, found in edges().items()}


def circles(graph):
    """The groups of files that reach each other (Tarjan's strongly connected components)."""
    index, low, stack, groups = {}, {}, [], []

    def visit(node):
        index[node] = low[node] = len(index)
        stack.append(node)
        for other in graph.get(node, ()):
            if other not in index:
                visit(other)
            if other in stack:
                low[node] = min(low[node], low[other])
        if low[node] == index[node]:
            at = stack.index(node)
            if len(stack) - at > 1:
                groups.append(tuple(sorted(stack[at:])))
            del stack[at:]

    for node in graph:
        if node not in index:
            visit(node)
    return groups


def layer(name):
    """The height of a file's layer; the root, which only names things, is above all."""
    matching = [
        (len(prefix), height)
        for height, prefixes in enumerate(LAYERS)
        for prefix in prefixes
        if name == prefix or name.startswith(prefix + ".")
    ]
    return max(matching)[1] if matching else len(LAYERS)


def test_the_imports_are_found():
    assert ("scene.scene", True) in edges()["engine.model"]
    assert "mjcf.writer" in running()["scene.scene"]
    assert "lesson.run" in running()["lesson"]
    assert circles({"a": {"b"}, "b": {"c"}, "c": {"b"}}) == [("b", "c")]


def test_no_circle_of_files():
    """Lazy imports count."""
    assert set(circles(running())) == set()


def test_circles_of_types_stay_in_the_engine():
    """Imports under TYPE_CHECKING count, in all files but the stub of the engine."""
    every = {name: {to for to, _ in found} for name, found in edges().items() if name != "_core"}
    assert ("scene.scene", True) in edges()["engine.model"]
    tied = {name for group in circles(every) for name in group}
    assert {name for name in tied if not name.startswith(TIED)} == set()


def test_imports_go_down():
    upward = {
        (name, to) for name, found in running().items() for to in found if layer(to) > layer(name)
    }
    assert upward == set()


def test_nothing_imports_the_root():
    """It gathers names for users; a file that imported it would import everything."""
    assert {name for name, found in running().items() if "" in found} == set()


def test_types_of_layers_above_are_only_named_where_they_are_handed_in():
    above = {
        (name, to)
        for name, found in edges().items()
        for to, types in found
        if types and layer(to) > layer(name)
    }
    assert {(name, to) for name, to in above if not name.startswith(HANDED)} == set()


def test_every_file_has_a_layer():
    assert [name for name in FILES if layer(name) == len(LAYERS)] == [""]
