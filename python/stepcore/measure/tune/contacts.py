"""solref and solimp for a wanted stiffness, depth, settling time or force noise of contacts.

At rest a row of MuJoCo's contacts has the force f = K d r / R, where r is the depth,
R = T (1 − d)/d with the inverse inertia T of the row, and K = 1/(d tc)² under solref="tc 1" and
solimp="d d width". So the rows of a geom have the stiffness Σ f/r = S / ((1 − d) tc²) with
S = Σ 1/T. The depth settles as a critically damped oscillator of frequency 1/tc, and tc is at least
2 dt (refsafe).
"""

from __future__ import annotations

import copy
import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from stepcore._core import SimulationError
from stepcore.engine.model import Model
from stepcore.engine.sim import Sim, unwatched
from stepcore.engine.start import Start
from stepcore.measure.tune.goal import SETTLES, WITHIN, Goal, Tuned
from stepcore.report.units import rounded, seconds
from stepcore.scene.layout import Layout

# The impedance of the proposals, and the largest that the engine takes.
USUAL, HARDEST = 0.95, 0.9999
# The time in which bodies come to rest, and the time over which forces and depths are averaged [s].
REST, LOOKED = 2.0, 0.5
# Corrections by the run; the factors by which tc grows until the noise is as wanted.
ROUNDS, SOFTER, SOFTEST = 5, 1.4, 16
# The push that shows the settling, as a share of the force at rest, and its length in units of tc.
PUSHED, RESPONSE = 0.1, 15.0
SETTLED = 0.02
# The least force of a contact at rest, as a share of the weight of the model.
TOUCHING = 1e-6


@dataclass(frozen=True)
class Resting:
    """What a run shows of a geom's contacts at rest.

    force: the normal force of all [N]. depth: their mean depth [m]. noise: RMS deviation of the
        force from its mean [N].
    """

    force: float
    depth: float
    noise: float

    @property
    def stiffness(self) -> float:
        return self.force / self.depth if self.depth > 0 else math.nan

    def of(self, goal: Goal) -> float:
        return float(getattr(self, goal.name))


def resting_geoms(
    model: Model, start: Start, ctrl: np.ndarray, names: Sequence[str] | None
) -> list[int]:
    """Return the geoms that rest on something at the end of a run, or those with given names.

    Of two geoms in contact, that of the body further from the world is meant.
    """
    if names is not None:
        return [model.index("geom", name) for name in names]
    bench = _Bench(model, start, ctrl)
    sim = bench.at_rest(model)
    if sim is None:
        return []
    found: dict[int, None] = {}
    for contact in sim.contacts:
        if contact["force"][2] > 0:
            both = int(contact["geom1"]), int(contact["geom2"])
            bodies = [int(model.geom_body[geom]) for geom in both]
            found[both[int(bodies[1] >= bodies[0])]] = None
    return list(found)


def tuned_contacts(
    model: Model, start: Start, ctrl: np.ndarray, geoms: Sequence[int], goal: Goal
) -> list[Tuned]:
    """Return solref and solimp for each geom, each verified by a run of its own."""
    bench = _Bench(model, start, ctrl)
    return [_tuned(bench, geom, goal) for geom in geoms]


def _tuned(bench: _Bench, geom: int, goal: Goal) -> Tuned:
    name, dt = bench.model.called("geom")[geom], bench.model.settings.dt
    lost = Tuned("geom", name, goal, "", {}, math.nan, math.nan, False)
    least = 2 * dt if bench.model.settings.refsafe else dt
    sim = bench.at_rest(bench.model)
    rest = None if sim is None else bench.resting(sim, geom)
    if sim is None or rest is None:
        lost.why = "It does not rest on anything at the end of the run"
        return lost
    if goal.name == "noise":
        return _quiet(bench, geom, goal, lost, rest, least)
    inverses = bench.sum_of_inverses(sim, geom)
    # What the closed form gives of the goal; a depth falls with the stiffness.
    power = -1 if goal.name == "depth" else 1
    target, measured, tc, d = goal.value, math.nan, least, USUAL
    for _ in range(ROUNDS):
        if goal.name == "settling":
            tc = rounded(max(target / SETTLES, least))
            measured = bench.settling(geom, tc, d)
        else:
            stiffness = rest.force / target if goal.name == "depth" else target
            tc = rounded(max(math.sqrt(inverses / ((1 - USUAL) * stiffness)), least))
            d = min(1 - inverses / (stiffness * tc**2), HARDEST)
            seen = bench.rested(geom, tc, d)
            measured = math.nan if seen is None else seen.of(goal)
        if not measured > 0 or abs(measured / goal.value - 1) < WITHIN / 4:
            break
        target *= min(4.0, max(0.25, goal.value / measured))

    def law(tc: float, d: float) -> float:
        """Return the goal by the closed form."""
        if goal.name == "settling":
            return SETTLES * tc
        return (inverses / ((1 - d) * tc**2)) ** power * (rest.force if power < 0 else 1.0)

    found = _told(bench, geom, goal, lost, tc, d, law(tc, d), measured)
    found.why = "The run does not come to rest with these values"
    if math.isfinite(measured):
        limit, word = goal.words(law(least, HARDEST)), "least" if power < 0 else "most"
        if goal.name == "settling":
            word = "least"
        found.why = f"{goal.words(measured)} in the run, whose contacts change with the softness"
        if tc <= least and (d >= HARDEST or goal.name == "settling"):
            found.why = (
                f"{goal.words(measured)} in the run; {seconds(dt)} allows {limit} at the {word}"
            )
    return found


def _quiet(bench: _Bench, geom: int, goal: Goal, lost: Tuned, rest: Resting, least: float) -> Tuned:
    """Soften a contact until its force is quiet enough."""
    tc, seen = least, rest
    for _ in range(SOFTEST):
        if seen is not None and seen.noise <= goal.value:
            break
        tc = rounded(tc * SOFTER)
        seen = bench.rested(geom, tc, USUAL) or Resting(math.nan, math.nan, math.nan)
    if seen is rest:
        lost.measured, lost.reached, lost.also = rest.noise, True, ", as it is"
        return lost
    found = _told(bench, geom, goal, lost, tc, USUAL, math.nan, seen.noise)
    found.reached = seen.noise <= goal.value
    found.why = f"At solref {tc:g} s the noise is still {goal.words(seen.noise)} RMS"
    found.also = f" ({goal.words(rest.noise)} before)"
    return found


def _told(
    bench: _Bench,
    geom: int,
    goal: Goal,
    lost: Tuned,
    tc: float,
    d: float,
    expected: float,
    measured: float,
) -> Tuned:
    reached = abs(measured / goal.value - 1) < WITHIN
    values = f'solref="{tc:g} 1" solimp="{d:.6g} {d:.6g} 0.001" priority="{bench.priority}"'
    named = lost.name in bench.model.geom_names
    tag = f'geom name="{lost.name}"' if named else "geom"
    return Tuned("geom", lost.name, goal, "", {tag: values}, expected, measured, reached)


class _Bench:
    """Runs of a model with other contact parameters of one geom, from one start."""

    def __init__(self, model: Model, start: Start, ctrl: np.ndarray) -> None:
        self.model, self.start, self.ctrl = model, start, np.array(ctrl, float)
        # A geom of the highest priority sets the parameters of its contacts alone.
        self.weight = float(model.body_mass.sum()) * 9.81
        self.priority = 1 + max((geom.priority for geom in model.scene.geoms), default=0)

    def at_rest(self, model: Model) -> Sim | None:
        """Return a Sim at the end of a run of `REST`, or None for a run that fails."""
        sim = unwatched(Sim(model))
        sim.reset()
        self.start.put(sim)
        sim.ctrl = self.ctrl
        try:
            sim.step(max(1, round(REST / model.settings.dt)))
        except SimulationError:
            return None
        return sim

    def changed(self, geom: int, tc: float, d: float) -> Model:
        scene = copy.deepcopy(self.model.scene)
        owner = Layout(scene).geoms[geom]
        midpoint, power = owner.solimp[3:]
        hard = rounded(d, 6)
        owner.solref, owner.solimp = (tc, 1.0), (hard, hard, 0.001, midpoint, power)
        owner.priority = self.priority
        return Model(scene, self.model.settings)

    def rested(self, geom: int, tc: float, d: float) -> Resting | None:
        """Return what a run with other parameters shows of a geom's contacts."""
        sim = self.at_rest(self.changed(geom, tc, d))
        return None if sim is None else self.resting(sim, geom)

    def resting(self, sim: Sim, geom: int) -> Resting | None:
        """Return the mean force and depth of a geom's contacts while a Sim goes on."""
        forces, depths = [], []
        try:
            for _ in range(max(10, round(LOOKED / sim.settings.dt))):
                sim.step()
                own = _contacts(sim, geom)
                forces.append(float(own["force"][:, 2].sum()))
                depths.append(-float(own["dist"].mean()) if len(own) else 0.0)
        except SimulationError:
            return None
        # Not on its own weight: what joints carry touches without a force.
        if np.mean(forces) <= TOUCHING * self.weight or np.mean(depths) <= 0:
            return None
        return Resting(float(np.mean(forces)), float(np.mean(depths)), float(np.std(forces)))

    def sum_of_inverses(self, sim: Sim, geom: int) -> float:
        """Return Σ 1/T over the rows of a geom's contacts, from the rows of a Sim at rest."""
        d = 0.9
        other = Sim(self.changed(geom, 0.02, d))
        other.qpos, other.qvel = sim.qpos, sim.qvel
        other.forward()
        pairs = {(int(c["index"]), int(c["part"])) for c in _contacts(other, geom)}
        rows = [r for r in other.rows if r["kind"] == "contact"]
        own = [r for r in rows if (int(r["index"]), int(r["part"])) in pairs]
        if self.model.settings.cone != "pyramidal":
            own = [row for row in own if row["lo"] == 0]
        return sum((1 - d) / (d * float(r["regulariser"])) for r in own)

    def settling(self, geom: int, tc: float, d: float) -> float:
        """Return how long the depth takes to settle after a step of the force [s]."""
        model = self.changed(geom, tc, d)
        sim = self.at_rest(model)
        rest = None if sim is None else self.resting(sim, geom)
        if sim is None or rest is None or not len(_contacts(sim, geom)):
            return math.nan
        normal = np.array(_contacts(sim, geom)["normal"])[0]
        body = int(model.geom_body[geom])
        side = -1.0 if _contacts(sim, geom)["geom2"][0] == geom else 1.0
        sim.xfrc_applied[body, :3] = side * PUSHED * rest.force * normal
        depths = []
        try:
            for _ in range(max(20, round(RESPONSE * tc / model.settings.dt))):
                sim.step()
                depths.append(-float(_contacts(sim, geom)["dist"].mean()))
        except (SimulationError, ValueError):
            return math.nan
        path = np.array(depths) - rest.depth
        share = path / path[-1]
        inside = np.flatnonzero(np.abs(share - 1) > SETTLED)
        return (inside[-1] + 1 if len(inside) else 0) * model.settings.dt


def _contacts(sim: Sim, geom: int) -> np.ndarray:
    contacts = sim.contacts
    own: np.ndarray = contacts[(contacts["geom1"] == geom) | (contacts["geom2"] == geom)]
    return own
