"""Creep of joints and tendons under less than their friction loss.

A row of friction loss has R f = b v at rest, with b = 2/(dmax tc) and R = (1 − d)/d · Â of its
solreffriction and solimpfriction (MuJoCo's documentation, "Constraint model"): below its limit it
is a damper, and moves at v = f R/b under a load f.
"""

from __future__ import annotations

import math
from collections.abc import Collection, Iterator
from dataclasses import dataclass

import numpy as np

from stepcore.engine.element import FRICTION_LOSSES, Element
from stepcore.engine.model import Model
from stepcore.engine.sim import Sim
from stepcore.experiment.sizes import Sizes
from stepcore.measure.monitors.creep import RUBS, UNSTEADY, WINDOW
from stepcore.measure.monitors.cures import assigned
from stepcore.measure.monitors.finding import Cure, Finding, Remedy, listed
from stepcore.measure.monitors.readings import FEWEST
from stepcore.report.units import FORCES, TORQUES, percent, quantity, radians, speed
from stepcore.scene.elements import Joint
from stepcore.scene.layout import Layout

# A row that gives at least this share of its friction slides.
SLIDES = 0.98
# Slowest creep that is told [rad/s]; for slides and tendons, relative to the body's size [1/s].
# People ask about arms that drift at 1.5 mrad/s (MuJoCo's issue 2082), and a tenth of a degree in
# a second is seen within a minute.
CREEPS = 1e-3
# Impedances that are advised, softest first: the creep falls as (1 − d)/d.
IMPEDANCES = ((0.99, 0.999), (0.999, 0.9999), (0.9999, 0.9999))

# The kind and the index of a row's element.
Key = tuple[str, int]


@dataclass(frozen=True)
class Drift:
    """A joint or tendon that creeps.

    speed: the mean velocity [rad/s or m/s]. share: of its friction loss.
    begin, end: the times between which it was seen [s].
    """

    of: Key
    speed: float
    share: float
    begin: float
    end: float


class FrictionLossMonitor:
    """A record of the rows of friction loss of one run."""

    def __init__(self, model: Model, sizes: Sizes) -> None:
        scene, self.model, self.sizes = model.scene, model, sizes
        self.losses = {
            **{("friction loss", k): at.frictionloss for k, at in enumerate(_joints(model))},
            **{("tendon friction loss", k): at.frictionloss for k, at in enumerate(scene.tendons)},
        }
        features = scene.features
        works = features.constraint and features.frictionloss and model.settings.law == "solref"
        self.watches = works and any(self.losses.values())
        # At each reading: the elements, their velocities, and the shares of their friction used.
        self.readings: list[tuple[np.ndarray, np.ndarray, np.ndarray]] = []
        self.driven: list[np.ndarray] = []

    def look(self, sim: Sim, rows: np.ndarray) -> None:
        """Record every row of friction loss."""
        self.driven.append(np.array(sim.ctrl))
        kinds = rows["kind"]
        rows = rows[(kinds == FRICTION_LOSSES[0]) | (kinds == FRICTION_LOSSES[1])]
        share = np.abs(rows["impulse"]) / np.maximum(rows["hi"], 1e-300)
        self.readings.append((rows[["kind", "index"]], rows["velocity"], share))

    def _series(self) -> dict[Key, tuple[np.ndarray, np.ndarray]]:
        """Return velocities and shares of all that was read in every reading with one row."""
        first = self.readings[0][0]
        if any(not np.array_equal(of, first) for of, *_ in self.readings):
            # Sleeping trees have no rows.
            return {}
        keys = [(str(kind), int(index)) for kind, index in first.tolist()]
        velocity, share = (
            np.array(column) for column in list(zip(*self.readings, strict=True))[1:]
        )
        return {
            key: (velocity[:, k], share[:, k]) for k, key in enumerate(keys) if keys.count(key) == 1
        }

    def drifts(self, times: list[float]) -> Iterator[Drift]:
        """Yield what moves steadily under less than its friction loss, at its fastest.

        A joint whose own controls change is meant to move, and one with a servo ends at its target.
        """
        if len(times) < 2 or not self.readings:
            return
        spacing = (times[-1] - times[0]) / (len(times) - 1)
        ctrl = np.array(self.driven)
        changing = np.flatnonzero(np.ptp(ctrl, axis=0) > 0) if ctrl.size else np.array([], int)
        servos = np.flatnonzero(self.model.actuator_bias[:, 1] < 0)
        moved = {int(joint) for joint in self.model.actuator_joint[[*changing, *servos]]}
        for key, (velocity, share) in self._series().items():
            # What a tendon's actuator moves is not told apart.
            if -1 in moved or (key[0] == "friction loss" and key[1] in moved):
                continue
            constant = max(self._solref(key)[0], 0.0)
            count = math.ceil(max(FEWEST, WINDOW * constant / spacing, 0.1 * len(times)))
            best: Drift | None = None
            for first in range(0, len(velocity) - count + 1, max(1, count // 2)):
                window = slice(first, first + count)
                mean = float(velocity[window].mean())
                held = share[window].max() < SLIDES and share[window].mean() > RUBS
                steady = np.abs(velocity[window] - mean).max() <= UNSTEADY * abs(mean)
                if held and steady and (best is None or abs(mean) > best.speed):
                    end = times[first + count - 1]
                    best = Drift(key, abs(mean), float(share[window].mean()), times[first], end)
            if best is not None:
                yield best

    def speed_of(
        self, keys: Collection[Key], times: list[float], begin: float, end: float
    ) -> float | None:
        """Return the fastest mean velocity of some rows within a time; None without readings."""
        within = (np.array(times) >= begin) & (np.array(times) <= end)
        series = self._series()
        if not within.any() or not set(keys) <= set(series):
            return None
        return max(abs(float(series[key][0][within].mean())) for key in keys)

    def findings(self, times: list[float]) -> Iterator[Finding]:
        """Yield a finding on all that creeps; times: of the readings [s]."""
        model = self.model
        notable = sorted(
            (
                (drift.speed / limit, drift)
                for drift in self.drifts(times)
                if drift.speed > (limit := CREEPS * self._scale(drift.of))
            ),
            key=lambda entry: -entry[0],
        )
        if not notable:
            return
        worst, keys = notable[0][1], [drift.of for _, drift in notable]
        elements = tuple(Element.of(model, *key) for key in keys)
        angular = self._angular(worst.of)
        rate = _turning if angular else speed
        loss = quantity(self.losses[worst.of], TORQUES if angular else FORCES)
        constant = float(f"{2 * model.settings.dt:.3g}")
        cures = tuple(
            Cure(
                f'solreffriction="{constant:g} 1" with solimpfriction="{low:g} {high:g}"',
                assigned(
                    model,
                    elements,
                    {
                        "solreffriction": (constant, 1.0),
                        "solimpfriction": (low, high, 0.001, 0.5, 2.0),
                    },
                ),
            )
            for low, high in IMPEDANCES
        )
        remedy = Remedy(
            (cures,),
            lambda m: m.friction_losses.speed_of(keys, m.times[1:], worst.begin, worst.end),
            CREEPS * self._scale(worst.of),
            rate,
            # A motion that harder friction does not end is no creep.
            needed=True,
        )
        moves = elements[0].owner or "tendon"
        problem = (
            f"{listed(elements, 'friction losses')} lets the {moves} creep at {rate(worst.speed)} "
            f"under {percent(worst.share)} of its {loss}"
        )
        unit = "rad/s" if angular else "m/s"
        yield Finding("creep", "warning", problem, "", elements, worst.speed, unit, remedy=remedy)

    def _angular(self, key: Key) -> bool:
        return key[0] == "friction loss" and self.model.jnt_type[key[1]] not in ("slide", "free")

    def _scale(self, key: Key) -> float:
        """Return the unit of a velocity: 1 rad, or the size of the body that slides [m]."""
        if self._angular(key):
            return 1.0
        if key[0] == "friction loss":
            return self.sizes.bodies[int(self.model.jnt_body[key[1]])]
        return max(float(self.model.tendon_length0[key[1]]), 1e-12)

    def _solref(self, key: Key) -> tuple[float, ...]:
        if key[0] == "friction loss":
            return _joints(self.model)[key[1]].solreffriction
        return self.model.scene.tendons[key[1]].solreffriction


def _turning(value: float) -> str:
    """Return an angular speed in words."""
    return f"{radians(value)}/s"


def _joints(model: Model) -> list[Joint]:
    return Layout(model.scene).joints
