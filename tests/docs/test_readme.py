"""The README's Python runs as it stands there."""

import re
from pathlib import Path

import pytest

README = Path(__file__).parents[2] / "README.md"
BLOCKS = re.findall(r"```python\n(.*?)```", README.read_text(encoding="utf-8"), re.DOTALL)

ROBOT = """
<mujoco model="robot">
  <worldbody>
    <geom type="plane" size="5 5 .1"/>
    <body pos="0 0 1">
      <joint axis="0 1 0" damping=".1"/>
      <geom type="capsule" size=".05" fromto="0 0 0 .5 0 0"/>
    </body>
  </worldbody>
</mujoco>
"""


@pytest.mark.parametrize("index", range(len(BLOCKS)))
def test_block_runs(index, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    Path("robot.xml").write_text(ROBOT, encoding="utf-8")
    names = {}
    exec(BLOCKS[index], names)
    if "trajectory" in names:
        assert names["sim"].qpos[2] == pytest.approx(0.09963, abs=1e-5)
    else:
        assert Path("trade.png").stat().st_size > 10_000
        assert names["fast"].settings != names["scene"].settings
