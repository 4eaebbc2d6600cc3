"""Tables and recorded runs of strangers: read, or refused by name; nothing hangs or grows."""

import io
import os
import zipfile

import numpy as np
import pytest

import stepcore as sc

ARM = """<mujoco><worldbody><body name="arm"><joint name="hinge" axis="0 1 0"/>
<geom size=".02" pos=".3 0 0" mass="1"/></body></worldbody>
<actuator><motor name="drive" joint="hinge"/></actuator></mujoco>"""


def header(shape):
    file = io.BytesIO()
    described = {"descr": "<f8", "fortran_order": False, "shape": shape}
    np.lib.format.write_array_header_1_0(file, described)
    return file.getvalue()


def bomb(path):
    """300 MiB of zeros in a file of some hundred kB."""
    with zipfile.ZipFile(path, "w", zipfile.ZIP_DEFLATED) as archive:
        archive.writestr("time.npy", header((300 * 2**17,)) + bytes(300 * 2**20))


def claims(path):
    """A header that tells of a terabyte."""
    with zipfile.ZipFile(path, "w") as archive:
        archive.writestr("time.npy", header((2**37,)))


def damaged(path):
    """Compressed numbers of which some bits are others."""
    np.savez_compressed(path, time=np.sin(np.arange(500.0)))
    data = bytearray(path.read_bytes())
    data[100:140] = bytes(40)
    path.write_bytes(data)


def packed(path):
    with zipfile.ZipFile(path, "w", zipfile.ZIP_LZMA) as archive:
        archive.writestr("time.npy", header((1,)) + bytes(8))


def shaped(time, drive):
    return lambda path: np.savez(path, time=np.ones(time).cumsum(0), drive=np.ones(drive))


def huge(path):
    with open(path, "wb") as file:
        file.truncate(2**30)


FILES = {
    "pipe.csv": os.mkfifo,
    "pipe.npz": os.mkfifo,
    "device.csv": lambda path: os.symlink("/dev/zero", path),
    "huge.csv": huge,
    "bytes.csv": lambda path: path.write_bytes(bytes(range(128, 256))),
    "field.csv": lambda path: path.write_text("time," + "d" * 300_000 + "\n0,1\n"),
    "many.csv": lambda path: path.write_text(
        "time," + ",".join(f"c{k}" for k in range(20_000)) + "\n" + "0," * 20_000 + "1\n"
    ),
    "bomb.npz": bomb,
    "claims.npz": claims,
    "objects.npz": lambda path: np.savez(path, time=np.array([{}], dtype=object)),
    "damaged.npz": damaged,
    "packed.npz": packed,
    "cube.npz": shaped(3, (3, 2, 2)),
    "clocks.npz": shaped((3, 2), 3),
    "wide.npz": shaped(3, (3, 2)),
    "short.npy": lambda path: path.write_bytes(b"\x93NUMPY"),
}
READERS = {
    "ctrl": lambda path: sc.run(sc.loads(ARM), horizon=0.1, ctrl=path),
    "follow": lambda path: sc.run(sc.loads(ARM), horizon=0.1, follow=path),
    "identify": lambda path: sc.identify(sc.loads(ARM), path, {"joint/hinge/damping": (0.01, 2)}),
    "trajectory": sc.Trajectory.load,
}


@pytest.mark.skipif(not hasattr(os, "mkfifo"), reason="no pipes here")
@pytest.mark.parametrize("name", FILES)
@pytest.mark.parametrize("reader", READERS)
def test_what_is_no_table_is_refused_by_name(name, reader, tmp_path):
    FILES[name](tmp_path / name)
    with pytest.raises(ValueError, match=rf"{name[:-4]}\.|logs\[0\]"):
        READERS[reader](str(tmp_path / name))


@pytest.mark.parametrize("text", ["no json", "[" * 100_000, "[1]"])
@pytest.mark.parametrize("name", ["sweep.json", "points.jsonl"])
def test_the_folder_of_a_sweep_that_is_damaged_is_refused(name, text, tmp_path):
    def sweep():
        return sc.sweep(
            sc.lesson.drop(), {"dt": [0.01]}, float, folder=tmp_path / "kept", progress=False
        )

    with pytest.raises((ValueError, TypeError)):
        sweep()
    (tmp_path / "kept" / name).write_text(text + "\n")
    with pytest.raises(ValueError, match=r"is damaged|of another"):
        sweep()
