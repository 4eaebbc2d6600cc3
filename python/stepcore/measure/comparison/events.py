"""The first event that differs between two runs: a contact, a joint limit, a saturated actuator."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any

import numpy as np

from stepcore._core import SimulationError
from stepcore.engine.model import Model
from stepcore.engine.sim import Sim, unwatched
from stepcore.experiment.engines import Engine
from stepcore.experiment.mujoco_engine import MuJoCo, mujoco
from stepcore.experiment.schedule import Schedule
from stepcore.report.units import seconds

# The most steps of a run: it is made in Python, at about 30 µs a step on two shared cores.
LONGEST_RUN = 50_000
# An event is over after this time without it [s]: contacts chatter for a few steps.
PAUSE = 0.02

# The time of a step, and the names of what acts then.
States = Iterator[tuple[float, set[str]]]


@dataclass(frozen=True)
class Event:
    """An event that one of two runs has earlier, or alone.

    name: such as "contact `floor`/`foot`". a, b: its times in A and in B [s]; inf if it does not
    happen there.
    """

    name: str
    a: float
    b: float

    @property
    def time(self) -> float:
        """The earlier of both times [s]."""
        return min(self.a, self.b)

    def __str__(self) -> str:
        text = f"at {seconds(self.time)} {self.name} begins in {'A' if self.a < self.b else 'B'}"
        later = abs(self.a - self.b)
        return f"{text} alone" if later == np.inf else f"{text}, {seconds(later)} earlier"


def first_difference(
    engines: tuple[Engine, Engine], schedules: tuple[Schedule, Schedule], start: int
) -> Event | None:
    """Return the first event that two engines have at different times, from one start.

    Times that differ by at most one step of the longer time step are equal. Returns None if there
    is no such event, under a control function, and for runs that take too many steps.
    """
    times = []
    for engine, schedule in zip(engines, schedules, strict=True):
        count = schedule.periods * schedule.steps(engine.dt)
        if schedule.control is not None or count > LONGEST_RUN:
            return None
        run = _run_of_mujoco if isinstance(engine, MuJoCo) else _run_of_stepcore
        times.append(_beginnings(run(engine, schedule, start)))
    step = max(engine.dt for engine in engines) * (1 + 1e-9)
    names = {*times[0], *times[1]}
    pairs = [
        Event(name, *map(float, pair))
        for name in sorted(names)
        for pair in _paired(times[0].get(name, []), times[1].get(name, []))
    ]
    differ = [event for event in pairs if not abs(event.a - event.b) <= step]
    return min(differ, key=lambda event: event.time, default=None)


def _paired(a: list[float], b: list[float]) -> Iterator[tuple[float, float]]:
    for k in range(max(len(a), len(b))):
        yield (a[k] if k < len(a) else np.inf), (b[k] if k < len(b) else np.inf)


def _beginnings(states: States) -> dict[str, list[float]]:
    """Return when each event begins [s], by its name."""
    times: dict[str, list[float]] = {}
    last: dict[str, float] = {}
    for time, active in states:
        for name in active:
            if time - last.get(name, -np.inf) > PAUSE:
                times.setdefault(name, []).append(time)
            last[name] = time
    return times


def _run_of_stepcore(engine: Engine, schedule: Schedule, start: int) -> States:
    model = schedule.driven_model(engine.model)
    sim = unwatched(Sim(model))
    schedule.starts[start].put(sim)
    names = _Named(model)
    for time, ctrl in _controls(schedule, start, engine.dt):
        if ctrl is not None:
            sim.ctrl[:] = ctrl
        try:
            sim.step()
        except SimulationError:
            return
        pairs = zip(sim.contacts["geom1"], sim.contacts["geom2"], strict=True)
        yield time, names.active(list(pairs), sim.qpos, sim.actuator_force)


def _run_of_mujoco(engine: Any, schedule: Schedule, start: int) -> States:
    names = _Named(schedule.driven_model(engine.model))
    with engine.world(schedule.change) as world:
        world.begin(schedule.starts[start])
        model, data = world.model, world.data
        for time, ctrl in _controls(schedule, start, engine.dt):
            if ctrl is not None:
                data.ctrl[:] = ctrl
            mujoco().mj_step(model, data)
            if not np.isfinite(data.qvel).all():
                return
            pairs = [c.geom for c in data.contact if c.efc_address >= 0]
            yield time, names.active(pairs, data.qpos, data.actuator_force)


def _controls(schedule: Schedule, start: int, dt: float) -> Iterator[tuple[float, Any]]:
    """Yield the time after each step, and its controls."""
    rows, hold = schedule.rows([start], dt)
    for step in range(schedule.periods * schedule.steps(dt)):
        row = None if rows is None else rows[0, min(step // hold, rows.shape[1] - 1)]
        yield (step + 1) * dt, row


class _Named:
    """The events of a model in words."""

    def __init__(self, model: Model) -> None:
        self.geoms = [name or f"#{k}" for k, name in enumerate(model.geom_names)]
        single = [k for k, kind in enumerate(model.jnt_type) if kind in ("hinge", "slide")]
        ranges = np.asarray(model.jnt_range, float)[single]
        limited = np.flatnonzero(np.isfinite(ranges).any(axis=1) & (ranges[:, 0] < ranges[:, 1]))
        self.joints = [(single[k], int(model.jnt_qposadr[single[k]])) for k in limited]
        self.low, self.high = ranges[limited].T
        self.joint_names = [name or f"#{k}" for k, name in enumerate(model.joint_names)]
        self.actuators = [name or f"#{k}" for k, name in enumerate(model.actuator_names)]
        self.least, self.most = np.asarray(model.actuator_forcerange, float).reshape(-1, 2).T

    def active(self, pairs: list[Any], qpos: np.ndarray, force: np.ndarray) -> set[str]:
        """Return the contacts, limits and saturated actuators that act."""
        names = {
            f"contact {'/'.join(f'`{name}`' for name in sorted((self.geoms[a], self.geoms[b])))}"
            for a, b in pairs
        }
        q = np.asarray(qpos)[[address for _, address in self.joints]]
        beyond = np.flatnonzero((q < self.low) | (q > self.high))
        names |= {f"limit of joint `{self.joint_names[self.joints[k][0]]}`" for k in beyond}
        full = np.flatnonzero((force <= self.least) | (force >= self.most))
        return names | {f"saturation of `{self.actuators[k]}`" for k in full}
