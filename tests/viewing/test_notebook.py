"""What a notebook shows of a scene, a model and a world: words over a picture."""

import base64
import html
import io
import re

import numpy as np
import pytest

import stepcore as sc
from stepcore import lesson
from stepcore.viewing import notebook, picture


def drawn(shown):
    import PIL.Image as image

    data = re.search(r'src="data:image/png;base64,([^"]+)"', shown).group(1)
    return np.asarray(image.open(io.BytesIO(base64.b64decode(data))))


@pytest.mark.parametrize("of", [lambda scene: scene, sc.Scene.compile, sc.Sim])
def test_words_over_a_picture(of):
    value = of(lesson.stack())
    shown = value._repr_html_()
    assert html.escape(repr(value)) in shown
    pixels = drawn(shown)
    assert pixels.shape == (360, 480, 3) and pixels.std() > 10


def test_a_world_is_shown_where_it_is_and_stays_there():
    pendulum = """<mujoco><worldbody><body><joint axis="0 1 0"/>
    <geom type="capsule" size=".02" fromto="0 0 0 .3 0 0"/></body></worldbody></mujoco>"""
    sim = sc.Sim(sc.loads(pendulum))
    before = drawn(sim._repr_html_())
    sim.qpos[0] = 1.0
    state = sim.state()
    assert (drawn(sim._repr_html_()) != before).any()
    assert sim.state() == state


def test_words_alone_where_nothing_draws(monkeypatch):
    sim = sc.Sim(lesson.stack())
    monkeypatch.setattr(notebook, "MAX_GEOMS", 1)
    assert sim._repr_html_() is None
    monkeypatch.undo()

    def none(*_, **__):
        raise ImportError

    monkeypatch.setattr(picture, "picture", none)
    assert sim._repr_html_() is None
    monkeypatch.undo()
    without_mass = "<mujoco><worldbody><body><freejoint/></body></worldbody></mujoco>"
    assert sc.loads(without_mass)._repr_html_() is None
