"""The renderers of pictures that work on this machine."""

import stepcore as sc
from stepcore import lesson
from stepcore.viewing.drawing import drawing_of
from stepcore.viewing.renderers import MujocoPicture


def opengl():
    """Whether MuJoCo's renderer works on this machine: that is not ours to promise."""
    sim = sc.Sim(lesson.drop())
    try:
        MujocoPicture(drawing_of(sim.model, sim), 16, 16).close()
    except (ImportError, RuntimeError):
        return False
    return True


RENDERERS = ["mitsuba", *(["mujoco"] if opengl() else [])]
