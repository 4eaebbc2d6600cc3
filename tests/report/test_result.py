"""`Result.text`: every result keeps to the width it is given, and refuses what is none."""

import pytest

import stepcore as sc
from stepcore import lesson

MADE = {
    "map": lambda: sc.stability_map(values=[10, 100], dts=[0.01, 0.02], progress=False),
    "predict": lambda: sc.predictability(
        lesson.spring(), horizon=0.2, starts=1, threads=1, progress=False
    ),
    "diagnose": lambda: sc.diagnose(lesson.spring(), progress=False),
    "converge": lambda: sc.converge(
        lesson.stack(), horizon=0.1, starts=1, threads=1, progress=False
    ),
}


@pytest.mark.parametrize("name", MADE)
def test_a_result_keeps_to_its_width(name):
    found = MADE[name]()
    for width in (20, 60, 100):
        assert max(map(len, found.text(width).splitlines())) <= width
    for wrong in (-1, 0, 19, "x", 40.5):
        with pytest.raises(ValueError, match=r"width = .*: must be a whole number >= 20"):
            found.text(wrong)
