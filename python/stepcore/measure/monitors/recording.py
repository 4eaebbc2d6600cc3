"""`Recording`: one run for the findings: arrays over time, and the contacts at each reading.

The run is one call of the engine. Results of a solve, such as contacts and their forces, are
computed afterwards, at a bounded number of recorded states.
"""

from __future__ import annotations

import contextlib
import dataclasses
import functools
import math
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from stepcore._core import Settings, SimulationError
from stepcore.checks import one_line
from stepcore.engine.arrays import Floats
from stepcore.engine.coordinates import cross, rotated
from stepcore.engine.follow import Followed, follow
from stepcore.engine.model import Model
from stepcore.engine.run_settings import converged_settings
from stepcore.engine.sim import Sim, unwatched
from stepcore.engine.start import Start
from stepcore.engine.unsolved import FEWEST_LOOKS as SAMPLES
from stepcore.engine.unsolved import Residuals
from stepcore.executors import checkpoint
from stepcore.experiment.schedule import Schedule
from stepcore.experiment.single_run import READINGS
from stepcore.experiment.sizes import Sizes
from stepcore.scene.softness import UNKNOWN

# Names of the recorded arrays.
RECORDED = ("qpos", "qvel", "act", "ctrl", "xpos", "xquat", "actuator_force")
# REST: last fraction of a run, in which rest is judged; half of it misses the noise of dm_control's
# hopper and of particle_free.xml. STEADY: largest relative variation of a quantity at rest; twice
# as much counts a moving foot of that hopper as resting. FEWEST: smallest number of readings from
# which rest or creep is judged.
REST, STEADY, FEWEST = 0.25, 0.2, 8

# A pair of geoms, and the index of one of its contacts.
Key = tuple[int, int]


@dataclass(eq=False)
class Recording:
    """One run of a model under its settings.

    driven: the model that was run, with the servos that stepcore adds if the controls need them.
    times: of the readings [s], (n,); the first is the start.
    data: the arrays of `RECORDED`, (n, …); readings after a failure are left out.
    begin: sets a Sim to the start of the run, with all values that stay constant.
    failure: why the run ended early, or None.
    wanted: the wanted depth of contacts at rest [m], or None.
    passed: geoms that passed through others.
    """

    model: Model
    driven: Model
    times: Floats
    data: Mapping[str, Floats]
    begin: Callable[[Sim], object]
    failure: str | None = None
    wanted: float | None = None
    passed: frozenset[int] = frozenset()
    _read: int | None = field(default=None, init=False)

    def __len__(self) -> int:
        return len(self.times)

    def __getitem__(self, name: str) -> Floats:
        return self.data[name]

    @property
    def spacing(self) -> float:
        """The time between readings [s]."""
        span = float(self.times[-1] - self.times[0]) if len(self) else 0.0
        return span / max(1, len(self) - 1)

    @property
    def late(self) -> int:
        """The first reading of the last part, in which rest is judged; negative if too few."""
        return len(self) - max(FEWEST, int(REST * len(self)))

    def part(self, first: int, last: int | None = None) -> Recording:
        """Return the readings from the first up to, but not including, the last."""
        some = slice(max(0, first), last)
        data = {name: values[some] for name, values in self.data.items()}
        return dataclasses.replace(self, times=self.times[some], data=data)

    def between(self, first: int, last: int) -> Recording:
        """Return the run between two readings, repeated with a reading at every step.

        The recorded controls are repeated, and pushes are left out.
        """
        sim, dt = self.at(first), self.model.settings.dt
        qpos, qvel, act = (np.array(self[name][first]) for name in ("qpos", "qvel", "act"))
        mocap = np.array(sim.mocap_pos), np.array(sim.mocap_quat)
        start, hold = Start(qpos, qvel, act, mocap), max(1, round(self.spacing / dt))
        rows = self["ctrl"][None, first:last]
        again = followed(self.driven, start, hold * (last - first), ctrl=rows, hold=hold)
        times = again.times + self.times[first]
        return dataclasses.replace(again, model=self.model, times=times)

    @functools.cached_property
    def sizes(self) -> Sizes:
        return Sizes(self.model)

    def thick(self, pair: int) -> float:
        """Return the half thickness of the thinner geom of a pair [m]."""
        return self.sizes.contact(*self.model.contact_pair(pair).geoms)

    @functools.cached_property
    def roots(self) -> np.ndarray:
        """The root of each body, (nbody,); 0 for the world."""
        return np.array([self.model.root(body) for body in range(self.model.nbody)])

    def centre_of_mass(self, root: int) -> Floats:
        """Return the centre of mass of a tree at all readings [m], (n, 3)."""
        bodies = np.flatnonzero(self.roots == root)
        mass, turn = self.model.body_mass[bodies], self["xquat"][:, bodies]
        each = self["xpos"][:, bodies] + rotated(turn, self.model.body_ipos[bodies])
        centre: Floats = np.einsum("nbi,b->ni", each, mass) / max(float(mass.sum()), 1e-300)
        return centre

    @functools.cached_property
    def gravity(self) -> float:
        """The strength of gravity [m/s²]; 0 if it is switched off."""
        scene = self.model.scene
        return float(np.linalg.norm(scene.gravity)) if scene.features.gravity else 0.0

    def weight(self, root: int) -> float:
        """Return the weight of a tree [N]."""
        return self.gravity * float(self.model.body_mass[self.roots == root].sum())

    def height(self, root: int) -> Floats:
        """Return the height of a tree's centre of mass against gravity [m], (n,); 0 without it."""
        up = -np.asarray(self.model.scene.gravity, float) / (self.gravity or math.inf)
        height: Floats = self.centre_of_mass(root) @ up
        return height

    @functools.cached_property
    def contacts(self) -> Contacts:
        """The contacts with a positive force, at all readings."""
        return Contacts(self)

    @functools.cached_property
    def _sim(self) -> Sim:
        sim = unwatched(Sim(self.driven, _solved(self.model.settings)))
        self.begin(sim)
        return sim

    def at(self, reading: int) -> Sim:
        """Return the Sim at a reading, with contacts and forces; always the same object."""
        sim = self._sim
        if self._read != reading:
            for name in ("qpos", "qvel", "act", "ctrl"):
                getattr(sim, name)[:] = self.data[name][reading]
            sim.forward()
            self._read = reading
        return sim

    @functools.cached_property
    def unsolved(self) -> bool:
        """Whether most of the sampled steps leave rows unsolved; see `Residuals`."""
        sim = unwatched(Sim(self.driven))
        self.begin(sim)
        residuals = Residuals(sim)
        with contextlib.suppress(SimulationError):
            for reading in np.linspace(0, len(self) - 1, SAMPLES).astype(int).tolist():
                checkpoint()
                for name in ("qpos", "qvel", "act", "ctrl"):
                    getattr(sim, name)[:] = self.data[name][reading]
                # The first steps lack the impulses of earlier steps.
                sim.step(FEWEST)
                residuals.look(sim)
        return residuals.typical > residuals.large

    @functools.cached_property
    def geoms(self) -> tuple[Floats, Floats]:
        """Centres [m] and axes of all geoms, (n, ngeom, 3) and (n, ngeom, 3, 3)."""
        first, body = self.at(0), self.model.geom_body
        xmat = np.array(first.xmat).reshape(-1, 3, 3)[body]
        place = np.einsum("gji,gj->gi", xmat, np.array(first.geom_xpos) - first.xpos[body])
        turn = np.swapaxes(xmat, 1, 2) @ np.array(first.geom_xmat).reshape(-1, 3, 3)
        quat = self["xquat"][:, body]
        axes = np.stack([rotated(quat, turn[:, :, k]) for k in range(3)], axis=-1)
        return self["xpos"][:, body] + rotated(quat, place), axes


def recorded(model: Model, schedule: Schedule) -> Recording:
    """Run a schedule under a model's settings from its first start, and record it."""
    count, driven = schedule.steps(model.settings.dt), schedule.driven_model(model)
    if schedule.control is not None:
        how: dict[str, Any] = {"control": schedule.control, "hold": count}
    else:
        how = dict(zip(("ctrl", "hold"), schedule.rows([0], model.settings.dt), strict=True))
    run = followed(driven, schedule.starts[0], schedule.periods * count, **how)
    return dataclasses.replace(run, model=model)


def cut(model: Model, schedule: Schedule, ran: Followed | None) -> Recording | None:
    """Return the motion's part of a longer run; None if it failed or has too few readings."""
    count = 0 if ran is None else int(np.searchsorted(ran.times, schedule.horizon * (1 + 1e-9)))
    if ran is None or ran.failures or count < READINGS / 2 or not set(RECORDED) <= set(ran.data):
        return None
    data = {name: ran[name][0] for name in RECORDED}
    run = whole(schedule.driven_model(model), ran.times, data, schedule.starts[0].put)
    return dataclasses.replace(run.part(0, count), model=model)


def followed(model: Model, start: Start, steps: int, **controls: Any) -> Recording:
    """Run steps from a start, and record them; controls: ctrl, hold and control of `follow`."""
    every = max(1, steps // READINGS)
    ran = follow(model, [start], steps - steps % every, every, record=RECORDED, **controls)
    error = ran.failures.get(0)
    data = {name: ran[name][0] for name in RECORDED}
    return whole(model, ran.times, data, start.put, None if error is None else one_line(error))


def whole(
    model: Model,
    times: Floats,
    data: Mapping[str, Floats],
    begin: Callable[[Sim], object],
    failure: str | None = None,
) -> Recording:
    """Return the recording up to the first reading that is not finite."""
    finite = np.ones(len(times), bool)
    for values in data.values():
        finite &= np.isfinite(values).reshape(len(times), -1).all(axis=1)
    count = len(times) if finite.all() else int(np.argmin(finite))
    return Recording(model, model, times, data, begin, failure).part(0, count)


def _solved(settings: Settings) -> Settings:
    """Return settings that solve the rows of a reading independently of earlier steps."""
    if settings.law == "solref" and settings.solver == "pgs":
        return converged_settings(settings, ledger=False)
    return settings.replace(ledger=False)


def settled(series: Floats) -> float | None:
    """Return the mean of the end of a series; None if the series still varies there."""
    late = series[-max(FEWEST, int(REST * len(series))) :]
    mean = float(late.mean())
    steady = len(late) >= FEWEST and mean > 0 and float(np.ptp(late)) < STEADY * mean
    return mean if steady else None


class Contacts:
    """The contacts with a positive force in one run, ordered by reading.

    reading, pair, part: indices, (m,). geoms: indices of both, (m, 2). depth: the overlap [m].
    position, normal: of the contact, the normal from the first geom to the second, (m, 3).
    force: along the normal [N].
    share: friction over μ × normal force. past: the tangential velocity [m/s], (m, 3).
    rolls: the speed at which the surfaces turn on each other: angular velocity × lever [m/s].
    """

    def __init__(self, run: Recording) -> None:
        self.run, self.model = run, run.model
        tables, moves, centres = [], [], []
        for k in range(len(run) if self.model.npair else 1):
            checkpoint()
            sim = run.at(k)
            tables.append(sim.contacts)
            moves.append(np.array(sim.cvel))
            centres.append(np.array(sim.subtree_com)[run.roots])
        every = np.concatenate(tables)
        reading = np.repeat(np.arange(len(tables)), [len(table) for table in tables])
        with np.errstate(over="ignore", invalid="ignore"):
            force = np.einsum("ci,ci->c", every["force"], every["normal"])
            some = np.flatnonzero(force > 0)
            self.reading, self.force, every = reading[some], force[some], every[some]
            self._slips(every, np.array(moves), np.array(centres))

    def _slips(self, every: np.ndarray, moves: Floats, centres: Floats) -> None:
        """Compute slip, friction and rolling; moves, centres: of the bodies at each reading."""
        self.pair, self.part = every["index"].astype(int), every["part"].astype(int)
        self.geoms = np.stack([every["geom1"], every["geom2"]], axis=1)
        self.depth, self.position, self.normal = -every["dist"], every["pos"], every["normal"]
        normal = self.normal
        # Body velocities refer to the point at the tree's centre of mass.
        spins, speeds = [], []
        for geom in ("geom1", "geom2"):
            at = self.reading, self.model.geom_body[every[geom]]
            spins.append(moves[at][:, :3])
            speeds.append(moves[at][:, 3:] + cross(spins[-1], every["pos"] - centres[at]))
        past = speeds[1] - speeds[0]
        self.past = past - np.einsum("ci,ci->c", past, normal)[:, None] * normal
        rubbed = np.linalg.norm(every["force"] - self.force[:, None] * normal, axis=1)
        kinds, each = np.unique(self.pair, return_inverse=True)
        friction, levers = np.zeros(len(kinds)), np.full(len(kinds), UNKNOWN)
        for k, pair in enumerate(kinds.tolist()):
            reach = min(self.run.sizes.reach[geom] for geom in self.model.contact_pair(pair).geoms)
            friction[k] = friction_of(self.model, pair)
            levers[k] = reach if math.isfinite(reach) else UNKNOWN
        most = friction[each] * self.force
        self.share = np.divide(rubbed, most, out=np.zeros_like(rubbed), where=most > 0)
        self.rolls = np.linalg.norm(spins[1] - spins[0], axis=1) * levers[each]

    @functools.cached_property
    def groups(self) -> dict[Key, np.ndarray]:
        """The indices of each contact in the arrays, in order of time."""
        keys = np.stack([self.pair, self.part], axis=1)
        each, which = np.unique(keys, axis=0, return_inverse=True)
        which = which.reshape(-1)
        order = np.argsort(which, kind="stable")
        parts = np.split(order, np.cumsum(np.bincount(which))[:-1]) if len(order) else []
        return {(int(a), int(b)): part for (a, b), part in zip(each, parts, strict=True)}

    def late(self) -> Iterator[tuple[Key, np.ndarray]]:
        """Yield contacts that last through the end of the run, with their indices there."""
        first = self.run.late
        for key, places in self.groups.items():
            end = places[self.reading[places] >= first]
            if first >= 0 and len(end) == len(self.run) - first:
                yield key, end


def friction_of(model: Model, pair: int) -> float:
    """Return the sliding friction of a pair; 0 if it has only a normal row."""
    of = model.contact_pair(pair)
    return of.friction if of.condim > 1 else 0.0


def free_bodies(model: Model) -> set[int]:
    """Return the bodies with a free joint."""
    joints = zip(model.jnt_body.tolist(), model.jnt_type, strict=True)
    return {body for body, kind in joints if kind == "free"}
