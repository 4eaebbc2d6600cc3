"""The build backend: maturin's, and for x86-64 a wheel whose module is there for AVX2 as well.

`pip install .` and `pip wheel .` come here. maturin builds the wheel twice, side by side: for every
x86-64, small and without lanes, and for AVX2. The module of the second goes into the first, in a
folder from which `stepcore/vectors.py` takes it. maturin's own commands (`maturin develop`) and
editable installations build one module, with the instructions of its target: the same bits, in less
time.
"""

from __future__ import annotations

import base64
import hashlib
import os
import re
import subprocess
import sys
import tempfile
from collections.abc import Mapping
from pathlib import Path
from typing import Any
from zipfile import ZipFile

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


def build_wheel(
    wheel_directory: str,
    config_settings: Mapping[str, Any] | None = None,
    metadata_directory: str | None = None,
) -> str:
    arguments = maturin.get_maturin_pep517_args(config_settings)
    target = _named(arguments) or os.environ.get("CARGO_BUILD_TARGET") or _own_target()
    if not target.startswith("x86_64"):
        return maturin.build_wheel(wheel_directory, config_settings, metadata_directory)
    if not _named(arguments):
        # So cargo keeps what runs during the build free of the target's instructions.
        arguments = [*arguments, "--target", target]
    with tempfile.TemporaryDirectory() as wide, tempfile.TemporaryFile() as messages:
        options = (metadata_directory or "", *arguments)
        # Less is copied into its callers than LLVM's 225 would have it: as quick, and smaller.
        flags = _flags("-C target-feature=+avx2 -C llvm-args=-inline-threshold=200")
        avx2 = _build("avx2", flags, messages, wide, *options)
        # Few machines run it, a wheel has a limit, and lanes gain nothing at this level.
        small = {"CARGO_PROFILE_RELEASE_OPT_LEVEL": "s", "CARGO_PROFILE_RELEASE_CODEGEN_UNITS": "1"}
        small |= _flags("-C llvm-args=-inline-threshold=20")
        features = ("--features", "single")
        baseline = _build("baseline", small, None, wheel_directory, *options, *features)
        if any([baseline.wait(), avx2.wait()]):
            # Two builds that talk at once are hard to follow: this one comes after the other.
            messages.seek(0)
            sys.exit(messages.read().decode(errors="replace"))
        (second,) = Path(wide).glob("*.whl")
        _add_module(Path(wheel_directory, second.name), second, "_avx2")
        return second.name


def _flags(more: str) -> dict[str, str]:
    """These flags of rustc after those of the environment."""
    return {"RUSTFLAGS": f"{os.environ.get('RUSTFLAGS', '')} {more}".strip()}


def _build(
    level: str, variables: dict[str, str], output: Any, *arguments: str
) -> subprocess.Popen[bytes]:
    """Starts maturin, with a folder of its own for what it compiles."""
    target = Path(os.environ.get("CARGO_TARGET_DIR", "target")).absolute() / level
    environment = os.environ | variables | {"CARGO_TARGET_DIR": str(target)}
    command = [sys.executable, "-c", BUILD, *arguments]
    return subprocess.Popen(command, env=environment, stdout=output, stderr=output)


def _named(arguments: list[str]) -> str | None:
    """The target that the arguments name."""
    for index, option in enumerate(arguments):
        if option == "--target":
            return "".join(arguments[index + 1 : index + 2])
        if option.startswith("--target="):
            return option.removeprefix("--target=")
    return None


def _own_target() -> str:
    """This machine's, as rustc names it. Without a rustc maturin brings one, and the wheel has one
    module."""
    try:
        version = subprocess.run(["rustc", "-vV"], capture_output=True, text=True, check=True)
    except (OSError, subprocess.CalledProcessError):
        return ""
    host = re.search(r"^host: (\S+)$", version.stdout, re.MULTILINE)
    return host[1] if host else ""


def _add_module(wheel: Path, wide: Path, folder: str) -> None:
    """Puts the module of the second wheel into the first, and into the list of its files."""
    with ZipFile(wide) as source:
        (entry,) = (info for info in source.infolist() if MODULE.fullmatch(info.filename))
        data = source.read(entry)
    entry.filename = entry.filename.replace("/", f"/{folder}/")
    digest = base64.urlsafe_b64encode(hashlib.sha256(data).digest()).rstrip(b"=").decode()
    record = f"{entry.filename},sha256={digest},{len(data)}\n"
    both = wheel.with_suffix(".both")
    with ZipFile(wheel) as old:
        entries = [(info, old.read(info)) for info in old.infolist()]
    # The list of files is the last of them.
    listed, text = entries.pop()
    assert listed.filename.endswith(".dist-info/RECORD")
    packed.write(both, [*entries, (entry, data), (listed, text + record.encode())])
    both.replace(wheel)
