"""What `help` says: every public name explains itself, and every example runs as it stands."""

import doctest
import importlib
import inspect
import pkgutil

import pytest

import stepcore as sc

MODULES = [found.name for found in pkgutil.walk_packages(sc.__path__, "stepcore.")]
# What a user calls or makes; what these hand out is shown in their examples.
FUNCTIONS = [name for name in sc.__all__ if inspect.isfunction(getattr(sc, name))]
MADE = ("Batch", "Linearization", "Model", "Motion", "Replay", "Report", "Scene", "Sim", "Table")


@pytest.mark.parametrize("name", ["stepcore", *MODULES])
def test_the_examples_of_a_module_run(name):
    assert doctest.testmod(importlib.import_module(name)).failed == 0


@pytest.mark.parametrize("name", [*FUNCTIONS, *MADE])
def test_a_public_name_has_an_example(name):
    assert ">>>" in inspect.getdoc(getattr(sc, name))


@pytest.mark.parametrize("name", ["Batch", "Model", "Scene", "Settings", "Sim", "Trade"])
def test_every_public_member_says_what_it_is(name):
    kind = getattr(sc, name)
    # A field of a dataclass is told in the class's own text.
    told = getattr(kind, "__dataclass_fields__", {})
    public = [member for member in dir(kind) if not member.startswith("_") and member not in told]
    silent = [member for member in public if not inspect.getdoc(getattr(kind, member))]
    assert silent == []


def test_dir_lists_the_public_names():
    assert dir(sc) == sorted(sc.__all__)
    assert all(hasattr(sc, name) for name in sc.__all__)
