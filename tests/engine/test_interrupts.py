"""Ctrl-C ends a long call within a second of processor time; a step that it ends is not taken."""

from __future__ import annotations

import signal
import threading
import time
from collections.abc import Callable

import numpy as np
import pytest

import stepcore as sc

pytestmark = pytest.mark.usefixtures("interruptible")


def seconds_to_stop(call: Callable[[], object]) -> float:
    """Return the processor time from a Ctrl-C within the call to the end of the call."""
    sent: list[float] = []

    def interrupt() -> None:
        sent.append(time.process_time())
        signal.raise_signal(signal.SIGINT)

    timer = threading.Timer(0.5, interrupt)
    with pytest.raises(KeyboardInterrupt):
        timer.start()
        call()
        timer.join()
        time.sleep(1.0)
        pytest.fail("the call ended before the signal came")
    return time.process_time() - sent[0]


def long_chain() -> sc.Scene:
    scene = sc.Scene()
    link = scene.world
    for _ in range(1500):
        link = scene.add_body(parent=link, pos=(0.1, 0, 0))
        scene.add_joint(link, "hinge", axis=(0, 1, 0))
        scene.add_geom(link, "sphere", size=0.02)
    return scene


def fine_mesh() -> sc.Scene:
    points = np.random.default_rng(0).normal(size=(600_000, 3))
    scene = sc.Scene()
    mesh = sc.Mesh(vertices=points / np.linalg.norm(points, axis=1)[:, None])
    scene.meshes.append(mesh)
    scene.add_geom(scene.add_body(), "mesh", mesh=mesh)
    return scene


def many_contacts() -> sc.Scene:
    scene = sc.Scene()
    for body in range(2):
        part = scene.add_body(pos=(0, 0, 0.01 * body))
        scene.add_joint(part, "free")
        for k in range(700):
            scene.add_geom(part, "sphere", size=0.5, pos=(1e-4 * k, 0, 0))
    return scene


def wide_field() -> sc.Scene:
    scene = sc.Scene()
    field = sc.HField(elevation=np.zeros((2000, 2000)), size=(10, 10, 1, 1))
    scene.hfields.append(field)
    scene.add_geom(scene.world, "hfield", hfield=field)
    ball = scene.add_body(pos=(0, 0, 5))
    scene.add_joint(ball, "free")
    scene.add_geom(ball, "sphere", size=9)
    return scene


@pytest.mark.parametrize("scene", [long_chain, fine_mesh])
def test_compiling(scene):
    made = scene()
    assert seconds_to_stop(made.compile) < 1


@pytest.mark.parametrize("threads", [1, 2])
@pytest.mark.parametrize("call", ["step", "forward"])
@pytest.mark.parametrize("scene", [many_contacts, wide_field])
def test_stepping(scene, call, threads):
    sim = sc.Sim(scene(), threads=threads)
    before = sim.state()
    assert seconds_to_stop(getattr(sim, call)) < 1
    assert sim.state() == before and sim.time == 0
    sim.qpos[2::7] += 100 * np.arange(1, len(sim.qpos[2::7]) + 1)
    sim.step()
    assert sim.time == sim.settings.dt


def test_batches():
    batch = sc.Batch(many_contacts().compile(), 3, threads=2)
    before = batch.state()
    assert seconds_to_stop(lambda: batch.step(3)) < 1
    assert batch.state() == before
