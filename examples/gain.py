"""How do the error and the largest stable step depend on a gain? A question asked of a `Study`.

python examples/gain.py arm.xml actuator/elbow/kp 1mm
"""

import sys

import numpy as np

from stepcore.experiment import Change, Study, choose


def gain(study, path, values, error):
    """Return the error as shipped and the largest stable step for each value of a path."""
    rows, period = [], study.schedule.period
    for value in values:
        change = Change({path: value})
        shipped = study.run(change, error=error)

        def off(steps, change=change):
            # A change of settings and of the model: both at once.
            return study.run(change.also(Change(dt=period / steps)), error=error).error

        # Stable: no run fails, and no body is off by half of the scene's size.
        steps = choose.least(range(1, 1000), off, study.size / 2, study.steps(), cliff=True)
        row = {path: value, "error as shipped": shipped.error, "stable up to": None}
        rows.append(row | ({"stable up to": period / steps} if steps else {}))
    # A step of a whole period is the longest that was tried.
    limits = [(row[path], row["stable up to"]) for row in rows]
    known = [(np.log(value), np.log(dt)) for value, dt in limits if dt and dt < period]
    sentences = ["Fewer than two of the gains limit the step."]
    if len(known) > 1:
        power = np.polyfit(*np.transpose(known), 1)[0]
        sentences = [f"The largest stable step goes as the gain to the power {power:.2f}."]
    return study.answer(
        f"error and largest stable step against {path}",
        sentences,
        rows,
        units={"error as shipped": "m", "stable up to": "s"},
        plot=(path, "stable up to"),
    )


def main(file, path, error="1mm"):
    study = Study(file, horizon=0.5, starts=2)
    values = study.value(path) * np.geomspace(0.1, 10, 5)
    print(gain(study, path, values.tolist(), error))


if __name__ == "__main__":
    main(*sys.argv[1:])
