"""`Table`: as text, as HTML and as data."""

import json

import pytest

from stepcore.report.table import Table


def test_a_table_fits_its_width_and_survives_json():
    table = Table([{"a": 1.5, "why": "x" * 90}, {"a": float("nan"), "b": 2}])
    assert table.columns == ["a", "why", "b"]
    lines = table.text(40).splitlines()
    assert max(map(len, lines)) <= 40 and "…" in lines[1]
    assert "no room for: why, b" in table.text(16)
    assert json.loads(table.to_json())[1] == {"a": None, "why": None, "b": 2}
    assert table.to_dict()["b"] == [None, 2]
    assert "<th>a</th>" in Table([{"a": 1, "why": "<&>"}])._repr_html_()
    assert "&lt;&amp;&gt;" in Table([{"a": 1, "why": "<&>"}])._repr_html_()
    with pytest.raises(KeyError, match="no column 'c'"):
        table["c"]
