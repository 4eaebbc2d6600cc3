"""The log of the page "Your robot and its log" is what its code makes, within its digits."""

import re
from pathlib import Path

import numpy as np

import stepcore as sc

ROOT = Path(__file__).parents[2]


def test_the_page_s_code_makes_the_log(tmp_path, monkeypatch):
    page = (ROOT / "docs" / "your_robot.md").read_text(encoding="utf-8")
    code = re.search(r"```python\n(.*?)```", page, re.DOTALL)[1]
    shown = re.search(r"```csv\n(.*?)```", page, re.DOTALL)[1]
    kept = (ROOT / "docs" / "reacher.csv").read_text(encoding="utf-8")
    assert kept.startswith(shown)
    monkeypatch.chdir(tmp_path)
    exec(code, {})
    made, before = (sc.Log(path).columns for path in ("reacher.csv", ROOT / "docs/reacher.csv"))
    assert made.keys() == before.keys()
    for name, values in made.items():
        np.testing.assert_allclose(values, before[name], rtol=1e-6, atol=1e-9)
