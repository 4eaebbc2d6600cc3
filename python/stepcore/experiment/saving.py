"""What runs that were made as batches have saved, measured beside runs that were made alone."""

from __future__ import annotations

import threading
from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import Any, NamedTuple

from stepcore.experiment.path import Path

# So much must be gained for the next batch to be made.
WORTH = 1.05


class Timed(NamedTuple):
    """Runs, and the computing time that they took [s]."""

    paths: list[Path]
    spent: float


@dataclass
class Saving:
    """What batches have saved so far.

    runs, batches: how many were made. alone: the computing time that the runs would have taken
    singly, by that of one run of each setting [s]; spent: what their batches took [s].
    """

    runs: int = 0
    batches: int = 0
    alone: float = 0.0
    spent: float = 0.0
    _lock: threading.Lock = field(default_factory=threading.Lock, repr=False, compare=False)

    @property
    def worth(self) -> bool:
        """Whether further batches are worth making."""
        return not self.batches or self.alone > WORTH * self.spent

    def compare(self, alone: Timed, batches: Sequence[Timed]) -> None:
        """Counts batches beside one run that was made alone under the same settings.

        Runs that ended early say nothing. Threads may call this at the same time.
        """
        paths = [path for batch in batches for path in batch.paths]
        if any(path.failure for path in (*alone.paths, *paths)):
            return
        with self._lock:
            self.runs, self.batches = self.runs + len(paths), self.batches + len(batches)
            self.alone += alone.spent * len(paths)
            self.spent += sum(batch.spent for batch in batches)

    @property
    def sentences(self) -> list[str]:
        """What was saved, in words; nothing where no batch was made or none saved anything."""
        if not self.batches or self.alone <= self.spent:
            return []
        batches = "one batch" if self.batches == 1 else f"{self.batches} batches"
        quicker = f"{self.alone / self.spent:.2g} times quicker than singly"
        return [f"{self.runs} runs were made as {batches}, {quicker} (computing time of a core)"]

    def __getstate__(self) -> dict[str, Any]:
        return {name: value for name, value in vars(self).items() if name != "_lock"}

    def __setstate__(self, state: dict[str, Any]) -> None:
        vars(self).update(state, _lock=threading.Lock())
