"""What a bench prints and keeps: the machine, the versions, the settings, the numbers."""

from __future__ import annotations

import argparse
import datetime
import importlib.metadata
import json
import os
import platform
import re
import subprocess
import sys
from pathlib import Path

RESULTS = Path(__file__).parent / "results"
README = Path(__file__).parents[1] / "README.md"
PACKAGES = (
    "stepcore",
    "numpy",
    "mujoco",
    "gymnasium",
    "rapier3d",
    "pybullet",
    "distributed",
    "envpool",
)


def arguments(description: str) -> argparse.Namespace:
    """The options that every bench has."""
    parser = argparse.ArgumentParser(description=description)
    parser.add_argument("--quick", action="store_true", help="a smoke test: few samples, not kept")
    parser.add_argument("--only", default="", help="only what has this text in its name")
    parser.add_argument("--pairs", type=int, default=0, help="timed pairs (default 15; quick 3)")
    parser.add_argument("--no-save", action="store_true", help="print, but keep nothing")
    chosen = parser.parse_args()
    chosen.pairs = chosen.pairs or (3 if chosen.quick else 15)
    chosen.sample = 0.003 if chosen.quick else 0.03
    chosen.save = not (chosen.quick or chosen.no_save or chosen.only)
    return chosen


def machine() -> dict[str, object]:
    return {
        "cpu": _cpu(),
        "vectors": _vectors(),
        "cores": os.cpu_count(),
        "system": f"{platform.system()} {platform.machine()}",
        "load": os.getloadavg() if hasattr(os, "getloadavg") else None,
    }


def versions() -> dict[str, str]:
    found = {"python": platform.python_version()}
    for name in PACKAGES:
        try:
            found[name] = importlib.metadata.version(name)
        except importlib.metadata.PackageNotFoundError:
            continue
    commit = _output("git", "-C", str(Path(__file__).parent), "describe", "--always", "--dirty")
    if commit:
        found["commit"] = commit
    return found


class Report:
    """Prints line by line, and at the end keeps the lines (.txt) and the data (.json)."""

    def __init__(self, bench: str, options: argparse.Namespace, note: str) -> None:
        self.bench, self.options = bench, options
        self.date = datetime.date.today().isoformat()
        self.data: dict[str, object] = {"bench": bench, "date": self.date, "note": note}
        self.data |= {"machine": machine(), "versions": versions()}
        self.data["options"] = {"pairs": options.pairs, "sample_s": options.sample}
        self.records: list[dict[str, object]] = []
        self.lines: list[str] = []
        for key in ("machine", "versions"):
            pairs = (f"{k} {_short(v)}" for k, v in self.data[key].items())
            self.say(f"{key}: " + ", ".join(pairs))
        if options.pairs:
            samples = f"samples of {options.sample * 1e3:.0f} ms"
            self.say(f"{options.pairs} interleaved pairs a line, {samples}")
        self.say(note)

    def say(self, text: str = "") -> None:
        print(text, flush=True)
        self.lines.append(text)

    def add(self, **record: object) -> None:
        self.records.append(record)

    def close(self) -> None:
        """Keeps everything, unless this was a smoke test or a part."""
        self.data["load_at_end"] = os.getloadavg() if hasattr(os, "getloadavg") else None
        self.data["records"] = self.records
        if not self.options.save:
            return
        RESULTS.mkdir(exist_ok=True)
        slug = re.sub(r"[^a-z0-9]+", "-", f"{self.data['machine']['cpu']}".lower()).strip("-")
        stem = f"{self.bench}-{self.date}-{slug}"
        (RESULTS / f"{stem}.txt").write_text("\n".join(self.lines) + "\n")
        text = json.dumps(self.data, indent=1, default=float)
        (RESULTS / f"{stem}.json").write_text(text + "\n")
        print(f"kept as {RESULTS.name}/{stem}.json and .txt")


def put(page: Path, mark: str, text: str) -> None:
    """The text between the marks of a page."""
    start, end = f"<!-- {mark} -->\n", f"<!-- end of {mark} -->"
    before, rest = page.read_text(encoding="utf-8").split(start)
    page.write_text(f"{before}{start}{text}{end}{rest.split(end)[1]}", encoding="utf-8")


def markdown(head: tuple[str, ...], rows: list[tuple[str, ...]]) -> str:
    """A table in Markdown."""
    lines = [head, ("---",) * len(head), *rows]
    return "\n".join(f"| {' | '.join(line)} |" for line in lines) + "\n"


def _short(value: object) -> str:
    if isinstance(value, tuple):
        return " ".join(f"{v:.2f}" for v in value)
    return str(value)


def _cpu() -> str:
    if sys.platform == "linux":
        for line in Path("/proc/cpuinfo").read_text().splitlines():
            if line.startswith("model name"):
                return line.split(":", 1)[1].strip()
    if sys.platform == "darwin":
        return _output("sysctl", "-n", "machdep.cpu.brand_string") or platform.machine()
    return platform.processor() or platform.machine()


def _vectors() -> str:
    """The widest vector registers that the processor says it has."""
    flags = ""
    if sys.platform == "linux":
        flags = Path("/proc/cpuinfo").read_text()
    return next((name for name in ("avx512f", "avx2", "sse2", "asimd") if name in flags), "unknown")


def _output(*command: str) -> str:
    try:
        run = subprocess.run(command, capture_output=True, text=True, check=True, timeout=10)
    except (OSError, subprocess.SubprocessError):
        return ""
    return run.stdout.strip()
