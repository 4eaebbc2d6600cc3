"""What is the same of every result: its text, its data, its page."""

import dataclasses
import html
import json

import pytest
from measured import RESULTS

import stepcore as sc

COMMON = ["kind", "model", "motion", "ran", "settings", "sentences", "rows", "units", "notes"]
# A plan and a post-mortem run no motion.
WITHOUT_MOTION = ("identification", "plan", "postmortem", "tuning")


@pytest.fixture(params=RESULTS)
def result(request):
    return RESULTS[request.param]()


def test_the_data_have_the_same_keys_and_are_plain(result):
    data = result.to_dict()
    assert list(data)[: len(COMMON)] == COMMON
    assert json.loads(json.dumps(data, allow_nan=False)) == data == json.loads(result.to_json())
    assert data["kind"] == result.kind and data["model"] == result.name
    assert data["sentences"] == result.sentences and data["notes"] == result.notes
    assert all(isinstance(sentence, str) and sentence for sentence in data["sentences"])
    assert data["rows"] and set(data["rows"][0]) == set(result.table.columns)
    assert set(result.units) & set(result.table.columns)
    # The numbers of these two are arrays, of which the table makes rows.
    if result.kind not in ("postmortem", "predictability"):
        assert all(dataclasses.is_dataclass(row) for row in result.rows)
        assert len(result.rows) == len(data["rows"])
    if result.kind not in WITHOUT_MOTION:
        assert isinstance(result.motion, sc.Motion) and data["motion"]["horizon"] > 0
        if result.kind != "check":
            assert result.ran.endswith(f"law {result.settings.law}")
            assert f"The motion: {result.ran}." in " ".join(result.text(200).split())
        assert data["settings"] == sc.Settings(**data["settings"]).as_dict()


def test_the_text_keeps_to_its_width(result):
    for width in (20, 60, 100):
        assert max(map(len, result.text(width).splitlines())) <= width
    with pytest.raises(ValueError, match=r"width = 19: must be a whole number >= 20"):
        result.text(19)


def test_the_text_says_its_title_and_its_sentences_first(result):
    text = " ".join(result.text(200).split())
    # A diagnosis begins with its answer.
    places = [text.index(result.title)] if result.kind != "diagnosis" else []
    places += [text.index(" ".join(sentence.split())) for sentence in result.sentences]
    assert places == sorted(places) and places[0] == 0
    assert str(result) == result.text()


def test_a_notebook_shows_tables(result):
    shown = result._repr_html_()
    assert "<table" in shown and "<pre" not in shown
    assert shown.index(html.escape(result.sentences[0]).split("`")[0]) < shown.index("<img")
    assert repr(result).startswith(f"<{type(result).__name__}")


def test_about_a_screen_is_printed(result):
    """A trade of many settings is cut; these small results have no need to be."""
    assert len(result.text(100).splitlines()) <= 40
    assert len(result.text(100, full=True)) >= len(result.text(100))


def test_a_notebook_without_matplotlib_shows_no_picture(result, monkeypatch):
    def missing(path=None):
        raise ImportError("a plot needs matplotlib")

    monkeypatch.setattr(type(result), "plot", lambda self, path=None: missing())
    shown = result._repr_html_()
    assert "<table" in shown and "<img" not in shown
