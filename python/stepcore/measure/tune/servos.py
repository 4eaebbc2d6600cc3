"""Gains of position servos for a wanted bandwidth, settling time or sag, verified by steps."""

from __future__ import annotations

import copy
import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from stepcore._core import SimulationError
from stepcore.engine.model import Model
from stepcore.engine.sim import Sim, unwatched
from stepcore.engine.start import Start
from stepcore.engine.stiffness import MARGIN
from stepcore.measure.diagnosis.linear import Held
from stepcore.measure.diagnosis.running import State, with_converged_rows
from stepcore.measure.monitors.actuators import on_one_dof
from stepcore.measure.tune.goal import PASSES, RISES, SETTLES, WITHIN, Goal, Tuned
from stepcore.report.units import rounded, seconds
from stepcore.scene.layout import Layout

# The size of a step of the target [rad or m]; the share of its range, and of the force left.
STEP, RANGE, LEFT = 0.05, 0.05, 0.5
# The time that holding the pose and a step of the target get, in units of 1/ω, within bounds [s].
HELD, RESPONSE, LEAST, LONGEST = 30.0, 25.0, 0.2, 10.0
# A step has settled when it stays within this share of its size.
SETTLED = 0.02
# Corrections of the inertia by the run, and bisections of the highest bandwidth.
ROUNDS, HALVINGS = 5, 7
# The time in which a linearised step must not grow [s].
LINEAR = 1.0


@dataclass(frozen=True)
class Servo:
    """A position servo on a hinge or slide.

    index, dof, gear: of the actuator. inertia: that it moves while the other joints are held.
    damping: of the joint. load: the force of the servo that the pose needs at rest [N or N·m].
    """

    index: int
    name: str
    unit: str
    dof: int
    gear: float
    inertia: float
    damping: float
    load: float

    def gains(self, omega: float, armature: float = 0.0) -> tuple[float, float]:
        """Return kp and kv of a critically damped servo of frequency ω [rad/s].

        armature: to add [kg·m² or kg].
        """
        inertia = self.inertia + armature
        kv = max(0.0, 2 * inertia * omega - self.damping) / self.gear**2
        return rounded(inertia * omega**2 / self.gear**2), rounded(kv)


@dataclass(frozen=True)
class Response:
    """What a run shows of a servo. rise, settling: of a step of its target [s]. sag: [rad or m]."""

    rise: float
    settling: float
    sag: float

    def of(self, goal: Goal) -> float:
        """Return the measured value of a goal; nan if the servo did not settle."""
        if goal.name == "bandwidth":
            return PASSES * RISES / (2 * math.pi * self.rise)
        return self.settling if goal.name == "settling" else self.sag


def servos_of(model: Model, start: Start, names: Sequence[str] | None) -> list[Servo]:
    """Return the position servos of a model, or those with the given names.

    Raises ValueError for a name that is no position servo.
    """
    sim = Sim(model)
    start.put(sim)
    sim.forward()
    mass, need = sim.mass_matrix(), np.array(sim.bias) - np.array(sim.passive)
    layout, called = Layout(model.scene), model.called("actuator")
    found = []
    for k in on_one_dof(model):
        joint, gear = int(model.actuator_joint[k]), float(model.actuator_gear[k, 0])
        bias, law = model.actuator_bias[k], model.scene.actuators[k].law
        if law.gaintype != "fixed" or not (bias[1] < 0 < model.actuator_gain[k]) or not gear:
            continue
        dof, unit = int(model.jnt_dofadr[joint]), "rad"
        if model.jnt_type[joint] == "slide":
            unit = "m"
        damping = float(np.ravel(layout.joints[joint].damping)[0])
        own = float(mass[dof, dof])
        found.append(Servo(k, called[k], unit, dof, gear, own, damping, float(need[dof] / gear)))
    known = [servo.name for servo in found]
    for name in names or ():
        if name not in known:
            model.index("actuator", name)
            raise ValueError(f"servo = {name!r}: is no position servo on a hinge or slide")
    return [servo for servo in found if names is None or servo.name in names]


def tuned_servos(
    model: Model, start: Start, ctrl: np.ndarray, servos: Sequence[Servo], goal: Goal
) -> list[Tuned]:
    """Return gains for each servo. All servos are changed together, and verified together."""
    bench = _Bench(model, start, ctrl)
    if goal.name == "sag":
        return _for_sag(bench, servos, goal)
    first = _frequency(goal, goal.value)
    omega = {servo.index: first for servo in servos}
    for _ in range(ROUNDS):
        responses = bench.responses(servos, _gains(servos, omega), min(omega.values()))
        values = {k: response.of(goal) / goal.value for k, response in responses.items()}
        if not all(math.isfinite(value) for value in values.values()):
            break
        if all(abs(value - 1) < WITHIN / 4 for value in values.values()):
            break
        for k, value in values.items():
            # A bandwidth is proportional to ω, and a settling time to 1/ω.
            omega[k] *= min(2.0, max(0.5, 1 / value if goal.name == "bandwidth" else value))
    tuned = []
    for servo in servos:
        kp, kv = servo.gains(omega[servo.index])
        # The closed form knows the frequency of the servo alone, the other joints held.
        expected = _value(goal, math.sqrt(kp * servo.gear**2 / servo.inertia))
        measured = responses[servo.index].of(goal)
        reached = abs(measured / goal.value - 1) < WITHIN
        lines = bench.attributes(servo, kp, kv, 0.0)
        why = f"The run shows {goal.words(measured)} with kp={kp:g} and kv={kv:g}"
        tuned.append(Tuned("servo", servo.name, goal, "", lines, expected, measured, reached, why))
    if all(math.isfinite(entry.measured) for entry in tuned):
        return tuned
    most = _most(bench, servos, goal, first)
    return [entry if entry.reached else replace(entry, why=most) for entry in tuned]


def _frequency(goal: Goal, value: float) -> float:
    """Return the frequency of a critically damped oscillator with a goal's value [rad/s]."""
    return 2 * math.pi * value / PASSES if goal.name == "bandwidth" else SETTLES / value


def _value(goal: Goal, omega: float) -> float:
    """Return the goal's value for a critically damped oscillator; omega: [rad/s]."""
    return PASSES * omega / (2 * math.pi) if goal.name == "bandwidth" else SETTLES / omega


def _gains(
    servos: Sequence[Servo], omega: Mapping[int, float]
) -> dict[int, tuple[float, float, float]]:
    """Return kp, kv and the armature to add, by actuator."""
    return {servo.index: (*servo.gains(omega[servo.index]), 0.0) for servo in servos}


def _most(bench: _Bench, servos: Sequence[Servo], goal: Goal, omega: float) -> str:
    """Return in words what the time step allows at most: the highest frequency that holds."""

    def holds(trial: float) -> bool:
        gains = _gains(servos, dict.fromkeys((servo.index for servo in servos), trial))
        responses = bench.responses(servos, gains, trial).values()
        return all(math.isfinite(response.settling) for response in responses)

    low = next((omega / 2**k for k in range(1, HALVINGS + 1) if holds(omega / 2**k)), None)
    if low is None:
        return "The pose does not come to rest, so nothing can be verified: try another keyframe"
    high = 2 * low
    for _ in range(HALVINGS // 2):
        middle = math.sqrt(low * high)
        low, high = (middle, high) if holds(middle) else (low, middle)
    settings = bench.model.settings
    limit = goal.words(_value(goal, low))
    said = f"{seconds(settings.dt)} under {settings.integrator} holds about {limit}"
    if settings.integrator != "implicitfast":
        bench.model = bench.model.with_settings(integrator="implicitfast")
        said += "; implicitfast holds it" if holds(omega) else "; implicitfast does not hold it"
    return said


def _for_sag(bench: _Bench, servos: Sequence[Servo], goal: Goal) -> list[Tuned]:
    """Return the kp that leaves a sag under the load of the pose, with kv of critical damping."""
    settings, most = bench.model.settings, math.inf
    whole = max(abs(servo.load) for servo in servos)
    unloaded = [servo for servo in servos if abs(servo.load) <= NOTHING * whole]
    servos = [servo for servo in servos if servo not in unloaded]
    load = {servo.index: abs(servo.load) for servo in servos}
    tuned = [
        Tuned("servo", servo.name, goal, servo.unit, {}, 0.0, 0.0, False, NO_LOAD)
        for servo in unloaded
    ]
    if not servos:
        return tuned
    for _ in range(ROUNDS):
        gains = {s.index: _holding(s, load[s.index], goal.value, most) for s in servos}
        slowest = min(abs(s.gear) * math.sqrt(gains[s.index][0] / s.inertia) for s in servos)
        responses = bench.responses(servos, gains, slowest)
        ratios = {k: response.sag / goal.value for k, response in responses.items()}
        ratios = {k: ratio for k, ratio in ratios.items() if math.isfinite(ratio)}
        if not ratios:
            # Armature slows servos that the step cannot resolve.
            most = SLOW / settings.dt
        elif all(abs(ratio - 1) < WITHIN / 4 for ratio in ratios.values()):
            break
        # Contacts, and the sag of the other joints, change the load.
        load |= {k: load[k] * min(10.0, max(0.1, ratio)) for k, ratio in ratios.items()}
    for servo in servos:
        kp, kv, more = gains[servo.index]
        measured, bound = responses[servo.index].sag, bench.bound(servo)
        expected = abs(servo.load) / (kp * abs(servo.gear))
        reached = abs(measured / goal.value - 1) < WITHIN
        step = f"{seconds(settings.dt)} under {settings.integrator}"
        why = f"{step} does not rest in the pose with kp={kp:g} and a stability margin of 2"
        if math.isfinite(measured):
            why = f"The run sags by {goal.words(measured, servo.unit)} with kp={kp:g}"
        if kp * goal.value * abs(servo.gear) > bound:
            why = f"The pose needs more than its forcerange of {bound:g}"
        lines = bench.attributes(servo, kp, kv, more)
        told = (goal, servo.unit, lines, expected, measured, reached, why)
        tuned.append(Tuned("servo", servo.name, *told))
    if math.isfinite(most) and settings.integrator != "implicitfast":
        plain = {s.index: _holding(s, load[s.index], goal.value, math.inf) for s in servos}
        bench.model = bench.model.with_settings(integrator="implicitfast")
        rests = bench.responses(servos, plain, slowest).values()
        if all(abs(response.sag / goal.value - 1) < WITHIN for response in rests):
            for entry in tuned:
                entry.also = "; implicitfast needs no armature"
    return tuned


def _holding(servo: Servo, load: float, sag: float, most: float) -> tuple[float, float, float]:
    """Return kp, kv and the armature to add for a sag under a load of the servo.

    most: the highest frequency of the servo [rad/s], which armature lowers.
    """
    kp = rounded(load / (sag * abs(servo.gear)))
    omega = abs(servo.gear) * math.sqrt(kp / servo.inertia)
    more = rounded(servo.inertia * ((omega / most) ** 2 - 1)) if omega > most else 0.0
    return kp, servo.gains(min(omega, most), more)[1], more


# The largest ω dt of a servo with armature; the least load, as a share of the largest.
SLOW, NOTHING = 0.1, 1e-3
NO_LOAD = "It carries no load in this pose; its gains are left as they are"


class _Bench:
    """Runs of a model with changed servos, from one start."""

    def __init__(self, model: Model, start: Start, ctrl: np.ndarray) -> None:
        self.model, self.start, self.ctrl = model, start, np.array(ctrl, float)
        # Other elements may leave no margin, which gains do not give back.
        self.has_margin = self._margin(model)

    def _margin(self, model: Model) -> bool:
        """Return whether the step is stable at the start with a margin of `MARGIN`."""
        begin = self.start
        act = np.zeros(0) if begin.act is None else begin.act
        state = State("the start", 0.0, begin.qpos, begin.qvel, self.ctrl, act)
        held = Held(with_converged_rows(model), state, LINEAR)
        return held.stable(model.settings.integrator, MARGIN * model.settings.dt)

    def bound(self, servo: Servo) -> float:
        """Return the largest force of a servo."""
        return float(np.abs(self.model.actuator_forcerange[servo.index]).min())

    def responses(
        self,
        servos: Sequence[Servo],
        gains: Mapping[int, tuple[float, float, float]],
        omega: float,
    ) -> dict[int, Response]:
        """Return the response of each servo to a step of its own target, the others holding."""
        lost = Response(math.nan, math.nan, math.nan)
        model = self.changed(servos, gains)
        if self.has_margin and not self._margin(model):
            return dict.fromkeys((servo.index for servo in servos), lost)
        dt = model.settings.dt
        held = math.ceil(min(max(LEAST, HELD / omega), LONGEST) / dt)
        count = math.ceil(min(max(LEAST, RESPONSE / omega), LONGEST) / dt)
        sim = self._sim(model)
        try:
            sim.step(held)
        except SimulationError:
            return dict.fromkeys((servo.index for servo in servos), lost)
        state = sim.state()
        found = {}
        for servo in servos:
            sim.restore(state)
            try:
                found[servo.index] = self._stepped(sim, servo, gains[servo.index][0], count)
            except SimulationError:
                found[servo.index] = lost
        return found

    def _stepped(self, sim: Sim, servo: Servo, kp: float, count: int) -> Response:
        k, dt = servo.index, sim.settings.dt
        before = float(sim.actuator_length[k])
        per = float(sim.model.actuator_gain[k] / -sim.model.actuator_bias[k, 1])
        sag = abs(float(sim.ctrl[k]) * per - before) / abs(servo.gear)
        low, high = sim.model.actuator_ctrlrange[k]
        step = min(STEP * abs(servo.gear), RANGE * float(high - low) * per)
        left = self.bound(servo) - abs(kp * sag * servo.gear)
        step = min(step, LEFT * left / kp) if kp > 0 and left > 0 else step
        up = float(sim.ctrl[k]) + 2 * step / per <= high
        sim.ctrl[k] += (step if up else -step) / per
        path = np.empty(count)
        for n in range(count):
            sim.step()
            path[n] = sim.actuator_length[k]
        share = (path - before) / (path[-1] - before)
        if not np.isfinite(share).all() or abs(abs(path[-1] - before) / step - 1) > 0.5:
            return Response(math.nan, math.nan, math.nan)
        if np.abs(share[-count // 5 :] - 1).max() > SETTLED:
            return Response(math.nan, math.nan, math.nan)
        inside = np.flatnonzero(np.abs(share - 1) > SETTLED)
        settling = (inside[-1] + 1 if len(inside) else 0) * dt
        share, times = np.concatenate([[0.0], share]), dt * np.arange(count + 1)
        first, last = (_crossing(times, share, level) for level in (0.1, 0.9))
        return Response(last - first, settling, sag)

    def changed(
        self, servos: Sequence[Servo], gains: Mapping[int, tuple[float, float, float]]
    ) -> Model:
        """Return the model with other gains and armatures."""
        scene = copy.deepcopy(self.model.scene)
        layout = Layout(scene)
        for servo in servos:
            kp, kv, armature = gains[servo.index]
            actuator = scene.actuators[servo.index]
            if actuator.type == "general":
                bias = actuator.biasprm or (0.0, 0.0, 0.0)
                actuator.gainprm, actuator.biasprm = kp, (bias[0], -kp, -kv)
            else:
                actuator.kp, actuator.kv, actuator.dampratio = kp, kv, None
            if armature:
                joint = layout.joints[int(self.model.actuator_joint[servo.index])]
                joint.armature += armature
        return Model(scene, self.model.settings)

    def attributes(self, servo: Servo, kp: float, kv: float, armature: float) -> dict[str, str]:
        """Return the MJCF attributes of a servo, and of its joint."""
        actuator = self.model.scene.actuators[servo.index]
        joint = int(self.model.actuator_joint[servo.index])
        values = f'kp="{kp:g}" kv="{kv:g}"'
        if actuator.type == "general":
            first = (actuator.biasprm or (0.0,))[0]
            values = f'gainprm="{kp:g}" biasprm="{first:g} {-kp:g} {-kv:g}"'
        tags = {f'{actuator.type} name="{servo.name}"': values}
        if armature:
            whole = float(Layout(self.model.scene).joints[joint].armature) + armature
            tags[f'joint name="{self.model.called("joint")[joint]}"'] = f'armature="{whole:g}"'
        return tags

    def _sim(self, model: Model) -> Sim:
        sim = unwatched(Sim(model))
        sim.reset()
        self.start.put(sim)
        sim.ctrl = self.ctrl
        return sim


def _crossing(times: np.ndarray, share: np.ndarray, level: float) -> float:
    """Return when a step response first reaches a level, interpolated between steps."""
    k = int(np.argmax(share >= level))
    if k == 0:
        return float(times[0])
    way = (level - share[k - 1]) / (share[k] - share[k - 1])
    return float(times[k - 1] + way * (times[k] - times[k - 1]))
