"""The instants of a run for drawing: poses, contacts, energy and the residual."""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from stepcore.scene import frames
from stepcore.viewing.drawing import Drawing, drawing_of

if TYPE_CHECKING:
    from stepcore.engine.snapshots import Snapshots


@dataclass(frozen=True)
class Instant:
    """One instant.

    time: [s]. xpos, xquat: of the bodies, shapes (nbody, 3) and (nbody, 4). tendons: the paths of
    spatial tendons, each of shape (points, 3) [m]. places, forces: of the contacts that carry load,
    in world axes [m] and [N], shape (n, 3). energy: kinetic and potential [J]. residual: of the
    solve [m/s]. error: the largest estimated error of a body [m]; NaN if not measured.
    """

    time: float
    xpos: NDArray[Any]
    xquat: NDArray[Any]
    tendons: list[NDArray[Any]]
    places: NDArray[Any] = field(default_factory=lambda: np.empty((0, 3)))
    forces: NDArray[Any] = field(default_factory=lambda: np.empty((0, 3)))
    energy: tuple[float, float] = (np.nan, np.nan)
    residual: float = np.nan
    error: float = np.nan

    @property
    def strongest(self) -> float:
        """The largest contact force [N]."""
        return float(np.linalg.norm(self.forces, axis=1).max(initial=0.0))

    def placed(self, body: int, points: Any) -> NDArray[Any]:
        """Return points of a body's frame in world coordinates [m], shape (n, 3)."""
        turn = np.array(frames.matrix(self.xquat[body].tolist()))
        places: NDArray[Any] = np.reshape(points, (-1, 3)) @ turn.T + self.xpos[body]
        return places


@dataclass(frozen=True)
class Replayed:
    """A run for drawing: its shapes, and its instants in order of time."""

    drawing: Drawing
    instants: list[Instant]
    label: str = ""

    @property
    def time(self) -> NDArray[np.float64]:
        """Time of each instant [s]."""
        return np.array([instant.time for instant in self.instants])

    @property
    def xpos(self) -> NDArray[Any]:
        """Positions of the bodies [m], shape (instants, nbody, 3)."""
        return np.array([instant.xpos for instant in self.instants])

    @property
    def strongest(self) -> float:
        """The largest contact force of the run [N]."""
        return max(instant.strongest for instant in self.instants)


def instant_of(sim: Any) -> Instant:
    """Return the present instant of a Sim; this solves its forces."""
    sim.forward()
    contacts = sim.contacts
    bearing = np.linalg.norm(contacts["force"], axis=1) > 0
    return replace(
        poses_of(sim),
        places=np.array(contacts["pos"][bearing]),
        forces=np.array(contacts["force"][bearing]),
        energy=(float(sim.energy.kinetic), float(sim.energy.potential)),
        residual=float(sim.residual),
        error=np.nan if getattr(sim, "_finer", None) is None else sim.error.largest,
    )


def poses_of(sim: Any) -> Instant:
    """Return poses and tendons of a Sim without solving forces."""
    tendons = [way for path in sim.tendon_paths() for way in path]
    return Instant(sim.time, np.array(sim.xpos), np.array(sim.xquat), tendons)


def replayed(snapshots: Snapshots, label: str = "") -> Replayed:
    """Return a run for drawing; its forces are solved again."""
    sim = snapshots.sim()
    sim.restore(snapshots.states[0])
    drawing, instants = drawing_of(snapshots.model, sim), []
    for state in snapshots.states:
        sim.restore(state)
        instants.append(instant_of(sim))
    return Replayed(drawing, instants, label)


def rms_distance(run: Replayed, other: Replayed) -> NDArray[np.float64]:
    """Return the RMS distance of the moving bodies of two runs, at the instants of the first [m].

    The distance is NaN before the other run begins and after it ends.

    Raises ValueError if the two runs have different bodies.
    """
    if run.drawing.bodies != other.drawing.bodies:
        counts = f"{len(run.drawing.bodies)} and {len(other.drawing.bodies)}"
        raise ValueError(f"runs to compare must be of the same bodies; these have {counts}")
    moving, time = run.drawing.moving, other.time
    if not moving.any():
        return np.zeros(len(run.instants))
    # Bodies move along straight lines between two instants.
    there = other.xpos[:, moving].reshape(len(time), -1)
    between = np.stack([np.interp(run.time, time, entry) for entry in there.T], axis=1)
    gap = run.xpos[:, moving] - between.reshape(len(run.time), -1, 3)
    apart = np.sqrt(np.mean(np.sum(gap**2, axis=-1), axis=-1))
    # The last instants of two runs of one duration may be a part of an interval apart.
    slack = max(np.max(np.diff(each), initial=0.0) for each in (run.time, time)) / 2
    there_too = (run.time >= time[0] - slack) & (run.time <= time[-1] + slack)
    return np.where(there_too, apart, np.nan)
