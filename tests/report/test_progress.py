"""The progress bar: where it shows, what it says, and what it calls."""

import io
import sys
import threading

import pytest

from stepcore.report import progress
from stepcore.report.progress import Progress


class Terminal(io.StringIO):
    def isatty(self):
        return True


class Notebook(io.StringIO):
    """A notebook's stream is no terminal, and understands a carriage return."""


Notebook.__module__ = "ipykernel.iostream"


@pytest.mark.parametrize(
    ("stream", "shows"), [(Terminal, True), (Notebook, True), (io.StringIO, False)]
)
def test_a_bar_shows_where_somebody_watches(monkeypatch, stream, shows):
    monkeypatch.setattr(sys, "stderr", stream())
    with Progress("runs", 4) as bar:
        bar.advance()
    text = sys.stderr.getvalue()
    assert bool(text) is shows
    if shows:
        assert f"runs{' ' * 21}[{'#' * 7}{'.' * 21}] 1/4" in text
        assert text.endswith("\r") and not text.split("\r")[-2].strip()


@pytest.mark.parametrize("columns", [20, 40, 62, 100])
def test_a_line_fits_the_terminal(monkeypatch, columns):
    """One that wraps could not be drawn over."""
    monkeypatch.setenv("COLUMNS", str(columns))
    monkeypatch.setattr(sys, "stderr", Terminal())
    with Progress("further starts", 3) as bar:
        for _ in range(5):
            bar.advance()
    lines = sys.stderr.getvalue().split("\r")
    assert max(map(len, lines)) < columns
    assert any("3/3" in line for line in lines)
    # More than was foreseen is told as it is.
    assert any("5/5" in line for line in lines) and not any("5/3" in line for line in lines)


def test_false_is_no_bar(monkeypatch):
    monkeypatch.setattr(sys, "stderr", Terminal())
    with Progress("runs", 1, False) as bar:
        bar.advance()
    assert sys.stderr.getvalue() == ""


@pytest.mark.parametrize(
    ("spent", "words"), [(1.0, ""), (10.0, ", 30 s left"), (60.0, ", 3 min left")]
)
def test_the_time_left_is_at_the_pace_so_far(monkeypatch, spent, words):
    times = iter([0.0, 0.0, spent])
    monkeypatch.setattr(progress, "monotonic", lambda: next(times))
    monkeypatch.setattr(sys, "stderr", Terminal())
    with Progress("runs", 4) as bar:
        bar.advance()
    assert f"1/4{words}\r" in sys.stderr.getvalue()


def test_a_function_is_called_in_place_of_the_bar_from_several_threads():
    calls = []
    bar = Progress("runs", 100, lambda *call: calls.append(call))
    threads = [
        threading.Thread(target=lambda: [bar.advance() for _ in range(25)]) for _ in range(4)
    ]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    assert calls == [("runs", done, 100) for done in range(1, 101)]


def test_short_work_has_no_bar(monkeypatch):
    times = iter([0.0, 0.0, 1.9, 2.1, 2.1])
    monkeypatch.setattr(progress, "monotonic", lambda: next(times))
    monkeypatch.setattr(sys, "stderr", Terminal())
    with Progress("steps", 4, after=2.0) as bar:
        bar.advance()
        assert sys.stderr.getvalue() == ""
        bar.advance()
    assert "2/4, 2 s left\r" in sys.stderr.getvalue()


def test_a_log_gets_a_line_every_ten_seconds(monkeypatch):
    """Also while one piece of work lasts, and bar after bar; work in a pause does not count."""
    now = [100.0]
    monkeypatch.setattr(progress, "LINES", 10.0)
    monkeypatch.setattr(progress, "clock", lambda: now[0])
    monkeypatch.setattr(progress, "monotonic", lambda: now[0])
    monkeypatch.setattr(progress, "_lines", progress._Lines())
    monkeypatch.setattr(sys, "stderr", io.StringIO())
    with Progress("reference", 4) as bar:
        for now[0] in (104.0, 109.9):
            progress.show_life()
        assert sys.stderr.getvalue() == ""
        now[0] = 110.0
        progress.show_life()
        bar.advance()
        assert sys.stderr.getvalue() == "reference: 0 of 4\n"
    with Progress("search", 10, False), Progress("starts", 10) as bar:
        now[0] = 120.0
        bar.advance(5)
    assert sys.stderr.getvalue().splitlines()[1:] == ["starts: 5 of 10, 10 s left"]
    now[0] = 1000.0
    with Progress("later", 3):
        progress.show_life()
    assert len(sys.stderr.getvalue().splitlines()) == 2
