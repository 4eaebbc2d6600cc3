"""The trade, seen: the recommended row over the converged motion, from its worst start."""

import numpy as np
import pytest

import stepcore as sc
from stepcore import lesson
from stepcore.viewing.frames import rms_distance
from stepcore.viewing.live import View


@pytest.fixture(scope="module")
def trade():
    return sc.trade(lesson.stack(), horizon=0.5, starts=2, error=1e-3, threads=1)


def test_the_distance_that_is_seen_is_the_error_of_the_row(trade):
    """The RMS over the run, of the only place where both are taken: the samples."""
    row = max((row for row in trade.rows if not row.failure), key=trade.error)
    truth, coarse = trade.seen(row)
    gap = rms_distance(coarse._replayed(), truth._replayed())
    assert 0.3 < np.sqrt(np.mean(gap**2)) / row.error < 3
    assert truth.snapshots.model.settings.dt == trade.reference.settings.dt


def test_it_is_viewed(trade, monkeypatch, capsys):
    monkeypatch.setattr(View, "wait", View.close)
    trade.view(port=8490)
    assert "stepcore view: http://localhost:" in capsys.readouterr().out
