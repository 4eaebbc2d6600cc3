"""Runs over time: overlap as a recordable number, and the picture."""

import numpy as np
import pytest

import stepcore as sc
from stepcore import lesson


def drop():
    sim = sc.Sim(lesson.drop())
    sim.reset(key="start")
    return sim


def test_overlap_is_that_of_the_present_state():
    """−qpos while the ball is in the floor, else 0; at rest softness m g h² / β deep."""
    sim = drop()
    run = sim.run(1.0, record=("qpos", "overlap"))
    assert run.overlap.shape == (501,)
    assert run.overlap == pytest.approx(np.maximum(0.0, -run.qpos[:, 0]), abs=1e-15)
    assert run.overlap[0] == 0.0 < run.overlap.max()
    assert sim.overlap == pytest.approx(0.5 * 9.81 * 0.002**2 / 0.2, rel=1e-6)


def test_reading_overlap_changes_nothing():
    """The last solve stays as it is, whatever is written and read in between."""
    sim = drop()
    sim.step(200)
    before, state = sim.contacts.copy(), sim.state()
    sim.qpos = [-0.05]
    assert sim.overlap == pytest.approx(0.05, abs=1e-15)
    assert np.array_equal(sim.contacts, before)
    sim.restore(state)
    again = drop()
    again.step(200)
    sim.step(50)
    again.step(50)
    assert sim.qpos[0] == again.qpos[0]


def test_overlap_of_a_batch_and_of_the_deepest_pair():
    """Two balls in one another and in the floor: the deeper counts, world by world."""
    model = lesson.stack().compile()
    batch = sc.Batch(model, 3)
    batch.qpos = [[0.0, 0.0], [-0.02, -0.02], [-0.01, -0.04]]
    assert batch.overlap == pytest.approx([0.0, 0.02, 0.03], abs=1e-15)


@pytest.mark.parametrize(
    ("record", "labels"),
    (
        (("qpos", "energy", "overlap"), ["energy [J]", "deepest overlap [m]"]),
        (("qpos", "residual"), ["qpos", "residual [m/s]"]),
    ),
)
def test_the_picture(tmp_path, record, labels):
    """Energy and overlap where they are, else all; words are inside, and nothing is cut off."""
    figure = drop().run(0.5, record=record).plot(tmp_path / "run.png")
    assert (tmp_path / "run.png").read_bytes().startswith(b"\x89PNG")
    assert [axes.get_ylabel() for axes in figure.axes] == labels
    assert figure.axes[-1].get_xlabel() == "time [s]"
    if "energy" in record:
        words = [text.get_text() for text in figure.axes[0].get_legend().get_texts()]
        assert words == ["kinetic", "potential", "total"]


def test_nothing_recorded_cannot_be_drawn():
    with pytest.raises(ValueError, match="recorded nothing"):
        drop().run(0.1, record=()).plot()
