"""Files that an included file names are looked for beside the main file, then beside it."""

from pathlib import Path

import compiled
import mujoco
import numpy as np
import pytest
from PIL import Image

import stepcore as sc
from stepcore.mjcf.appearance import read_looks

TETRA = "v 0 0 0\nv {0} 0 0\nv 0 1 0\nv 0 0 1\nf 1 3 2\nf 1 2 4\nf 2 3 4\nf 3 1 4\n"
MAIN = """<mujoco>{}<include file="sub/inc.xml"/><worldbody><body><joint/>
  <geom type="mesh" mesh="m"/></body></worldbody></mujoco>"""
INCLUDED = """<mujoco>{}<asset><mesh name="m" file="{}"/></asset></mujoco>"""
# Compiler, the file that the mesh names, the folders that have it, and what included files hold.
CASES = {
    "beside the included file": ("", "m.obj", ["sub"]),
    "below it": ("", "x/m.obj", ["sub/x"]),
    "of its name in meshdir": ('<compiler meshdir="in"/>', "m.obj", ["in/sub"]),
    "of its name in assetdir": ('<compiler assetdir="in"/>', "m.obj", ["in/sub"]),
    "in meshdir first": ('<compiler meshdir="in"/>', "m.obj", ["in", "in/sub", "sub"]),
    "with strippath": ('<compiler strippath="true" meshdir="in"/>', "y/m.obj", ["in"]),
}


def write(folder: Path, name: str, text: str) -> None:
    (folder / name).parent.mkdir(parents=True, exist_ok=True)
    (folder / name).write_text(text)


@pytest.mark.parametrize("what", CASES)
def test_meshes(what: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    compiler, file, folders = CASES[what]
    write(tmp_path, "main.xml", MAIN.format(compiler))
    write(tmp_path, "sub/inc.xml", INCLUDED.format("", file))
    for number, folder in enumerate(folders, 1):
        # Their sizes tell which of them was read.
        write(tmp_path, f"{folder}/m.obj", TETRA.format(number))
    # In its own folder MuJoCo knows the included file by a relative path.
    monkeypatch.chdir(tmp_path)
    theirs = mujoco.MjModel.from_xml_path("main.xml")
    scene = sc.load("main.xml")
    compiled.compare(scene, theirs)
    assert Path(scene.meshes[0].file) == tmp_path / folders[0] / "m.obj"
    assert "main.xml" in scene._source.files[0]
    compiled.compare(sc.load(tmp_path / "main.xml"), theirs)


def test_beside_the_included_file_by_an_absolute_path_too(tmp_path: Path) -> None:
    write(tmp_path, "main.xml", MAIN.format('<compiler meshdir="in"/>'))
    write(tmp_path, "sub/inc.xml", INCLUDED.format("", "m.obj"))
    write(tmp_path, "sub/m.obj", TETRA.format(1))
    theirs = mujoco.MjModel.from_xml_path(str(tmp_path / "main.xml"))
    compiled.compare(sc.load(tmp_path / "main.xml"), theirs)
    # A text with a base is the main file; without an include there is one place to look in.
    compiled.compare(sc.loads(MAIN.format('<compiler meshdir="in"/>'), base=tmp_path), theirs)
    alone = (tmp_path / "sub" / "inc.xml").read_text().replace("</mujoco>", "<worldbody>")
    alone += '<geom type="mesh" mesh="m"/></worldbody></mujoco>'
    assert sc.loads(alone, base=tmp_path / "sub").meshes[0].file == str(tmp_path / "sub" / "m.obj")
    with pytest.raises(FileNotFoundError, match=r"<string>:1: .*m\.obj: no such file"):
        sc.loads(alone, base=tmp_path)


def test_an_included_file_in_an_included_one(tmp_path: Path) -> None:
    """Beside the file that names it, not beside the one that includes that."""
    write(tmp_path, "main.xml", MAIN.format(""))
    write(tmp_path, "sub/inc.xml", '<mujoco><include file="deep/inc.xml"/></mujoco>')
    write(tmp_path, "sub/deep/inc.xml", INCLUDED.format("", "m.obj"))
    write(tmp_path, "sub/m.obj", TETRA.format(2))
    with pytest.raises(ValueError, match="Error opening"):
        mujoco.MjModel.from_xml_path(str(tmp_path / "main.xml"))
    with pytest.raises(FileNotFoundError):
        sc.load(tmp_path / "main.xml")
    write(tmp_path, "sub/deep/m.obj", TETRA.format(1))
    theirs = mujoco.MjModel.from_xml_path(str(tmp_path / "main.xml"))
    compiled.compare(sc.load(tmp_path / "main.xml"), theirs)


def test_height_fields_textures_and_attached_models(tmp_path: Path) -> None:
    write(
        tmp_path,
        "sub/inc.xml",
        """<mujoco><asset><hfield name="h" file="h.png" size="1 1 1 .1"/>
  <texture name="t" type="2d" file="red.png"/><material name="t" texture="t"/>
  <model name="kid" file="kid.xml"/></asset></mujoco>""",
    )
    write(
        tmp_path,
        "main.xml",
        """<mujoco><include file="sub/inc.xml"/><worldbody>
  <geom type="hfield" hfield="h" material="t"/><attach model="kid" prefix="K-"/></worldbody>
  </mujoco>""",
    )
    write(
        tmp_path,
        "sub/kid.xml",
        """<mujoco><asset><mesh file="m.obj"/></asset><worldbody>
  <body name="b"><joint name="j"/><geom type="mesh" mesh="m"/></body></worldbody></mujoco>""",
    )
    write(tmp_path, "sub/m.obj", TETRA.format(1))
    heights = np.random.default_rng(1).integers(0, 255, (5, 4), np.uint8)
    Image.fromarray(heights).save(tmp_path / "sub" / "h.png")
    Image.new("RGB", (2, 2), (255, 0, 0)).save(tmp_path / "sub" / "red.png")
    theirs = mujoco.MjModel.from_xml_path(str(tmp_path / "main.xml"))
    scene = sc.load(tmp_path / "main.xml")
    compiled.compare(scene, theirs)
    assert scene.hfields[0].elevation.shape == (theirs.hfield_nrow[0], theirs.hfield_ncol[0])
    looks = read_looks(scene)
    assert looks is not None and looks.colours[0].rgba == (1.0, 0.0, 0.0, 1.0)
