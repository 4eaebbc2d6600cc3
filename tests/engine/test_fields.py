"""Keyword fields are typed: a misspelt one is found before anything runs."""

import inspect
import sys
import textwrap
from pathlib import Path

import keyword_types
import pytest
from mypy import api

import stepcore as sc
from stepcore.scene import elements
from stepcore.scene.element import field_rows
from stepcore.signatures import SettingsFields

ROOT = Path(__file__).parents[2]


def test_the_types_of_keywords_are_those_of_the_tables():
    """After a change of a field: python benches/keyword_types.py."""
    assert keyword_types.STUB.read_text() == keyword_types.text()


@pytest.mark.parametrize("kind", keyword_types.KINDS)
def test_the_arguments_of_add_are_fields_of_the_element(kind):
    known = {*field_rows(getattr(elements, kind)), "fromto", "joints", "file"}
    named = inspect.signature(getattr(sc.Scene, f"add_{kind.lower()}")).parameters
    assert {*named} - {"self", "fields"} <= known


def test_the_keywords_of_a_sim_are_the_fields_of_settings():
    assert {*SettingsFields.__annotations__} == {*sc.Settings().as_dict()}


GOOD = """
import numpy as np
import stepcore as sc

scene = sc.Scene()
arm = scene.add_body("arm", pos=np.zeros(3))
knee = scene.add_joint(arm, axis=(0, 1, 0), damping=0.1, range=[-1, 1])
scene.add_geom(arm, "capsule", 0.1, fromto=(0, 0, 0, 1, 0, 0), friction=0.4)
scene.add_actuator(knee, "position", kp=10.0, ctrlrange=(-1, 1))
sim = sc.Sim(scene, dt=0.01, integrator="rk4", sweeps="auto")
batch = sc.Batch(sim.model, 4, precision="f32")
model = sim.model.with_settings(tolerance=1e-6)
"""
WRONG = {
    "scene.add_joint(arm, dampning=0.1)": "dampning",
    'scene.add_geom(arm, "sphere", 0.1, desnity=1.0)': "desnity",
    "scene.add_actuator(knee, gaer=1.0)": "gaer",
    "sc.Sim(scene, dtt=0.01)": "dtt",
    "sc.Batch(scene, 4, swepes=3)": "swepes",
    "model.with_settings(solver=3)": "int",
    "scene.with_settings(law=None)": "None",
    "sc.Settings().replace(bta=0.1)": "bta",
}


def test_a_type_checker_finds_a_misspelt_field(tmp_path):
    file = tmp_path / "robot.py"
    file.write_text(textwrap.dedent(GOOD) + "\n".join(WRONG) + "\n")
    first = file.read_text().splitlines().index(next(iter(WRONG))) + 1
    config = f"--config-file={ROOT / 'pyproject.toml'}"
    python = f"--python-executable={sys.executable}"
    says, broken, _ = api.run([config, python, "--no-error-summary", str(file)])
    assert not broken
    lines = [line for line in says.splitlines() if ": error:" in line]
    assert len(lines) == len(WRONG), says
    for number, (line, word) in enumerate(zip(lines, WRONG.values(), strict=True), first):
        assert f"robot.py:{number}:" in line and word in line
