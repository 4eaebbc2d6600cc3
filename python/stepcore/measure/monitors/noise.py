"""Noise of contact forces and of force sensors in a run: what changes from reading to reading.

The noise of a series f is the RMS of f_k − (f_{k−1} + f_{k+1})/2, times √(2/3). For white noise
this is its RMS; of a motion that is resolved by the readings, the second difference is small.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Collection, Iterator

import numpy as np

from stepcore.engine.model import Model
from stepcore.experiment.change import Change
from stepcore.measure.monitors.finding import (
    FEW,
    PARTS,
    Cure,
    Finding,
    Remedy,
    assigned,
    listed,
    named,
    shorter,
    worst,
)
from stepcore.measure.monitors.recording import STEADY, Recording
from stepcore.report.units import newtons, percent

# Readings further apart than this do not tell noise from motion [s].
APART = 0.01
# Surfaces that move slower than this on each other stand still [m/s]: those of particle_free.xml,
# and not the feet of walker2d.
STILL = 0.01
# Sensors whose noise is watched.
SENSORS = ("force", "torque", "touch")
# Noise and mean of a force, by pair or sensor.
Noises = dict[int, tuple[float, float]]


def noise_findings(run: Recording) -> Iterator[Finding]:
    """Yield the noisiest contacts, and the noisiest sensors."""
    if run.late < 0 or run.spacing > APART:
        return
    for kind, noises in (("contact", of_contacts), ("sensor", of_sensors)):
        yield from _noisy(run, kind, noises)


def _noisy(run: Recording, kind: str, noises: Callable[[Recording], Noises]) -> Iterator[Finding]:
    model, every = run.model, noises(run)
    # Force control of a few per cent is usual.
    keys = worst(every, lambda k: every[k][0] / (FEW * every[k][1]) if every[k][1] else 0.0)
    if not keys:
        return
    key, (rms, mean), elements = keys[0], every[keys[0]], named(model, kind, keys)
    torque = kind == "sensor" and model.sensor_type[key] == "torque"
    unit = "N·m" if torque else "N"
    does = (
        f"pushes with {newtons(mean)} and" if kind == "contact" else f"reads {mean:.3g} {unit} with"
    )
    problem = (
        f"{listed(elements, kind)} {does} a noise of {rms:.3g} {unit} RMS ({percent(rms / mean)})"
    )
    pairs = keys if kind == "contact" else sorted(set(run.contacts.pair))

    def left(other: Recording) -> float | None:
        found = noises(other).get(key)
        return None if found is None else found[0]

    # What no knob lowers is the motion.
    say = f"{{:.3g}} {unit}".format
    remedy = Remedy(tuple(_knobs(model, pairs)), left, FEW * mean, say, needed=True)
    yield Finding("force noise", "remark", problem, "", elements, rms, unit, remedy=remedy)


def of_contacts(run: Recording) -> Noises:
    """Return noise and mean of the normal force of each pair that stands still [N]."""
    seen, first, noises = run.contacts, run.late, Noises()
    late = np.flatnonzero(seen.reading >= first)
    moves = np.linalg.norm(seen.past[late], axis=1) + seen.rolls[late]
    for pair in np.unique(seen.pair[late]).tolist():
        mine = seen.pair[late] == pair
        places = late[mine]
        force = np.bincount(seen.reading[places] - first, seen.force[places], len(run) - first)
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


def _knobs(model: Model, pairs: Collection[int]) -> Iterator[tuple[Cure, ...]]:
    """Yield the changes that may lower the noise of some pairs."""
    settings, contacts = model.settings, named(model, "contact", pairs)
    solrefs = [model.contact_pair(pair).solref for pair in pairs]
    if settings.law == "solref" and solrefs:
        base = max(2 * settings.dt, *(ref[0] for ref in solrefs))
        yield tuple(
            Cure(
                f'solref="{constant:g} 1" on the geoms that touch',
                Change(assigned(model, contacts, {"solref": (constant, 1.0)})),
            )
            for constant in (float(f"{base * part:.3g}") for part in PARTS[1:])
        )
    if settings.cone == "pyramidal":
        yield (Cure('cone="elliptic"', Change(cone="elliptic")),)
    yield shorter(settings.dt / part for part in PARTS[1:])


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
