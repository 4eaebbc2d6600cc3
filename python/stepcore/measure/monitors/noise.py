"""Noise of contact forces and of force sensors in a run: what changes from reading to reading.

The noise of a series f is the RMS of f_k − (f_{k−1} + f_{k+1})/2, times √(2/3). For white noise
this is its RMS; of a motion that is resolved by the readings, the second difference is small.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Collection, Iterator
from functools import partial

import numpy as np

from stepcore.engine.element import Element
from stepcore.engine.model import Model
from stepcore.experiment.change import Change
from stepcore.measure.monitors.cures import assigned
from stepcore.measure.monitors.finding import Cure, Finding, Remedy, listed, named
from stepcore.measure.monitors.recording import Recording
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


def noise_findings(run: Recording) -> Iterator[Finding]:
    """Yield the noisiest contacts, and the noisiest sensors."""
    if run.late < 0 or run.spacing > APART:
        return
    loud = _loud(of_contacts(run))
    if loud:
        pair, (rms, mean) = loud[0]
        pairs = [entry[0] for entry in loud]
        contacts = named(run.model, "contact", pairs)
        words = f"{listed(contacts, 'contacts')} pushes with {newtons(mean)} and a noise of"
        left = partial(_left, of_contacts, pair)
        yield _finding(run.model, words, contacts, (rms, mean, "N"), pairs, left)
    loud = _loud(of_sensors(run))
    if loud:
        sensor, (rms, mean) = loud[0]
        sensors = named(run.model, "sensor", [entry[0] for entry in loud])
        unit = "N·m" if run.model.sensor_type[sensor] == "torque" else "N"
        words = f"{listed(sensors, 'sensors')} reads {mean:.3g} {unit} with a noise of"
        pairs = sorted({pair for pair, _ in run.contacts.groups})
        left = partial(_left, of_sensors, sensor)
        yield _finding(run.model, words, sensors, (rms, mean, unit), pairs, left)


Noises = dict[int, tuple[float, float]]


def of_contacts(run: Recording) -> Noises:
    """Return noise and mean of the normal force of each pair that stands still [N]."""
    seen, first = run.contacts, run.late
    late = np.flatnonzero(seen.reading >= first)
    moves = np.linalg.norm(seen.past[late], axis=1) + seen.rolls[late]
    noises = {}
    for pair in np.unique(seen.pair[late]).tolist():
        mine = seen.pair[late] == pair
        places = seen.reading[late[mine]] - first
        force = np.bincount(places, seen.force[late[mine]], len(run) - first)
        if force.all() and moves[mine].mean() < STILL and _lasts(force):
            noises[pair] = noise(force)
    return noises


def of_sensors(run: Recording) -> Noises:
    """Return noise and mean size of each force sensor at the end of the run."""
    kinds, ends = run.model.sensor_type, np.cumsum(run.model.sensor_dim)
    sensors = [k for k, kind in enumerate(kinds) if kind in SENSORS]
    if not sensors:
        return {}
    late = np.array([run.at(k).sensordata for k in range(run.late, len(run))])
    series = {k: late[:, ends[k] - run.model.sensor_dim[k] : ends[k]] for k in sensors}
    return {k: noise(values) for k, values in series.items() if _lasts(values)}


def _left(of: Callable[[Recording], Noises], key: int, run: Recording) -> float | None:
    found = of(run).get(key)
    return None if found is None else found[0]


def _finding(
    model: Model,
    words: str,
    elements: tuple[Element, ...],
    size: tuple[float, float, str],
    pairs: Collection[int],
    left: Callable[[Recording], float | None],
) -> Finding:
    """Return the finding; size: the noise, the mean, and their unit."""
    rms, mean, unit = size
    problem = f"{words} {rms:.3g} {unit} RMS ({percent(rms / mean)})"
    # What no knob lowers is the motion.
    ways, enough = tuple(_knobs(model, pairs)), NOISY * mean
    remedy = Remedy(ways, left, enough, lambda value: f"{value:.3g} {unit}", needed=True)
    return Finding("force noise", "remark", problem, "", elements, rms, unit, remedy=remedy)


def _knobs(model: Model, pairs: Collection[int]) -> Iterator[tuple[Cure, ...]]:
    """Yield the changes that may lower the noise of some pairs."""
    settings = model.settings
    contacts = named(model, "contact", pairs)
    solrefs = [model.contact_pair(pair).solref for pair in pairs]
    constants = [max(ref[0], 2 * settings.dt) for ref in solrefs if ref[0] > 0]
    if settings.law == "solref" and solrefs:
        base = max(constants, default=2 * settings.dt)
        softer = (float(f"{base * factor:.3g}") for factor in SOFTER)
        yield tuple(
            Cure(
                f'solref="{constant:g} 1" on the geoms that touch',
                Change(assigned(model, contacts, {"solref": (constant, 1.0)})),
            )
            for constant in softer
        )
    if settings.cone == "pyramidal":
        yield (Cure('cone="elliptic"', Change(cone="elliptic")),)
    dts = [settings.dt / part for part in PARTS]
    yield tuple(Cure(f"a dt of {seconds(dt)}", Change(dt=dt)) for dt in dts)


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
    noises: Noises,
) -> list[tuple[int, tuple[float, float]]]:
    """Return what is noisy, the noisiest first."""
    loud = [(k, both) for k, both in noises.items() if both[0] > NOISY * both[1] > 0]
    return sorted(loud, key=lambda entry: -entry[1][0])
