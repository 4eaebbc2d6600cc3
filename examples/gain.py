"""How do the error and the largest stable step depend on a gain? A question asked of a `Study`.

python examples/gain.py arm.xml actuator/elbow/kp 1mm
"""

import sys

import numpy as np

import stepcore as sc
from stepcore.experiment import Change, Study, choose
from stepcore.report.units import length, metres, seconds
from stepcore.scene.value_paths import find


def gain(study, path, values, error):
    """Return (value, error as shipped [m], largest stable step [s]) for each value of a path."""
    rows, period = [], study.schedule.period
    for value in values:
        change = Change({path: value})
        shipped, *_ = study.run([change], error=error)

        def off(steps, change=change):
            # A change of settings and of the model: both at once.
            return study.run([change.also(Change(dt=period / steps))], error=error)[0].error

        # Stable: no run fails, and no body is off by half of the scene's size.
        steps = choose.least(range(1, 1000), off, study.size / 2, study.steps(), cliff=True)
        rows.append((value, shipped.error, period / steps if steps else 0.0))
    return rows


def main(file, path, error="1mm"):
    study = Study(file, sc.Motion(horizon=0.5, starts=2))
    element, field = find(study.model.scene, path)
    values = getattr(element, field) * np.geomspace(0.1, 10, 5)
    rows = gain(study, path, values.tolist(), length("gain", "error", error, study.size))
    print(f"{path:>12} {'error as shipped':>18} {'stable up to':>14}")
    for value, off, dt in rows:
        print(f"{value:12.4g} {metres(off):>18} {seconds(dt) if dt else 'none':>14}")
    known = [(np.log(value), np.log(dt)) for value, _, dt in rows if 0 < dt < study.schedule.period]
    if len(known) > 1:
        power = np.polyfit(*np.transpose(known), 1)[0]
        print(f"The largest stable step goes as the gain to the power {power:.2f}.")


if __name__ == "__main__":
    main(*sys.argv[1:])
