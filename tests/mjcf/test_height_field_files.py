"""Files of height fields: images of every kind, and MuJoCo's binary format; damage is refused."""

from __future__ import annotations

import struct
import zlib

import mujoco
import numpy as np
import pytest
from png_writer import ADAM7, CHANNELS, SIGNATURE, chunk, data, grey, packed

from stepcore.scene import asset_files

KINDS = {
    **{f"grey{depth}": (0, depth) for depth in (1, 2, 4, 8, 16)},
    **{f"rgb{depth}": (2, depth) for depth in (8, 16)},
    **{f"palette{depth}": (3, depth) for depth in (2, 8)},
    **{f"alpha{depth}": (4, depth) for depth in (8, 16)},
    **{f"rgba{depth}": (6, depth) for depth in (8, 16)},
}


@pytest.mark.parametrize("interlaced", [False, True])
@pytest.mark.parametrize("kind", KINDS)
def test_heights_of_coloured_images_are_mujocos(kind, interlaced, tmp_path):
    colour, depth = KINDS[kind]
    channels = CHANNELS[colour]
    most = 4 if colour == 3 else 2**depth
    pixels = np.random.default_rng(depth).integers(0, most, (11, 9, channels))
    pixels[0, 0], pixels[0, 1] = 0, most - 1
    passes = ADAM7 if interlaced else ((0, 0, 1, 1),)
    body = b"".join(packed(pixels[y::dy, x::dx], depth) for x, y, dx, dy in passes)

    head = chunk(b"IHDR", struct.pack(">IIBBBBB", 9, 11, depth, colour, 0, 0, interlaced))
    palette = chunk(b"PLTE", bytes([10, 20, 30, 50, 40, 30, 100, 0, 0, 200, 250, 1]))
    path = tmp_path / "image.png"
    path.write_bytes(
        SIGNATURE + head + palette * (colour == 3) + data(zlib.compress(body)) + chunk(b"IEND", b"")
    )
    text = f"""<mujoco><asset><hfield name="h" file="{path}" size="1 1 1 1"/></asset>
      <worldbody><geom type="hfield" hfield="h"/></worldbody></mujoco>"""
    theirs = mujoco.MjModel.from_xml_string(text).hfield_data.reshape(11, 9)[::-1]
    ours = asset_files.read_hfield(path)
    assert np.abs((ours - ours.min()) / np.ptp(ours) - theirs).max() < 1e-6


def test_images_and_binary_height_fields(tmp_path):
    pixels = np.random.default_rng(0).integers(0, 256, (9, 6))
    for filters in (None, [1], [2], [3], [4], [4, 3, 2, 1, 0]):
        (tmp_path / "a.png").write_bytes(grey(pixels, filters=filters))
        assert (asset_files.read_hfield(tmp_path / "a.png") == pixels).all()
    heights = struct.pack("<2i", 9, 6) + pixels.astype("<f4").tobytes()
    (tmp_path / "h.bin").write_bytes(heights)
    assert (asset_files.read_hfield(tmp_path / "h.bin") == pixels[::-1]).all()
    broken = {
        "b.png": (grey(pixels, colour=5), "it is damaged"),
        "c.png": (grey(pixels, depth=16), "it is damaged"),
        "f.png": (grey(pixels, colour=3), "one has the colour 2[0-9]*, of 0"),
        "d.png": (grey(pixels)[:-40], "it is damaged"),
        "e.png": (b"GIF89a", "it is damaged"),
        "a.bin": (heights[:-1], "it has 223"),
        "b.bin": (struct.pack("<2i", 2**31 - 1, 2**31 - 1), "at most 16777216"),
        "e.bin": (struct.pack("<2i", 4096, 4096), "asks for 67108872 bytes"),
        "c.bin": (struct.pack("<2i", -1, 4), "-1 rows"),
        "d.bin": (struct.pack("<2i2f", 1, 2, 0, np.nan), "not a finite"),
    }
    for name, (content, why) in broken.items():
        (tmp_path / name).write_bytes(content)
        with pytest.raises(ValueError, match=why):
            asset_files.read_hfield(tmp_path / name)
