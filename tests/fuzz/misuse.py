"""Calls in an order that nobody means: views that outlive worlds, arrays of wrong kinds, copies."""

from __future__ import annotations

import copy
import gc
import pickle
import random
import threading
import warnings
from collections.abc import Callable

import numpy as np
from cases import PROMISED, VALUES, _small, finite

import stepcore as sc

ARRAYS = ("qpos", "qvel", "ctrl", "act", "qfrc_applied", "xfrc_applied", "mocap_pos", "eq_active")
READ = (
    *("energy", "momentum", "contacts", "rows", "overlap", "sensordata", "xpos", "residual"),
    *("qacc", "asleep", "ten_length", "nbytes", "time"),
)
# What numpy itself says of a wrong assignment.
NUMPYS = (TypeError, IndexError, AttributeError, OverflowError)
DTYPES = (np.float32, np.int64, np.complex128, np.bool_, object, "U3", ">f8", np.float16)


class Player:
    """Worlds and views of their arrays, on which a random call is made at a time."""

    def __init__(self, seed: int) -> None:
        self.rng = random.Random(seed)
        self.model = _small().compile()
        self.worlds: list[sc.Sim | sc.Batch] = [sc.Sim(self.model)]
        # What was read, some of it of worlds that are gone.
        self.kept: list[np.ndarray] = []
        self.states: list[object] = []

    def world(self) -> sc.Sim | sc.Batch:
        return self.rng.choice(self.worlds)

    def make(self) -> None:
        rng = self.rng
        settings = {
            "precision": rng.choice(("f64", "f32")),
            "solver": rng.choice(("pgs", "newton")),
        }
        if rng.random() < 0.5:
            self.worlds.append(sc.Sim(self.model, **settings))
        else:
            lanes = rng.choice(("auto", True, False))
            size, threads = rng.choice((1, 2, 7)), rng.choice((1, 2, 5))
            how = rng.choice(("stop", "go on"))
            self.worlds.append(
                sc.Batch(self.model, size, threads=threads, lanes=lanes, on_failure=how, **settings)
            )

    def forget(self) -> None:
        """A world is gone, views of it stay."""
        if len(self.worlds) > 1:
            del self.worlds[self.rng.randrange(len(self.worlds))]
            gc.collect()

    def step(self) -> None:
        self.world().step(self.rng.choice((0, 1, 3, 20)))

    def keep(self) -> None:
        value = getattr(self.world(), self.rng.choice((*ARRAYS, *READ)))
        if isinstance(value, np.ndarray):
            self.kept.append(value)

    def write_kept(self) -> None:
        """Into a view, of a world that may be gone."""
        if self.kept:
            view = self.rng.choice(self.kept)
            view[...] = self.rng.choice((0, 1, -1.5, np.nan, 1e300, "a", None, [1, 2, 3], 1 + 1j))

    def read_kept(self) -> None:
        for view in self.kept:
            view.sum() if view.dtype.kind == "f" else view.tobytes()

    def assign(self) -> None:
        """An array of another kind or shape."""
        rng, name = self.rng, self.rng.choice(ARRAYS)
        world = self.world()
        shape = rng.choice((getattr(world, name).shape, (3,), (0,), (2, 2), ()))
        value = np.ones(shape).astype(rng.choice(DTYPES))
        if rng.random() < 0.3:
            value = np.ones((4, 40, 3))[::-2, ::2, 1]
        setattr(world, name, rng.choice((value, rng.choice(VALUES))))

    def reset(self) -> None:
        rng, world = self.rng, self.world()
        if isinstance(world, sc.Batch) and rng.random() < 0.7:
            n = len(world)
            masks = (np.ones(n, bool), [0], [n], [-1], np.zeros(n), "a", [True], range(n), None)
            world.reset(worlds=rng.choice(masks), qvel=rng.choice((None, None, *VALUES)))
        else:
            world.reset(**rng.choice(({}, {"key": 0}, {"key": "no"}, {"key": None}, {"key": -1})))

    def save(self) -> None:
        self.states.append(self.world().state())

    def restore(self) -> None:
        if self.states:
            self.world().restore(self.rng.choice((*self.states, b"", (), None, (b"", b""))))

    def copied(self) -> None:
        world = self.world()
        make = self.rng.choice((copy.copy, copy.deepcopy, lambda w: pickle.loads(pickle.dumps(w))))
        self.worlds.append(make(world))

    def resized(self) -> None:
        """numpy's own ways to take memory away from an array or to write into it."""
        if self.kept:
            view = self.rng.choice(self.kept)
            change: Callable[[], object] = self.rng.choice(
                (
                    lambda: view.resize(1000),
                    lambda: view.setflags(write=True),
                    lambda: view.sort(),
                    lambda: np.copyto(view, 3.0),
                    lambda: memoryview(view).release(),
                )
            )
            with warnings.catch_warnings():
                warnings.simplefilter("ignore")
                change()

    def together(self) -> None:
        """Two threads step and read one world."""
        world, errors = self.world(), []

        def play() -> None:
            try:
                for _ in range(5):
                    world.step(1)
                    world.state()
                    world.qpos.sum()
            except (*PROMISED, RuntimeError) as error:
                errors.append(error)

        threads = [threading.Thread(target=play) for _ in range(2)]
        for one in threads:
            one.start()
        for one in threads:
            one.join()
        for error in errors:
            if "panic" in str(error) or "internal error" in str(error):
                raise error

    def other_model(self) -> None:
        self.model.with_values(self.rng.choice(({"gravity": self.rng.choice(VALUES)}, {})))


ACTIONS = (
    *("make", "forget", "step", "step", "keep", "keep", "write_kept", "read_kept", "assign"),
    *("reset", "save", "restore", "copied", "resized", "together", "other_model"),
)


def misuse(seed: int) -> None:
    """Whatever is called in whatever order: a promised error, and worlds that stay finite."""
    player = Player(seed)
    for _ in range(60):
        action = player.rng.choice(ACTIONS)
        try:
            getattr(player, action)()
        except PROMISED as error:
            if "panic" in str(error) or "internal error" in str(error):
                raise
        except NUMPYS:
            if action not in ("write_kept", "resized", "assign"):
                raise
        del player.worlds[4:], player.kept[8:], player.states[4:]
    for world in player.worlds:
        world.reset()
        world.step(2)
        finite(world)
