"""Cases by seed: exploding scenes, changed attributes, damaged files, bad arguments, flipped bits.

Each raises what a user is promised, or nothing; `Broken` says that a promise was not kept.
"""

from __future__ import annotations

import copy
import math
import pickle
import random
import re
import tempfile
import warnings
from pathlib import Path

import numpy as np
from zoo import ZOO

import stepcore as sc

# What a user is promised for bad input and for motions that diverge.
PROMISED = (ValueError, FileNotFoundError, IsADirectoryError, sc.SimulationError)
LAWS = ("solref", "lesson", "relaxed", "rigid", "penalty")
INTEGRATORS = (
    *("explicit", "semi-implicit", "euler", "implicitfast"),
    *("implicit", "discrete", "midpoint", "rk4"),
)
EXTREMES = (0.0, 1e-300, 1e-12, 1e-3, 0.7, 3.0, 1e3, 1e8, 1e40, 1e140, 1e154, 1e308)
ODD = (
    *("", "nan", "inf", "-1", "0", "1e308", "1e-320", "1e400", "a", "0 0 0", "1 2 3 4 5 6 7 8"),
    *("true", "auto", "\u00b2", "-0", "1,2", "0x10", "--1", "world", "9" * 400, "1e154"),
    *(".5", "1e-3", "7", "1e6", "1e12", "1e40", "-1e40", "1 1", "1e-8 1e8", "0 0 1e154", ".5 2 .1"),
)
VALUES = (
    *(None, True, -1, 0, 1, 10**400, 1e308, -1e308, math.nan, math.inf, 1j, "", "a", "qpos", b"x"),
    *([], [1], {}, {"a": 1}, (), object, np.nan, np.zeros(0), np.ones((2, 2)), np.array(["a"])),
    *(np.array([1j]), np.array([None]), [[1], [1, 2]], range(3), {1, 2}, lambda *a: a, slice(3)),
)


class Broken(Exception):
    """A promise that was not kept."""


def prepare() -> None:
    """Imports what the cases use, once and not in each process."""
    for name in dir(sc):
        getattr(sc, name)
    sc.Sim(_small()).step(2)
    _calls(1, 1)


def text_of(rng: random.Random) -> str:
    # Laws on velocities refuse what adheres.
    return ZOO[rng.choice(sorted(ZOO.keys() - {"sticky"}))].text


def scene_of(text: str) -> sc.Scene:
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        return sc.loads(text)


def run(sim: sc.Sim, steps: int) -> None:
    """Steps; whatever happens, the state stays finite and the Sim usable."""
    start = sim.state()
    try:
        sim.step(steps)
    except sc.SimulationError as error:
        finite(sim)
        for name in ("step", "time", "element", "shares", "replay"):
            getattr(error, name)
        sim.restore(sim.state())
        pickle.loads(pickle.dumps(sim))
        copy.deepcopy(sim)
        sim.restore(start)
        finite(sim)
        raise
    finite(sim)


def finite(sim: sc.Sim) -> None:
    if not (np.isfinite(sim.qpos).all() and np.isfinite(sim.qvel).all()):
        raise Broken("a state that is not finite")


def exploding_scene(seed: int) -> None:
    """A scene with extreme stiffness, damping, masses and speeds, under any numerics."""
    rng = random.Random(seed)
    text = text_of(rng)
    for name in ("stiffness", "damping", "armature", "frictionloss", "kp", "kv", "mass"):
        if rng.random() < 0.4:
            number = 10 ** rng.uniform(-3, 9) if rng.random() < 0.8 else rng.choice(EXTREMES)
            text = re.sub(rf'(\b{name})="[^"]*"', rf'\1="{number:g}"', text)
    scene = scene_of(text)
    sim = sc.Sim(
        scene,
        dt=10 ** rng.uniform(-5, -0.3),
        law=rng.choice(LAWS),
        integrator=rng.choice(INTEGRATORS),
        solver=rng.choice(("pgs", "pgs", "newton")),
        acceleration=rng.choice(("none", "momentum")),
        precision=rng.choice(("f64", "f64", "f32")),
        cone=rng.choice(("pyramidal", "elliptic")),
        sweeps=rng.choice((1, 3, 20)),
        softness=rng.choice((0.0, 0.1)),
        ledger=rng.random() < 0.5,
    )
    speeds = np.random.default_rng(seed)
    scale = rng.choice((0.1, 1.0, 30.0, 1e4, 1e9, rng.choice(EXTREMES)))
    sim.qvel[:] = np.clip(scale * speeds.normal(size=sim.model.nv), -1e38, 1e38)
    sim.ctrl[:] = rng.choice((0.0, 1.0, 1e6))
    run(sim, 300)


def changed_attribute(seed: int) -> None:
    """One attribute of a file replaced, added or repeated with an odd value."""
    rng = random.Random(seed)
    text = text_of(rng)
    spots = list(re.finditer(r'([a-z]+)="([^"]*)"', text))
    for spot in rng.sample(spots, min(len(spots), rng.choice((1, 1, 2)))):
        text = text.replace(spot.group(), f'{spot.group(1)}="{rng.choice(ODD)}"', 1)
    run(sc.Sim(scene_of(text)), 20)


def damaged_file(seed: int) -> None:
    """A file that was cut, repeated, or had bytes changed."""
    rng = random.Random(seed)
    data = bytearray(text_of(rng).encode())
    for _ in range(rng.choice((1, 2, 5))):
        at, length = rng.randrange(len(data)), rng.choice((1, 3, 40))
        change = rng.randrange(4)
        if change == 0:
            del data[at : at + length]
        elif change == 1:
            data[at] = rng.randrange(256)
        elif change == 2:
            data[at:at] = data[at : at + length]
        else:
            del data[max(at, 1) :]
        if not data:
            break
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "model.xml"
        path.write_bytes(bytes(data))
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")
            scene = sc.load(path)
    run(sc.Sim(scene), 5)


def _small() -> sc.Scene:
    return scene_of(ZOO["all_together"].text)


def _calls(value: object, other: object) -> list[object]:
    """Public calls, each with one or two values that are mostly wrong."""
    scene = _small()
    model = scene.compile()
    sim = sc.Sim(model)
    batch = sc.Batch(model, 2)
    settings = sorted(model.settings.as_dict())
    assign = sim.__setattr__
    return [
        lambda: sc.load(value),
        lambda: sc.loads(value),
        lambda: sc.Sim(value),
        lambda: sc.Sim(model, value),
        *(lambda name=name: sc.Sim(model, **{name: value}).step() for name in settings),
        *(lambda name=name: scene.with_settings({name: value}) for name in settings),
        lambda: scene.with_settings(value),
        lambda: sc.Batch(model, value),
        lambda: sc.Batch(model, 2, threads=value),
        lambda: sim.step(value),
        lambda: sim.run(value),
        lambda: sim.run(0.01, control=value),
        lambda: sim.run(0.01, control=lambda *_: value),
        lambda: sim.run(0.01, control_dt=value),
        lambda: sim.run(0.01, record=value),
        lambda: sim.restore(value),
        lambda: sim.reset(key=value),
        lambda: sim.body(value),
        lambda: sim.jacobian(value),
        lambda: sim.count_flops(0 if value == 1e308 else value),
        *(lambda name=name: assign(name, value) for name in ("qpos", "qvel", "ctrl", "time")),
        lambda: batch.step(value),
        lambda: batch.rollout(value),
        lambda: batch.reset(key=value),
        lambda: model.index(value, other),
        lambda: model.index("body", value),
        lambda: model.with_values(value),
        lambda: model.with_values({"gravity": value}),
        lambda: model.with_values({value if isinstance(value, str) else "x": other}),
        lambda: model.with_values({"geom/floor/friction": value}),
        lambda: scene.add_body(value, other),
        lambda: scene.add_joint(value, other),
        lambda: scene.add_geom(value, other),
        lambda: scene.add_geom("world", "sphere", value),
        lambda: scene.add_actuator(value, other),
        lambda: scene.add_key("k", qpos=value, time=other),
        lambda: sc.sweep(model, value, lambda sim: 1),
        lambda: sc.sweep(model, {"dt": value}, lambda sim: 1),
        *(
            lambda name=name: sc.trade(
                sc.lesson.spring(), horizon=0.1, **{name: value}, progress=False
            )
            for name in ("starts", "error", "budget", "solvers", "integrators")
        ),
        lambda: sc.Motion(horizon=value, starts=other),
        lambda: sc.Motion(control=value, control_dt=other),
        lambda: sc.diagnose(sc.lesson.spring(), horizon=value),
        lambda: sc.diagnose(scene, dt=value, horizon=0.01, seconds=5),
        lambda: sc.plan(value),
        lambda: sc.replay(value),
    ]


def bad_argument(seed: int) -> None:
    """A public call with a value of a wrong type or size."""
    rng = random.Random(seed)
    value, other = rng.choice(VALUES), rng.choice(VALUES)
    calls = _calls(value, other)
    rng.choice(calls)()


def flipped_bit(seed: int) -> None:
    """Bytes of a snapshot or of a replay file, damaged: refused, and nothing has changed."""
    rng = random.Random(seed)
    sim = sc.Sim(_small())
    sim.step(rng.choice((1, 7)))
    if rng.random() < 0.8:
        damaged = _damaged(sim.state(), rng)
        before = sim.state()
        try:
            sim.restore(damaged)
        except ValueError:
            if sim.state() != before:
                raise Broken("a refused snapshot changed the state") from None
            return
        raise Broken("a damaged snapshot was restored")
    spring = sc.Sim(sc.lesson.spring(), dt=0.3, integrator="explicit", ledger=True)
    spring.reset("start")
    try:
        spring.step(5000)
    except sc.SimulationError as error:
        text = error.replay.to_json()
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "spring.replay.json"
        path.write_bytes(_damaged(text.encode(), rng))
        try:
            sc.replay(path)
        except ValueError:
            return
    raise Broken("a damaged replay file was accepted")


def _damaged(data: bytes, rng: random.Random) -> bytes:
    changed = bytearray(data)
    kind = rng.randrange(3)
    at = rng.randrange(len(changed))
    if kind == 0:
        changed[at] ^= 1 << rng.randrange(8)
    elif kind == 1:
        del changed[at:]
    else:
        changed[at:at] = bytes([rng.randrange(256)])
    return bytes(changed)
