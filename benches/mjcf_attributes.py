"""What becomes of every attribute of MuJoCo's schema: writes docs/mjcf_attributes.md.

    python benches/mjcf_attributes.py

The list is that of the schema in the installed MuJoCo. Each attribute is set to a value that is
not its default, in a scene where it matters (`attributes/`), and both engines run it: it is
honoured if the motion is MuJoCo's and another one than without it, has no effect if MuJoCo's motion
is the same, and is refused if reading it is an error. Anything else is a mistake, and nothing is
written.
"""

from __future__ import annotations

import sys
from pathlib import Path

import mujoco
from attributes.runs import SCENES, case_of, measured

from stepcore.mjcf.schema import ROOT, Spec
from stepcore.scene import elements
from stepcore.scene.element import Element, field_rows

PAGE = Path(__file__).parent.parent / "docs" / "mjcf_attributes.md"
# What the schema's text calls the elements of the tree, and those that stand outside of it.
TREE = "(world)body"
OUTSIDE = {
    "frame": "name childclass pos quat axisangle xyaxes zaxis euler scale scaling massscale",
    "replicate": "count sep offset euler",
    "include": "file",
}
# What a motion does not show, and the tests that do.
ELSEWHERE = {
    "compiler": dict.fromkeys(("meshdir", "assetdir", "strippath"), "test_mesh_files.py")
    | {"conflict": "test_expand.py", "autolimits": "test_mjcf_errors.py"},
    "asset/mesh": dict.fromkeys(("file", "content_type"), "test_mesh_files.py"),
    "option": {"sleep_tolerance": "test_sleep_as_in_mujoco.py"},
    "asset/hfield": dict.fromkeys(("file", "content_type"), "test_height_field_files.py"),
    "asset/model": dict.fromkeys(("file", "content_type"), "test_expand.py"),
    "attach": dict.fromkeys(("model", "body", "frame", "prefix"), "test_expand.py"),
    "replicate": {"sep": "test_expand.py"},
    "include": {"file": "test_mjcf_files.py"},
    "compiler/lengthrange": dict.fromkeys(
        [
            *("mode", "useexisting", "uselimit", "accel", "maxforce", "timeconst", "timestep"),
            *("inttotal", "interval", "tolrange"),
        ],
        "test_length_ranges.py",
    ),
}
# Of a sensor with a history: one that reads late or rarely is read past; else nobody asks for it.
LATE = {"nsample": "no effect", "interp": "no effect", "delay": "senses", "interval": "senses"}
DIRECTIONS = ("ballquat", "framequat", "framexaxis", "frameyaxis", "framezaxis")
# What cannot be tried alone: the state of flexes.
KNOWN = {
    "keyframe/key": {"plastic": "refused"},
    **{f"sensor/{tag}": LATE for tag in ROOT.children["sensor"].children},
    # MuJoCo refuses a cutoff of directions too.
    **{f"sensor/{tag}": {"cutoff": "refused"} | LATE for tag in DIRECTIONS},
    "sensor/rangefinder": {"camera": "senses"} | LATE,
    "sensor/insidesite": {"enclosed": "senses"} | LATE,
}
ROLES = {"draws": "only draws", "senses": "senses", "data": "data", "unbuilt": "refused"}
# The element class whose fields are attributes of an element, by path.
CLASSES: dict[str, type[Element]] = {
    **{"body": elements.Body, "joint": elements.Joint, "geom": elements.Geom},
    **{"site": elements.Site, "contact/pair": elements.Pair, "keyframe/key": elements.Key},
    **{"compiler": elements.MassRules, "compiler/lengthrange": elements.LengthRange},
    **{"asset/mesh": elements.Mesh, "asset/hfield": elements.HField},
}
SECTIONS: dict[str, type[Element]] = {
    **{"tendon": elements.Tendon, "equality": elements.Equality},
    **{"actuator": elements.Actuator, "sensor": elements.Sensor},
}
COLUMNS = ("honoured", "no effect", "only draws", "senses", "data", "refused")
TEXT = """# Every attribute of MJCF

From the schema of MuJoCo {version}, by `python benches/mjcf_attributes.py`, which sets each
attribute to a value that is not its default in a scene where it matters, and runs that scene here
and in MuJoCo:

- **honoured**: the motion is MuJoCo's, and it differs from the motion without the attribute. Names
  are honoured too.
- **no effect**: MuJoCo's motion is the same with and without the attribute. It is read and checked.
- **only draws**, **senses**, **data**: the element is listed in `Scene.ignored` and not simulated.
  A sensor is listed only if it has this attribute.
- **refused**: an error with file and line says how the attribute would change the motion. It can be
  left out: `load(path, without=["joint/springyield"])`, `--without joint/springyield`
  ([refusals](#refusals)).

An attribute of a default class is treated as the same attribute of the element. Units and defaults
are given for attributes that are fields of an element class (`stepcore.Joint` and so on). Units are
those of the fields; a file gives angles in degrees, unless it has `<compiler angle="radian"/>`.

Of {count} attributes {counts}.

{table}

## Refusals

An error lists everything that is wrong with a file or not built yet, one line for each:

    robot.xml:12: <flexcomp> in <body> is not built yet: its points move, … (also in line 15)
    robot.xml:40: a spring that yields (springyield) is not built yet: the spring of the …
    without=["worldbody/flexcomp", "joint/springyield"] leaves these things out; trade(…)

`without` takes a section (`contact`, `tendon`, `equality`, `actuator`, `sensor`, `keyframe`), an
element (`weld`, or `actuator/muscle` where a name is ambiguous), an attribute
(`joint/springyield`), `flex` or `plugin`. Elements that refer to a removed one are removed too, and
a keyframe keeps the controls of the actuators that stay. `Scene.notes` says what this changes, and
every result names it in its motion: "…; law solref; without flex (2)".

Reasons for the refusals:

- **flex, plugins, skins that move**: another kind of body, and code outside the file.
- **flags**: `ipc` solves the contacts of flexes. `diagexact` gives rows another softness, and
  `speculative` adds contacts before shapes meet: options that change MuJoCo's own motion.
- **as MuJoCo does**: a sensor's `cutoff` of axes and quaternions.
- **not built yet**: an `orientation` of a site (that of a ball is built); springs that yield, and
  their state in keyframes (`plastic`); scaled frames; an `<attach>` of a part of the same model.
  Sensors that read late or rarely are not computed.

`<replicate>`, `<attach>`, builtin meshes, `align="true"`, `alignfree` and `discardvisual` need
MuJoCo (`pip install ".[mujoco]"` in a clone), which writes such a file as plain MJCF. `load` checks
the file and all that it attaches first. Elements of the expanded file that have no name have the
line of the element around them.
"""


def schema() -> dict[str, list[str]]:
    """The attributes of every element, by path, but for default classes."""
    tree: dict[str, list[str]] = {}
    path: list[str] = []
    for line in mujoco.mj_printSchema(False, False).splitlines():
        words = line.split()
        if not words:
            continue
        indent = len(line) - len(line.lstrip())
        if indent < 28:
            path = [*path[: indent // 3], words[0]]
            words = line[28:].split()
        if path[1:2] != ["default"]:
            tree.setdefault("/".join(path[1:]), []).extend(words)
    found = {_short(name): attributes for name, attributes in tree.items() if name}
    return found | {name: words.split() for name, words in OUTSIDE.items()}


def _short(path: str) -> str:
    return "body" if path == TREE else path.removeprefix(f"{TREE}/")


def spec_of(path: str) -> Spec | None:
    """Our own element of this path."""
    for root in (ROOT, ROOT.children["worldbody"]):
        found: Spec | None = root
        for tag in path.split("/"):
            found = found.children.get(tag) if found else None
        if found is not None:
            return found
    return ROOT.children["worldbody"].children["body"].children.get(path)


def mark(path: str, attribute: str) -> tuple[str, str]:
    """(what becomes of an attribute, what is wrong with that)."""
    if attribute in ELSEWHERE.get(path, {}):
        return "honoured", ""
    spec = spec_of(path)
    if spec is None or attribute not in spec.attrs:
        if path == "composite" or (spec is None and _refused_above(path)):
            return "refused", ""
        return "honoured", f"{path} {attribute}: not in our schema"
    role = _refused_above(path) or spec.role
    if role:
        return ROLES[role], ""
    if attribute in ("name", "class"):
        return "honoured", ""
    if attribute in KNOWN.get(path, {}):
        return KNOWN[path][attribute], ""
    case = case_of(path, attribute)
    if path not in SCENES or case is None:
        return "honoured", f"{path} {attribute}: no case"
    outcome = measured(path, attribute, case)
    if outcome.word in COLUMNS:
        return outcome.word, ""
    return "honoured", f"{path} {attribute}: {outcome.word}: {outcome.text}"


def _refused_above(path: str) -> str:
    """The role of an element that holds this one."""
    parts = path.split("/")
    above = [spec_of("/".join(parts[:count])) for count in range(1, len(parts))]
    return next((spec.role for spec in above if spec is not None and spec.role), "")


def value_of(path: str, attribute: str) -> str:
    """What an attribute holds, in words."""
    spec = spec_of(path)
    notation = "" if spec is None else spec.attrs.get(attribute, "")
    if not notation or "|" in notation:
        return notation.replace("|", ", ") or "text"
    kind = "integer" if notation.startswith("int") else "number"
    count = notation.removeprefix("int").replace("-", " to ") or "1"
    return f"{kind}s" if count == "*" else f"{count} {kind}{'s' * (count != '1')}"


def field_of(path: str, attribute: str) -> tuple[str, str]:
    """The unit and the default of an attribute that is a field of an element class."""
    kind = CLASSES.get(path, SECTIONS.get(path.partition("/")[0]))
    row = None if kind is None else field_rows(kind).get(attribute)
    spec = spec_of(path)
    if row is None or row.type.attribute is None or spec is None or attribute not in spec.attrs:
        return "", ""
    default = row.checked
    if default is None or default == "" or row.type.refers or attribute in spec.required:
        return row.unit, ""
    numbers = default if isinstance(default, tuple) else (default,)
    words = [f"{x:g}" if isinstance(x, float) else str(x) for x in numbers]
    return row.unit, " ".join(words).replace("True", "true").replace("False", "false")


def page() -> tuple[str, list[str]]:
    """The text of the page, and what is wrong."""
    wrong: list[str] = []
    columns = ("element", "attribute", "value", "unit", "default", "here")
    lines = [f"| {' | '.join(columns)} |", "|---" * len(columns) + "|"]
    counts = dict.fromkeys(COLUMNS, 0)
    for path, attributes in schema().items():
        for attribute in attributes:
            word, mistake = mark(path, attribute)
            counts[word] += 1
            wrong += [mistake] if mistake else []
            cells = (value_of(path, attribute), *field_of(path, attribute), word)
            lines.append(f"| `{path}` | {attribute} | {' | '.join(cells)} |")
    said = ", ".join(f"{count} {word}" for word, count in counts.items() if count)
    text = TEXT.format(
        version=mujoco.__version__,
        count=sum(counts.values()),
        counts=said,
        table="\n".join(lines),
    )
    return text, wrong


def main() -> int:
    text, wrong = page()
    for line in wrong:
        print(line, file=sys.stderr)
    if wrong:
        return 1
    PAGE.write_text(text)
    return 0


if __name__ == "__main__":
    sys.exit(main())
