"""The page on the trade runs as it stands there."""

import re
from pathlib import Path

PAGE = Path(__file__).parent.parent / "docs" / "trade.md"


def test_the_double_pendulum_of_the_page(tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    (block,) = re.findall(r"```python\n(.*?)```", PAGE.read_text(encoding="utf-8"), re.DOTALL)
    exec(block, {})
    assert capsys.readouterr().out.strip() == re.search(r"# (14\.\d s)", block)[1]
    assert Path("growth.png").stat().st_size > 10_000
