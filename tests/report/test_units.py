"""Quantities: what is printed, and what users may write."""

import math

import pytest

import stepcore as sc
from stepcore.report import units
from stepcore.report.settings import label


@pytest.mark.parametrize(
    ("printed", "words"),
    [
        (units.seconds(0.0), "0 s"),
        (units.seconds(math.inf), "inf s"),
        (units.seconds(9.9996e-4), "1 ms"),
        (units.metres(math.nan), "nan m"),
        (units.metres(3e-15), "< 1 pm"),
        (units.speed(2.5e-3), "2.5 mm/s"),
        (units.newtons(1234.0), "1.23 kN"),
        (units.newtons(0.0), "0 N"),
        (units.computing(0.25), "0.25 µs"),
        (units.operations(2.5e6), "2.5 Mflop"),
        (units.hertz(20 * math.pi), "10 Hz"),
        (units.percent(0.1234), "12 %"),
        (units.percent(-0.031), "-3.1 %"),
        (units.percent(0.0), "0 %"),
        (units.times(3.4), "3.4×"),
        (units.times(1000.0), "1000×"),
        (units.times(1.23e6), "1.2e6×"),
        (units.times(math.inf), "inf×"),
        (units.counted(1, "start"), "1 start"),
        (units.counted(8, "start"), "8 starts"),
        (units.compact(1.34e-3), "1.3e-3"),
        (units.compact(-1e-9), "0"),
        (units.kind_unit("kp", angular=True), "N·m/rad"),
        (units.kind_unit("armature", angular=False), "kg"),
        (units.kind_unit("gear", angular=False), ""),
    ],
)
def test_what_is_printed(printed, words):
    assert printed == words


@pytest.mark.parametrize(
    ("text", "metres"),
    [(1e-3, 1e-3), ("0.001", 1e-3), ("1 mm", 1e-3), ("2um", 2e-6), ("2µm", 2e-6), ("1%", 0.02)],
)
def test_a_length(text, metres):
    assert units.length("trade", "error", text, size=2.0) == pytest.approx(metres, rel=1e-15)


@pytest.mark.parametrize("text", ["", "mm", "-1mm", "0", "1 kg", "nan", "1..2", None, True, 0])
def test_what_is_no_length(text):
    with pytest.raises(
        ValueError, match=r'ablate: error = .*: must be a length > 0: metres, "1mm"'
    ):
        units.length("ablate", "error", text, size=2.0)


@pytest.mark.parametrize(
    ("text", "by", "price"),
    [
        ("20us/step", "time", 1e4),
        ("5 ms/s", "time", 5e3),
        ("100x", "time", 1e4),
        ("2kflop/step", "flops", 1e6),
        (7, "flops", 7.0),
    ],
)
def test_a_budget(text, by, price):
    assert units.budget("trade", "budget", text, 0.002, by) == pytest.approx(price, rel=1e-15)


@pytest.mark.parametrize(
    ("text", "by"), [("20", "time"), ("0x", "time"), ("100x", "flops"), ("1us/step", "flops")]
)
def test_what_is_no_budget(text, by):
    with pytest.raises(ValueError, match="trade: budget = "):
        units.budget("trade", "budget", text, 0.002, by)


def test_newton_that_may_end_early_is_named_with_its_iterations():
    """MJX models ship one iteration, which is their error: 36 mm on a Go1."""
    one, usual = sc.Settings(sweeps=1), sc.Settings()
    assert label(one) == "euler, newton 1 iteration, dt 2 ms"
    assert label(usual) == "euler, newton, dt 2 ms"
    assert label(one, usual) == "euler, newton 1 iteration, dt 2 ms"
    assert label(usual, one) == "euler, newton, 100 iterations, dt 2 ms"
