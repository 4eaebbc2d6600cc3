"""Random scenes of everything that a scene can hold, in any numerics, in a Sim and in lanes."""

from __future__ import annotations

import random
import tempfile
import warnings
from pathlib import Path

import numpy as np
import violent
from cases import INTEGRATORS, LAWS, Broken, finite, run
from random_drives import DrivesMaker
from random_model import Maker
from zoo import ZOO

import stepcore as sc

STEPS = 40


def drawn(rng: random.Random) -> sc.Scene:
    """A scene of one of the generators that the other tests have."""
    kind = rng.choice(("tree", "tree", "drives", "drives", "violent", "zoo"))
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        if kind == "tree":
            return sc.loads(Maker(rng).model())
        if kind == "violent":
            return sc.loads(violent.text_of(rng.choice(violent.KINDS), rng)[0])
        if kind == "zoo":
            return sc.loads(ZOO[rng.choice(sorted(ZOO))].text)
        maker = DrivesMaker(rng)
        text = maker.model()
        with tempfile.TemporaryDirectory() as folder:
            for name, content in maker.files().items():
                (Path(folder) / name).write_text(content)
            path = Path(folder) / "model.xml"
            path.write_text(text)
            return sc.load(path)


def numerics(rng: random.Random) -> dict[str, object]:
    """Settings of any kind."""
    law = rng.choice(LAWS)
    chosen: dict[str, object] = {
        "dt": 10 ** rng.uniform(-4, -1.3),
        "law": law,
        "integrator": rng.choice(INTEGRATORS),
        # Newton minimises; Coulomb cones have nothing to minimise.
        "solver": rng.choice(("pgs", "newton")) if law in ("solref", "penalty") else "pgs",
        "precision": rng.choice(("f64", "f64", "f32")),
        "cone": rng.choice(("pyramidal", "elliptic")),
        "sweeps": rng.choice((1, 5, 30)),
        "warm_start": rng.random() < 0.7,
        "ledger": rng.random() < 0.3,
        "stiction": rng.random() < 0.2,
    }
    if chosen["solver"] == "pgs" and rng.random() < 0.2:
        chosen["acceleration"] = "momentum"
    if law == "rigid":
        chosen["restitution"] = rng.choice((0.0, 0.9))
    return chosen


def start(world: sc.Sim | sc.Batch, numbers: np.random.Generator, speed: float) -> None:
    """Speeds, controls and pushes; of a batch the same in each world but for their size."""
    for name in ("qvel", "ctrl", "qfrc_applied", "xfrc_applied"):
        array = getattr(world, name)
        shape = array.shape if isinstance(world, sc.Sim) else array.shape[1:]
        array[...] = speed * numbers.normal(size=shape)


def random_scene(seed: int) -> None:
    """A step either gives finite numbers or raises; what can be read can be read then too."""
    rng = random.Random(seed)
    scene = drawn(rng)
    sim = sc.Sim(scene, **numerics(rng))
    start(sim, np.random.default_rng(seed), rng.choice((0.0, 1.0, 10.0, 1e4)))
    run(sim, STEPS)
    for name in ("energy", "momentum", "contacts", "rows", "sensordata", "element_forces"):
        getattr(sim, name)
    before = sim.state()
    sim.restore(before)
    if sim.state() != before:
        raise Broken("a state that was restored is another one")


def random_batch(seed: int) -> None:
    """The worlds of a batch, in lanes and threads, have the bits that each has in a Sim."""
    rng = random.Random(seed)
    scene = drawn(rng)
    model = scene.compile()
    # A Sim balances its ledger after other steps than a Batch.
    chosen = numerics(rng) | {"ledger": False}
    worlds, threads = rng.choice((1, 3, 5, 9)), rng.choice((1, 2, 3))
    batch = sc.Batch(
        model,
        worlds,
        threads=threads,
        lanes=rng.choice((True, False)),
        on_failure="go on",
        **chosen,
    )
    start(batch, np.random.default_rng(seed), rng.choice((0.0, 1.0, 10.0, 1e4)))
    size = np.linspace(0.5, 1.0, worlds)
    batch.qvel[...] *= size.reshape(-1, 1)
    starts = batch.state()
    batch.step(STEPS // 2)
    finite(batch)
    for world in range(worlds):
        sim = sc.Sim(model, **chosen)
        sim.restore(starts[world])
        for name in ("ctrl", "qfrc_applied", "xfrc_applied"):
            getattr(sim, name)[...] = getattr(batch, name)[world]
        try:
            sim.step(STEPS // 2)
        except sc.SimulationError:
            if world not in batch.failures:
                raise Broken(f"world {world} fails in a Sim, and not in the batch") from None
        else:
            if world in batch.failures:
                raise Broken(f"world {world} fails in the batch, and not in a Sim")
        if not (sim.qpos == batch.qpos[world]).all() or not (sim.qvel == batch.qvel[world]).all():
            raise Broken(f"world {world} of {worlds} has other bits than its Sim")
