"""Rows of a trade whose steps keep an accuracy."""

import math

import pytest

import stepcore as sc
from stepcore.measure.trade.adaptive import rung

BALL = """<mujoco model="ball"><option timestep=".002"/><worldbody>
 <geom type="plane" size="5 5 .1"/>
 <body name="ball" pos="0 0 .2"><freejoint/><geom size=".1" mass="1"/></body>
 </worldbody></mujoco>"""
FIELDS = {"horizon": 0.3, "starts": 2, "further": 2, "progress": False}


def test_a_ball_that_lands_is_cheapest_within_an_accuracy():
    """No step of a fixed length is as accurate at the cost, counted in operations."""
    trade = sc.trade(sc.loads(BALL), error="0.2mm", by="flops", **FIELDS)
    chosen = trade.recommended
    assert chosen.settings.accuracy is not None
    assert trade.error(chosen) <= 2e-4
    fixed = [r for r in trade.rows if r.settings.accuracy is None and trade.error(r) <= 2e-4]
    assert all(row.flops > chosen.flops for row in fixed)
    assert f"accuracy {1e3 * chosen.settings.accuracy:g} mm" in str(trade)
    assert chosen.record()["accuracy"] == chosen.settings.accuracy
    # Errors of such rows are no power of dt.
    assert all(math.isfinite(order) for order in trade.orders.values())


def test_what_a_model_ships_may_keep_an_accuracy():
    model = sc.loads(BALL).compile().with_settings(accuracy="1mm", dt=0.02)
    trade = sc.trade(model, error="1mm", by="flops", **FIELDS)
    assert trade.shipped.settings == model.settings
    assert trade.error(trade.shipped) < 1e-3
    assert trade.reference.settings.accuracy is None
    assert any(row.settings.accuracy is None for row in trade.rows)


def test_where_steps_keep_none_no_such_row_is_tried():
    """Under a law that a step of a fixed length defines."""
    model = sc.loads(BALL).compile().with_settings(law="rigid", solver="pgs")
    trade = sc.trade(model, error="1mm", by="flops", **FIELDS)
    assert all(row.settings.accuracy is None for row in trade.rows)


@pytest.mark.parametrize("measure", (sc.check, sc.predict))
def test_others_that_run_it(measure):
    model = sc.loads(BALL).compile().with_settings(accuracy="1mm", dt=0.02)
    assert measure(model, horizon=0.2, progress=False)


def test_rungs():
    assert [rung(k) for k in (-4, -3, -2)] == [0.05, 0.1, 0.2]


def test_accuracies_are_an_axis():
    trade = sc.trade(
        sc.loads(BALL), dts=[0.002], accuracies=["10mm", 1e-3, "0.1%"], by="flops", **FIELDS
    )
    kept = {row.settings.accuracy for row in trade.rows if row.settings.accuracy is not None}
    assert {0.01, 1e-3} < kept and len(kept) == 3
    for bad in (["soon"], [-1.0], 3):
        with pytest.raises(ValueError, match="accuracies"):
            sc.trade(sc.loads(BALL), accuracies=bad, **FIELDS)
