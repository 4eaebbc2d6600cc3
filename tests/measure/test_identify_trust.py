"""`identify` gives no interval that its logs do not support."""

from functools import cache

import numpy as np
import pytest

import stepcore as sc
from stepcore import deadline
from stepcore.measure.identification.doubts import log_findings
from stepcore.measure.identification.log import read_log

LINK = """<mujoco><worldbody><body name="arm"><joint name="hinge" axis="0 1 0" damping=".1"/>
<geom type="capsule" size=".02" fromto="0 0 0 .3 0 0" mass="1"/></body></worldbody>
<actuator><motor name="drive" joint="hinge"/></actuator></mujoco>"""
DAMPING, MASS = "joint/hinge/damping", "body/arm/mass"
RANGES = {DAMPING: (0.01, 2.0), MASS: (0.2, 5.0)}
HIDDEN = {DAMPING: 0.4, MASS: 1.3}


def link():
    return sc.loads(LINK).compile()


@cache
def swing(seconds=1.0, every=1, noise=0.0, within=0.0, **hidden):
    """A log of the link with hidden values.

    within: the part of a step at which its held command was sampled; rows have the commands at
    their times.
    """
    steps = np.arange(round(seconds / 0.002))
    ctrl, told = (np.sin((steps + part) / 40)[:, None] for part in (within, 0.0))
    true = link().with_values(HIDDEN | {f"joint/hinge/{key}": v for key, v in hidden.items()})
    run = sc.Sim(true).run(seconds, control=ctrl, record=("qpos", "ctrl"))
    rng = np.random.default_rng(0)
    rows = {"time": run.time, "qpos": run.qpos + rng.normal(0, noise, run.qpos.shape)}
    rows["ctrl"] = np.concatenate([told, told[-1:]])[: len(run.time)]
    return {key: np.array(value)[::every] for key, value in rows.items()}


def told(found):
    return " ".join(found.text().split())


def unknown(found):
    return all(np.isinf(ends).all() for ends in found.intervals.values())


def test_a_wrong_sign_is_no_error_of_the_time_step():
    """Shorter steps change the prediction by as much as the residual, and do not explain it."""
    log = swing()
    found = sc.identify(link(), log | {"qpos": -log["qpos"]}, RANGES, most=10)
    assert found.quality.verdict == "bad" and not found.quality.refined and unknown(found)


@pytest.mark.parametrize("rows", [2, 3, 4])
def test_as_many_values_as_measured_numbers_have_no_intervals(rows):
    log = {key: value[:rows] for key, value in swing().items()}
    found = sc.identify(link(), log, RANGES)
    assert found.quality.verdict == "few" and found.quality.spare == rows - 4 and unknown(found)


def test_intervals_of_few_numbers_hold_the_truth():
    """Student's t, of few degrees of freedom, instead of a normal distribution's."""
    held = []
    for seed in range(5):
        log = {key: np.array(value[:200:33]) for key, value in swing().items()}
        log["qpos"] += np.random.default_rng(seed).normal(0, 1e-3, log["qpos"].shape)
        full = {"qpos": {key: log[key] for key in ("time", "qpos")}}
        full["ctrl"] = {key: swing()[key] for key in ("time", "ctrl")}
        found = sc.identify(link(), full, {DAMPING: RANGES[DAMPING]} | {MASS: RANGES[MASS]})
        low, high = found.intervals[DAMPING]
        held.append(low <= HIDDEN[DAMPING] <= high)
    assert sum(held) >= 4


@pytest.mark.parametrize("every", [2, 3])
def test_noise_is_that_of_measured_rows(every):
    """Positions in every second row, of a friction that is missing."""
    log = swing(noise=2e-4, frictionloss=0.3)
    few = log["qpos"].copy()
    few[np.arange(len(few)) % every != 0] = np.nan
    found = sc.identify(link(), log | {"qpos": few}, {DAMPING: (0.01, 2.0)}, interpolation="held")
    assert found.quality.misfits["qpos[hinge]"].noise == pytest.approx(2e-4, rel=0.2)
    assert found.quality.verdict == "bad" and unknown(found)


def test_values_that_were_never_changed_are_not_results():
    found = sc.identify(link(), swing(noise=1e-3), RANGES, most=1)
    assert found.unfinished and found.kept == [*RANGES] and unknown(found)
    assert found.values == found.start and told(found).count("was not estimated") == 2


def test_steps_that_were_not_run_change_nothing_that_is_told(monkeypatch):
    from stepcore.measure.identification.predictions import Predictions

    own = Predictions.predicted

    def late(self, x, finer=1):
        if finer > 1:
            raise deadline.OutOfTime("over")
        return own(self, x, finer)

    monkeypatch.setattr(Predictions, "predicted", late)
    found = sc.identify(link(), swing(), RANGES)
    assert np.isnan([*found.integration.values(), *found.finer.values()]).all()
    assert "not computed" in told(found) and "by 0" not in told(found)


def test_commands_between_rows_are_interpolated_where_that_explains_the_log():
    """Rows of every 20 ms of a command that changes in each step."""
    log = swing(2.0, every=10, noise=1e-4, within=0.5)
    held, found = (sc.identify(link(), log, RANGES, interpolation=i) for i in ("held", None))
    assert held.quality.verdict == "bad" and found.quality.verdict != "bad"
    for path, value in HIDDEN.items():
        assert found.values[path] == pytest.approx(value, rel=0.02)
    assert any("--interpolation linear" in note for note in found.notes)
    with pytest.raises(ValueError, match="interpolation = 'cubic'"):
        sc.identify(link(), log, RANGES, interpolation="cubic")


def test_positions_may_lead_the_commands():
    log = swing(2.0, noise=1e-4)
    early = log | {"ctrl": np.concatenate([log["ctrl"][:1]] * 5 + [log["ctrl"][:-5]])}
    found = sc.identify(link(), early, RANGES | {"delay": (-0.05, 0.05)}, interpolation="held")
    assert found.values["delay"] == pytest.approx(-0.01, abs=1e-3)
    assert "ositions in the log lead the commands by 10 ms" in told(found)
    first = sc.identify(link(), early, RANGES, interpolation="held").sentences[0]
    assert "lead the commands" in first or "early" in first


def test_ranges_are_refused_with_a_cure():
    with pytest.raises(ValueError, match="without 0: use 1e-06"):
        sc.identify(link(), swing(), {DAMPING: (0, 2)})
    two = LINK.replace("</body></worldbody>", "</body>{}</worldbody>").format(
        '<body name="b"><joint name="other" damping="9"/><geom size=".1"/></body>'
    )
    with pytest.raises(ValueError, match=r"joint/hinge/damping, joint/other/damping.*0\.1, 9"):
        log = {"time": [0, 1], "hinge.position": [0, 1], "drive.control": [0, 0]}
        sc.identify(sc.loads(two), log, {"joint/*/damping": (1, 2)})


def test_identify_does_not_offer_to_follow():
    log = {key: swing()[key] for key in ("time", "qpos")}
    with pytest.raises(ValueError) as error:
        sc.identify(link(), log, RANGES)
    assert "follow" not in str(error.value)


@pytest.mark.parametrize("wrong, unit", [("qpos", "degrees"), ("ctrl", "degrees in the model")])
def test_degrees_are_told_by_the_targets_of_servos(wrong, unit):
    servo = LINK.replace('motor name="drive"', 'position name="drive" kp="100" kv="1"')
    ctrl = 0.5 * np.sin(np.arange(500) / 100)[:, None]
    run = sc.Sim(sc.loads(servo)).run(1.0, control=ctrl, record=("qpos",))
    log = {"time": run.time[:500], "qpos": np.array(run.qpos[:500]), "ctrl": ctrl}
    model = sc.loads(servo).compile()
    assert not log_findings(model, [read_log(model, log, "log")], [])
    log[wrong] = np.degrees(log[wrong])
    found = log_findings(model, [read_log(model, log, "log")], [])
    assert f"it looks like {unit}" in [finding.fix for finding in found if finding.kind == "units"]
