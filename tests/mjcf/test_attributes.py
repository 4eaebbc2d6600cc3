"""No attribute of MJCF makes a silent difference: each is honoured, without effect, or refused."""

import re

import mjcf_attributes
import pytest
from attributes.runs import models
from attributes.scenes import SCENES

from stepcore import loads
from stepcore.mjcf.nodes import MJCFError
from stepcore.mjcf.schema import ROOT

# Values that matter are stiff ones too.
pytestmark = pytest.mark.filterwarnings("ignore::stepcore.StiffnessWarning")


def test_every_attribute_is_what_the_page_says() -> None:
    """After a change: python benches/mjcf_attributes.py."""
    text, wrong = mjcf_attributes.page()
    assert wrong == []
    page = mjcf_attributes.PAGE.read_text().splitlines()
    assert page == text.splitlines()


# (path, the element of a default class) where one stands for the other.
CLASSES = {
    **{tag: tag for tag in ("joint", "geom", "site")},
    **{f"contact/{tag}": tag for tag in ("pair",)},
    **{f"equality/{tag}": "equality" for tag in ("connect", "weld", "joint", "tendon")},
    **{f"tendon/{tag}": "tendon" for tag in ("fixed", "spatial")},
    **{path: path.partition("/")[2] for path in SCENES if path.startswith("actuator/")},
}
# What a class of motors needs, in MuJoCo too.
MOTOR = {"motorconst": ".5", "resistance": "1"}
# What a class does to other attributes of its actuator, or hands down with them alone: gains.py,
# controllers.py.
GAINS = {"inheritrange", "nominal", "imax"}


def held(text: str, place: int) -> set[str]:
    """The attributes of the element whose tag ends at this place."""
    return set(re.findall(r'(\w+)="', text[place : text.index(">", place)]))


@pytest.mark.parametrize("path", [path for path in CLASSES if "," not in path])
def test_an_attribute_of_a_class_is_that_of_the_element(path: str) -> None:
    default = ROOT.children["default"].children[CLASSES[path]]
    scene, tag = SCENES[path], path.rpartition("/")[2]
    for attribute in mjcf_attributes.schema().get(path, []):
        case = mjcf_attributes.case_of(path, attribute)
        if case is None or attribute not in default.attrs or attribute in GAINS:
            continue
        if (path, attribute) == ("actuator/general", "input"):
            # Discarded where the gain type is another one.
            continue
        base, tried = models(path, attribute, case)
        value = case if isinstance(case, str) else case[0]
        motor = MOTOR if path == "actuator/dcmotor" else {}
        more = " ".join(f'{name}="{x}"' for name, x in motor.items() if name != attribute)
        own = f'<{CLASSES[path]} {attribute}="{value}" {more}/>'
        classes = f'<default><default class="own">{own}</default></default>'
        # The element is where the two texts part.
        start = next(i for i, (a, b) in enumerate(zip(base, tried, strict=False)) if a != b)
        start = base.rindex(f"<{tag}", 0, start + 1)
        place = start + len(tag) + 1
        rest = re.sub(f' {attribute}="[^"]*"', "", base[place:], count=1)
        if attribute not in held(base, place):
            rest = base[place:]
        named = f'{base[:place]} class="own"{rest}'
        named = named.replace("<worldbody>", f"{classes}<worldbody>", 1)
        try:
            scene = loads(tried)
        except MJCFError:
            continue
        assert loads(named) == scene, (path, attribute)


def test_an_empty_material_takes_back_that_of_the_class() -> None:
    """Converters of URDFs write it so; the class names a material that the file lacks."""
    geom = '<geom class="v" size="1" material=""/>'
    body = f'<body><joint type="slide"/>{geom}</body>'
    classes = '<default><default class="v"><geom material="none"/></default></default>'
    text = f"<mujoco>{classes}<worldbody>{body}</worldbody></mujoco>"
    assert len(loads(text).geoms) == 1
    with pytest.raises(MJCFError, match='material="none": no such material'):
        loads(text.replace(' material=""', ""))
