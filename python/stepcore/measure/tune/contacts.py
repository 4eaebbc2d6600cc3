"""solref and solimp for a wanted stiffness, depth, settling time or force noise of contacts.

At rest a row of MuJoCo's contacts has the force f = K d r / R, where r is the depth,
R = T (1 − d)/d with the inverse inertia T of the row, and K = 1/(d tc)² under solref="tc 1" and
solimp="d d width". So the rows of a geom have the stiffness Σ f/r = S / ((1 − d) tc²) with
S = Σ 1/T. The depth settles as a critically damped oscillator of frequency 1/tc, and tc is at least
2 dt (refsafe).
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np

from stepcore._core import SimulationError
from stepcore.engine.model import Model
from stepcore.engine.sim import Sim, unwatched
from stepcore.engine.trajectory import pieces
from stepcore.experiment.change import Change
from stepcore.measure.tune.goal import ROUNDS, SETTLES, WITHIN, At, Goal, Tuned, pasted, settling
from stepcore.report.units import rounded, seconds

# The impedance of the proposals, and the largest that the engine takes.
USUAL, HARDEST = 0.95, 0.9999
# The time in which bodies come to rest, and the time over which forces and depths are averaged [s].
REST, LOOKED = 2.0, 0.5
# The factor by which tc grows until the noise is as wanted, and how often.
SOFTER, SOFTEST = 1.4, 16
# The push that shows the settling, as a share of the force at rest, and its length in units of tc.
PUSHED, RESPONSE = 0.1, 15.0


class Resting(NamedTuple):
    """What a run shows of a geom's contacts at rest.

    force: the normal force of all [N]. depth: their mean depth [m]. noise: RMS deviation of the
        force from its mean [N]. sim: at the end.
    """

    force: float
    depth: float
    noise: float
    sim: Sim

    @property
    def stiffness(self) -> float:
        return self.force / self.depth

    def of(self, goal: Goal) -> float:
        return float(getattr(self, goal.name))


@dataclass(frozen=True)
class Touching:
    """A geom's contacts in runs of a model from one state, under other parameters."""

    model: Model
    at: At
    geom: int

    @property
    def least(self) -> float:
        """The least tc that the step takes [s]."""
        dt = self.model.settings.dt
        return 2 * dt if self.model.settings.refsafe else dt

    def values(self, tc: float, d: float) -> dict[str, object]:
        """Return parameters as values by path. The geom of the highest priority sets them alone."""
        path, d = f"geom/#{self.geom}", rounded(d, 6)
        priority = 1 + max(geom.priority for geom in self.model.scene.geoms)
        return {
            f"{path}/solref": (tc, 1.0),
            f"{path}/solimp": (d, d, 0.001),
            f"{path}/priority": priority,
        }

    def rested(self, values: dict[str, object]) -> Resting | None:
        """Return what is seen of the contacts at rest; None if they bear nothing, or it fails."""
        model = Change(values).of(self.model)
        rest = self.at.after(model, REST)
        if rest is None:
            return None
        sim = unwatched(Sim(model))
        rest.put(sim)
        sim.ctrl = self.at.ctrl
        seen = self.looked(sim, max(10, round(LOOKED / model.settings.dt)))
        weight = 9.81 * float(model.body_mass.sum())
        # Not on its own weight: what joints carry touches without a force.
        if seen is None or seen[0].mean() <= 1e-6 * weight or seen[1].mean() <= 0:
            return None
        force, depths = seen
        return Resting(float(force.mean()), float(depths.mean()), float(force.std()), sim)

    def looked(self, sim: Sim, steps: int) -> tuple[np.ndarray, np.ndarray] | None:
        """Return force and mean depth of the contacts after each step; None if the run fails."""
        looks = []
        try:
            for done in pieces(sim, steps, pauses=(1,)):
                own = self.contacts(sim)
                if done:
                    depth = -float(own["dist"].mean()) if len(own) else 0.0
                    looks.append((float(own["force"][:, 2].sum()), depth))
        except (SimulationError, ValueError):
            return None
        force, depths = np.array(looks).T
        return force, depths

    def contacts(self, sim: Sim) -> np.ndarray:
        contacts = sim.contacts
        own: np.ndarray = contacts[
            (contacts["geom1"] == self.geom) | (contacts["geom2"] == self.geom)
        ]
        return own

    def inverses(self, sim: Sim) -> float:
        """Return Σ 1/T over the rows of the geom's contacts, from a Sim at rest."""
        d = 0.9
        other = Sim(Change(self.values(0.02, d)).of(self.model))
        other.qpos, other.qvel = sim.qpos, sim.qvel
        other.forward()
        pairs = {(int(c["index"]), int(c["part"])) for c in self.contacts(other)}
        own = [r for r in other.rows if (int(r["index"]), int(r["part"])) in pairs]
        own = [r for r in own if r["kind"] == "contact"]
        if self.model.settings.cone != "pyramidal":
            own = [row for row in own if row["lo"] == 0]
        return sum((1 - d) / (d * float(row["regulariser"])) for row in own)

    def settling(self, rest: Resting, tc: float) -> float:
        """Return how long the depth takes to settle after a step of the force [s]."""
        own, sim = self.contacts(rest.sim), rest.sim
        if not len(own):
            return math.nan
        side = -1.0 if own["geom2"][0] == self.geom else 1.0
        push = side * PUSHED * rest.force * np.array(own["normal"])[0]
        sim.xfrc_applied[int(self.model.geom_body[self.geom]), :3] = push
        seen = self.looked(sim, max(20, round(RESPONSE * tc / sim.settings.dt)))
        if seen is None:
            return math.nan
        path = seen[1] - rest.depth
        return settling(path / path[-1], sim.settings.dt)


def resting_geoms(model: Model, at: At, names: Sequence[str] | None) -> list[int]:
    """Return the geoms that rest on something at the end of a run, or those with given names.

    Of two geoms in contact, that of the body further from the world is meant.
    """
    if names is not None:
        return [model.index("geom", name) for name in names]
    rest, found = at.after(model, REST), dict[int, None]()
    if rest is not None:
        sim = Sim(model)
        rest.put(sim)
        sim.ctrl = at.ctrl
        sim.forward()
        for contact in sim.contacts:
            both = int(contact["geom1"]), int(contact["geom2"])
            bodies = [int(model.geom_body[geom]) for geom in both]
            if contact["force"][2] > 0:
                found[both[int(bodies[1] >= bodies[0])]] = None
    return list(found)


def tuned_contact(model: Model, at: At, geom: int, goal: Goal) -> Tuned:
    """Return solref and solimp for a geom, verified by a run."""
    touching, none = Touching(model, at, geom), Tuned("geom", model.called("geom")[geom], goal)
    rest = touching.rested({})
    if rest is None:
        none.why = "It does not rest on anything at the end of the run"
        return none
    return (_quiet if goal.name == "noise" else _reached)(touching, rest, none)


def _reached(touching: Touching, rest: Resting, none: Tuned) -> Tuned:
    """Reach a stiffness, a depth or a settling time."""
    goal, least, inverses = none.goal, touching.least, touching.inverses(rest.sim)

    def law(tc: float, d: float) -> float:
        """Return the goal by the closed form; a depth falls with the stiffness."""
        if goal.name == "settling":
            return SETTLES * tc
        stiffness = inverses / ((1 - d) * tc**2)
        return rest.force / stiffness if goal.name == "depth" else stiffness

    target, measured, d = goal.value, math.nan, USUAL
    for _ in range(ROUNDS):
        tc = target / SETTLES
        if goal.name != "settling":
            stiffness = rest.force / target if goal.name == "depth" else target
            tc = math.sqrt(inverses / ((1 - USUAL) * stiffness))
        tc = rounded(max(tc, least))
        if goal.name != "settling":
            d = min(1 - inverses / (stiffness * tc**2), HARDEST)
        seen = touching.rested(touching.values(tc, d))
        if seen is None:
            measured = math.nan
            break
        measured = touching.settling(seen, tc) if goal.name == "settling" else seen.of(goal)
        if not measured > 0 or goal.near(measured, WITHIN / 4):
            break
        target *= min(4.0, max(0.25, goal.value / measured))
    why = "The run does not come to rest with these values"
    if math.isfinite(measured):
        why = f"{goal.words(measured)} in the run, whose contacts change with the softness"
        if tc <= least and (d >= HARDEST or goal.name == "settling"):
            step, word = (
                seconds(touching.model.settings.dt),
                "most" if goal.name == "stiffness" else "least",
            )
            limit = goal.words(law(least, HARDEST))
            why = f"{goal.words(measured)} in the run; {step} allows {limit} at the {word}"
    return replace(
        _proposed(touching, none, tc, d, measured),
        expected=law(tc, d),
        reached=goal.near(measured),
        why=why,
    )


def _quiet(touching: Touching, rest: Resting, none: Tuned) -> Tuned:
    """Soften a contact until its force is quiet enough."""
    goal, tc, noise = none.goal, touching.least, rest.noise
    if noise <= goal.value:
        return replace(none, measured=noise, reached=True, also=", as it is")
    for _ in range(SOFTEST):
        tc = rounded(tc * SOFTER)
        seen = touching.rested(touching.values(tc, USUAL))
        noise = math.nan if seen is None else seen.noise
        if noise <= goal.value:
            break
    return replace(
        _proposed(touching, none, tc, USUAL, noise),
        reached=noise <= goal.value,
        why=f"At solref {tc:g} s the noise is still {goal.words(noise)} RMS",
        also=f" ({goal.words(rest.noise)} before)",
    )


def _proposed(touching: Touching, none: Tuned, tc: float, d: float, measured: float) -> Tuned:
    values = touching.values(tc, d)
    lines = tuple(pasted(touching.model, values))
    return replace(none, change=Change(values), lines=lines, measured=measured)
