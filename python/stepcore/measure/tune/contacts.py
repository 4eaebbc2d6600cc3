"""solref and solimp for a wanted depth or settling time of contacts.

At rest a row of MuJoCo's contacts has the force f = K d r / R, where r is the depth,
R = T (1 − d)/d with the inverse inertia T of the row, and K = 1/(d tc)² under solref="tc 1" and
solimp="d d width". So the rows of a geom have the stiffness Σ f/r = S / ((1 − d) tc²) with
S = Σ 1/T. The depth settles like a critically damped oscillator of frequency 1/tc, and tc is at
least 2 dt (refsafe).
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace
from typing import Any, NamedTuple

import numpy as np

from stepcore.engine.model import Model
from stepcore.engine.sim import Sim, unwatched
from stepcore.engine.start import Start
from stepcore.experiment.change import Change
from stepcore.measure.tune.goal import (
    SETTLED,
    SETTLES,
    At,
    Goal,
    Tuned,
    pasted,
    settling,
    steps_of,
)
from stepcore.report.units import rounded, seconds

# The impedance of the proposals, and the largest that the engine accepts.
USUAL, HARDEST = 0.95, 0.9999
# The time in which bodies come to rest [s]; in its last quarter, forces and depths are averaged.
REST = 2.0


class Resting(NamedTuple):
    """A geom's contacts at rest, as measured in a run.

    depth: mean depth [m]. force: total normal force [N]. state: at the end of the run.
    """

    depth: float
    force: float
    state: Start


@dataclass(frozen=True)
class Touching:
    """A geom's contacts in runs of a model from one state, under other parameters."""

    model: Model
    at: At
    geom: int

    @property
    def least(self) -> float:
        """The least tc that the time step allows [s]."""
        return self.model.settings.dt * (2 if self.model.settings.refsafe else 1)

    def values(self, tc: float, d: float) -> dict[str, Any]:
        """Return parameters as values by path. The geom with the highest priority sets them."""
        path, d = f"geom/#{self.geom}", rounded(d, 6)
        priority = 1 + max(geom.priority for geom in self.model.scene.geoms)
        solimp = (d, d, 0.001)
        return {f"{path}/solref": (tc, 1.0), f"{path}/solimp": solimp, f"{path}/priority": priority}

    def rested(self, values: dict[str, Any]) -> Resting | None:
        """Measure the contacts at rest. Return None if they carry no load, or the run fails."""
        model = Change(values).of(self.model)
        weight = 9.81 * float(model.body_mass.sum())
        # Soft contacts take longer to settle.
        for longer in (1, 2, 4, 8):
            steps = math.ceil(longer * REST / model.settings.dt)
            states = self.at.states(model, steps)
            if states is None:
                return None
            last = max(10, steps // 4)
            force, depths = self.seen(model, states[-last:])
            # A geom may touch without resting: if joints carry it, the contact has no force.
            if force.mean() <= 1e-6 * weight or depths.mean() <= 0:
                return None
            found = Resting(float(depths.mean()), float(force.mean()), states[-1])
            before = self.seen(model, states[-2 * last : -last])[1].mean()
            if abs(before - depths.mean()) <= SETTLED * depths.mean():
                break
        return found

    def seen(self, model: Model, states: Iterable[Start]) -> tuple[np.ndarray, np.ndarray]:
        """Return the normal force and the mean depth of the contacts in each state."""
        sim, looks = unwatched(Sim(model)), []
        for state in states:
            own = self.own(self.at.contacts(sim, state))
            depth = -float(own["dist"].mean()) if len(own) else 0.0
            looks.append((float(own["force"][:, 2].sum()), depth))
        force, depths = np.array(looks).T
        return force, depths

    def own(self, contacts: np.ndarray) -> np.ndarray:
        """Return the contacts of the geom among some contacts."""
        found: np.ndarray = contacts[
            (contacts["geom1"] == self.geom) | (contacts["geom2"] == self.geom)
        ]
        return found

    def settling(self, rest: Resting, values: dict[str, Any]) -> float:
        """Return the settling time of the depth after 10 % more force [s]; nan if none is found."""
        model = Change(values).of(self.model)
        own = self.own(self.at.contacts(Sim(model), rest.state))
        if not len(own):
            return math.nan
        side = -0.1 if own["geom2"][0] == self.geom else 0.1
        push, body = side * rest.force * np.array(own["normal"])[0], model.geom_body[self.geom]

        def pushed(time: float, sim: Sim) -> np.ndarray:
            sim.xfrc_applied[int(body), :3] = push
            return self.at.ctrl

        steps = steps_of(model, 1 / values[f"geom/#{self.geom}/solref"][0])
        states = self.at._replace(start=rest.state).states(model, steps, control=pushed, hold=steps)
        if states is None:
            return math.nan
        return settling(self.seen(model, states)[1], model.settings.dt)


def resting_geoms(model: Model, at: At, names: Sequence[str] | None) -> list[int]:
    """Return the geoms that rest on something at the end of a run, or the named ones.

    If two geoms touch, the geom whose body is further from the world is returned.
    """
    if names is not None:
        return [model.index("geom", name) for name in names]
    states, found = at.states(model, math.ceil(REST / model.settings.dt)), dict[int, None]()
    if states is not None:
        for contact in at.contacts(Sim(model), states[-1]):
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
        return replace(none, why="It does not rest on anything at the end of the run")
    return _reached(touching, none)


def _reached(touching: Touching, none: Tuned) -> Tuned:
    """Find solref and solimp for a depth or a settling time."""
    goal, least = none.goal, touching.least
    # A run with MuJoCo's default tc gives the number of contacts and their inertia.
    usual = max(0.02, least)
    rest = touching.rested(touching.values(usual, USUAL))
    if rest is None:
        return replace(none, why=f"The run does not come to rest with a solref of {usual:g} s")
    inverses = rest.force / rest.depth * (1 - USUAL) * usual**2

    def law(tc: float, d: float) -> float:
        """Return the value by the closed form."""
        return SETTLES * tc if goal.name == "settling" else rest.force * (1 - d) * tc**2 / inverses

    def proposal(asked: float) -> tuple[float, float]:
        """Return tc and d for a requested value by the closed form."""
        if goal.name == "settling":
            return rounded(max(asked / SETTLES, least)), USUAL
        stiffness = rest.force / asked
        tc = rounded(max(math.sqrt(inverses / ((1 - USUAL) * stiffness)), least))
        return tc, min(1 - inverses / (stiffness * tc**2), HARDEST)

    def run(asked: np.ndarray) -> np.ndarray:
        values = touching.values(*proposal(asked[0]))
        seen = touching.rested(values)
        if seen is None:
            return np.array([math.nan])
        settles = goal.name == "settling"
        return np.array([touching.settling(seen, values) if settles else seen.depth])

    (asked,), (measured,) = goal.corrected(1, run)
    tc, d = proposal(asked)
    why = "The run does not come to rest with these values"
    if math.isfinite(measured):
        why = f"{goal.words(measured)} in the run, whose contacts change with the softness"
        if tc <= least and (d >= HARDEST or goal.name == "settling"):
            step = seconds(touching.model.settings.dt)
            limit = goal.words(law(least, HARDEST))
            why = f"{goal.words(measured)} in the run; {step} allows {limit} at the least"
    found = _proposed(touching, none, tc, d, float(measured))
    return replace(found, expected=law(tc, d), reached=bool(goal.near(measured)), why=why)


def _proposed(touching: Touching, none: Tuned, tc: float, d: float, measured: float) -> Tuned:
    values = touching.values(tc, d)
    lines = pasted(touching.model, values)
    return replace(none, change=Change(values), lines=lines, measured=measured)
