"""The page on the trade runs as it stands there."""

import re
from pathlib import Path

import stepcore as sc

PAGE = Path(__file__).parents[2] / "docs" / "trade.md"
BLOCKS = re.findall(r"```python\n(.*?)```", PAGE.read_text(encoding="utf-8"), re.DOTALL)


def test_the_double_pendulum_of_the_page(tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    block = BLOCKS[0]
    exec(block, {})
    assert capsys.readouterr().out.strip() == re.search(r"# (14\.\d s)", block)[1]
    assert Path("growth.png").stat().st_size > 10_000


def test_the_recommendation_of_the_page(tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    names = {}
    exec(BLOCKS[1], names)
    assert capsys.readouterr().out.strip() == "rk4 16"
    assert sc.load("fast.xml").settings == names["fast"].settings
