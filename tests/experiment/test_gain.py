"""examples/gain.py: a user's question, answered by a `Study`."""

import subprocess
import sys
from pathlib import Path

REPO = Path(__file__).parents[2]


def test_the_largest_stable_step_goes_as_the_root_of_the_gain():
    """ω dt = 2 with ω² ~ kp: the power is -1/2."""
    command = ["examples/gain.py", "docs/arm.xml", "actuator/elbow/kp", "1mm"]
    done = subprocess.run(
        [sys.executable, *command], cwd=REPO, capture_output=True, text=True, check=True
    )
    last = done.stdout.strip().splitlines()[2]
    power = float(last.removesuffix(".").split()[-1])
    assert abs(power + 0.5) < 0.03
    assert len((REPO / "examples" / "gain.py").read_text().splitlines()) < 60
