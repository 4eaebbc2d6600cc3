"""The settings of a scene in MJCF: `<option>` with its flags, and what MJCF cannot express.

`<custom><text name="stepcore" data="…"/>` has words "name=value", separated by blanks: settings
(``integrator=midpoint``), features without an MJCF flag, and ``unnamed=body/body_3,joint/joint_1``,
which lists elements that have a name in the file only because MJCF refers by name. MuJoCo ignores
the text.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping
from typing import TYPE_CHECKING, Any

from stepcore._core import Settings
from stepcore.checks import nearest
from stepcore.mjcf.nodes import OWN_TEXT, Node, is_own_text
from stepcore.mjcf.schema import FLAGS_OFF, OWN_FEATURES
from stepcore.mjcf.validation import INT, REAL, bad
from stepcore.scene.elements import WHOLE

if TYPE_CHECKING:
    from stepcore.scene.scene import Scene

# The MJCF attribute of each setting; for a word, the setting for each of MJCF's words.
_SETTINGS: dict[str, tuple[str, dict[str, str] | None]] = {
    "dt": ("timestep", None),
    "integrator": (
        "integrator",
        {word: word.lower() for word in ("Euler", "RK4", "implicitfast", "implicit", "discrete")},
    ),
    "solver": ("solver", {"PGS": "pgs", "Newton": "newton", "CG": "newton"}),
    "sweeps": ("iterations", None),
    "cone": ("cone", {"pyramidal": "pyramidal", "elliptic": "elliptic"}),
    **{name: (name, None) for name in ("impratio", "noslip_iterations", "sleep_tolerance")},
    "cost_tolerance": ("tolerance", None),
    "noslip_tolerance": ("noslip_tolerance", None),
}
_FLAGS = {"warm_start": "warmstart", "refsafe": "refsafe", "sleep": "sleep"}
# For each attribute: the test of a value, and the limit in words.
_POSITIVE, _NOT_NEGATIVE = (lambda value: value > 0), (lambda value: value >= 0)
_LIMITS: dict[str, tuple[Callable[[Any], bool], str]] = {
    "timestep": (_POSITIVE, "> 0 s"),
    **dict.fromkeys(("density", "viscosity", "iterations"), (_NOT_NEGATIVE, ">= 0")),
    "impratio": (_POSITIVE, "> 0"),
    "sleep_tolerance": (_NOT_NEGATIVE, ">= 0 m/s"),
    **dict.fromkeys(("tolerance", "noslip_tolerance"), (_NOT_NEGATIVE, ">= 0")),
}
# A time step from which on milliseconds are likely [s]: the longest in about 90 files is 0.02.
LONG = 0.5
# Ignored attributes, which do not change the converged motion.
IGNORED = {
    "ls_tolerance": "the line search is exact",
    "ls_iterations": "the line search is exact",
}
# Flags without effect in stepcore, with the reason.
FLAG_NOTES = {
    "midphase": "it decides how pairs are found, not which",
    "autoreset": "a diverged step is always an error",
    "nativeccd": "no general convex collider is used",
    "multiccd": "no general convex collider is used",
    "island": "it decides how rows are grouped, not their solution",
    "energy": "energy can always be read",
    "fwdinv": "it is a check within MuJoCo",
    "invdiscrete": "inverse dynamics are always those of continuous time",
}
SLEEP_NOTE = (
    'flag sleep="enable": trees sleep by MuJoCo\'s rule; sensors of what sleeps are computed as if '
    "it were awake, where MuJoCo's keep their last values"
)
# The attributes "o_margin", "o_solref", …, which the flag "override" turns on.
OVERRIDES = ("margin", "solref", "solimp", "friction")
FLAGS_UNBUILT = ("diagexact", "ipc", "speculative")
# The number of slow steps after which MuJoCo lets a tree sleep (mjMINAWAKE).
SLOW_STEPS = 10


def read_option(scene: Scene, node: Node) -> None:
    """Read an option section into `scene`; a later section overrides an earlier one."""
    values, options = node.values, scene.options
    for name, (fits, limit) in _LIMITS.items():
        if name in values and not fits(values[name]):
            raise bad(node, name, values[name], limit)
    for name in WHOLE:
        if name in values:
            setattr(scene, name, values[name])
    for setting, (name, words) in _SETTINGS.items():
        if name in values:
            options[setting] = words[values[name]] if words else values[name]
    if values.get("timestep", 0.0) >= LONG:
        dt = values["timestep"]
        _note(scene, node, f"timestep {dt:g} is in seconds; {dt:g} ms is {dt / 1000:g}")
    if values.get("solver") == "CG":
        _note(scene, node, "solver CG -> newton (the same minimum)")
    if "noslip_iterations" in values:
        # In MuJoCo a negative number means 0.
        options["noslip_iterations"] = max(values["noslip_iterations"], 0)
    for name in OVERRIDES:
        # The parameters that every contact has if the flag "override" is on.
        if f"o_{name}" in values:
            vector, old = values[f"o_{name}"], getattr(scene.contact_override, name)
            # A shorter list replaces only the first entries.
            vector = (*vector, *old[len(vector) :]) if isinstance(vector, tuple) else vector
            setattr(scene.contact_override, name, vector)
    for name, why in IGNORED.items():
        if name in values:
            _note(scene, node, f"{name} is ignored: {why}")
    for group in values.get("actuatorgroupdisable", ()):
        if not 0 <= group <= 30:
            raise bad(node, "actuatorgroupdisable", group, "groups from 0 to 30")
    for child in node.children:
        _flags(scene, child)


def resolve_options(scene: Scene, nodes: list[Node]) -> None:
    """Convert what depends on several options after all sections are read.

    These are what MuJoCo's PGS and noslip have by default, and its sleep rule, which counts steps.

    nodes: the option sections.
    """
    scene.options = {**implied(scene.options), **scene.options}
    if not scene.options.get("sleep"):
        return
    flags = [child for node in nodes for child in node.children if "sleep" in child.values]
    if scene.options.get("integrator") == "rk4":
        scene.options["sleep"] = False
        _note(scene, flags[-1], 'flag sleep="enable" is ignored under RK4: nothing sleeps')
        return
    scene.options["sleep_time"] = SLOW_STEPS * scene.options.get("dt", Settings().dt)
    _note(scene, flags[-1], SLEEP_NOTE)


def implied(options: Mapping[str, Any]) -> dict[str, Any]:
    """Return the settings of MuJoCo's PGS and noslip, if requested, that a file does not set."""
    values: dict[str, Any] = {}
    if options.get("solver") == "pgs":
        values |= {"acceleration": "momentum", "cost_tolerance": 1e-8}
    if options.get("noslip_iterations", 0) > 0:
        values["noslip_tolerance"] = 1e-6
    return values


def _flags(scene: Scene, node: Node) -> None:
    settings = {flag: setting for setting, flag in _FLAGS.items()}
    for name, word in node.values.items():
        on = word == "enable"
        if name in settings:
            scene.options[settings[name]] = on
        elif name == "override":
            scene.contact_override.enable = on
        elif name in FLAGS_UNBUILT:
            if on:
                raise node.unbuilt(f'the flag "{name}"', name)
        elif name in FLAG_NOTES:
            if on == (name in FLAGS_OFF):
                _note(scene, node, f'flag {name}="{word}" has no effect: {FLAG_NOTES[name]}')
        else:
            setattr(scene.features, name, on)


def _note(scene: Scene, node: Node, text: str) -> None:
    scene.notes.append(f"{node.file}:{node.line}: {text}")


def to_say(settings: Settings) -> dict[str, Any]:
    values = settings.as_dict()
    unsaid = {**Settings().as_dict(), **implied(values)}
    if settings.sleep:
        unsaid["sleep_time"] = SLOW_STEPS * settings.dt
    return {name: value for name, value in values.items() if value != unsaid[name]}


def as_option(values: Mapping[str, Any]) -> tuple[dict[str, str], dict[str, str], dict[str, Any]]:
    """Split settings into attributes of ``<option>``, flags, and settings that MJCF lacks."""
    attributes, flags, rest = {}, {}, {}
    for name, value in values.items():
        attribute, words = _SETTINGS.get(name, ("", None))
        word = next((word for word, setting in (words or {}).items() if setting == value), "")
        if name in _FLAGS:
            flags[_FLAGS[name]] = "enable" if value else "disable"
        elif word:
            attributes[attribute] = word
        elif attribute and not words and not isinstance(value, str) and value < 2**31:
            attributes[attribute] = shortest(value)
        elif (name, value) == ("solver", "cg"):
            # MuJoCo has cg as a separate solver.
            attributes[name] = "CG"
        else:
            rest[name] = value
    return attributes, flags, rest


def shortest(number: float) -> str:
    """Return the shortest decimal text that reads back as exactly this number."""
    text = repr(number)
    return text[:-2] if text.endswith(".0") else text


# Kinds of elements that references can name.
NAMED_KINDS = ("geom", "site", "body", "joint", "tendon", "actuator", "mesh", "hfield")


def own_data(words: Mapping[str, Any], unnamed: Iterable[tuple[str, str]] = ()) -> str:
    """Return the own_data of the text for these settings and features; "" if there are none.

    words: settings and features by name.
    unnamed: (kind, name) of elements without a name in the scene.
    """
    parts = [f"{name}={_word(value)}" for name, value in words.items()]
    names = [f"{kind}/{name}" for kind, name in unnamed]
    return " ".join([*parts, *(["unnamed=" + ",".join(names)] if names else [])])


def _word(value: Any) -> str:
    if isinstance(value, bool):
        return "true" if value else "false"
    return repr(value) if isinstance(value, float) else str(value)


def _value(text: str) -> Any:
    if text in ("true", "false"):
        return text == "true"
    if INT.fullmatch(text) and len(text) < 20:
        return int(text)
    return float(text) if REAL.fullmatch(text) else text


def own_texts(nodes: Iterable[Node]) -> list[Node]:
    """Return stepcore's text as a list of at most one node; raise MJCFError for a second."""
    texts = [node for node in nodes if is_own_text(node)]
    if len(texts) > 1:
        raise texts[1].error(f'a second <text name="{OWN_TEXT}">')
    return texts


def read_own_text(scene: Scene, node: Node) -> None:
    """Read stepcore's text into a scene that is otherwise complete."""
    settings: dict[str, Any] = {}
    defaults = Settings().as_dict()
    seen = set()
    for word in node.attrs.get("data", "").split():
        name, equals, text = word.partition("=")
        if not equals or not text:
            raise node.error(f'<text name="{OWN_TEXT}"> has the word "{word}": must be name=value')
        if name in seen:
            raise node.error(f'<text name="{OWN_TEXT}"> has {name} twice')
        seen.add(name)
        if name == "unnamed":
            for part in text.split(","):
                kind, _, name = part.partition("/")
                if kind not in NAMED_KINDS:
                    kinds = ", ".join(f'"{kind}/name"' for kind in NAMED_KINDS)
                    raise node.error(f"unnamed={part}: must be one of {kinds}")
                getattr(scene, kind)(name).name = ""
        elif name in OWN_FEATURES:
            setattr(scene.features, name, _value(text))
        elif name in defaults:
            settings[name] = _value(text)
        else:
            near = nearest(name, [*defaults, *OWN_FEATURES, "unnamed"])
            raise node.error(f'<text name="{OWN_TEXT}"> has an unknown name "{name}"{near}')
    complete = Settings(**(scene.options | settings)).as_dict()
    scene.options.update({name: complete[name] for name in settings})
