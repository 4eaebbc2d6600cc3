"""Measurements whose time is over: a valid answer that lists the work not done, or none in a line.

The clock of these tests counts its readings, so that nothing depends on the machine.
"""

import itertools
import math
import re
import signal

import numpy as np
import pytest

import stepcore as sc
from stepcore import deadline, lesson
from stepcore.cli import main
from stepcore.deadline import Deadline
from stepcore.experiment.engines import visits
from stepcore.experiment.motion import Motion
from stepcore.experiment.study import Study
from stepcore.measure.identification.readings import WORLDS, Readings
from stepcore.report.progress import Progress


@pytest.fixture
def clock(monkeypatch):
    """A clock that advances by a second at each reading."""
    ticks = itertools.count()
    monkeypatch.setattr(deadline, "clock", lambda: next(ticks))
    return ticks


@pytest.fixture(scope="module")
def hinge():
    return sc.loads("""<mujoco><option timestep="0.01" gravity="0 0 0"/><worldbody>
      <body><joint name="a" axis="0 1 0" stiffness="100" damping="1"/>
      <geom type="capsule" size=".02" fromto="0 0 0 .3 0 0" mass="1"/></body></worldbody>
      <keyframe><key qpos="0.01"/></keyframe></mujoco>""").compile()


def measurements(hinge):
    short = {"horizon": 0.2, "progress": False, "threads": 1}
    spring = lesson.spring()
    stiffer = spring.compile().with_values({"joint/spring/stiffness": 90.0})
    return {
        "check": lambda seconds: sc.check(hinge, **short, seconds=seconds),
        "diagnose": lambda seconds: sc.diagnose(hinge, **short, dt=0.2, seconds=seconds),
        "trade": lambda seconds: sc.trade(
            spring, **short, starts=3, error="1mm", further=4, by="flops", seconds=seconds
        ),
        "predict": lambda seconds: sc.predict(spring, **short, starts=3, seconds=seconds),
        "compare": lambda seconds: sc.compare(spring, stiffer, **short, starts=2, seconds=seconds),
        "ablate": lambda seconds: sc.ablate(hinge, **short, starts=2, seconds=seconds),
        "converge": lambda seconds: sc.converge(spring, **short, starts=1, seconds=seconds),
        "stability_map": lambda seconds: sc.stability_map(
            spring,
            path="joint/spring/stiffness",
            values=[10, 100],
            dts=[0.01, 0.1],
            **short,
            seconds=seconds,
        ),
    }


NAMES = (
    *("check", "diagnose", "trade", "predict", "compare", "ablate", "converge", "stability_map"),
)


@pytest.mark.parametrize("name", NAMES)
def test_a_measurement_ends_at_its_deadline_with_what_it_has(hinge, clock, name):
    """From too early for any answer up to the whole time needed."""
    measure, ends = measurements(hinge)[name], []
    for power in range(6, 50):
        try:
            result = measure(1.3**power)
        except sc.OutOfTime as error:
            said = re.fullmatch(
                r"stopped after ([\d.e+]+) s, too early for any answer.*; `--seconds \d+` .*",
                str(error),
            )
            # It gives up when the time is over, and not before (two digits are printed).
            assert said and float(said[1]) >= 0.95 * 1.3**power
            ends.append("nothing")
            continue
        text = result.text()
        assert (result.unfinished in text.replace("\n", " ")) and result.to_json()
        assert result.to_dict()["unfinished"] == result.unfinished
        if not result.unfinished:
            ends.append("all")
            break
        said = re.match(r"Stopped after ([\d.e+]+) s\. Not done: ", result.unfinished)
        # Every stage that is left out reads the clock a few times.
        assert said and float(said[1]) <= 1.2 * 1.3**power + 60
        assert result.not_done and not result.interrupted
        ends.append("part")
    assert ends[-1] == "all" and "part" in ends
    assert ends == sorted(ends, key=("nothing", "part", "all").index)


@pytest.mark.parametrize("name", ["trade", "predict"])
def test_without_a_cut_a_deadline_changes_nothing(hinge, clock, name):
    measure = measurements(hinge)[name]
    assert measure(None).to_dict() == measure(1e15).to_dict()


@pytest.mark.parametrize(("seconds", "words"), [(0, "seconds = 0"), ("much", "seconds = 'much'")])
def test_a_wrong_time_is_refused(hinge, seconds, words):
    with pytest.raises(ValueError, match=words):
        sc.diagnose(hinge, seconds=seconds)


def test_stages_end_at_their_shares_and_an_answer_is_still_completed(clock):
    with Deadline(100.0).opened() as limit:
        with limit.stage("the first half", 0.5):
            while True:
                deadline.check()
        assert 50 <= limit.spent < 60
        limit.stop()
        with limit.stage("what follows"):
            deadline.check()
        with limit.closing():
            deadline.check()
    assert limit.left_out == ["the first half", "what follows"]
    assert limit.sentence.startswith("Interrupted after ")
    assert "Not done: the first half; what follows. `--seconds 200`" in limit.sentence
    assert deadline.current() is None


@pytest.mark.parametrize("interrupted", [False, True])
def test_all_closings_share_the_time_kept_for_them(clock, interrupted):
    """Stages like `diagnose` within `check`: three that each take all the time they get."""
    with Deadline(None if interrupted else 100.0).opened() as limit:
        with limit.stage("the work"):
            while True:
                deadline.check()
                if interrupted and limit.spent > 100:
                    limit.stop()
        begun = limit.spent
        with Deadline(None, limit).opened() as inner:
            for one in (inner, inner, limit):
                with one.closing(), one.stage("the rest"):
                    while True:
                        deadline.check()
    assert inner.left_out == limit.left_out[1:] == ["the rest"]
    asked = 16  # ticks of the clock
    assert limit.spent - begun <= deadline.CLOSING + asked and limit.spent <= 120 + asked


@pytest.mark.parametrize("seconds", [10.0, 1000.0])
def test_closings_end_within_a_share_of_the_time(clock, seconds):
    with Deadline(seconds).opened() as limit:
        next(itertools.dropwhile(lambda spent: spent < seconds, iter(lambda: limit.spent, None)))
        with limit.closing():
            assert limit.left <= min(deadline.CLOSING, 0.15 * seconds)


def test_long_work_looks_at_the_deadline(monkeypatch):
    """At every state that is visited, and at every block of readings."""
    looks = []
    monkeypatch.setattr(deadline, "check", lambda: looks.append(1))
    model = lesson.stack().compile()
    schedule = Study(model, Motion(starts=2, horizon=0.5)).schedule
    states = sum(1 for _ in visits(model, schedule, [0, 1], schedule.every))
    assert states > 20 and len(looks) > states
    sensed = sc.loads("""<mujoco><worldbody><body><joint name="j"/><geom size=".1"/></body>
      </worldbody><sensor><jointpos joint="j"/></sensor></mujoco>""").compile()
    count = 10 * WORLDS
    state = {
        "qpos": np.zeros((count, 1)),
        "qvel": np.zeros((count, 1)),
        "act": np.zeros((count, 0)),
    }
    looks.clear()
    Readings(sensed, state | {"ctrl": np.zeros((count, 0))}).values()
    assert len(looks) == 10


def press(monkeypatch, after):
    """Press Ctrl-C when this many of the runs are done."""
    advance, begin = Progress.advance, Progress.__enter__
    done = itertools.count(1)

    def advanced(bar, count=1):
        advance(bar, count)
        if bar.label == "runs" and next(done) == after:
            signal.raise_signal(signal.SIGINT)

    def begun(bar):
        if bar.label == "runs" and not after:
            signal.raise_signal(signal.SIGINT)
        return begin(bar)

    monkeypatch.setattr(Progress, "advance", advanced)
    monkeypatch.setattr(Progress, "__enter__", begun)


COMMAND = ("predict", "lesson:stack", "--horizon", "0.2", "--threads", "1", "--starts", "3")


def test_ctrl_c_prints_what_is_known_and_how_to_go_on(capsys, monkeypatch):
    press(monkeypatch, 1)
    status = main(COMMAND)
    out, err = capsys.readouterr()
    assert status == 130 and "The motion can be predicted" in out
    assert re.search(r"Interrupted after .* s\. Not done: 2 of 3 starts\. `--seconds \d+`", out)
    assert "what is known follows" in err


def test_ctrl_c_before_any_answer_is_one_line(capsys, monkeypatch):
    press(monkeypatch, 0)
    status = main(COMMAND)
    out, err = capsys.readouterr()
    assert status == 130 and not out
    last = err.strip().splitlines()[-1]
    assert re.match(r"stepcore: interrupted after .*, too early for any answer \(0 of \d+ ", last)


def test_a_second_ctrl_c_ends_at_once(capsys, monkeypatch):
    press(monkeypatch, 1)
    closing = Deadline.stop

    def twice(self):
        closing(self)
        signal.raise_signal(signal.SIGINT)

    monkeypatch.setattr(Deadline, "stop", twice)
    assert main(COMMAND) == 130
    assert "interrupted after 1 of" in capsys.readouterr().err


def test_seconds_on_the_command_line(capsys, clock):
    assert main([*COMMAND, "--seconds", "3"]) == 3
    assert "too early for any answer" in capsys.readouterr().err
    assert main([*COMMAND, "--seconds", "inf"]) == 0
    assert "Not done" not in capsys.readouterr().out


def test_the_help_says_how_long_a_command_takes(capsys, monkeypatch):
    for command, limit in deadline.SECONDS.items():
        assert limit == math.inf  # in tests; see conftest
        monkeypatch.setitem(deadline.SECONDS, command, 20.0)
        assert main([command, "--help"]) == 0
        assert "(default: 20)" in " ".join(capsys.readouterr().out.split())


def test_a_long_check_says_first_what_the_file_alone_shows(capsys, clock, tmp_path):
    file = tmp_path / "late.xml"
    file.write_text("""<mujoco><worldbody><body><joint name="knee" range="-90 90"/>
      <geom size=".1"/></body></worldbody><keyframe><key name="home" qpos="2"/></keyframe>
      </mujoco>""")
    assert main(["check", str(file), "--horizon", "0.1", "--threads", "1"]) == 1
    out, err = capsys.readouterr()
    assert err.startswith("stepcore: so far: 1 finding in the file") and "knee" in err
    assert "\nError: Keyframe `home` has joint `knee`" in out
    assert main(["check", str(file), "--horizon", "0.1", "--json"]) == 1
    assert not capsys.readouterr().err


@pytest.mark.parametrize(
    ("command", "words"),
    [
        (
            ("trade", "lesson:spring", "--further", "0"),
            r"error as shipped [\d.]+ mm, ± .*; best .* at [\d.]+× the shipped cost",
        ),
        (
            ("predict", "lesson:spring", "--starts", "12"),
            "from 1 start, the motion can be predicted over all of",
        ),
        (("ablate", "gymnasium:reacher"), r"\d+ of \d+ features add at most 1 mm"),
    ],
)
def test_long_measurements_say_what_they_know_so_far(capsys, clock, command, words):
    name, file, *more = command
    assert main([name, file, "--horizon", "0.2", "--starts", "3", "--threads", "1", *more]) == 0
    out, err = capsys.readouterr()
    assert re.search(f"^stepcore: so far: {words}", err, re.MULTILINE) and "so far" not in out
    told = err.splitlines()
    assert len(told) == len(set(told))


def test_a_longer_time_is_longer_than_what_was_spent():
    """Work that cannot end between two checks took 36 s of 15."""
    limit = Deadline(15.0)
    limit.begun -= 36
    assert limit.longer == 2 * 37


def test_a_tenth_of_the_first_start_is_an_answer_of_predict(clock):
    parts = []
    for ticks in range(2, 200):
        try:
            parts.append(sc.predict(lesson.spring(), horizon=2.0, progress=False, seconds=ticks))
        except sc.OutOfTime:
            continue
        if not parts[-1].unfinished:
            break
    first, last = parts[0], parts[-1]
    assert "what follows 200 ms; 7 of 8 starts" in first.unfinished
    assert "over all of 200 ms" in first.sentences[0] and len(first.growth.ends) == 1
    assert first.ran.startswith("200 ms from ") and "starts near it" not in first.ran
    assert last.horizon == pytest.approx(2.0) and len(last.growth.ends) == 8
