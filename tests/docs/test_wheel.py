"""What the build backend requires, and what it does to a wheel: `wheel/packed.py`."""

import os
import subprocess
import sys
from pathlib import Path
from zipfile import ZIP_DEFLATED, ZipFile, ZipInfo

import pytest

WHEEL = Path(__file__).parents[2] / "wheel"
ENTRIES = {
    "stepcore/__init__.py": b"# nothing\n" * 500,
    "stepcore/empty.py": b"",
    "stepcore/naïve.txt": bytes(range(256)),
}


@pytest.fixture
def packed(monkeypatch):
    monkeypatch.syspath_prepend(str(WHEEL))
    yield __import__("packed")
    sys.modules.pop("packed", None)


def test_an_archive_is_what_zipfile_reads(packed, tmp_path):
    entries = []
    for name, data in ENTRIES.items():
        info = ZipInfo(name, (2026, 11, 21, 20, 6, 58))
        info.external_attr = 0o100755 << 16
        entries.append((info, data))
    path = tmp_path / "a.whl"
    packed.write(path, entries)
    with ZipFile(path) as archive:
        assert archive.testzip() is None
        assert archive.namelist() == list(ENTRIES)
        for info in archive.infolist():
            assert archive.read(info) == ENTRIES[info.filename]
            assert info.compress_type == ZIP_DEFLATED
            assert info.external_attr == 0o100755 << 16
            assert info.date_time == (2026, 11, 21, 20, 6, 58)


def test_any_compressor_of_deflate_streams_serves(packed, tmp_path, monkeypatch):
    """The package `deflate` where it is installed; here one that stands in for it."""
    calls = []

    def deflate_compress(data, level):
        calls.append(level)
        return bytearray(packed._by_zlib(data))

    stand_in = type(sys)("deflate")
    stand_in.deflate_compress = deflate_compress
    monkeypatch.setitem(sys.modules, "deflate", stand_in)
    path = tmp_path / "a.whl"
    packed.write(path, [(ZipInfo("a"), b"a" * 1000)])
    with ZipFile(path) as archive:
        assert archive.read("a") == b"a" * 1000
    assert calls == [12]


def test_the_build_installs_a_missing_rust(tmp_path):
    """Without cargo the requirements name what installs it, and the build then finds its rustc."""
    pytest.importorskip("maturin")
    (tmp_path / "rust").mkdir()
    rustc = tmp_path / "rust" / "rustc"
    rustc.write_text("#!/bin/sh\necho host: x86_64-unknown-linux-gnu\n", encoding="utf-8")
    rustc.chmod(0o755)
    stand_in = f"def setup_rust(): return {{'PATH': {str(rustc.parent)!r}}}"
    (tmp_path / "puccinialin.py").write_text(stand_in, encoding="utf-8")
    code = (
        "import backend; required = backend.get_requires_for_build_wheel();"
        "backend._install_missing_rust(); print(*required, backend._own_target())"
    )
    done = subprocess.run(
        [sys.executable, "-c", code],
        cwd=WHEEL.parent,
        env={"PATH": "/nowhere", "PYTHONPATH": os.pathsep.join((str(WHEEL), str(tmp_path)))},
        capture_output=True,
        text=True,
        check=False,
    )
    assert done.stdout.split() == ["puccinialin", "x86_64-unknown-linux-gnu"], done.stderr
