"""`MuJoCo`: runs the changes of a Study by `mujoco.rollout`, with MuJoCo's settings.

The package mujoco is imported here only, on use. Settings have stepcore's names (dt, integrator,
solver, sweeps, …), and `Change.mjcf` writes them as `<option>`. All engines have the same truth,
norm and choice. Starts and controls come from stepcore's model of the scene.

If stepcore refuses a file that MuJoCo loads, they come from MuJoCo's model: starts are near the
keyframe, a flex moves as a whole, and controls are the user's rows, or follow a rule: "hold" holds
the keyframe's controls, "sines" (the default) sums random sines within the control ranges, "random"
draws new controls in every period, and "fall" sets all controls to 0.
"""

from __future__ import annotations

import copy
import dataclasses
import math
import os
import threading
import time
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from functools import partial
from operator import attrgetter
from typing import Any

import numpy as np

from stepcore import checks
from stepcore.engine.control import ControlError, evaluate_control, new_control
from stepcore.engine.coordinates import Coordinates
from stepcore.engine.model import Model
from stepcore.engine.norm import Matter, Tracks
from stepcore.engine.sim import Sim, unwatched
from stepcore.engine.start import Start
from stepcore.engine.trajectory import OF_WORLDS, recordable
from stepcore.executors import checkpoint
from stepcore.experiment.change import Change
from stepcore.experiment.control_table import Controls, PositionTable
from stepcore.experiment.default_motion import MotionRequest, by_rule
from stepcore.experiment.elements import Elements, Source, contact_force
from stepcore.experiment.engines import (
    RECORDED,
    Course,
    Engine,
    Recording,
    Stepcore,
    Way,
    spread,
)
from stepcore.experiment.motion import Motion
from stepcore.experiment.schedule import (
    FINEST,
    HORIZON,
    Schedule,
    laid_out,
    random_start,
    user_controls,
)
from stepcore.experiment.sizes import scene_size
from stepcore.loading import find_asset, find_model, find_scene
from stepcore.mjcf.reader import read_text
from stepcore.mjcf.through_mujoco import quiet
from stepcore.scene.scene import Scene
from stepcore.scene.softness import UNKNOWN

# MuJoCo's enumerations and numbers of `MjOption`, with stepcore's names.
INTEGRATORS = ("euler", "rk4", "implicit", "implicitfast", "discrete")
SOLVERS, CONES = ("pgs", "cg", "newton"), ("pyramidal", "elliptic")
KINDS = {"integrator": INTEGRATORS, "solver": SOLVERS, "cone": CONES}
NUMBERS = {
    "dt": "timestep",
    "sweeps": "iterations",
    "cost_tolerance": "tolerance",
    **{name: name for name in ("impratio", "noslip_iterations", "noslip_tolerance")},
}
# Solvers that a trade tries. MuJoCo's newton ends by its tolerance after a few iterations.
SOLVED: tuple[dict[str, Any], ...] = (
    {"solver": "newton"},
    {"solver": "newton", "cost_tolerance": 1e-4},
    {"solver": "cg"},
    *({"solver": "pgs", "sweeps": sweeps} for sweeps in (4, 16, 64)),
)
# The most steps of one call, after which the deadline is checked; and the most idle worlds kept.
CHUNK, KEPT = 2000, 16
# Flags that leave features out, as in `Features`; and the numbers that show a model has them.
FLAGS = {
    "equality": "neq",
    "frictionloss": "dof_frictionloss tendon_frictionloss",
    "limit": "jnt_limited tendon_limited",
    "contact": "ngeom nflex",
    "spring": "jnt_stiffness jnt_stiffnesspoly tendon_stiffness tendon_stiffnesspoly nflex nplugin",
    "damper": "dof_damping dof_dampingpoly tendon_damping tendon_dampingpoly nflex nplugin",
    "gravity": "opt.gravity",
    "actuation": "nu",
    "constraint": "nv",
    # These change the method, not the modelled physics.
    **dict.fromkeys(("clampctrl", "filterparent", "eulerdamp"), ""),
}
# Arrays whose values after a step are those of the step, or of the state after it.
OF_STEP = {"contacts", "qpos", "qvel", "act", "ctrl", "qacc", "sensordata", "actuator_force"}
# Values that can be changed, by kind of element.
VALUES = {
    "joint": ("damping", "armature", "frictionloss", "stiffness"),
    "tendon": ("damping", "armature", "frictionloss", "stiffness"),
    "geom": ("friction", "solref", "solimp", "margin"),
    "actuator": ("gear", "kp", "kv"),
}
# MuJoCo's warnings that end a run, and their reasons.
WARNINGS = {
    "BADQPOS": "its position is not finite",
    "BADQVEL": "its velocity is not finite",
    "BADQACC": "its acceleration is not finite",
    "BADCTRL": "its control is not finite",
    "INERTIA": "its inertia matrix is singular",
    "CONTACTFULL": "its contacts do not fit in memory",
    "CNSTRFULL": "its rows do not fit in memory",
}


@dataclass(frozen=True)
class MujocoSettings:
    """MuJoCo's settings with stepcore's names; for all other settings the scene's values hold.

    dt: `timestep` [s]. sweeps: `iterations`. cost_tolerance: `tolerance`.
    """

    dt: float
    integrator: str
    solver: str
    sweeps: int
    cost_tolerance: float
    cone: str
    impratio: float
    noslip_iterations: int
    noslip_tolerance: float
    refsafe: bool
    warm_start: bool
    sleep: bool

    # Further fields of stepcore's settings, for the words of tables.
    accuracy, law = None, "solref"
    precision, acceleration, tolerance = "f64", "none", 0.0

    @classmethod
    def of(cls, opt: Any) -> MujocoSettings:
        """Return the settings of an `MjOption`."""
        fields = {name: getattr(opt, mine) for name, mine in NUMBERS.items()}
        fields |= {name: known[getattr(opt, name)] for name, known in KINDS.items()}
        for name, (flags, bit, on) in _switches().items():
            fields[name] = bool(getattr(opt, flags) & bit) == on
        return cls(**fields)

    def put(self, opt: Any) -> None:
        """Write the settings into an `MjOption`."""
        for name, mine in NUMBERS.items():
            setattr(opt, mine, getattr(self, name))
        for name, known in KINDS.items():
            setattr(opt, name, known.index(getattr(self, name)))
        for name, (flags, bit, on) in _switches().items():
            bits = getattr(opt, flags)
            setattr(opt, flags, bits | bit if getattr(self, name) == on else bits & ~bit)

    def as_dict(self) -> dict[str, Any]:
        """Return all settings by name."""
        return dataclasses.asdict(self)

    def replace(self, **fields: Any) -> MujocoSettings:
        """Return changed settings; ValueError for settings that MuJoCo lacks."""
        own = {field.name for field in dataclasses.fields(self)}
        for name, value in fields.items():
            if name not in own and value != getattr(type(self), name, None):
                raise ValueError(f"{name} = {checks.shown(value)}: MuJoCo has no such setting")
            if name in KINDS:
                checks.one_of(*KINDS[name])("MuJoCo", name, value)
        if not fields.get("dt", self.dt) > 0:
            raise ValueError(f"dt = {fields['dt']}: must be > 0 s")
        checks.count("sweeps", fields.get("sweeps", self.sweeps))
        return dataclasses.replace(self, **{k: v for k, v in fields.items() if k in own})


def _switches() -> dict[str, tuple[str, int, bool]]:
    """Return the flags and the bit of each setting that is a flag, and whether a bit means on."""
    off, on = mujoco().mjtDisableBit, mujoco().mjtEnableBit
    return {
        "refsafe": ("disableflags", int(off.mjDSBL_REFSAFE), False),
        "warm_start": ("disableflags", int(off.mjDSBL_WARMSTART), False),
        "sleep": ("enableflags", int(on.mjENBL_SLEEP), True),
    }


class MuJoCo(Engine):
    """MuJoCo as the engine of a `Study`, for one scene.

    source: the path of an MJCF file, or its text; "package:name"; an MjModel or MjSpec of MuJoCo; a
        Scene or a Model.

    scene: MuJoCo's model.

    Raises ImportError without MuJoCo, ValueError and OSError for a source that MuJoCo cannot load.
    """

    name = "mujoco"
    # Newton stops at a cost: the elliptic cones of metaworld's sawyer reach 1e-6 of the size.
    nearby = 1e-6

    def __init__(self, source: Any) -> None:
        self.scene = scene = load(source)
        self.version = version()
        super().__init__(*_read_by_stepcore(source, scene))
        # A state that is not finite is a failure, so MuJoCo must not reset it. Sensors and energies
        # do not affect the motion.
        mj, opt = mujoco(), scene.opt
        off = mj.mjtDisableBit.mjDSBL_AUTORESET | mj.mjtDisableBit.mjDSBL_SENSOR
        opt.disableflags |= int(off)
        opt.enableflags &= ~int(mj.mjtEnableBit.mjENBL_ENERGY | mj.mjtEnableBit.mjENBL_FWDINV)
        self.title = scene.names.split(b"\0", 1)[0].decode(errors="replace") or "scene"
        self.shipped, self.nv = MujocoSettings.of(opt), int(scene.nv)
        self.coordinates = _coordinates(scene)
        moving = self.coordinates.moving
        mass = np.maximum(scene.body_mass[moving], 1e-300)
        gyration = np.sqrt(scene.body_inertia[moving].sum(axis=1) / 2 / mass)
        self.matter = Matter(moving, scene.body_ipos[moving].copy(), gyration, mass)
        # The same size as `scene_size` returns for a scene.
        extent = scene.geom_rbound.max(initial=0.0)
        extent += np.linalg.norm(scene.body_pos, axis=1).max(initial=0.0)
        self.size = scene_size(self.model.scene) if self.known else float(extent) or UNKNOWN
        falls = not opt.disableflags & int(mj.mjtDisableBit.mjDSBL_GRAVITY)
        self.gravity = math.hypot(*opt.gravity) if falls else 0.0
        self.integrators = INTEGRATORS
        limited = scene.actuator_forcelimited.astype(bool)[:, None]
        self.force_ranges = np.where(limited, scene.actuator_forcerange, (-np.inf, np.inf))
        self._rows, self._looks = False, list[tuple[np.ndarray, np.ndarray]]()
        self._free, self._lock = list[_World](), threading.Lock()

    def __getstate__(self) -> dict[str, Any]:
        return {**super().__getstate__(), "_free": [], "_lock": None}

    def __setstate__(self, state: dict[str, Any]) -> None:
        self.__dict__.update(state, _lock=threading.Lock())

    def scheduled(
        self, motion: Motion, period: float, starts: int | None = None, horizon: float = HORIZON
    ) -> Schedule:
        if self.known:
            return super().scheduled(motion, period, starts, horizon)
        return _scheduled(motion, self.scene, self.coordinates, period, starts, horizon)

    @contextmanager
    def world(self, change: Change) -> Iterator[_World]:
        """Yield a world under a change, which only this thread uses meanwhile."""
        physics = change.physics
        with self._lock:
            own = [k for k, world in enumerate(self._free) if world.physics == physics]
            world = self._free.pop(own[-1]) if own else None
        world = world or _World(physics, _changed(self.scene, physics))
        self.settings(change).put(world.model.opt)
        with quiet():
            yield world
        with self._lock:
            self._free.append(world)
            del self._free[:-KEPT]

    def compile(self, change: Change, schedule: Schedule) -> None:
        with self.world(schedule.change.also(change)):
            pass

    def follow(
        self, change: Change, schedule: Schedule, starts: Sequence[int], first: int = 1
    ) -> Tracks:
        shape = (len(starts), len(schedule.times) + 1 - first, self.scene.nbody)
        xpos, xquat = np.full((*shape, 3), np.nan), np.full((*shape, 4), np.nan)
        readings = np.full((*shape[:2], self.width), np.nan)
        failures = dict[int, str]()
        try:
            with self.world(schedule.change.also(change)) as world:
                for k, start in enumerate(starts):
                    states, _, read, failure = self._run(world, schedule, start)
                    places, turns = world.frames(states)
                    far = np.linalg.norm(places - places[0], axis=-1).max(axis=1, initial=0.0)
                    for sample in np.flatnonzero(far > self.farthest(schedule))[:1]:
                        away, time = far[sample], schedule.times[sample - 1]
                        failure = f"a body is {away:.3g} m from its start at {time:.4g} s"
                        places[sample:] = turns[sample:] = read[sample:] = np.nan
                    xpos[k], xquat[k], readings[k] = places[first:], turns[first:], read[first:]
                    failures |= {k: failure} if failure else {}
        except ControlError:
            raise
        except ValueError as error:
            failures = dict.fromkeys(range(len(starts)), checks.one_line(error))
        tracks = self.matter.tracks(xpos, xquat, failures)
        return dataclasses.replace(tracks, readings=readings) if self.sources else tracks

    @property
    def elements(self) -> Elements:
        return _elements(self.scene, self.coordinates)

    def reading(self, sources: Sequence[Source]) -> MuJoCo:
        engine = super().reading(sources)
        if any(source.array == "sensordata" for source in sources):
            engine.scene = copy.copy(self.scene)
            engine.scene.opt.disableflags &= ~int(mujoco().mjtDisableBit.mjDSBL_SENSOR)
        return engine

    def _run(
        self, world: _World, schedule: Schedule, start: int
    ) -> tuple[np.ndarray, np.ndarray, np.ndarray, str]:
        """Run from one start; return its states, controls and readings at start and samples.

        They are NaN after a failure, and readings at the start. The function also returns the
        failure's reason, or "".
        """
        dt, function = float(world.model.opt.timestep), schedule.function()
        steps, nu = schedule.steps(dt), self.scene.nu
        sample, state = schedule.every * steps, world.begin(schedule.starts[start])
        states = np.full((len(schedule.times) + 1, len(state)), np.nan)
        played = np.full((len(states), nu), np.nan)
        read = np.full((len(states), self.width), np.nan)
        states[0], played[0] = state, 0.0
        if function is None:
            rows, hold = schedule.rows([start], dt)
            once = sample if self.sources else sample * max(1, CHUNK // sample)
        else:
            shown, once = unwatched(Sim(self.model)), steps
            schedule.starts[start].put(shown)
        whole = sample * len(schedule.times)
        for done in range(0, whole, once):
            checkpoint()
            ctrl = np.zeros((min(once, whole - done), nu))
            if function is not None:
                shown.qpos, shown.qvel, shown.time = world.data.qpos, world.data.qvel, done * dt
                shown.forward()
                ctrl[:] = evaluate_control(function, shown)
            elif rows is not None:
                held = np.arange(done, done + len(ctrl)) // hold
                ctrl[:] = rows[0, np.minimum(held, rows.shape[1] - 1)]
            made, failure = world.roll(state, ctrl)
            ends = np.arange(done // sample + 1, (done + len(made)) // sample + 1)
            states[ends] = made[ends * sample - done - 1]
            played[ends] = ctrl[ends * sample - done - 1]
            if failure:
                return states, played, read, f"{failure} at {(done + len(made)) * dt:.4g} s"
            state = made[-1]
            if self.sources and len(ends):
                read[ends[-1]] = world.readings(self.sources)
        return states, played, read, ""

    def converged(self) -> MuJoCo:
        exact = {"solver": "newton", "sweeps": 200, "cost_tolerance": 1e-15, "sleep": False}
        return self.changed(self._change(**exact))

    def changed(self, change: Change) -> MuJoCo:
        engine = copy.copy(self)
        engine.scene = _changed(self.scene, change.physics)
        self.settings(change).put(engine.scene.opt)
        engine.shipped = MujocoSettings.of(engine.scene.opt)
        engine._free, engine._lock, engine._counts = [], threading.Lock(), {}
        if self.known:
            engine._model = change.physics.of(self.model)
        return engine

    def finest(self, schedule: Schedule) -> Change:
        return Change(integrator=self.ways(schedule, self.size)[0].name)

    def record(self, change: Change, start: Start, course: Course) -> Recording:
        dt, every, hold = float(self.settings(change).dt), course.every, course.hold
        table, function = None if course.ctrl is None else course.ctrl[0], None
        if course.control is not None:
            function, shown = new_control(course.control), unwatched(Sim(self.model))
            start.put(shown)
        samples, done, failure = list[dict[str, np.ndarray]](), 0, ""
        with self.world(change) as world:
            world.begin(start)
            data, samples = world.data, [world.sample()]
            home = data.xpos.copy()
            while done < course.steps and not failure:
                if function is not None and done % hold == 0:
                    shown.qpos, shown.qvel, shown.time = data.qpos, data.qvel, done * dt
                    shown.forward()
                    data.ctrl[:] = evaluate_control(function, shown)
                elif table is not None:
                    data.ctrl[:] = table[min(done // hold, len(table) - 1)]
                # Until the next sample, or the next row of controls.
                ahead = every - done % every
                if function is not None or (table is not None and done < hold * len(table)):
                    ahead = min(ahead, hold - done % hold)
                checkpoint()
                failure, done = world.advance(ahead), done + ahead
                if not failure and done % every == 0:
                    samples.append(world.sample())
                    if np.abs(data.xpos - home).max() > course.bound:
                        failure = f"a body is more than {course.bound:.3g} m from its start"
        arrays = {name: np.array([sample[name] for sample in samples]) for name in RECORDED}
        missing = course.steps // every + 1 - len(samples)
        for name, values in arrays.items():
            arrays[name] = np.pad(values, ((0, missing), (0, 0)), constant_values=np.nan)
        why = f"{failure} at {done * dt:.4g} s" if failure else ""
        return Recording(every * dt * np.arange(len(arrays["qpos"])), arrays, why, done * dt)

    def inertia(self, start: Start) -> np.ndarray:
        with self.world(Change()) as world:
            world.begin(start)
            mujoco().mj_forward(world.model, world.data)
            column, diagonal = np.zeros(self.nv), np.zeros(self.nv)
            for k, unit in enumerate(np.eye(self.nv)):
                mujoco().mj_mulM(world.model, world.data, column, unit)
                diagonal[k] = column[k]
        return diagonal

    def operations_at(self, start: Start, ctrl: np.ndarray | None = None) -> float:
        with self.world(Change()) as world:
            state, row = world.begin(start), np.zeros(self.scene.nu)
            # The second step is warm-started from the first one's forces.
            world.roll(state, np.stack(2 * [row if ctrl is None else ctrl]))
            return operations(world.model, world.data)

    def _counted(self, change: Change, schedule: Schedule) -> float:
        """Estimate the operations of a step from the counts that MuJoCo reports: `operations`."""
        if not self._looks:
            with self.world(schedule.change) as world:
                states, played, *_ = self._run(world, schedule, 0)
            self._looks = [(states[k], played[k]) for k in spread(states)]
        with self.world(schedule.change.also(change)) as world:
            world.begin(schedule.starts[0])
            total = 0.0
            for state, ctrl in self._looks:
                # The second step is warm-started from the first one's forces.
                world.roll(state, np.stack([ctrl, ctrl]))
                total += operations(world.model, world.data)
                self._rows = self._rows or world.data.nefc > 0
        return total / len(self._looks)

    def _runs(self, change: Change, schedule: Schedule) -> bool:
        return math.isfinite(self.work(change, schedule))

    def _change(self, **fields: Any) -> Change:
        return Change(**{k: v for k, v in fields.items() if v != getattr(self.shipped, k)})

    def _exact(self, **fields: Any) -> Change:
        exact = {"solver": "newton", "sweeps": 200, "cost_tolerance": 1e-15}
        return self._change(**exact, warm_start=True, refsafe=False, sleep=False, **fields)

    def ways(self, schedule: Schedule, goal: float) -> list[Way]:
        # MuJoCo does not run a flex with elasticity under implicitfast.
        able = [self.halved(schedule, name) for name in ("implicitfast", "discrete", "rk4")]
        able = [way for way in able if self._runs(way.at(0), schedule)]
        return [able[0], *able[-1:]] if len(able) > 1 else able

    def families(self, schedule: Schedule) -> list[Change]:
        if not self._runs(Change(), schedule):
            return [Change()]
        made = [
            self._change(integrator=integrator, **fields)
            for integrator in dict.fromkeys([self.shipped.integrator, *INTEGRATORS[:-1]])
            for fields in (SOLVED if self._rows else [{}])
        ]
        return list(dict.fromkeys([Change(), *made]))

    @property
    def flags(self) -> list[str]:
        """The flags of the features that the scene has, and that can be left out."""

        def has(numbers: str) -> bool:
            return any(np.any(attrgetter(name)(self.scene)) for name in numbers.split())

        return [flag for flag, numbers in FLAGS.items() if has(numbers)]

    def has_rows(self, schedule: Schedule) -> bool:
        # Counting the work examines states of the motion, and sets `_rows`.
        return self._runs(Change(), schedule) and self._rows

    def seconds(self, change: Change, schedule: Schedule) -> float:
        with self.world(schedule.change.also(change)) as world:
            begun = time.thread_time()
            failure = self._run(world, schedule, 0)[-1]
            return math.nan if failure else time.thread_time() - begun


def engine_of(model: Any, engine: Engine | str, motion: Motion) -> Engine:
    """Return the engine of a name for a model, see `Study`; or the engine itself.

    motion: a model without motors gets motors for it.

    Raises ValueError for another name, and ImportError if MuJoCo is not installed.
    """
    if not isinstance(engine, str):
        return engine
    checks.one_of("stepcore", "mujoco")("study", "engine", engine)
    made = MuJoCo(model) if engine == "mujoco" else Stepcore(find_model(model))
    if not made.known or (driven := motion.driven(made.model, "move")) is made.model:
        return made
    return engine_of(driven, engine, motion)


class _World:
    """MuJoCo's model and data for one changed model; one thread at a time uses them."""

    def __init__(self, physics: Change, model: Any) -> None:
        self.physics, self.model, self.data = physics, model, mujoco().MjData(model)
        codes = {name: int(getattr(mujoco().mjtWarning, f"mjWARN_{name}")) for name in WARNINGS}
        self.warnings = [(codes[name], text) for name, text in WARNINGS.items()]
        kinds = mujoco().mjtState
        self.state = kinds.mjSTATE_FULLPHYSICS
        self.inputs = int(kinds.mjSTATE_CTRL)
        if model.nmocap:
            self.inputs |= int(kinds.mjSTATE_MOCAP_POS | kinds.mjSTATE_MOCAP_QUAT)

    def read(self, kind: int) -> np.ndarray:
        """Return a part of the state."""
        values = np.empty(mujoco().mj_stateSize(self.model, kind))
        mujoco().mj_getState(self.model, self.data, values, kind)
        return values

    def begin(self, start: Start) -> np.ndarray:
        """Set the start of a run; return its state."""
        data = self.data
        mujoco().mj_resetData(self.model, data)
        data.qpos[:], data.qvel[:] = start.qpos, start.qvel
        data.act[:] = 0.0 if start.act is None else start.act
        if start.mocap is not None:
            data.mocap_pos[:], data.mocap_quat[:] = start.mocap
        return self.read(self.state)

    def roll(self, state: np.ndarray, ctrl: np.ndarray) -> tuple[np.ndarray, str]:
        """Make a step with each row of controls; return the states after them, and a failure.

        The states of a run that fails end before the failing step.
        """
        inputs = np.tile(self.read(self.inputs), (1, len(ctrl), 1))
        inputs[0, :, : self.model.nu] = ctrl
        made = np.empty((1, len(ctrl), len(state)))
        sensed = np.empty((1, len(ctrl), self.model.nsensordata))
        try:
            mujoco().rollout.rollout(
                *([self.model], self.data, state[None], inputs if inputs.size else None),
                control_spec=self.inputs,
                nstep=len(ctrl),
                initial_warmstart=self.data.qacc_warmstart[None].copy(),
                state=made,
                sensordata=sensed,
                skip_checks=True,
            )
        except mujoco().FatalError as error:
            raise ValueError(checks.one_line(error)) from None
        failure = self.warning
        # A warning ends the roll-out: the state after that step fills the rest.
        last = int(np.argmax(made[0, :, 0] >= made[0, -1, 0])) if failure else len(ctrl)
        return made[0, :last], failure

    @property
    def warning(self) -> str:
        """The reason of a warning that ends a run; "" without one."""
        counts = self.data.warning
        return next((text for k, text in self.warnings if counts[k].number), "")

    def advance(self, steps: int) -> str:
        """Make steps under the present controls; return why they fail, or ""."""
        try:
            mujoco().mj_step(self.model, self.data, steps)
        except mujoco().FatalError as error:
            raise ValueError(checks.one_line(error)) from None
        finite = np.isfinite(self.data.qpos).all() and np.isfinite(self.data.qvel).all()
        return self.warning if finite else self.warning or WARNINGS["BADQVEL"]

    def readings(self, sources: Sequence[Source]) -> np.ndarray:
        """Return readings after a step: forces are those of the step."""
        mj, model, data = mujoco(), self.model, self.data
        arrays = {source.array for source in sources}
        forces, wrench = np.zeros(data.ncon), np.zeros(6)
        for k in range(data.ncon if "contacts" in arrays else 0):
            mj.mj_contactForce(model, data, k, wrench)
            forces[k] = abs(wrench[0])
        pairs = data.contact.geom.reshape(-1, 2).copy()
        if arrays - OF_STEP:
            # The step leaves the places of the state before it.
            mj.mj_fwdPosition(model, data)
            mj.mj_energyPos(model, data)
            mj.mj_energyVel(model, data)

        def read(source: Source) -> Any:
            if source.array == "contacts":
                return contact_force(source, pairs, forces)
            values = getattr(data, source.array)
            return values[list(source.indices)].sum() if source.indices else values.ravel()

        return np.hstack([read(source) for source in sources])

    def sample(self) -> dict[str, np.ndarray]:
        """Return the arrays of a `Recording` after a step: forces are those of the step."""
        mj, model, data = mujoco(), self.model, self.data
        mj.mj_fwdPosition(model, data)
        mj.mj_energyPos(model, data)
        mj.mj_energyVel(model, data)
        arrays = {name: np.array(getattr(data, name)) for name in RECORDED}
        # MuJoCo has the potential energy first.
        return arrays | {"energy": data.energy[::-1].copy()}

    def frames(self, states: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Return the places and orientations of all bodies in some states."""
        count = self.model.nbody
        xpos, xquat = (np.full((len(states), count, n), np.nan) for n in (3, 4))
        for k in np.flatnonzero(np.isfinite(states).all(axis=1)):
            mujoco().mj_setState(self.model, self.data, states[k], self.state)
            mujoco().mj_kinematics(self.model, self.data)
            xpos[k], xquat[k] = self.data.xpos, self.data.xquat
        return xpos, xquat


def operations(model: Any, data: Any) -> float:
    """Estimate the operations of the step that was just made, in the unit of `price.OPERATION`.

    The terms are MuJoCo's counts; nnz are the non-zeros of Newton's factor or of PGS's matrix.
    `python benches/cost_of_work.py --mujoco` compares them with times.
    """
    solver, nefc = SOLVERS[model.opt.solver], data.nefc
    islands = max(1, data.nisland)
    iterations = data.solver_niter[:islands].astype(float)
    nonzeros = float(iterations @ data.solver_nnz[:islands])
    sparse = data.nJ + model.nM
    each = 2400 + 105 * (model.nbody + model.nv + model.ngeom + model.nM / 2)
    each += 475 * nefc + 110 * model.nflexelem
    if solver == "pgs":
        each += 2 * (nonzeros + nefc**2)
    else:
        each += 3 * iterations.sum() * sparse + 3 * nonzeros * (solver == "newton")
    if CONES[model.opt.cone] == "elliptic":
        each += 9 * iterations.sum() * (data.contact.dim.astype(float) ** 3).sum()
    integrator = INTEGRATORS[model.opt.integrator]
    # `discrete` solves with the stiffness of every flex.
    once = 140 * model.nv + 80 * model.nD * (integrator == "implicit") + 50 * data.nefmK
    return float((4 if integrator == "rk4" else 1) * each + once)


# --- MuJoCo's model -------------------------------------------------------------------------------


def mujoco() -> Any:
    """Return the module mujoco; ImportError with the command that installs it."""
    try:
        import mujoco  # type: ignore[import-untyped,unused-ignore]
        import mujoco.rollout  # type: ignore[import-untyped,unused-ignore]
    except ModuleNotFoundError as error:
        if error.name != "mujoco":
            raise
        raise ImportError("the engine mujoco needs MuJoCo: pip install mujoco") from None
    except ImportError as error:
        # If Ctrl-C interrupts the import of a compiled module, only the error's text shows it.
        if "KeyboardInterrupt" in str(error):
            raise KeyboardInterrupt from None
        raise
    return mujoco


def version() -> str:
    """Return MuJoCo's name and version."""
    return f"MuJoCo {mujoco().__version__}"


def load(source: Any) -> Any:
    """Return MuJoCo's model of a source; see `MuJoCo`."""
    mj = mujoco()
    with quiet(), _refusals_name_the_version(source):
        if isinstance(source, mj.MjModel):
            return copy.copy(source)
        if isinstance(source, mj.MjSpec):
            return source.compile()
        if isinstance(source, (Scene, Model)):
            if source.settings.law != "solref":
                raise ValueError(f"law = '{source.settings.law}': MuJoCo has solref alone")
            scene = source if isinstance(source, Scene) else source.scene
            return mj.MjModel.from_xml_string(scene.with_settings(source.settings).to_mjcf())
        if not isinstance(source, (str, os.PathLike)):
            kind = type(source).__name__
            raise ValueError(f"{kind}: MuJoCo loads an MJCF file or text, a Scene or an MjModel")
        text = os.fsdecode(source)
        if _is_text(text):
            return mj.MjModel.from_xml_string(text)
        package, colon, name = text.partition(":")
        if package == "lesson":
            return load(find_scene(text))
        if text.lower().endswith(".urdf"):
            # MuJoCo finds no mesh of a package.
            return load(find_scene(text))
        path = text if os.path.exists(text) or not colon else find_asset(package, name)
        return mj.MjModel.from_xml_path(os.fspath(path))


@contextmanager
def _refusals_name_the_version(source: Any) -> Iterator[None]:
    """Add the file and MuJoCo's version to errors of MuJoCo's reader of XML."""
    try:
        yield
    except ValueError as error:
        text = checks.one_line(error)
        if not text.startswith(("XML Error", "Error")):
            raise
        path = isinstance(source, (str, os.PathLike)) and not _is_text(os.fsdecode(source))
        file = f"{checks.brief(os.fsdecode(source))}: " if path else ""
        raise ValueError(f"{file}{version()} refuses it: {text}") from None


def _is_text(source: str) -> bool:
    return source.lstrip().startswith("<")


def _read_by_stepcore(source: Any, scene: Any) -> tuple[Model | None, str]:
    """Return stepcore's model of a source, or why there is none; scene: MuJoCo's model."""
    try:
        if isinstance(source, str) and _is_text(source):
            text, source = source, Scene()
            read_text(source, text)
        model = find_model(source)
    except (ValueError, OSError) as error:
        return None, checks.one_line(error)
    ours, theirs = (
        [getattr(of, name) for name in ("nq", "nv", "nu", "nbody")] for of in (model, scene)
    )
    same = ours == theirs
    return (model, "") if same else (None, f"its nq, nv, nu, bodies are {ours}, but {theirs} there")


def _changed(scene: Any, physics: Change) -> Any:
    """Return a copy of MuJoCo's model with other values, and without some features."""
    mj, model = mujoco(), copy.copy(scene)
    for removal in physics.without:
        for edit, value in removal.edits:
            if edit == "feature" and value in FLAGS:
                flag = getattr(mj.mjtDisableBit, f"mjDSBL_{value.upper()}")
                model.opt.disableflags |= int(flag)
            elif edit == "no fluid":
                model.opt.density = model.opt.viscosity = 0.0
            else:
                raise ValueError(f"without {removal.label}: MuJoCo has no flag for it")
    for path, value in physics.values:
        _assign(model, path, value)
    for servo in physics.servos:
        k = servo.actuator
        k = k if isinstance(k, int) else mj.mj_name2id(model, mj.mjtObj.mjOBJ_ACTUATOR, k)
        model.actuator_gaintype[k] = mj.mjtGain.mjGAIN_FIXED
        model.actuator_biastype[k] = mj.mjtBias.mjBIAS_AFFINE
        model.actuator_gainprm[k, 0] = servo.kp
        model.actuator_biasprm[k, :3] = 0.0, -servo.kp, -servo.kv
        model.actuator_ctrllimited[k] = False
        model.actuator_forcelimited[k] = bool(np.isfinite(servo.forcerange).all())
        model.actuator_forcerange[k] = servo.forcerange
    if physics.values:
        mj.mj_setConst(model, mj.MjData(model))
    return model


def _assign(model: Any, path: str, value: Any) -> None:
    """Set a value of MuJoCo's model by its path."""
    if path in ("gravity", "density", "viscosity", "wind"):
        setattr(model.opt, path, value)
        return
    kind, _, rest = path.partition("/")
    name, _, field = rest.rpartition("/")
    known = VALUES.get(kind, ())
    if field not in known:
        raise ValueError(f"{path}: MuJoCo's engine changes {', '.join(known) or 'no such value'}")
    object_type = getattr(mujoco().mjtObj, f"mjOBJ_{kind.upper()}")
    index = mujoco().mj_name2id(model, object_type, name)
    if index < 0:
        count = getattr(model, {"joint": "njnt", "actuator": "nu"}.get(kind, f"n{kind}"))
        names = [mujoco().mj_id2name(model, object_type, k) for k in range(count)]
        near = checks.nearest(name, filter(None, names))
        raise ValueError(f"{path}: no {kind} is named {checks.quoted(name)}{near}")
    if field in ("kp", "kv"):
        gain, bias = model.actuator_gainprm[index], model.actuator_biasprm[index]
        place = 1 + (field == "kv")
        if not (bias[1] or bias[place]):
            raise ValueError(f"{path}: the actuator has no {field}")
        # As `Actuator.set_servo_gain`: the main gain scales the control's gain too.
        if field == "kp" or not bias[1]:
            old = -bias[place]
            gain[0] = value if gain[0] == old else gain[0] * value / old
            bias[0] *= value / old
        bias[place] = -value
        return
    of_dofs = kind == "joint" and field != "stiffness"
    array = getattr(model, f"{'dof' if of_dofs else {'joint': 'jnt'}.get(kind, kind)}_{field}")
    given = np.atleast_1d(value)
    rows = array.reshape(len(array), -1)
    rows[model.dof_jntid == index if of_dofs else [index], : len(given)] = given


def _elements(scene: Any, coordinates: Coordinates) -> Elements:
    """Return the named elements of MuJoCo's model."""
    mj = mujoco()
    counts = {"joint": scene.njnt, "actuator": scene.nu}
    counts |= {
        kind: getattr(scene, f"n{kind}") for kind in ("body", "site", "geom", "tendon", "sensor")
    }
    names = {kind: [getattr(scene, kind)(k).name for k in range(n)] for kind, n in counts.items()}
    points = {
        kind: list(zip(bodies.tolist(), places.copy(), strict=True))
        for kind, bodies, places in (
            ("body", np.arange(scene.nbody), np.zeros((scene.nbody, 3))),
            ("site", scene.site_bodyid, scene.site_pos),
            ("geom", scene.geom_bodyid, scene.geom_pos),
        )
    }
    driven = _Actuators(scene).actuator_joint
    hinges = scene.jnt_type == int(mj.mjtJoint.mjJNT_HINGE)
    types = (mj.mjtSensor(kind).name.removeprefix("mjSENS_").lower() for kind in scene.sensor_type)
    sensors = zip(types, scene.sensor_adr.tolist(), scene.sensor_dim.tolist(), strict=True)
    over_joints = scene.wrap_type[scene.tendon_adr] == int(mj.mjtWrap.mjWRAP_JOINT)
    return Elements(
        names=names,
        moving=coordinates.moving,
        joints=[joint[:3] for joint in coordinates.joints],
        forces=["N·m" if k >= 0 and hinges[k] else "N" for k in driven],
        points=points,
        sensors=list(sensors),
        tendons=["" if fixed else "m" for fixed in over_joints],
        shape=partial(_shape, mj.MjData(scene)),
    )


def _shape(data: Any, name: str) -> tuple[int, ...]:
    """Return the shape of an array of MuJoCo's data."""
    recordable((name,), OF_WORLDS)
    array = getattr(data, name, None)
    if not isinstance(array, np.ndarray):
        raise ValueError(f"quantity: MuJoCo's data has no array {checks.quoted(name)}")
    return array.shape


class _Flexible(Coordinates):
    """Coordinates with shared changes of flexes: a random change moves all vertices equally.

    flexes: the dofs of the free vertices of every flex, (vertices, 3).
    """

    flexes: list[np.ndarray]

    def drawn(self, rng: np.random.Generator, slides: float, turns: float) -> np.ndarray:
        change = super().drawn(rng, slides, turns)
        for dofs in self.flexes:
            change[dofs] = change[dofs[0]]
        return change


def _coordinates(scene: Any) -> Coordinates:
    """Return the layout of the coordinates of MuJoCo's model."""
    kinds = ("free", "ball", "slide", "hinge")
    limited = not scene.opt.disableflags & int(mujoco().mjtDisableBit.mjDSBL_LIMIT)
    joints = [
        (
            kinds[int(scene.jnt_type[k])],
            int(scene.jnt_qposadr[k]),
            int(scene.jnt_dofadr[k]),
            tuple(scene.jnt_range[k].tolist()) if limited and scene.jnt_limited[k] else None,
        )
        for k in range(scene.njnt)
    ]
    moving = np.flatnonzero(scene.body_weldid).tolist()
    made = _Flexible.of(int(scene.nv), joints, moving)
    owners = [*zip(scene.flex_vertadr, scene.flex_vertnum, strict=True)]
    bodies = [np.unique(scene.flex_vertbodyid[first : first + n]) for first, n in owners]
    firsts = [scene.body_dofadr[own[scene.body_dofnum[own] == 3]] for own in bodies]
    made.flexes = [first[:, None] + np.arange(3) for first in firsts if len(first)]
    return made


# --- the schedule from MuJoCo's model alone -------------------------------------------------------


class _Actuators:
    """The actuators of MuJoCo's model, in the form that tables of controls need."""

    def __init__(self, scene: Any) -> None:
        self.nu = int(scene.nu)
        self.joint_names = [scene.joint(k).name for k in range(scene.njnt)]
        self.actuator_names = [scene.actuator(k).name for k in range(scene.nu)]
        kinds = mujoco().mjtTrn
        joints = [int(kinds.mjTRN_JOINT), int(kinds.mjTRN_JOINTINPARENT)]
        drives = np.isin(scene.actuator_trntype, joints)
        self.actuator_joint = np.where(drives, scene.actuator_trnid[:, 0], -1)

    def called(self, kind: str) -> list[str]:
        return [name or f"{kind} {k}" for k, name in enumerate(self.actuator_names)]


def _scheduled(
    motion: Motion,
    scene: Any,
    coordinates: Coordinates,
    period: float,
    starts: int | None,
    horizon: float,
) -> Schedule:
    """Return the schedule of a motion; ValueError if it needs stepcore's model."""
    if motion.control is not None or isinstance(motion.ctrl, PositionTable):
        given = "control" if motion.control is not None else "follow"
        raise ValueError(f"{given}: needs stepcore's model of the scene; give rows of controls")
    kind = motion.kind or "sines"
    checks.one_of("hold", "sines", "random", "fall")("a motion by MuJoCo alone", "kind", kind)
    first, held = _home(scene, motion.key)
    drives = _Actuators(scene)

    def drive(begin: Sequence[Start], periods: int) -> Controls:
        if motion.ctrl is not None:
            return user_controls(motion, drives, held, period)
        free = scene.opt.disableflags & int(mujoco().mjtDisableBit.mjDSBL_CLAMPCTRL)
        clamped = scene.actuator_ctrllimited & (not free)
        ranges = np.where(clamped[:, None], scene.actuator_ctrlrange, (-np.inf, np.inf))
        asked = MotionRequest(first, held, begin, motion.seed, period, periods, True)
        return by_rule(kind, "actuators", drives.called("actuator"), ranges, asked)

    dt = float(scene.opt.timestep)
    moving = scene.dof_damping * dt <= FINEST * scene.dof_M0
    nearby = partial(random_start, coordinates, first, moving, _overlaps(scene), 1e-4)
    return laid_out(motion, dt, first, nearby, drive, period, starts, horizon)


def _home(scene: Any, key: str | int | None) -> tuple[Start, np.ndarray]:
    """Return the state and controls of a keyframe; by default the first, or qpos0."""
    if key is None and not scene.nkey:
        return Start(scene.qpos0.copy(), np.zeros(scene.nv)), np.zeros(scene.nu)
    names = [scene.key(k).name for k in range(scene.nkey)]
    index = names.index(key) if key in names else key if key is not None else 0
    if not isinstance(index, int) or not 0 <= index < scene.nkey:
        near = checks.nearest(str(key), names)
        raise ValueError(f"key = {checks.shown(key)}: the scene has no such keyframe{near}")
    qpos, qvel, act, mpos, mquat, ctrl = (
        getattr(scene, f"key_{name}")[index].copy()
        for name in ("qpos", "qvel", "act", "mpos", "mquat", "ctrl")
    )
    return Start(qpos, qvel, act, (mpos.reshape(-1, 3), mquat.reshape(-1, 4))), ctrl


def _overlaps(scene: Any) -> Callable[[Start], float]:
    """Return a function that measures the deepest overlap of a start's contacts [m]."""
    data = mujoco().MjData(scene)

    def overlap(start: Start) -> float:
        data.qpos[:] = start.qpos
        if start.mocap is not None:
            data.mocap_pos[:], data.mocap_quat[:] = start.mocap
        mujoco().mj_fwdPosition(scene, data)
        return -float(data.contact.dist.min(initial=0.0))

    return overlap
