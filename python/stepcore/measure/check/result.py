"""`Check`: what `check` returns, its findings in sentences, a table and data."""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass, field
from typing import Any, ClassVar

from stepcore._core import Settings
from stepcore.experiment.motion import Motion
from stepcore.measure.diagnosis import Diagnosis
from stepcore.measure.findings import Finding
from stepcore.report.result import Result
from stepcore.report.settings import label
from stepcore.report.table import Table
from stepcore.report.units import counted


@dataclass(eq=False, repr=False)
class Check(Result):
    """What is wrong with a scene, or may be; `stepcore.check` returns it.

    name: the name of the scene.
    settings: its own settings, under which it ran.
    motion: the motion that was run.
    findings: what was found, the most severe first.
    diagnosis: the `Diagnosis` of the time step; None where it failed, and a note says why.
    commands: what to run next, and why.
    ran: what motion was run, in words.
    """

    kind = "check"
    units: ClassVar = {"value": "unit"}

    name: str
    settings: Settings
    motion: Motion
    findings: list[Finding]
    diagnosis: Diagnosis | None
    commands: list[tuple[str, str]]
    ran: str = ""
    notes: list[str] = field(default_factory=list)

    @property
    def title(self) -> str:
        """What was checked."""
        return f"{self.name}: check"

    @property
    def setup(self) -> str:
        """Under which settings, and on what motion the time step was judged."""
        said = f"Under {label(self.settings)}."
        if self.diagnosis is not None and self.diagnosis.ran not in ("", self.ran):
            said += f"\nThe time step was judged on another motion: {self.diagnosis.ran}."
        return said

    @property
    def rows(self) -> list[Finding]:
        """The findings."""
        return self.findings

    @property
    def sentences(self) -> list[str]:
        """What was found with its cures, the diagnosis' answer, and the commands to run next."""
        return list(self._said())

    def _said(self) -> Iterator[str]:
        if self.findings:
            several = ", the most severe first" if len(self.findings) > 1 else ""
            yield f"Found {counted(len(self.findings), 'thing')}{several}:"
            yield from (f"- {finding.severity}: {finding.text}" for finding in self.findings)
        else:
            explodes = self.diagnosis and self.diagnosis.limit() < self.settings.dt
            yield "Nothing found but the time step." if explodes else "Nothing found."
        if self.diagnosis is not None:
            said = self.diagnosis.sentences
            if math.isinf(self.diagnosis.limit()) or self.diagnosis.rate is None:
                said = said[:1]
            yield from said
        yield "Next:"
        yield from (f"- {command} ({why})" for command, why in self.commands)

    @property
    def table(self) -> Table:
        """The findings; see `Finding`."""
        columns = ["severity", "kind", "element", "value", "unit", "text"]
        return Table(map(vars, self.findings), columns)

    def tables(self, full: bool) -> list[Table]:
        """The numbers that the findings are judged by."""
        if not self.findings:
            return []
        columns = ["severity", "kind", "element", "value", "unit"]
        return [Table(map(vars, self.findings), columns, heading="By element and value")]

    def details(self) -> dict[str, Any]:
        """The commands, and the diagnosis as data."""
        found = None if self.diagnosis is None else self.diagnosis.to_dict()
        return {"next": [command for command, _ in self.commands], "diagnosis": found}

    def __repr__(self) -> str:
        return f"<Check of {self.name}: {counted(len(self.findings), 'finding')}>"
