"""Logs as they come: forty spoiled ones are read correctly, or refused with place and fix."""

import csv
import datetime
import io

import numpy as np
import pandas
import pytest
from test_control_files import in_cdr, write_mcap

import stepcore as sc
from stepcore.experiment.control_table import ControlTable

ARM = """<mujoco><worldbody><body><joint name="hip" axis="0 1 0"/>
<geom type="capsule" size=".03" fromto="0 0 0 0 0 .3"/><body pos="0 0 .3">
<joint name="knee" axis="0 1 0" range="-115 115"/><geom type="capsule" size=".03"
 fromto="0 0 0 0 0 .3"/></body></body></worldbody>
<actuator><motor name="lift" joint="hip"/><motor name="kick" joint="knee" gear="2"/></actuator>
<sensor><jointpos name="angle" joint="knee"/></sensor></mujoco>"""
COUNT = 40
TIMES = 0.008 * np.arange(COUNT)
QPOS = np.column_stack([5.0 * np.sin(9 * TIMES) + 2.0, 0.8 * np.cos(5 * TIMES)])
QVEL = np.column_stack([45.0 * np.cos(9 * TIMES), -4 * np.sin(5 * TIMES)])
EFFORT = np.column_stack([np.cos(TIMES), 3 * np.sin(20 * TIMES)])
TRUE = {"qpos": QPOS, "qvel": QVEL, "effort": EFFORT}
HEADS = [f"{j}.{word}" for word in ("position", "velocity", "effort") for j in ("hip", "knee")]
ROWS = np.column_stack([TIMES, QPOS, QVEL, EFFORT])
TURNED = (QPOS + np.pi) % (2 * np.pi) - np.pi


@pytest.fixture(scope="module")
def model():
    return sc.loads(ARM).compile()


def table(heads=("time", *HEADS), rows=ROWS, mark=",", comma=False, above=(), below=()):
    """The text of a log; above: lines before the names; below: rows before the numbers."""
    file = io.StringIO()
    file.writelines(f"{line}\n" for line in above)
    writer = csv.writer(file, delimiter=mark, lineterminator="\n")
    writer.writerows([[*heads], *below])
    for row in rows:
        cells = [cell if isinstance(cell, str) else repr(float(cell)) for cell in row]
        writer.writerow([cell.replace(".", ",") if comma else cell for cell in cells])
    return file.getvalue()


def changed(column, values, heads=None):
    """The text with other numbers in a column."""
    rows = ROWS.astype(object)
    rows[:, column] = values
    return table(rows=rows, **({"heads": heads} if heads else {}))


def swapped(k, time):
    rows = ROWS.copy()
    rows[k, 0] = time
    return table(rows=rows)


def named(pattern):
    return ("time", *(pattern.format(*head.split(".")) for head in HEADS))


def dates(form):
    begin = datetime.datetime(2026, 11, 25, 4, 31, tzinfo=datetime.UTC)
    return [(begin + datetime.timedelta(seconds=t)).strftime(form) for t in TIMES.tolist()]


DEGREES = np.degrees(QPOS)
TOLD = ("time", "hip [deg]", "knee (deg)", *HEADS[2:])
SINCE = 1_700_000_000
UNITS = ["s", "rad", "rad", "rad/s", "rad/s", "Nm", "Nm"]
ODD = [["ms", "deg", "deg", "deg/s", "deg/s", "mNm", "mNm"], [1e3, *[180 / np.pi] * 4, 1e3, 1e3]]
# Each kind twice: the text or bytes, and the error; without an error the log is read correctly.
SPOILED = {
    "joint names alone": (table(("time", "hip", "knee", *HEADS[2:])), ""),
    "actuator names": (table([h.replace("hip", "lift") for h in ("time", *HEADS)]), ""),
    "prefix": (table(named("/{}/{}")), ""),
    "topic": (table(named("/joint_states/{0}/{1}")), ""),
    "underscore": (table(named("{}_{}")), ""),
    "brackets": (table(named("{1}[{0}]")), ""),
    "t": (table(("t", *HEADS)), ""),
    "timestamp": (table(("Timestamp", *HEADS)), ""),
    "ms": (changed(0, 1e3 * TIMES, ("time [ms]", *HEADS)), ""),
    "ns": (changed(0, 1e9 * TIMES, ("t_ns", *HEADS)), ""),
    "unit not told, ms": (changed(0, 1e3 * TIMES), "log.csv, column time: rows are 8 s .*\\[ms\\]"),
    "unit not told, ns": (changed(0, 1e9 * TIMES), "column time: rows are 8e.06 s.*tell the"),
    "unix": (changed(0, SINCE + TIMES), ""),
    "unix in ns": (changed(0, [str(SINCE * 10**9 + round(1e9 * t)) for t in TIMES]), ""),
    "iso": (changed(0, dates("%Y-%m-%dT%H:%M:%S.%fZ")), ""),
    "iso with a space": (changed(0, dates("%Y-%m-%d %H:%M:%S.%f")), ""),
    "units": (table(below=[UNITS]), ""),
    "odd units": (table(rows=ROWS * ODD[1], below=[ODD[0]]), ""),
    "unknown unit": (table(below=[[*UNITS[:5], "A", "A"]]), 'column hip.effort: unit "A": must be'),
    "unit of time": (table(("time [h]", *HEADS)), 'time \\[h\\]: unit "h": must be one of s'),
    "comments": (table(above=["# of Tuesday", "% by me"]), ""),
    "comment in the rows": (table().replace("\n0.08,", "\n# here\n0.08,"), ""),
    "spaces": (table().replace(",", " , "), ""),
    "only spaces": (table(mark=" "), ""),
    "decimal commas": (table(mark=";", comma=True), ""),
    "quoted commas": (table(comma=True), ""),
    "bare commas": (table(comma=True).replace('"', ""), "row 2: 14 columns, above 7: decimal"),
    "bom": (b"\xef\xbb\xbf" + table().encode(), ""),
    "utf-16": (table(mark="\t").encode("utf-16"), ""),
    "latin-1": (table(above=["# Gelenk für Prüfung"]).encode("latin-1"), ""),
    "latin-1 unit": (table(("time", "hip [°]", "knee [°]", *HEADS[2:]),
                           np.column_stack([TIMES, DEGREES, ROWS[:, 3:]])).encode("latin-1"), ""),
    "degrees told": (table(TOLD, np.column_stack([TIMES, DEGREES, ROWS[:, 3:]])), ""),
    "degrees not told": (table(rows=np.column_stack([TIMES, DEGREES, ROWS[:, 3:]])),
                         'hip.position: changes .* name the column "hip.position \\[deg\\]"'),
    "degrees beyond a range": (
        table(("time", *HEADS[:2]), np.column_stack([TIMES, DEGREES])),
        'column knee.position: reaches 45.8 rad, and the range of its joint 2.01 rad.*\\[deg\\]'),
    "wrapped": (changed(1, TURNED[:, 0]), ""),
    "wrapped to a turn": (changed(1, QPOS[:, 0] % (2 * np.pi)), ""),
    "repeated time": (swapped(17, TIMES[16]), "row 19, column time: 0.128 s repeats row 18.*keep"),
    "swapped times": (swapped(17, TIMES[15] + 0.001),
                      "row 19, column time: 0.121 s is before row 18, 0.128 s.*sort the rows"),
    "a name that is nearly one": (table([h.replace("knee", "kneee") for h in ("time", *HEADS)]),
                                  'no joint is named "kneee.position"; nearest: "knee"'),
    "another near one": (table([h.replace("hip.v", "hipp.v") for h in ("time", *HEADS)]),
                         'no joint or actuator is named "hipp.velocity"; nearest: "hip"'),
    "text in a number": (changed(4, ["ok" if k == 9 else v for k, v in enumerate(QVEL[:, 1])]),
                         "log.csv, row 11, column knee.velocity: 'ok': must be a number"),
    "cut off": (table()[:-60], "log.csv, row 41: 4 columns, above 7: remove this row"),
}  # fmt: skip


@pytest.mark.parametrize("kind", SPOILED)
def test_a_spoiled_log_is_read_rightly_or_refused_with_place_and_cure(kind, model, tmp_path):
    text, said = SPOILED[kind]
    (tmp_path / "log.csv").write_bytes(text if isinstance(text, bytes) else text.encode())
    if said:
        with pytest.raises(ValueError, match=said):
            ControlTable(tmp_path / "log.csv").placed(model)
        return
    log = ControlTable(tmp_path / "log.csv")
    assert log.times == pytest.approx(TIMES, abs=3e-7)
    arrays = log.placed(model).arrays
    for key, values in TRUE.items():
        turn = 2 * np.pi * round((arrays[key][0, 0] - values[0, 0]) / (2 * np.pi))
        assert arrays[key] - [turn, 0] == pytest.approx(values, abs=1e-9), key
    assert log.told(model).startswith(
        "312 ms at 125 Hz: position, velocity and torque of hip, knee"
    )
    assert ("unwrapped at" in log.told(model)) == kind.startswith("wrapped")


def test_forty_kinds_are_tried():
    assert len(SPOILED) >= 40


def clean(tmp_path):
    """Ten ways to write the same log."""
    columns = dict(zip(("time", *HEADS), ROWS.T, strict=True))
    frame = pandas.DataFrame(columns)
    frame.to_csv(tmp_path / "log.csv", index=False)
    frame.to_csv(tmp_path / "index.csv")
    frame.to_parquet(tmp_path / "log.parquet")
    np.savez(tmp_path / "log.npz", **columns)
    states = {"name": np.array(["hip", "knee"]), "position": QPOS, "velocity": QVEL}
    np.savez(tmp_path / "ros.npz", stamp=TIMES, effort=EFFORT, **states)
    words = ("position", "velocity", "effort")
    messages = [
        {"name": ["hip", "knee"], **dict(zip(words, row.reshape(3, 2).tolist(), strict=True))}
        for row in ROWS[:, 1:]
    ]
    json = write_mcap(tmp_path / "json.mcap", {"/joint_states": messages}, times=TIMES)
    cdr = [in_cdr(message) for message in messages]
    ros = write_mcap(tmp_path / "cdr.mcap", {"/joint_states": cdr}, times=TIMES)
    dated = frame.drop(columns="time").set_index(
        pandas.Timestamp(0) + pandas.to_timedelta(TIMES, "s")
    )
    names = ("log.csv", "index.csv", "log.parquet", "log.npz", "ros.npz")
    return [*(tmp_path / name for name in names), json, ros, frame, dated, columns]


def test_a_clean_log_has_no_findings_and_is_the_same_for_every_question(model, tmp_path):
    """From ten sources: the numbers, the line about the source, and a run."""
    for source in clean(tmp_path):
        log = sc.Log(source)
        placed = log.placed(model)
        assert log.times == pytest.approx(TIMES, abs=1e-9)
        assert not placed.notes and placed.unread in ([], ["Unnamed: 0"])
        for key, values in TRUE.items():
            assert placed.arrays[key] == pytest.approx(values, abs=1e-12)
        run = sc.run(model, horizon=0.02, ctrl=source, record=("qpos", "qvel", "ctrl"))
        assert run.trajectory.qpos[0] == pytest.approx(QPOS[0], abs=1e-12)
        assert run.trajectory.qvel[0] == pytest.approx(QVEL[0], abs=1e-12)
        assert run.trajectory.ctrl[1] == pytest.approx(EFFORT[0] / [1, 2], abs=1e-12)
        assert "(312 ms at 125 Hz: position, velocity and torque of hip, knee)" in run.ran
        assert sc.run(model, horizon=0.02, follow=source).success
