"""Pages of results in a headless Chromium: tables sort, and light and dark can be chosen."""

import pytest
from viewing_browser import complaints, opened

from stepcore.report.report import Report
from stepcore.report.table import Table

ROWS = [
    {"solver": "pgs 20", "error": "<1.1e-3", "cost": 9.0, "share": "37 %"},
    {"solver": "newton", "error": "2.5e-2", "cost": 10.0, "share": ""},
    {"solver": "pgs 3", "error": "9.0e-3", "cost": float("inf"), "share": "4.1 %"},
]


@pytest.fixture(scope="module")
def chrome(tmp_path_factory):
    path = tmp_path_factory.mktemp("pages") / "result.html"
    table = Table(ROWS, formats={"error": "", "share": ""}, heading="Settings")
    report = Report("arm: a trade", ["The answer."], [table], ["one start"], "1 s")
    path.write_text(report.page(b'<svg xmlns="http://www.w3.org/2000/svg"/>'), encoding="utf-8")
    browser = opened()
    browser.get(path.as_uri())
    yield browser
    browser.quit()


def column(chrome, index):
    script = (
        f"return [...document.querySelectorAll('tbody tr')].map(r => r.cells[{index}].innerText)"
    )
    return chrome.execute_script(script)


def click(chrome, index):
    chrome.execute_script(f"document.querySelectorAll('th button')[{index}].click()")


@pytest.mark.parametrize(
    ("index", "rising"),
    [
        (0, ["newton", "pgs 3", "pgs 20"]),
        (1, ["<1.1e-3", "9.0e-3", "2.5e-2"]),
        (2, ["9", "10", "inf"]),
        (3, ["4.1 %", "37 %", ""]),
    ],
)
def test_a_column_sorts_both_ways(chrome, index, rising):
    """Numbers as numbers, though a mark or a unit stands beside them; empty cells last."""
    click(chrome, index)
    assert [cell.strip() for cell in column(chrome, index)] == rising
    click(chrome, index)
    filled = [cell for cell in rising if cell]
    expected = filled[::-1] + [""] * (len(rising) - len(filled))
    assert [cell.strip() for cell in column(chrome, index)] == expected
    sorts = "return [...document.querySelectorAll('th')].map(h => h.getAttribute('aria-sort'))"
    assert chrome.execute_script(sorts)[index] == "descending"
    assert not complaints(chrome)


def test_light_and_dark(chrome):
    """By the reader's system, and by a click on the button."""
    paper = "return getComputedStyle(document.body).backgroundColor"
    for scheme, colour in (("light", "rgb(255, 255, 255)"), ("dark", "rgb(20, 23, 27)")):
        features = [{"name": "prefers-color-scheme", "value": scheme}]
        chrome.execute_cdp_cmd("Emulation.setEmulatedMedia", {"features": features})
        assert chrome.execute_script(paper) == colour
    chrome.execute_script("document.getElementById('theme').click()")
    assert chrome.execute_script(paper) == "rgb(255, 255, 255)"
