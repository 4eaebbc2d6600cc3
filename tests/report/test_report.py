"""`Report` and `Table`: the same blocks as text, as HTML and as data."""

import json
import re
from xml.etree import ElementTree

import numpy as np
import pytest

import stepcore as sc
from stepcore import lesson
from stepcore.report.report import SCREEN, Report
from stepcore.report.table import Table, jsonable

LONG = "The answer is a sentence that no narrow window shows in one line, so it goes on."
REPORT = Report(
    "arm: an answer",
    [LONG, "- do this <first>", "- or that"],
    [Table([{"element": "knee & co", "dt [s]": 1.5e-3}], heading="Limits", legend="dt: time step")],
    ["one start", "ends with a stop."],
    "1 s from 1 start",
)


def test_the_text_says_the_answer_first_then_tables_then_notes():
    text = REPORT.text(100)
    places = [text.index(part) for part in ("arm:", "The answer", "  - do", "1 s from", "Limits")]
    places += [text.index(part) for part in ("knee & co", "dt: time step.", "Note: one start.")]
    assert places == sorted(places)
    assert "stop.." not in text


def test_notes_beyond_a_screen_are_counted():
    notes = [f"a remark of one line, number {k}" for k in range(50)]
    report = Report("arm: an answer", ["It moves."], [], notes)
    lines = report.text(100, full=False).splitlines()
    assert len(lines) == SCREEN
    shown = sum(line.startswith("Note: ") for line in lines)
    assert lines[-1] == f"Not shown: {50 - shown} more notes (--all; in Python text(full=True))."
    assert report.text(100).count("Note: ") == 50 and "Not shown" not in report.text(100)
    few = Report("arm: an answer", ["It moves."], [], notes[:30])
    assert few.text(100, full=False) == few.text(100)
    table = Table([{"a": k} for k in range(SCREEN)])
    text = Report("arm: an answer", [], [table], notes[:1]).text(100, full=False)
    assert text.endswith("Not shown: 1 note (--all; in Python text(full=True)).")


@pytest.mark.parametrize("width", [20, 33, 80])
def test_the_text_keeps_to_its_width(width):
    lines = REPORT.text(width).splitlines()
    assert max(map(len, lines)) <= width
    assert "".join(LONG.split()) in "".join(REPORT.text(width).split())


def test_no_line_ends_between_a_number_and_its_unit():
    text = "The error is 6.94 µm after 12 ms of 40 % of the 3 motions at 2.5 m/s and 9 rad/s."
    for width in range(20, 90):
        for line in Report("title", [text]).text(width).splitlines():
            assert not line.endswith(("6.94", "12", "40", "2.5", "9")), line


@pytest.mark.parametrize("width", [-1, 0, 19, "x", 40.5])
def test_a_width_that_is_none_is_refused(width):
    with pytest.raises(ValueError, match=r"width = .*: must be a whole number >= 20"):
        REPORT.text(width)


def test_the_html_has_a_real_table_and_escapes_names():
    tree = ElementTree.fromstring(f"<div>{REPORT.html()}</div>")
    assert [cell.text for cell in tree.iter("th")] == ["element", "dt [s]"]
    assert [cell.text for cell in tree.iter("td")] == ["knee & co", "0.0015"]
    assert [item.text for item in tree.iter("li")] == ["do this <first>", "or that"]
    assert tree.find(".//caption/span").text == "Limits"
    assert not list(tree.iter("pre"))


def test_the_page_holds_its_picture():
    page = REPORT.page(b"<svg/>")
    assert "data:image/svg+xml;base64,PHN2Zy8+" in page and "<title>arm: an answer</title>" in page


def test_the_page_has_the_answer_on_top_and_needs_nothing_else():
    page = REPORT.page(b"<svg/>")
    places = [page.index(part) for part in ('id="answer"', "The answer", "<img", "1 s from")]
    places += [page.index(part) for part in ("<table", "dt: time step.", "one start")]
    assert places == sorted(places)
    assert not re.search(r"https?://|href=|import\(|fetch\(", page)
    assert "prefers-color-scheme: dark" in page


def test_names_in_backticks_are_code():
    page = Report("arm", ["Joint `a<b` is stiff."]).html()
    assert page == "<p>Joint <code>a&lt;b</code> is stiff.</p>"


def test_a_part_of_a_table_is_a_table():
    table = Table([{"a": 1.0}, {"a": 2.0}], formats={"a": ".2f"}, heading="h", legend="l")
    part = table[:1]
    assert (len(part), part.formats, part.heading, part.legend) == (1, table.formats, "h", "l")


def test_plain_data_is_what_json_knows():
    value = {
        "array": np.arange(2.0),
        "bad": [np.nan, float("inf")],
        "settings": sc.Settings(),
        "control": lesson.spring,
        1: {np.float64(2)},
    }
    plain = jsonable(value)
    assert plain["array"] == [0.0, 1.0] and plain["bad"] == [None, None] and plain["1"] == [2.0]
    assert plain["settings"]["dt"] == sc.Settings().dt and plain["control"] == "spring"
    assert json.loads(json.dumps(plain, allow_nan=False)) == plain
