"""Whichever vector instructions the module was compiled for, the bits are the same."""

import os
import subprocess
import sys
from pathlib import Path

import pytest
import zoo

from stepcore import _core, vectors

LEVELS = list(vectors.levels())
# Every scene of the zoo, of which some lanes fill and others are to spare; and what the scenes do
# alone, which is on record.
RUN = """
import hashlib
import bits
import numpy as np
import zoo
import stepcore as sc
from stepcore import _core

print(_core.VECTORS)
for name, entry in zoo.ZOO.items():
    if name in bits.HEAPS:
        continue
    model = sc.loads(entry.text).compile()
    for way, settings in bits.WAYS.items():
        for precision in ("f64", "f32"):
            batch = sc.Batch(model, 19, threads=1, lanes=True, precision=precision, **settings)
            rng = np.random.default_rng(29)
            batch.qvel[:] = rng.integers(-64, 65, batch.qvel.shape) / 64
            batch.ctrl[:] = rng.integers(-64, 65, batch.ctrl.shape) / 64
            batch.step(12)
            # One zero is as good as the other.
            state = np.hstack([batch.qpos, batch.qvel]) + 0.0
            print(name, way, precision, hashlib.sha256(state.tobytes()).hexdigest())
"""


def run(level, code):
    """What the code prints where this level is forced."""
    tests = Path(__file__).parents[1]
    path = os.pathsep.join([str(tests), *sys.path])
    environment = os.environ | {vectors.VARIABLE: level, "PYTHONPATH": path}
    command = [sys.executable, "-c", code]
    return subprocess.run(command, env=environment, capture_output=True, text=True)


def test_every_level_gives_the_same_bits():
    if len(LEVELS) == 1:
        pytest.skip("this build has one level alone")
    printed = {}
    for level in LEVELS:
        done = run(level, RUN)
        assert done.returncode == 0, done.stderr
        instructions, *printed[level] = done.stdout.splitlines()
        assert (instructions == level) == (level != vectors.BASELINE)
        assert len(printed[level]) > 3 * len(zoo.ZOO)
    first = printed[LEVELS[0]]
    for level in LEVELS[1:]:
        assert printed[level] == first, level


def test_the_bits_on_record_are_those_of_every_level():
    code = "import sys, pytest; sys.exit(pytest.main(['-q', '-p', 'no:cacheprovider', {!r}]))"
    for level in LEVELS:
        done = run(level, code.format(str(Path(__file__).with_name("test_bits.py"))))
        assert done.returncode == 0, (level, done.stdout)


def test_the_widest_is_chosen():
    if vectors.VARIABLE in os.environ:
        pytest.skip("another one is forced")
    if LEVELS[0] != vectors.BASELINE:
        assert LEVELS[0] == _core.VECTORS
        assert Path(_core.__file__).parent.name == f"_{LEVELS[0]}"


def test_what_a_processor_has_is_what_numpy_finds():
    module = pytest.importorskip("numpy._core._multiarray_umath")
    assert vectors.has_avx2() == module.__cpu_features__.get("AVX2", False)


def test_a_module_for_other_processors_is_refused_unread(tmp_path, monkeypatch):
    """As where a folder of packages was copied from a newer machine."""
    (tmp_path / "_avx2").mkdir()
    (tmp_path / "_avx2" / "_core.abi3.so").write_bytes(b"instructions that nobody may run")
    monkeypatch.setattr(vectors, "__file__", str(tmp_path / "vectors.py"))
    monkeypatch.delenv(vectors.VARIABLE, raising=False)
    monkeypatch.setitem(vectors._RUNS, "avx2", lambda: False)
    with pytest.raises(ImportError, match="built for processors with AVX2"):
        vectors.select_module([str(tmp_path)])
    monkeypatch.setitem(vectors._RUNS, "avx2", lambda: True)
    path = [str(tmp_path)]
    vectors.select_module(path)
    assert path[0] == str(tmp_path / "_avx2")


def test_a_level_that_is_not_there_is_refused():
    done = run("x87", "import stepcore")
    assert f"{vectors.VARIABLE} = 'x87': must be one of '{LEVELS[0]}'" in done.stderr


def test_what_info_says():
    for level in LEVELS:
        done = run(level, "import stepcore.cli; stepcore.cli.main(['info', '--json'])")
        assert f'"levels": "{", ".join(LEVELS)}"' in done.stdout
        assert (f'"vectors": "{level}"' in done.stdout) == (level != vectors.BASELINE)
