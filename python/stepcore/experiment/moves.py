"""`Moves`: moves from pose to pose that a machine could make, found by trials.

The path is q(t) = q₀ + s(t) d with s = 10x³ − 15x⁴ + 6x⁵, x = t/T: the path with the least squared
jerk that begins and ends at rest (Flash and Hogan, 1985). If the start has contacts, d keeps their
places, to first order.

Motors are replaced by servos. The gains of joint j are kp = ω² I and kv = 2 ω I, where 1/I is
entry jj of the inverse mass matrix. ω is at most 30 rad/s, and small enough for the longest time
step T that is tried by default, four shipped steps: with μ the largest eigenvalue of M⁻¹I, an
explicit step changes a velocity by the factor 1 − 2 ω μ T, and ω ≤ 0.35/(μT) leaves a stability
margin of 3. Their targets carry the load of the start: bias − passive − Jᵀf, where f are the
contact forces of least norm that balance the dofs without a motor.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field, replace

import numpy as np

from stepcore._core import SimulationError
from stepcore.checks import one_line
from stepcore.engine.actuator import MOTOR, SERVO, VELOCITY_SERVO, Actuator, actuators, hold_load
from stepcore.engine.coordinates import Coordinates, rotated
from stepcore.engine.follow import Followed, follow
from stepcore.engine.model import Model
from stepcore.engine.sim import Sim
from stepcore.engine.start import Start
from stepcore.experiment.change import Change, Servo
from stepcore.experiment.control_table import MOST_DT, ControlLog, Controls

# The duration of a move, and the duration of the rest after it [s].
MOVE, WAIT = 0.8, 0.2
# The longest time for which a target is held [s]. In 8 ms, a pose that moves at 1 rad/s would jump
# by 8 mrad, to which a stiff servo responds with its whole force.
HELD = 1e-3
# The largest move of a joint: this share of its range, and at most this [rad], [m].
RANGE_SHARE, MAX_TURN, MAX_SLIDE = 0.1, 0.5, 0.05
# The largest force, as a share of the range that holding the start leaves.
FORCE_SHARE = 0.5
# The parts of a move that are tried, also in the opposite direction, before the start is held.
MOVE_PARTS = (1.0, -1.0, 0.5, -0.5, 0.25, -0.25, 0.125, -0.125)
# Speeds and forces before this time [s] do not count: the start may jump to its servos' targets, or
# out of an overlap. Contacts are examined at this interval.
SHOCK = 0.1
# The time between samples of a trial [s].
SAMPLE = 0.008
# A robot falls if it tilts by more than this [rad], or the height of its centre of mass above the
# lowest of its geoms shrinks by this share. A robot that sinks into the floor has not fallen.
TILT, SINKS = 0.35, 0.25


def profile(times: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return the share s of the path and its rate ds/dt [1/s]: forward, a rest, back, a rest, ….

    times: since the beginning [s].
    """
    turn, within = np.divmod(times, MOVE + WAIT)
    x = np.minimum(within / MOVE, 1.0)
    way = x**3 * (10 + x * (6 * x - 15))
    rate = 30 * x**2 * (1 - x) ** 2 / MOVE
    back = turn % 2 == 1
    return np.where(back, 1 - way, way), np.where(back, -rate, rate)


@dataclass
class Seen:
    """Measurements of a trial.

    force: the largest force of each actuator as a share of its bound, (nu,); 0 without a bound.
    full: the share of the run in which it was saturated, (nu,).
    speed: the largest speed of each dof [rad/s or m/s], (nv,).
    met: the bodies in contact at some time, and the joints at a limit.
    ends_on: the bodies in contact at the end. points: both bodies and the place of each contact.
    end: the state at the end. fell: when the robot fell [s], or None. failure: why the run failed.
    """

    force: np.ndarray
    full: np.ndarray
    speed: np.ndarray
    met: set[frozenset[int] | int] = field(default_factory=set)
    ends_on: set[frozenset[int]] = field(default_factory=set)
    points: list[tuple[int, int, np.ndarray]] = field(default_factory=list)
    end: Start | None = None
    fell: float | None = None
    failure: str = ""


class Moves:
    """Moves of a model from starts near one home.

    drives: the actuators. joints: the hinges and slides that they drive. others: actuators that
    drive no joint. about: whether the machine moves about. of_root: roots of the geoms, (ngeom,).
    ctrl: the controls that hold home, (nu,). servos: the replacements of motors. lag: kv/kp of the
    servos, by which their targets lead the path [s], (nu,). held: the trial of `ctrl`.
    """

    def __init__(self, model: Model, home: Start, ctrl: np.ndarray, *, keep: bool) -> None:
        """home, ctrl: the state and the controls of the keyframe.

        keep: whether to hold the start, under the keyframe's controls even where these are 0.
        """
        self.model, self.home, self.keep = model, home, keep
        self.drives, self.coordinates = actuators(model), Coordinates(model)
        driven = self.of(SERVO, VELOCITY_SERVO, MOTOR)
        self.joints = sorted({drive.joint for drive in driven if drive.joint is not None})
        self.others = [drive for drive in driven if drive.joint is None]
        self.dofs, self.roots = model.jnt_dofadr[self.joints], driven_roots(model, self.drives)
        self.about = moves_about(model, self.drives)
        self.of_root = np.array([model.root(body) for body in model.geom_body.tolist()], int)
        self.kept = self._jacobian(home, touching(_put(Sim(model), home)))
        self.ctrl, self.lag = self._holding(np.array(ctrl, float)), np.zeros(model.nu)
        self.servos = tuple(self._servos())
        self.driven = Change(servos=self.servos).of(model)
        still = np.zeros((1, model.nu))
        (self.held,) = self.trials([home], still, still, 2 * (MOVE + WAIT))
        if self.held.fell is None and self.held.end is not None:
            self.kept = self._jacobian(self.held.end, self.held.points)

    def of(self, *kinds: str) -> list[Actuator]:
        """Return the actuators of some kinds."""
        return [drive for drive in self.drives if drive.kind in kinds]

    def _holding(self, ctrl: np.ndarray) -> np.ndarray:
        """Return the controls that hold the start, (nu,); ctrl: the keyframe's controls.

        If the keyframe's controls are 0, servos hold its pose.
        """
        positions = [servo.index for servo in self.of(SERVO)]
        if not self.keep:
            if not ctrl[positions].any():
                lengths = self.lengths(self.home.qpos)
                ctrl[positions] = [self.drives[k].holding(lengths[k]) for k in positions]
            ctrl[[drive.index for drive in self.of(VELOCITY_SERVO)]] = 0.0
        return np.clip(ctrl, *np.reshape([drive.ctrlrange for drive in self.drives], (-1, 2)).T)

    def _servos(self) -> Iterator[Servo]:
        """Yield servos that replace motors, and set their controls and lags."""
        model, motors = self.model, self.of(MOTOR)
        if not motors:
            return
        sim, dofs = _put(Sim(model), self.home), [motor.dof for motor in motors]
        inverse = np.linalg.inv(sim.mass_matrix())
        inertia = 1.0 / np.diag(inverse)[dofs]
        largest = float(np.abs(np.linalg.eigvals(inverse[np.ix_(dofs, dofs)] * inertia)).max())
        # At most 30 rad/s, and at most 2 ω μ T = 0.7.
        omega = min(30.0, 0.7 / (2 * largest * MOST_DT * model.settings.dt))
        load = support(sim, dofs, self.kept)
        for motor, effective, force in zip(motors, inertia.tolist(), load.tolist(), strict=True):
            # Several motors on a joint share its force.
            k, share = motor.index, 1 / dofs.count(motor.dof)
            kp, kv = (gain * effective * share / motor.gear**2 for gain in (omega**2, 2 * omega))
            target = motor.gear * self.home.qpos[motor.qposadr]
            self.ctrl[k], self.lag[k] = target + force * share / motor.gear / kp, kv / kp
            yield Servo(model.actuator_names[k] or k, kp, kv, motor.forces)

    def _jacobian(self, state: Start, points: Sequence[tuple[int, int, np.ndarray]]) -> np.ndarray:
        """Return the Jacobian of the contacts of the driven trees, (3 contacts, nv)."""
        sim, rows = _put(Sim(self.model), state), [np.zeros((0, self.model.nv))]
        for first, second, place in points:
            if {self.model.root(first), self.model.root(second)} & self.roots:
                ends = [sim.jacobian(body, place)[:3] for body in (second, first) if body]
                rows.append(ends[0] - ends[1] if len(ends) == 2 else ends[0])
        return np.vstack(rows)

    def lengths(self, qpos: np.ndarray) -> np.ndarray:
        """Return the lengths of the actuators at a pose, (nu,)."""
        return np.array(_put(Sim(self.model), replace(self.home, qpos=qpos)).actuator_length)

    def _drawn(self, rng: np.random.Generator) -> np.ndarray:
        """Draw a random change of the pose, (nv,), of the joints that actuators drive."""
        model, q = self.model, self.home.qpos[self.model.jnt_qposadr[self.joints]]
        low, high = model.jnt_range[self.joints].reshape(-1, 2).T
        far = [MAX_TURN if model.jnt_type[joint] == "hinge" else MAX_SLIDE for joint in self.joints]
        weights = np.zeros(model.nv)
        for kind, _, v, _ in self.coordinates.joints if len(self.kept) else ():
            if kind == "free":
                # A base on contacts turns by at most a fifth as much as a joint (Go2's joints then
                # move by 0.26 rad; without this limit by 0.34).
                weights[v : v + 6] = np.repeat((MAX_SLIDE, 0.2 * MAX_TURN), 3)
        weights[self.dofs] = np.minimum(far, RANGE_SHARE * (high - low))
        change = rng.uniform(0.5, 1.0, model.nv) * rng.choice([-1.0, 1.0], model.nv) * weights
        low, high = np.minimum(q, low), np.maximum(q, high)
        kept = self._keeping(change, weights, rng) if len(self.kept) else None
        if kept is None:
            # A joint near a limit moves the other way.
            d = change[self.dofs]
            change[self.dofs] = np.where((q + d < low) | (q + d > high), -d, d)
        else:
            change = kept
        joints = np.zeros(model.nv)
        joints[self.dofs] = np.clip(q + change[self.dofs], low, high) - q
        return joints

    def _keeping(
        self, change: np.ndarray, weights: np.ndarray, rng: np.random.Generator
    ) -> np.ndarray | None:
        """Return the part of a change that keeps the places of contacts.

        None if a robot that moves about has none: its castor must slide for its wheels to turn.
        """
        spread = (self.kept * weights**2).T
        change = change - spread @ np.linalg.pinv(self.kept @ spread, 1e-6) @ self.kept @ change
        moved = (np.abs(self.kept).max(axis=0) > 1e-9) & (weights > 0)
        most = float((np.abs(change[moved]) / weights[moved]).max(initial=0.0))
        if most > 1e-6:
            # The projection of a random change on those that keep contacts is small, so joints that
            # move contacts are scaled to a share of their largest move.
            change[moved] *= rng.uniform(0.5, 1.0) / most
        elif moved.any():
            if self.about:
                return None
            change[moved] = 0.0
        return change

    def _toward(self, change: np.ndarray, share: float) -> tuple[np.ndarray, np.ndarray]:
        """Return the spans and the rates of the controls for a change of the pose.

        share: the part of its move that each actuator makes that drives no joint.
        """
        after = self.lengths(self.coordinates.moved(self.home.qpos, change))
        ways = after - self.lengths(self.home.qpos)
        for drive in self.others:
            wide = np.ptp(drive.ctrlrange) * (drive.gain / drive.kp if drive.kp else math.inf)
            ways[drive.index] = share * (RANGE_SHARE * wide if math.isfinite(wide) else MAX_SLIDE)
        spans, rates = np.zeros(self.model.nu), np.zeros(self.model.nu)
        for drive in self.of(SERVO, VELOCITY_SERVO, MOTOR):
            k = drive.index
            if drive.kind == MOTOR:
                spans[k], rates[k] = ways[k], ways[k] * self.lag[k]
            elif drive.kind == VELOCITY_SERVO:
                rates[k] = ways[k] * (drive.kp if drive.integrates else drive.kv) / drive.gain
            else:
                spans[k] = ways[k] * drive.kp / drive.gain
        return spans, rates

    def log(self, spans: np.ndarray, rates: np.ndarray, end: float, period: float) -> ControlLog:
        """Return the controls of moves, a row for each period, until a time [s].

        spans: the change of the controls from the start to the target, (starts, nu).
        rates: the controls per 1/s of ds/dt, (starts, nu).
        """
        times = period * np.arange(max(1, round(end / period)))
        way, rate = profile(times + period / 2)
        moved = way[:, None] * spans[:, None] + rate[:, None] * rates[:, None]
        return ControlLog(times, self.ctrl + moved)

    def trials(
        self,
        starts: Sequence[Start],
        spans: np.ndarray,
        rates: np.ndarray,
        horizon: float = MOVE + WAIT,
    ) -> list[Seen]:
        """Run moves from some starts under the model's settings, all at once; see `log`."""
        model, dt = self.model, self.model.settings.dt
        every = max(1, round(SAMPLE / dt))
        steps = every * max(1, round(horizon / (every * dt)))
        log = self.log(spans, rates, steps * dt, min(HELD, dt))
        rows, repeats = Controls(log).rows(range(len(starts)), dt, steps)
        record = ("qpos", "qvel", "act", "actuator_force")
        try:
            ran = follow(self.driven, starts, steps, every, ctrl=rows, hold=repeats, record=record)
        except (SimulationError, ValueError) as error:
            nothing = Seen(np.zeros(model.nu), np.zeros(model.nu), np.zeros(model.nv))
            return [replace(nothing, failure=one_line(error)) for _ in starts]
        # Only the places of bodies are read from it.
        sim = Sim(model, solver="pgs", sweeps=1)
        return [self._seen(sim, ran, k, start) for k, start in enumerate(starts)]

    def _seen(self, sim: Sim, ran: Followed, k: int, start: Start) -> Seen:
        """Measure a run: forces and speeds at its samples, contacts at some of them."""
        model, finite = self.model, np.isfinite(ran["qvel"][k]).all(axis=-1)
        qpos, qvel, act, force = (ran[name][k][finite] for name in ran.data)
        times, bounds = ran.times[finite], np.array([drive.bound for drive in self.drives])
        bounds = np.where(np.isfinite(bounds) & (bounds > 0), bounds, np.inf)
        late = times > SHOCK if times[-1] > SHOCK else times > 0
        shares = np.abs(force[late]) / bounds
        seen = Seen(
            force=shares.max(axis=0, initial=0.0),
            full=(shares > 1 - 1e-9).sum(axis=0) / max(1, len(shares)),
            speed=np.abs(qvel[late]).max(axis=0, initial=0.0),
            failure=one_line(ran.failures[k]) if k in ran.failures else "",
        )
        if model.scene.features.limit:
            for joint, (kind, q) in enumerate(zip(model.jnt_type, model.jnt_qposadr, strict=True)):
                low, high = model.jnt_range[joint]
                if kind in ("hinge", "slide") and ((qpos[:, q] < low) | (qpos[:, q] > high)).any():
                    seen.met.add(joint)
        _put(sim, start)
        stood = {body: self._stance(sim, body) for body in (self.roots if self.about else ())}
        stride = max(1, round(SHOCK / times[1])) if len(times) > 1 else 1
        looks = dict.fromkeys([*range(stride, len(times), stride), len(times) - 1])
        for place in () if seen.failure else looks:
            sim.qpos[:], sim.qvel[:] = qpos[place], qvel[place]
            sim.forward()
            seen.points = touching(sim) if sim.overlap > 0 else []
            seen.ends_on = {self._touch(*point[:2]) for point in seen.points}
            seen.met |= seen.ends_on
            for body, (axis, height) in stood.items():
                now, above = self._stance(sim, body)
                if now @ axis < np.cos(TILT) or above < (1 - SINKS) * height:
                    seen.fell = min(seen.fell or math.inf, float(times[place]))
        if not seen.failure:
            seen.end = Start(qpos[-1], qvel[-1], act[-1], start.mocap)
        return seen

    def _stance(self, sim: Sim, body: int) -> tuple[np.ndarray, float]:
        """Return the vertical of the world in the frame of a robot's root, and the height of its
        centre of mass above the lowest of its geoms.
        """
        back = np.array(sim.xquat[body]) * (1.0, -1.0, -1.0, -1.0)
        geoms = self.of_root == body
        lowest = sim.geom_xpos[geoms, 2] - sim.model.geom_size[geoms].max(axis=1)
        height = float(sim.subtree_com[body, 2] - lowest.min(initial=np.inf))
        return rotated(back, np.array([0.0, 0.0, 1.0])), height

    def _touch(self, first: int, second: int) -> frozenset[int]:
        """Return two bodies in contact; or their roots, if these differ and none is the world."""
        pair = frozenset((self.model.root(first), self.model.root(second)))
        return pair if len(pair) == 2 and 0 not in pair else frozenset((first, second))

    def choose(self, starts: Sequence[Start], seed: int) -> Chosen:
        """Return a move for each start: the largest part of a random one that shows no trouble.

        Events that a start shows without a move are no trouble.
        """
        count, nu = len(starts), self.model.nu
        ways, speeds, part = np.zeros((count, nu)), np.zeros((count, nu)), np.zeros((count, 1))
        reach = np.zeros((count, len(self.joints)))
        seen, alone = [self.held] * count, dict[int, Seen]()
        still = self.keep or self.held.failure or self.held.fell is not None
        todo = [] if still else list(range(count))
        for k in todo:
            rng = np.random.default_rng([seed, k])
            change = self._drawn(rng)
            ways[k], speeds[k] = self._toward(change, float(rng.uniform(-1.0, 1.0)))
            reach[k] = np.abs(change[self.dofs])
        room = [d.ctrlrange if d.kind == SERVO else (-math.inf, math.inf) for d in self.drives]
        low, high = np.reshape(room, (-1, 2)).T - self.ctrl

        def tried(some: Sequence[int]) -> dict[int, Seen]:
            """Return the trials of some starts, with their part of the move."""
            spans, rates = np.clip(part * ways, low, high)[some], (part * speeds)[some]
            runs = self.trials([starts[k] for k in some], spans, rates)
            return dict(zip(some, runs, strict=True))

        for factor in MOVE_PARTS:
            if not todo:
                break
            part[todo] = factor
            now = tried(todo)
            bad = [k for k in todo if self._trouble(now[k], self.held)]
            if new := [k for k in bad if k not in alone]:
                part[new] = 0.0
                alone |= tried(new)
                part[new] = factor
            for k in todo:
                seen[k] = now[k]
            todo = [k for k in bad if self._trouble(seen[k], alone[k])]
        part[todo] = 0.0
        for k in todo:
            seen[k] = alone[k]
        far = (np.abs(part) * reach).max(axis=0, initial=0.0)
        return Chosen(np.clip(part * ways, low, high), part * speeds, far, seen)

    def _trouble(self, seen: Seen, alone: Seen) -> bool:
        """Return whether a move demands too much; alone: the trial without it."""
        over = (seen.force > alone.force + FORCE_SHARE * (1 - alone.force)) | (
            # Panda's light wrist is saturated in 4 % of a run, at the speed of a start.
            seen.full > alone.full + 0.05
        )
        met = seen.met - alone.met - self.held.met
        left = self.about and bool(alone.ends_on - seen.ends_on)
        falls = seen.fell is not None and alone.fell is None
        return bool(seen.failure or over.any() or met or left or falls)


@dataclass
class Chosen:
    """The moves of some starts; see `Moves.log`.

    far: the largest move of each joint, (joints,). seen: the trial of each start.
    """

    spans: np.ndarray
    rates: np.ndarray
    far: np.ndarray
    seen: list[Seen]

    @property
    def still(self) -> int:
        """The number of starts that only hold their pose."""
        moved = np.maximum(np.abs(self.spans), np.abs(self.rates)).max(axis=1, initial=0.0)
        return int((moved <= 1e-6).sum())


def driven_roots(model: Model, drives: Sequence[Actuator]) -> set[int]:
    """Return the roots of the trees whose joints actuators drive."""
    joints = {drive.joint for drive in drives if drive.joint is not None}
    return {model.root(int(model.jnt_body[joint])) for joint in joints}


def moves_about(model: Model, drives: Sequence[Actuator]) -> bool:
    """Return whether the actuators are on a body that moves freely, or on undriven slides."""
    driven, trees = {drive.joint for drive in drives}, driven_roots(model, drives)
    return any(
        body in trees and model.jnt_type[joint] in ("free", "slide") and joint not in driven
        for joint, body in enumerate(model.jnt_body.tolist())
    )


def support(sim: Sim, dofs: Sequence[int], contacts: np.ndarray) -> np.ndarray:
    """Return the force on each of some dofs that a Sim's pose needs at rest [N or N·m]."""
    need = hold_load(sim)
    if len(contacts):
        others = np.setdiff1d(np.arange(sim.model.nv), dofs)
        push = np.linalg.lstsq(contacts[:, others].T, need[others], rcond=1e-8)[0]
        need = need - contacts.T @ push
    return need[list(dofs)]


def touching(sim: Sim) -> list[tuple[int, int, np.ndarray]]:
    """Return the contacts of the last solve: both bodies, and the place."""
    body, table = sim.model.geom_body, sim.contacts
    table = table[table["dist"] < 0]
    return [(int(body[c["geom1"]]), int(body[c["geom2"]]), np.array(c["pos"])) for c in table]


def _put(sim: Sim, start: Start) -> Sim:
    """Return a Sim at a start, solved there."""
    sim.reset()
    start.put(sim)
    sim.forward()
    return sim
