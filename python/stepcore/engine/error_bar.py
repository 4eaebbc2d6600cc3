"""The error of a run, estimated by a second, finer run."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np

from stepcore._core import Settings, SimulationError
from stepcore.engine.arrays import INPUTS, STATE, Floats, refuse_late
from stepcore.engine.control import ControlError, evaluate_control, new_control
from stepcore.engine.norm import Matter, Tracks, distances, largest, rms
from stepcore.engine.run_settings import converged_settings
from stepcore.scene.layout import Layout

if TYPE_CHECKING:
    from stepcore.engine.model import Model
    from stepcore.engine.sim import Sim

# The finer run: a fraction of the accuracy, or of the time step. In a first-order method its error
# is this fraction of the run's error and the distance is the rest; in a higher-order method the
# distance is nearly the whole error.
ACCURACY, DT_RATIO = 1 / 10, 4


class ErrorBar(NamedTuple):
    """The estimated error of a run in position [m], inf if it is unknown.

    rms: over the moving bodies, in the norm of `stepcore.engine.norm`. largest: the largest error
    of a body.
    """

    rms: float
    largest: float


class FinerRun:
    """A finer run of the same model from the same state, under the same inputs.

    It starts from the state of the first run, and restarts whenever that state is written.

    until: the time at which the runs diverged [s]; inf while they agree.
    """

    def __init__(self, sim: Sim) -> None:
        if sim.settings.accuracy is None:
            refuse_late("error_bar", sim)
        model: Model = sim.model
        finer = finer_settings(model.settings)
        self.of, self.sim = sim, type(sim)(model, finer)
        self.sim._core.unwatch()
        self.steps = round(model.settings.dt / finer.dt)
        # The smallest ratio of distance to error.
        self.seen = 1 - (1 / DT_RATIO if sim.settings.accuracy is None else ACCURACY)
        # The runs are compared at least every 50 ms.
        self.block = max(1, round(0.05 / model.settings.dt))
        self.matter = Matter.of(model)
        reach = longest(model, self.matter)
        # Runs diverge if a body's distance exceeds a tenth of the scene's lengths, and agree again
        # below a thousandth: diverged runs can meet by chance.
        self.parted, self.together = 0.1 * reach, 0.001 * reach
        self.until = np.inf
        # State of the first run at the last common time, None before; and the inputs of both runs.
        self.state: list[bytes] | None = None
        self.inputs: list[bytes] | None = None
        self.failed = False
        # The present distances of the bodies, once computed; and steps since the last comparison.
        self.far: Floats | None = None
        self.unseen = 0
        # The distances at the ends of the last two blocks, and steps since then.
        self.before: list[Floats] = []
        self.since = 0
        # The last result of the finer run's copy of a control function.
        self.ctrl: Floats | None = None

    def step(self, n: int) -> None:
        """Take n steps of the first run, and advance the finer run by the same time."""
        is_count = isinstance(n, (int, np.integer)) and n > 0
        while is_count and n > self.block:
            self._step(self.block)
            n -= self.block
        self._step(n)

    def _step(self, n: int) -> None:
        self.meet()
        try:
            self.of._call(self.of._core.step, n)
        except (SimulationError, KeyboardInterrupt):
            self._fail()
            raise
        try:
            if not self.failed:
                self.sim.step(n * self.steps)
        except (SimulationError, KeyboardInterrupt) as error:
            self._fail()
            if isinstance(error, KeyboardInterrupt):
                raise
        self._keep()
        self.unseen += n
        if self.unseen >= self.block:
            self._look()

    def _fail(self) -> None:
        """Stop the finer run, which is no longer at the time of the first run."""
        self.failed, self.until = True, min(self.until, self.of.time)
        self._keep()

    def _look(self) -> None:
        """Check whether the runs have diverged, or agree again."""
        if self.unseen and not self.failed:
            distances = self._distances()
            far = float(distances.max(initial=0.0))
            self.since += self.unseen
            if self.since >= self.block:
                self.before, self.since = [*self.before[-1:], distances], 0
            if self.until < np.inf:
                self.until = np.inf if far <= self.together else self.until
            elif not far <= self.parted:
                self.until = self.of.time
        self.unseen = 0

    def judged(self) -> FinerRun:
        """Compare the runs, and return this run."""
        self.meet()
        self._look()
        return self

    def meet(self) -> None:
        """Copy the inputs of the first run, and also its state unless that comes from a step."""
        first, finer = self.of._arrays, self.sim._arrays
        if self.state != self._bits(STATE):
            for name in STATE:
                finer[name][...] = first[name]
            self.sim._restart(self.of.time)
            self.until, self.failed, self.unseen = np.inf, False, 0
            self.before, self.since = [], 0
            self._keep()
        inputs = self._bits(INPUTS)
        if inputs != self.inputs or self.ctrl is not None:
            self.inputs = inputs
            for name in INPUTS:
                finer[name][...] = first[name]
        if self.ctrl is not None:
            self.inputs = None
            finer["ctrl"][...] = self.ctrl

    def _keep(self) -> None:
        self.far, self.state = None, self._bits(STATE)

    def _bits(self, names: Sequence[str]) -> list[bytes]:
        return [self.of._arrays[name].tobytes() for name in names]

    def errors(self) -> Floats:
        """Return the error of each body [m], (nbody,); inf if it is unknown.

        It is at least half of its value within the last tenth of a second: two runs that land are
        close to each other for a moment, although their errors are not smaller.
        """
        errors = np.zeros(self.of.model.nbody)
        separating = not np.isfinite(self.until)
        far = np.max([self._distances(), *(0.5 * far for far in self.before)], axis=0)
        errors[self.matter.moving] = far / self.seen if separating else np.inf
        return errors

    @property
    def error(self) -> ErrorBar:
        """The error of all moving bodies."""
        far = self.errors()[None, None, self.matter.moving]
        if not far.size:
            return ErrorBar(0.0, 0.0)
        return ErrorBar(float(rms(far)[0]), float(largest(far)[0]))

    def _distances(self) -> Floats:
        """Return the distance of each moving body from its pose in the finer run [m]."""
        if self.far is None:
            self.far = distances(self._poses(self.of), self._poses(self.sim), self.matter)[0, 0]
        return self.far

    def _poses(self, sim: Sim) -> Tracks:
        moving, ipos = self.matter.moving, self.matter.ipos[:, :, None]
        com = sim.xpos[moving] + (sim.xmat[moving] @ ipos)[..., 0]
        return Tracks(com[None, None], sim.xquat[moving][None, None])

    def kept(self) -> tuple[bytes, float, bool, list[Floats], int]:
        """Return the state from which a copy continues."""
        self.judged()
        return self.sim.state(), self.until, self.failed, self.before, self.since

    def go_on(
        self, state: bytes, until: float, failed: bool, before: list[Floats], since: int
    ) -> None:
        """Continue from a result of `kept`."""
        self.sim.restore(state)
        self.until, self.failed, self.before, self.since = until, failed, before, since
        self._keep()


def recorded_names(sim: Any, names: Sequence[str]) -> tuple[str, ...]:
    """Return the names of quantities to record, including the error if it is measured."""
    errors = () if getattr(sim, "_finer", None) is None else ("error", "body_error")
    return tuple(dict.fromkeys((*names, *errors)))


@contextmanager
def driven_finer(sim: Any, control: Any) -> Iterator[Callable[[], None]]:
    """Control the finer run of a Sim, if there is one, by another copy of a control function.

    The yielded function has to be called at the beginning of each period, before the controls of
    the first run are set. Raises ControlError if the control function is not repeatable: the
    distance of the two runs would not be the error.
    """
    finer: FinerRun | None = getattr(sim, "_finer", None)
    if finer is None or not callable(control):
        yield lambda: None
        return
    finer.meet()
    # Both calls read the finer run: the first run's readouts may differ at the same state.
    first, second = (np.array(evaluate_control(new_control(control), finer.sim)) for _ in range(2))
    if not np.array_equal(first, second):
        raise ControlError.not_repeatable(control, "a finer run asked for the error bar")
    controller = new_control(control)

    def period() -> None:
        finer.ctrl = None
        finer.meet()
        finer.ctrl = np.array(evaluate_control(controller, finer.sim))

    try:
        yield period
    finally:
        finer.ctrl = None


def finer_settings(settings: Settings) -> Settings:
    """Return the settings of the finer run, in double precision."""
    if (accuracy := settings.accuracy) is not None:
        try:
            return settings.replace(accuracy=accuracy * ACCURACY, precision="f64")
        except ValueError:
            limit = "ten times the least one, for the finer run of an error bar"
            raise ValueError(f"accuracy = {accuracy:g}: must be at least {limit}") from None
    return converged_settings(settings, dt=settings.dt / DT_RATIO, sleep=False, ledger=False)


def longest(model: Model, matter: Matter) -> float:
    """Return the longest path from a parent's frame via a moving body's frame to its mass [m]."""
    bodies = Layout(model.scene).bodies
    arms = [np.linalg.norm(bodies[index].pos) for index in matter.moving]
    ways = np.array(arms) + np.linalg.norm(matter.ipos, axis=1) + matter.gyration
    return float(ways.max(initial=0.0)) or 1.0
