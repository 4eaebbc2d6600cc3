"""Wrong arguments are one line that names the argument, its value and the limit."""

import pytest

import stepcore as sc
from stepcore import checks, lesson


@pytest.fixture(scope="module")
def model():
    return lesson.spring().compile()


def one_line(call, words):
    with pytest.raises(ValueError, match=words) as caught:
        call()
    assert "\n" not in str(caught.value) and len(str(caught.value)) < 300


@pytest.mark.parametrize(
    ("options", "words"),
    [
        ({"starts": 1.5}, "starts = 1.5: must be a whole number"),
        ({"starts": "8"}, "starts = '8'"),
        ({"seed": -1}, "seed = -1"),
        ({"threads": 0.5}, "threads = 0.5"),
        ({"budget": "much"}, "budget = 'much'"),
        ({"effort": "much"}, "effort = 'much'"),
        ({"horizon": "long"}, "horizon = 'long'"),
        ({"horizon": [1]}, r"horizon = \[1\]"),
        ({"control_dt": "a"}, "control_dt = 'a'"),
        ({"dts": ["a"]}, "dts = 'a'"),
        ({"dts": []}, r"dts = \[\]: must be a list of at least one value"),
        ({"integrators": "rk4"}, "integrators = 'rk4': must be a list"),
        ({"integrators": {"rk4": 1}}, "integrators = "),
        ({"solvers": [3]}, "solver = 3"),
        ({"sweeps": [1.5], "solvers": ["pgs"]}, "sweeps = 1.5"),
        ({"key": "zzz"}, 'no key is named "zzz"; known: "start"'),
        ({"key": ["home"]}, r"key = \['home'\]"),
        ({"ctrl": "abc"}, "abc: must end in .csv"),
        ({"control": 3}, r"control = 3: must be a function of \(time, sim\)"),
        ({"control": lambda time: 0}, r"must be a function of \(time, sim\)"),
        ({"progress": 4}, "progress = 4"),
    ],
)
def test_of_a_trade(model, options, words):
    one_line(lambda: sc.trade(model, **options), words)


@pytest.mark.parametrize("wrong", [None, 3, [1], {}])
def test_of_what_is_traded_swept_or_loaded(wrong):
    one_line(lambda: sc.trade(wrong), "model = ")
    one_line(lambda: sc.sweep(wrong, {"dt": [0.1]}, float), "make_or_model = ")
    one_line(lambda: sc.load(wrong), "path = ")


@pytest.mark.parametrize(
    ("grid", "measure", "options", "words"),
    [
        ({"dt": 0.01}, float, {}, r"grid\['dt'\] = 0.01: must be a list"),
        ({"integrator": "rk4"}, float, {}, r"grid\['integrator'\] = 'rk4': must be a list"),
        ([1], float, {}, "grid = "),
        ({"dt": [0.01]}, 3, {}, "measure = 3: must be a function"),
        ({"dt": [0.01]}, lambda: 0, {}, r"must be a function of \(sim\)"),
        ({"dt": [0.01]}, float, {"threads": "two"}, "threads = 'two'"),
        ({"dt": [0.01]}, float, {"executor": 3}, "executor = 3"),
        ({"dtt": [0.01]}, float, {}, 'no "dtt"; nearest'),
        ({"joint/sprin/stiffness": [1]}, float, {}, 'no joint is named "sprin"; nearest: "spring"'),
        ({"joint/spring/stifness": [1]}, float, {}, 'nearest: "stiffness"'),
        ({"joints/spring/stiffness": [1]}, float, {}, 'nearest: "joint"'),
    ],
)
def test_of_a_sweep(model, grid, measure, options, words):
    one_line(lambda: sc.sweep(model, grid, measure, **options), words)


def test_a_bad_value_is_still_the_failure_of_its_point(model):
    table = sc.sweep(model, {"joint/spring/damping": [0.1, "x"]}, lambda sim: sim.time, threads=1)
    assert table["failure"][0] is None and "damping = 'x'" in table["failure"][1]


def test_of_best(model):
    result = sc.trade(model, horizon=0.08, dts=[0.01], starts=1, progress=False)
    one_line(lambda: result.best(error="a"), "error = 'a'")
    one_line(lambda: result.best(error=float("nan")), "error = nan")


def test_an_unknown_field_is_the_same_error_everywhere(model):
    one_line(lambda: sc.Scene().add_geom(frction=1), 'no field "frction"; nearest: "friction"')
    one_line(lambda: sc.Sim(model, dT=1), 'no argument "dT"; nearest: "dt"')


def test_where_nothing_is_near_what_exists_is_listed():
    assert checks.nearest("dampng", ["damping", "mass"]) == '; nearest: "damping"'
    assert checks.nearest("RK5", ["rk4", "euler"]) == '; nearest: "rk4"'
    assert checks.nearest("zzz", ["a", "", "b"]) == '; known: "a", "b"'
    assert checks.nearest("zzz", []) == "; known: none"
    many = checks.nearest("zzz", [f"body{i}" for i in range(25)])
    assert many.count('"') == 20 and many.endswith("and 15 more")


def test_load_takes_what_the_command_line_takes():
    assert sc.load("lesson:stack").name == "stack"
    with pytest.raises(ValueError, match="spring, drop, stack, grasp"):
        sc.load("lesson:stak")
    with pytest.raises(FileNotFoundError):
        sc.load("no_such_file.xml")
    assert sc.load("gymnasium:ant").compile().nu == 8
    with pytest.raises(ValueError, match='nearest: "ant"'):
        sc.load("gymnasium:antt")
