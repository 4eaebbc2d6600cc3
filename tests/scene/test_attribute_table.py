"""The table of attributes: what an element class says of its fields holds where they are used."""

import pytest

from stepcore import Scene
from stepcore.mjcf.schema import ROOT
from stepcore.scene import elements
from stepcore.scene.element import field_rows
from stepcore.scene.elements.actuator_laws import LAWS

BODY = ROOT.children["worldbody"].children["body"]
# The elements of MJCF whose attributes are the fields of a class.
SPECS = {
    "Body": [BODY],
    "Joint": [BODY.children["joint"]],
    "Geom": [BODY.children["geom"]],
    "Site": [BODY.children["site"]],
    "Pair": [ROOT.children["contact"].children["pair"]],
    "Key": [ROOT.children["keyframe"].children["key"]],
    "Mesh": [ROOT.children["asset"].children["mesh"]],
    "MassRules": [ROOT.children["compiler"]],
    "LengthRange": [ROOT.children["compiler"].children["lengthrange"]],
    **{
        kind: list(ROOT.children[kind.lower()].children.values())
        for kind in ("Tendon", "Equality", "Actuator", "Sensor")
    },
}
# Fields that MJCF holds in other elements or in other attributes.
ELSEWHERE = {
    "Body": {"parent", "mass", "ipos", "iquat"},
    "Geom": {"body"},
    "Joint": {"body"},
    "Site": {"body"},
    "Sensor": {"type", "object", "reference"},
    "Equality": {"type"},
    "Actuator": {"type", "feeds", "current_rate"},
}


@pytest.mark.parametrize("kind", SPECS)
def test_a_field_is_an_attribute_of_its_element(kind):
    attributes = {name for spec in SPECS[kind] for name in spec.attrs}
    rows = field_rows(getattr(elements, kind)).values()
    fields = {row.name for row in rows if row.type.attribute is not None}
    assert fields - attributes == ELSEWHERE.get(kind, set())


@pytest.mark.parametrize("kind", [*SPECS, "HField"])
def test_the_documentation_of_a_class_gives_the_unit_of_each_field(kind):
    """But for "or": a hinge has rad where a slide has m."""
    text = " ".join(getattr(elements, kind).__doc__.split())
    for row in field_rows(getattr(elements, kind)).values():
        assert row.name in text, row.name
        for unit in row.unit.replace(" and ", " or ").replace(", ", " or ").split(" or "):
            assert unit == "1" or unit in text, (row.name, unit)


@pytest.mark.parametrize("kind", [kind for kind in LAWS if LAWS[kind].from_law])
def test_a_law_that_a_class_hands_down_is_that_of_the_fields(kind):
    """from_law gives the fields whose law is the same again, where none is a muscle's."""
    row = LAWS[kind]
    law = row.to_law(row.fields)
    again = row.to_law(row.fields | row.from_law(law))
    assert again == law or kind == "damper"


@pytest.mark.parametrize("kind", LAWS)
def test_a_general_actuator_can_have_any_law_without_a_controller(kind):
    row = LAWS[kind]
    values = row.fields | {"kp": 5.0, "dampratio": 0.5, "input": "pos"}
    if kind == "orientation":
        values["input"] = "expmap"
    law = row.to_law(values)
    assert LAWS["general"].to_law(law.general()) == law


@pytest.mark.parametrize("kind", ["pid", "dcmotor"])
def test_a_controller_has_no_input_of_an_orientation(kind):
    scene = Scene()
    body = scene.add_body("arm")
    scene.add_joint(body, "hinge", name="elbow")
    scene.add_geom(body, "sphere", 0.1)
    scene.add_actuator("elbow", kind, name="servo", motorconst=None, input="x")
    with pytest.raises(ValueError, match=f"\"servo\": input = 'x': must be .* for a {kind}"):
        scene.compile()
