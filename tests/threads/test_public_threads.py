"""Scenes rebuilt from public threads in which people asked for help: what is true of each is said.

The scenes are beside this file. What is true was measured in MuJoCo, or follows from a closed form.
"""

import importlib
import re
import warnings
from pathlib import Path
from unittest import mock

import pytest

import stepcore as sc
from stepcore.cli import main

FOLDER = Path(__file__).parent
# What the findings say, without the time step.
FOUND = {
    "friction8": ("102 mm deep", 'cone="elliptic" leaves 108 µm'),
    "friction1000": ("passes through", 'cone="elliptic" leaves none', "a friction of 1 on both"),
    "boxes": ("look like mm",),
    "cubedrop": ("`cube` passes through geom `table`", "leaves none that passes"),
    "cup fast": ("pass through geom `w6`", "4.68 mm in a step", 'solref="0.004 1"'),
    "frictionloss": ("creep at 2.02 mrad/s", 'solreffriction="0.004 1"', "leaves 38.7 µrad/s"),
    "fl": ("creep at 49.2 mrad/s", 'solimpfriction="0.99 0.999" leaves 942 µrad/s'),
    "friceq": ("friction loss of joint `B` lets the joint creep at",),
    "isaacfranka": ("sags by 227 mrad", "kp 1810"),
    "binpack": ("86 % of the thinner",),
    "worm02": ("MuJoCo refuses less",),
    "newtonball": ("turns joint `ball` on and on", "kv 1.46 of each leaves it at rest"),
    "hingeball": ("may make it explode", 'integrator="midpoint" leaves 0.1 %', 'integrator="rk4"'),
    "ur3e": ("joint's range in degrees", "multiply degrees by π/180"),
    "weldballs": ("gapes by 2.52 mm", "leaves 263 µm"),
    "backlash": (),
    "legweak": ("its kp 0.157 is too small for its load of 184 mN·m",),
    "legweak legweak.csv": ("servo `lf2_lf3` is 940 mrad RMS", "kp 5.2 and kv 0.106"),
    "fastsine sine10": ("follows 10 Hz with 75 % of the amplitude", "its force ends at 10 N·m"),
    "drone": ("4.88 N of thrust at most against 10.14 N of weight", "2.18× the gear of each"),
    "warehouse": ("63 bodies only rest", "a step with 3", "within 1 µm of its motion"),
    "wheelspd damping10": (),
    "decimation pd": ("motor `calf` can push joint `calf`",),
    "graspslip": ("slips out of its grip", "a friction of 1.44 on both geoms leaves it"),
    # A friction of 2 lets it slide out later.
    "grasplift": ("which the grip would carry at rest", "a friction of 4 on both geoms leaves it"),
    "gripshake shake": ("slips out of its grip", 'cone="elliptic" leaves it in the grip'),
    "quadkp20": ("falls over within 675 ms", "kp 40 of each leaves it standing"),
    "graspcreep": ("creeps at 4.23 mm/s", 'cone="elliptic" with impratio="500"'),
}
# What the whole answer says, with the time step: 2I/D of the wheels is 5.5 ms.
ANSWERED = {
    "wheelspd damping20": ("the run fails", "the 4 controls of motors", "limit dt to 5."),
    "wheelspd damping10": ("no problems found", "a step of 8.33 ms is stable"),
    "impedance impedance": ("the run fails", "controls of motors `t6`, `t7`", "limit dt to 1.5"),
    "decimation pd": ("a step of 5 ms is stable",),
    "tendonservo": ("a step of 10 ms", "servo `s`"),
    "robotiqloop": ("connect `right_loop`",),
    # A weight on light links: no spin is so fast.
    "cable": ("the run fails", "the motion as a whole limits dt to 298 µs", "no change that"),
    "masstendon": ("limits dt to 399 µs", "use integrator implicitfast"),
    "velservo": ("the 2 servos `wl`, `wr` together", "use integrator implicitfast", "change kv"),
}


def checked(case):
    """What `check` says of a scene, with a control function or a log after its name."""
    name, _, control = case.partition(" ")
    motion = {}
    if control.endswith(".csv"):
        motion = {"ctrl": str(FOLDER / control)}
    elif control:
        motion = {"control": getattr(importlib.import_module("controls"), control)}
    with warnings.catch_warnings():
        # What a load warns of is what the check says.
        warnings.simplefilter("ignore", sc.ModelWarning)
        warnings.simplefilter("ignore", sc.StiffnessWarning)
        warnings.simplefilter("ignore", sc.EnergyWarning)
        result = sc.check(str(FOLDER / f"{name}.xml"), progress=False, threads=1, **motion)
    return result, " ".join(result.sentences).lower()


@pytest.fixture(autouse=True)
def controls(monkeypatch):
    monkeypatch.syspath_prepend(str(FOLDER))


@pytest.mark.parametrize("case", FOUND)
def test_what_is_true_is_found(case):
    with mock.patch("stepcore.measure.check._diagnosis", return_value=(None, [])):
        result, said = checked(case)
    for words in FOUND[case]:
        assert words.lower() in said
    assert bool(result.findings) == bool(FOUND[case])
    # The servo of the hip is healthy; a gain of energy of 1e-8 J is no failure.
    assert "lf1_lf2" not in said and (case != "decimation pd" or not result.failed)


# Fields of elements as the answers above name them, and what must be true after some seconds.
CURED = {
    "friction8": ("cone=elliptic", 1.0, lambda sim: abs(sim.overlap - 108e-6) < 2e-6),
    "friction1000": ("cone=elliptic", 2.0, lambda sim: sim.qpos[2] > 0.4),
    "friceq": (
        "joint B solreffriction .004 1, joint B solimpfriction .9999 .9999 .001 .5 2",
        1.0,
        lambda sim: abs(sim.qpos[1]) < 1e-3,
    ),
    "cubedrop": (
        "geom * solref .004 1, geom * solimp .99 .99 .001 .5 2",
        5.0,
        lambda sim: sim.qpos[2] > 0.8,
    ),
    "legweak": (
        "actuator lf2_lf3 kp 11.7, actuator lf2_lf3 kv .159",
        2.0,
        lambda sim: abs(sim.qpos[1]) < 0.02,
    ),
    "graspslip": ("geom * friction 1.44 .005 .0001", 2.0, lambda sim: sim.qpos[5] > 0.3),
    "grasplift": ("geom * friction 4 .005 .0001", 1.0, lambda sim: sim.qpos[5] > 0.3),
    "quadkp20": ("actuator * kp 40", 3.0, lambda sim: sim.qpos[2] > 0.3),
    "masstendon": ("integrator=implicitfast", 2.0, lambda sim: abs(sim.qvel[0]) < 1e-6),
    "velservo": ("integrator=implicitfast", 4.0, lambda sim: abs(sim.qvel[6] - 5) < 0.01),
    "newtonball": ("actuator * kv 1.46", 10.0, lambda sim: abs(sim.qvel).max() < 1e-6),
    "hingeball": ("integrator=midpoint", 40.0, lambda sim: abs(sum(sim.energy) - 196.2) < 2),
}


@pytest.mark.filterwarnings(
    *(f"ignore::stepcore.{name}Warning" for name in ("Model", "Energy", "Stiffness"))
)
@pytest.mark.parametrize("name", CURED)
def test_a_cure_that_is_named_holds_when_it_is_made_by_hand(name):
    cure, time, holds = CURED[name]
    scene = sc.load(FOLDER / f"{name}.xml")
    settings = {}
    for change in cure.split(", "):
        if "=" in change:
            field, settings[field] = change.split("=")
            continue
        kind, which, field, *values = change.split()
        numbers = tuple(map(float, values))
        for element in getattr(scene, f"{kind}s"):
            if which in ("*", element.name):
                setattr(element, field, numbers if len(numbers) > 1 else numbers[0])
    cured, shipped = scene.with_settings(**settings), sc.load(FOLDER / f"{name}.xml")
    assert ends(cured, time, holds) and not ends(shipped, time, holds)


def ends(scene, time, holds):
    """Whether a law holds at the end of a run that holds the keyframe's controls."""
    sim = sc.Sim(scene)
    sim.reset(key=0 if sim.model.keys else None)
    try:
        sim.step(round(time / sim.settings.dt))
    except sc.SimulationError:
        return False
    return bool(holds(sim))


@pytest.mark.parametrize("case", ANSWERED)
def test_the_time_step_is_judged_on_the_motion_that_fails(case):
    result, said = checked(case)
    for words in ANSWERED[case]:
        assert words in said
    assert not (result.failed and "is stable under" in said)
    contradictions(said)


def test_a_limit_has_its_failure():
    """friceq.xml is chaotic under rk4: a step may hold beside one that fails."""
    found = sc.diagnose(str(FOLDER / "friceq.xml"), integrators=["rk4"], progress=False, threads=1)
    assert {limit.outcome for limit in found.limits.values()} <= {
        "diverges",
        "gains energy",
        "grows",
    }


# Two sentences that cannot both be true.
PAIRS = (
    (r"the run fails", r"is stable under"),
    (r"no problems found\.", r"a step of \S+ \S+ (explodes|chatters|rattles)"),
    (r"no element limits dt", r"limits dt to"),
    (r"stability does not limit dt", r"a step of \S+ \S+ (explodes|chatters|rattles)"),
    (r"limits and servos hold", r"(error|warning): "),
)
# Messages of checks within, which name what nobody typed.
INNER = r"Traceback|index = |must be a whole number|KeyError|TypeError|AssertionError|nan\b"


def contradictions(said):
    for one, other in PAIRS:
        assert not (re.search(one, said) and re.search(other, said)), (one, other)


@pytest.mark.long
@pytest.mark.parametrize("name", sorted(path.stem for path in FOLDER.glob("*.xml")))
@pytest.mark.parametrize(
    "command", ["check", "diagnose", "run", "trade", "tune", "predict", "plan", "ablate"]
)
def test_no_command_shows_what_is_inside_or_contradicts_itself(capsys, command, name):
    more = ["--bandwidth", "2"] if command == "tune" else []
    more += [] if command in ("run", "plan") else ["--seconds", "5"]
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        main([command, str(FOLDER / f"{name}.xml"), *more])
    said = capsys.readouterr()
    assert not re.search(INNER, said.out + said.err)
    contradictions(said.out.lower())
