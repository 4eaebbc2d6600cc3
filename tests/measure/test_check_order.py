"""Which findings come first, what a limit is attributed to, and what a plot shows as unlimited."""

import math

import numpy as np
import pytest

import stepcore as sc
from stepcore.measure.check import _causes_first
from stepcore.measure.diagnosis.limits import Limit
from stepcore.measure.monitors import Finding
from stepcore.measure.monitors.finding import named

PARTS = """<mujoco><worldbody><geom name="floor" type="plane" size="1 1 1"/>
<body name="a" pos="0 0 1"><freejoint/><geom name="a" size=".1"/></body>
<body name="b" pos="0 .1 1"><freejoint/><geom name="b" size=".1"/></body>
<body name="c" pos="0 1 1"><freejoint/><geom name="c" size=".1"/></body></worldbody></mujoco>"""
ARM = """<robot name="arm"><link name="base"/><link name="upper"><inertial><origin xyz="0 0 .2"/>
<mass value="1"/><inertia ixx=".02" iyy=".02" izz=".001" ixy="0" ixz="0" iyz="0"/></inertial></link>
<joint name="j" type="revolute"><parent link="base"/><child link="upper"/><axis xyz="0 1 0"/>
<limit lower="-1" upper="1" effort="30" velocity="9"/></joint></robot>"""


@pytest.mark.parametrize(("mover", "first"), [("a", "overlap at the start"), ("c", "tunnelling")])
def test_an_overlap_comes_before_the_passage_that_it_causes(mover, first):
    model = sc.loads(PARTS).compile()
    geoms = [set(pair) for pair in np.asarray(model.pair_geoms).tolist()]
    pair = geoms.index({model.index("geom", "a"), model.index("geom", "b")})
    passage = Finding(
        "tunnelling", "error", "", "", named(model, "geom", [model.index("geom", mover)])
    )
    overlap = Finding("overlap at the start", "warning", "", "", named(model, "contact", [pair]))
    other = Finding("density", "remark", "")
    ordered = _causes_first([passage, other, overlap], model)
    assert ordered[0].kind == first and len(ordered) == 3 and ordered[-1] in (other, overlap)


def test_a_limit_by_the_test_motion_is_labelled():
    """A URDF has no motors; the gains are of stepcore's own controller."""
    model = sc.loads(ARM)
    result = sc.diagnose(model, progress=False)
    assert result.stiffest() == "control of motor `j`"
    assert "the controller of stepcore's test motion" in result.sentences[0]


@pytest.mark.parametrize(
    ("values", "ends"),
    [
        ({"dt": math.inf, "held": math.inf, "longest": 0.05}, (0.05, 0.05)),
        ({"dt": math.nan, "held": math.inf, "holds": 0.02}, (0.02, 0.02)),
        ({"dt": 0.01, "held": 0.03}, (0.01, 0.03)),
    ],
)
def test_a_bar_ends_at_the_longest_step_that_was_run(values, ends):
    assert Limit("euler", **values).ends == ends


def test_default_settings_are_described_in_words():
    scene = sc.loads(PARTS)
    assert sc.run(scene, horizon=0.01).setup == "Under euler, newton, dt 2 ms."
    fine = scene.compile().with_settings(dt=0.001)
    assert sc.run(fine, horizon=0.01).setup == "Settings(dt=0.001)"
