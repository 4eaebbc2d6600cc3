"""Imports of the engine's files go one way too: no circle leaves a folder, and those within shrink.

An import is a `use`, or a path that begins with `crate`, `super` or `self`, in what is not compiled
for tests alone. It counts as one of the file that defines the name, not of one that hands it on.
"""

import re
from pathlib import Path

from test_layers import circles

ROOT = Path(__file__).parents[2] / "crates/stepcore/src"

# Files of a folder that import each other in circles: the sum of their sizes, which may only fall.
WITHIN = {
    "detect": 2,
    "place": 6,
    "shapes": 9,
    "solve": 16,
}
# A `Sim` has the list of its steps, and the list of a step is written down by a `Sim`.
ACROSS = {"observer", "compile", "sim"}

USE = re.compile(r"(?m)^\s*(pub(?:\([^)]*\))?\s+)?use\s+([^;]+);")
TESTS = re.compile(r"(^|/|_)tests?(\.rs|/)")


def name_of(file):
    parts = file.relative_to(ROOT).with_suffix("").parts
    return parts[:-1] if parts[-1] in ("mod", "lib") else parts


FILES = {
    name_of(file): file
    for file in ROOT.rglob("*.rs")
    if not TESTS.search(str(file.relative_to(ROOT)))
}


def compiled(text):
    """The text without comments and without what is compiled for tests alone."""
    text = re.sub(r"//[^\n]*", "", text)
    while (start := text.find("#[cfg(test)]")) >= 0:
        end = re.compile(r"[;{]").search(text, start).start()
        depth = text[end] == "{"
        while depth:
            end += 1
            depth += (text[end] == "{") - (text[end] == "}")
        text = text[:start] + text[end + 1 :]
    return text


def leaves(tree):
    """The paths of a use tree: `a::{b, c::d}` has a::b and a::c::d."""
    tree = re.sub(r"\s+as\s+\w+|\s", "", tree)
    while match := re.search(r"([\w:]*)\{([^{}]*)\}", tree):
        inner = ",".join(match[1] + part for part in match[2].split(",") if part)
        tree = tree[: match.start()] + inner + tree[match.end() :]
    return [tuple(path.removesuffix("::self").split("::")) for path in tree.split(",")]


def absolute(path, file):
    """A path from the crate's root; None for one of another crate."""
    if path[0] == "crate":
        return path[1:]
    if path[0] == "self":
        return file + path[1:]
    if path[0] == "super":
        while path and path[0] == "super":
            path, file = path[1:], file[:-1]
        return file + path
    return file + path if file + path[:1] in FILES else None


HANDED_ON = {}
IMPORTS = {}
for name, source in FILES.items():
    text = compiled(source.read_text())
    body = re.sub(r"\bmod \w+;", "", USE.sub("", text))
    paths = [tuple(path.split("::")) for path in re.findall(r"\b(?:crate|super)(?:::\w+)+", body)]
    IMPORTS[name] = [absolute(path, name) for path in paths]
    for public, tree in USE.findall(text):
        for path in filter(None, (absolute(path, name) for path in leaves(tree))):
            if public:
                HANDED_ON[name + path[-1:]] = path
            if not public or re.search(rf"\b{path[-1]}\b", body):
                IMPORTS[name].append(path)


def defining(path):
    """The file in which what a path names is defined."""
    for end in range(len(path), 0, -1):
        if path[:end] in FILES:
            on = HANDED_ON.get(path[: end + 1])
            return defining(on + path[end + 1 :]) if on else path[:end]
    return ()


GRAPH = {name: {defining(path) for path in paths} - {name, ()} for name, paths in IMPORTS.items()}
CIRCLES = circles(GRAPH)


def test_the_imports_are_found():
    assert ("model",) in GRAPH["place", "kinematics"]
    assert ("place",) in GRAPH["place", "kinematics"]
    assert ("solve", "rows") in GRAPH["elements", "contact"], "through solve/mod.rs"
    assert ("sim",) not in GRAPH["shapes", "gjk"]


def test_no_circle_leaves_its_folder():
    across = [{name[0] for name in circle} for circle in CIRCLES]
    assert [tops for tops in across if len(tops) > 1 and tops != ACROSS] == []


def test_circles_within_a_folder_only_shrink():
    for folder in {name[0] for name in FILES if name}:
        inside = [circle for circle in CIRCLES if {name[0] for name in circle} == {folder}]
        assert sum(map(len, inside)) <= WITHIN.get(folder, 0), inside
