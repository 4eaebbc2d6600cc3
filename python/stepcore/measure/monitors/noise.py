"""Noise of contact forces and of force sensors in a run: what changes from reading to reading.

The noise of a series f is the RMS of f_k − (f_{k−1} + f_{k+1})/2, times √(2/3). For white noise
this is its RMS; of a motion that is resolved by the readings, the second difference is small.
"""

from __future__ import annotations

import functools
import math
from collections.abc import Callable, Collection, Iterator

import numpy as np

from stepcore.engine.model import Model
from stepcore.experiment.change import Change
from stepcore.measure.monitors.cures import assigned
from stepcore.measure.monitors.finding import Cure, Finding, Remedy, listed, named
from stepcore.measure.monitors.recording import STEADY, Recording
from stepcore.report.units import newtons, percent, seconds

# Least noise that is told, relative to the mean force: force control of a few per cent is usual.
NOISY = 0.05
# Readings further apart than this do not tell noise from motion [s].
APART = 0.01
# Surfaces that move slower than this on each other stand still [m/s].
STILL = 0.01
# Sensors whose noise is watched.
SENSORS = ("force", "torque", "touch")
# Factors of the time constant, and parts of the time step, that are tried.
FACTORS = (2, 4)


def noise_findings(run: Recording) -> Iterator[Finding]:
    """Yield the noisiest contacts, and the noisiest sensors."""
    if run.late < 0 or run.spacing > APART:
        return
    model = run.model
    for kind, noises in (("contact", of_contacts), ("sensor", of_sensors)):
        found = noises(run).items()
        loud = sorted((both[0], k) for k, both in found if both[0] > NOISY * both[1] > 0)
        if not loud:
            continue
        keys = [k for _, k in reversed(loud)]
        (rms, mean), elements = noises(run)[keys[0]], named(model, kind, keys)
        torque = kind == "sensor" and model.sensor_type[keys[0]] == "torque"
        unit = "N·m" if torque else "N"
        words = f"{listed(elements, f'{kind}s')} reads {mean:.3g} {unit} with a noise of"
        if kind == "contact":
            words = f"{listed(elements, 'contacts')} pushes with {newtons(mean)} and a noise of"
        problem = f"{words} {rms:.3g} {unit} RMS ({percent(rms / mean)})"
        remedy = Remedy(
            tuple(_knobs(model, keys if kind == "contact" else sorted(set(run.contacts.pair)))),
            functools.partial(_left, noises, keys[0]),
            NOISY * mean,
            _said(unit),
            # What no knob lowers is the motion.
            needed=True,
        )
        yield Finding("force noise", "remark", problem, "", elements, rms, unit, remedy=remedy)


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


def _said(unit: str) -> Callable[[float], str]:
    return lambda value: f"{value:.3g} {unit}"


def _knobs(model: Model, pairs: Collection[int]) -> Iterator[tuple[Cure, ...]]:
    """Yield the changes that may lower the noise of some pairs."""
    settings = model.settings
    contacts = named(model, "contact", pairs)
    solrefs = [model.contact_pair(pair).solref for pair in pairs]
    constants = [max(ref[0], 2 * settings.dt) for ref in solrefs if ref[0] > 0]
    if settings.law == "solref" and solrefs:
        base = max(constants, default=2 * settings.dt)
        softer = (float(f"{base * factor:.3g}") for factor in FACTORS)
        yield tuple(
            Cure(
                f'solref="{constant:g} 1" on the geoms that touch',
                Change(assigned(model, contacts, {"solref": (constant, 1.0)})),
            )
            for constant in softer
        )
    if settings.cone == "pyramidal":
        yield (Cure('cone="elliptic"', Change(cone="elliptic")),)
    dts = [settings.dt / part for part in FACTORS]
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
    return apart < STEADY * float(np.linalg.norm(means[0] + means[1])) / 2
