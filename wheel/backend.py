"""The build backend: maturin's, and for x86-64 a module for each level of vector instructions.

`pip install .` builds one module, for the processor at hand: with AVX2 where it has it, else for
every x86-64, small and without lanes. A release's wheel holds both, side by side: its builder sets
`STEPCORE_LEVELS=baseline,avx2`. The module with AVX2 stands in a folder of its own, from which
`stepcore/vectors.py` takes it where the processor runs it. maturin's own commands (`maturin
develop`) and editable installations build one module, with the instructions of its target: the
same bits.
"""

from __future__ import annotations

import base64
import hashlib
import importlib.util
import os
import re
import subprocess
import sys
import tempfile
from collections.abc import Mapping
from pathlib import Path
from typing import Any
from zipfile import ZipFile, ZipInfo

import maturin
import packed
from maturin import (  # noqa: F401
    build_editable,
    build_sdist,
    get_requires_for_build_editable,
    get_requires_for_build_sdist,
    get_requires_for_build_wheel,
    prepare_metadata_for_build_editable,
    prepare_metadata_for_build_wheel,
)

MODULE = re.compile(r"stepcore/(_core\.[^/]*(?:so|pyd))")
BUILD = """
import sys, maturin
folder, metadata, *arguments = sys.argv[1:]
maturin.build_wheel(folder, {"build-args": arguments}, metadata or None)
"""
# Of each level: flags of rustc, other variables, and arguments of maturin.
LEVELS: dict[str, tuple[str, dict[str, str], tuple[str, ...]]] = {
    # Less is copied into its callers than LLVM's 225 would have it: as quick, and smaller.
    "avx2": ("-C target-feature=+avx2 -C llvm-args=-inline-threshold=200", {}, ()),
    # Few machines run it, a wheel has a limit, and lanes gain nothing at this level.
    "baseline": (
        "-C llvm-args=-inline-threshold=20",
        {"CARGO_PROFILE_RELEASE_OPT_LEVEL": "s", "CARGO_PROFILE_RELEASE_CODEGEN_UNITS": "1"},
        ("--features", "single"),
    ),
}


def build_wheel(
    wheel_directory: str,
    config_settings: Mapping[str, Any] | None = None,
    metadata_directory: str | None = None,
) -> str:
    _install_missing_rust()
    arguments = maturin.get_maturin_pep517_args(config_settings)
    own = _own_target()
    target = _named(arguments) or os.environ.get("CARGO_BUILD_TARGET") or own
    if not target.startswith("x86_64"):
        return maturin.build_wheel(wheel_directory, config_settings, metadata_directory)
    if not _named(arguments):
        # So cargo keeps what runs during the build free of the target's instructions.
        arguments = [*arguments, "--target", target]
    with tempfile.TemporaryDirectory() as folder:
        builds = []
        for level in _levels(target == own):
            wheels, messages = Path(folder, level), Path(folder, f"{level}.log")
            wheels.mkdir()
            options = [str(wheels), metadata_directory or "", *arguments]
            builds.append((level, wheels, messages, _build(level, messages, options)))
        failed = [messages for *_, messages, build in builds if build.wait()]
        if failed:
            sys.exit(failed[0].read_text(errors="replace"))
        made = {level: next(wheels.glob("*.whl")) for level, wheels, *_ in builds}
        name = next(iter(made.values())).name
        _join(made, Path(wheel_directory, name))
        return name


def _install_missing_rust() -> None:
    """Install Rust if there is no cargo, as maturin does, but before the target is looked up:
    a build that does not know its target would leave out AVX2."""
    if "puccinialin" in get_requires_for_build_wheel():
        from puccinialin import setup_rust

        os.environ.update(setup_rust())


def _levels(for_this_machine: bool) -> list[str]:
    """The levels that the environment asks for; else the widest that this processor runs, and for
    other machines the one that all of them run."""
    asked = os.environ.get("STEPCORE_LEVELS")
    if asked:
        levels = asked.split(",")
        if unknown := set(levels) - set(LEVELS):
            sys.exit(f"STEPCORE_LEVELS = '{asked}': {unknown} is none of {', '.join(LEVELS)}")
        return levels
    path = Path(__file__).parents[1] / "python" / "stepcore" / "vectors.py"
    spec = importlib.util.spec_from_file_location("vectors", path)
    assert spec and spec.loader
    vectors = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(vectors)
    return ["avx2" if for_this_machine and vectors.has_avx2() else "baseline"]


def _build(level: str, messages: Path, options: list[str]) -> subprocess.Popen[bytes]:
    """Starts maturin, with a folder of its own for what it compiles."""
    flags, variables, arguments = LEVELS[level]
    target = Path(os.environ.get("CARGO_TARGET_DIR", "target")).absolute() / level
    environment = (
        os.environ
        | variables
        | {
            "RUSTFLAGS": f"{os.environ.get('RUSTFLAGS', '')} {flags}".strip(),
            "CARGO_TARGET_DIR": str(target),
        }
    )
    command = [sys.executable, "-c", BUILD, *options, *arguments]
    # Two builds that talk at once are hard to follow: what one says is printed if it fails.
    with messages.open("wb") as output:
        return subprocess.Popen(command, env=environment, stdout=output, stderr=subprocess.STDOUT)


def _named(arguments: list[str]) -> str | None:
    """The target that the arguments name."""
    for index, option in enumerate(arguments):
        if option == "--target":
            return "".join(arguments[index + 1 : index + 2])
        if option.startswith("--target="):
            return option.removeprefix("--target=")
    return None


def _own_target() -> str:
    """This machine's, as rustc names it."""
    try:
        version = subprocess.run(["rustc", "-vV"], capture_output=True, text=True, check=True)
    except (OSError, subprocess.CalledProcessError):
        return ""
    host = re.search(r"^host: (\S+)$", version.stdout, re.MULTILINE)
    return host[1] if host else ""


def _join(wheels: Mapping[str, Path], to: Path) -> None:
    """One wheel of those of several levels, each with its module where `vectors.py` looks."""
    entries: list[tuple[ZipInfo, bytes]] = []
    listed = b""
    for level, wheel in wheels.items():
        with ZipFile(wheel) as archive:
            infos = archive.infolist()
            if entries:
                infos = [info for info in infos if MODULE.fullmatch(info.filename)]
            for info in infos:
                data = archive.read(info)
                if MODULE.fullmatch(info.filename) and level != "baseline":
                    info.filename = info.filename.replace("/", f"/_{level}/")
                entries.append((info, data))
    (record,) = (info for info, _ in entries if info.filename.endswith(".dist-info/RECORD"))
    entries = [entry for entry in entries if entry[0] is not record]
    for info, data in entries:
        digest = base64.urlsafe_b64encode(hashlib.sha256(data).digest()).rstrip(b"=").decode()
        listed += f"{info.filename},sha256={digest},{len(data)}\n".encode()
    packed.write(to, [*entries, (record, listed + f"{record.filename},,\n".encode())])
