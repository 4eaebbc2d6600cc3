"""Noise of contact forces and of force sensors in a run: what changes from reading to reading.

The noise of a series f is the RMS of f_k − (f_{k−1} + f_{k+1})/2, times √(2/3). For white noise
this is its RMS; of a motion that is resolved by the readings, the second difference is small.
"""

from __future__ import annotations

import math
from collections.abc import Collection, Iterator
from typing import Any

import numpy as np

from stepcore.engine.element import Element
from stepcore.engine.model import Model
from stepcore.engine.sim import Sim
from stepcore.measure.monitors.contacts import ContactMonitor
from stepcore.measure.monitors.cures import assigned
from stepcore.measure.monitors.finding import Cure, Finding, Remedy, listed, named
from stepcore.measure.monitors.readings import FEWEST, REST
from stepcore.report.units import newtons, percent, seconds

# Least noise that is told, relative to the mean force: force control of a few per cent is usual.
NOISY = 0.05
# Readings further apart than this do not tell noise from motion [s].
APART = 0.01
# Surfaces that move slower than this on each other stand still [m/s]; means of a thing at rest
# agree within this share.
STILL, LASTS = 0.01, 0.2
# Sensors whose noise is watched.
SENSORS = ("force", "torque", "touch")
# Factors of the time constant and parts of the time step that are tried.
SOFTER, PARTS = (2.0, 4.0), (2, 4)


class NoiseMonitor:
    """A record of the force sensors of one run; contact forces are in its `ContactMonitor`."""

    def __init__(self, model: Model, contacts: ContactMonitor) -> None:
        self.model, self.contacts = model, contacts
        ends = np.cumsum(model.sensor_dim)
        self.sensors = {
            k: slice(int(ends[k] - model.sensor_dim[k]), int(ends[k]))
            for k, kind in enumerate(model.sensor_type)
            if kind in SENSORS
        }
        self.data: list[np.ndarray] = []

    def look(self, sim: Sim) -> None:
        """Record the sensors."""
        if self.sensors:
            self.data.append(np.array(sim.sensordata))

    def of_contacts(self) -> dict[int, tuple[float, float]]:
        """Return noise and mean of the normal force of each pair that stands still [N]."""
        looks = self.contacts.looks
        first = looks - max(FEWEST, int(REST * looks))
        forces: dict[int, np.ndarray] = {}
        moves: dict[int, list[float]] = {}
        for (pair, _), seen in self.contacts.seen.items():
            for at in seen:
                if at.look >= first >= 0:
                    forces.setdefault(pair, np.zeros(looks - first))[at.look - first] += at.force
                    moves.setdefault(pair, []).append(float(np.linalg.norm(at.past)) + at.rolls)
        return {
            pair: noise(f)
            for pair, f in forces.items()
            if f.all() and np.mean(moves[pair]) < STILL and _lasts(f)
        }

    def of_sensors(self) -> dict[int, tuple[float, float]]:
        """Return noise and mean size of each force sensor at the end of the run."""
        late = np.array(self.data[-max(FEWEST, int(REST * len(self.data))) :])
        if len(late) < FEWEST:
            return {}
        return {k: noise(late[:, p]) for k, p in self.sensors.items() if _lasts(late[:, p])}

    def findings(self, times: list[float]) -> Iterator[Finding]:
        """Yield the noisiest contacts, and the noisiest sensors.

        times: of the readings [s].
        """
        if len(times) < FEWEST or (times[-1] - times[0]) / (len(times) - 1) > APART:
            return
        loud = _loud(self.of_contacts())
        if loud:
            pair, (rms, mean) = loud[0]
            pairs = [entry[0] for entry in loud]
            contacts = named(self.model, "contact", pairs)
            words = f"{listed(contacts, 'contacts')} pushes with {newtons(mean)} and a noise of"
            yield self._finding(words, contacts, rms, mean, "N", pairs, "of_contacts", pair)
        loud = _loud(self.of_sensors())
        if loud:
            sensor, (rms, mean) = loud[0]
            sensors = named(self.model, "sensor", [entry[0] for entry in loud])
            unit = "N·m" if self.model.sensor_type[sensor] == "torque" else "N"
            words = f"{listed(sensors, 'sensors')} reads {mean:.3g} {unit} with a noise of"
            pairs = sorted({pair for pair, _ in self.contacts.seen})
            yield self._finding(words, sensors, rms, mean, unit, pairs, "of_sensors", sensor)

    def _finding(
        self,
        words: str,
        elements: tuple[Element, ...],
        rms: float,
        mean: float,
        unit: str,
        pairs: Collection[int],
        source: str,
        key: int,
    ) -> Finding:
        def left(monitor: Any) -> float | None:
            found = getattr(monitor.noise, source)().get(key)
            return None if found is None else float(found[0])

        problem = f"{words} {rms:.3g} {unit} RMS ({percent(rms / mean)})"
        remedy = Remedy(
            tuple(self._knobs(pairs)),
            left,
            NOISY * mean,
            lambda value: f"{value:.3g} {unit}",
            # What no knob lowers is the motion.
            needed=True,
        )
        return Finding("force noise", "remark", problem, "", elements, rms, unit, remedy=remedy)

    def _knobs(self, pairs: Collection[int]) -> Iterator[tuple[Cure, ...]]:
        """Yield the changes that may lower the noise of some pairs."""
        model, settings = self.model, self.model.settings
        contacts = named(model, "contact", pairs)
        solrefs = [model.contact_pair(pair).solref for pair in pairs]
        constants = [max(ref[0], 2 * settings.dt) for ref in solrefs if ref[0] > 0]
        if settings.law == "solref" and solrefs:
            base = max(constants, default=2 * settings.dt)
            softer = (float(f"{base * factor:.3g}") for factor in SOFTER)
            yield tuple(
                Cure(
                    f'solref="{constant:g} 1" on the geoms that touch',
                    assigned(model, contacts, {"solref": (constant, 1.0)}),
                )
                for constant in softer
            )
        if settings.cone == "pyramidal":
            yield (Cure('cone="elliptic"', settings={"cone": "elliptic"}),)
        dts = [settings.dt / part for part in PARTS]
        yield tuple(Cure(f"a dt of {seconds(dt)}", settings={"dt": dt}) for dt in dts)


def noise(series: np.ndarray) -> tuple[float, float]:
    """Return the noise of a series of numbers or vectors, and the size of its mean.

    >>> rms, mean = noise(np.array([1.0, 1.2] * 8))
    >>> print(f"{rms:.3f} {mean:.1f}")
    0.163 1.1
    """
    series = series.reshape(len(series), -1)
    with np.errstate(over="ignore", invalid="ignore"):
        second = series[1:-1] - (series[:-2] + series[2:]) / 2
        rms = math.sqrt(2 / 3 * float(np.mean((second**2).sum(axis=1))))
        return rms, float(np.linalg.norm(series.mean(axis=0)))


def _lasts(series: np.ndarray) -> bool:
    """Return whether both halves of a series have one mean, as of a thing at rest."""
    half = len(series) // 2
    means = [np.atleast_1d(part.mean(axis=0)) for part in (series[:half], series[half:])]
    apart = float(np.linalg.norm(means[1] - means[0]))
    return apart < LASTS * float(np.linalg.norm(means[0] + means[1])) / 2


def _loud(
    noises: dict[int, tuple[float, float]],
) -> list[tuple[int, tuple[float, float]]]:
    """Return what is noisy, the noisiest first."""
    loud = [(k, both) for k, both in noises.items() if both[0] > NOISY * both[1] > 0]
    return sorted(loud, key=lambda entry: -entry[1][0])
