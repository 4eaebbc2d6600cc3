"""`<custom><text name="stepcore" data="…"/>`: settings and features that MJCF cannot express.

The data are words "name=value", separated by blanks: settings (``integrator=midpoint``), features
without an MJCF flag, and ``unnamed=body/body_3,joint/joint_1``. The last word lists elements that
have a name in the file only because MJCF refers by name. MuJoCo ignores the text.
"""

from __future__ import annotations

import re
from collections.abc import Iterable, Mapping
from typing import TYPE_CHECKING, Any

from stepcore.checks import nearest
from stepcore.mjcf.nodes import Node
from stepcore.mjcf.schema import OWN_FEATURES

if TYPE_CHECKING:
    from stepcore.scene.scene import Scene

NAME = "stepcore"
# Kinds of elements that references can name.
KINDS = ("geom", "site", "body", "joint", "tendon", "actuator", "mesh", "hfield")
_WHOLE = re.compile(r"[+-]?\d+", re.ASCII)
_REAL = re.compile(r"[+-]?(\d+\.?\d*|\.\d+)([eE][+-]?\d+)?", re.ASCII)


def ours(node: Node) -> bool:
    """Return whether a node is stepcore's own text."""
    return node.tag == "text" and node.attrs.get("name") == NAME


def data(words: Mapping[str, Any], unnamed: Iterable[tuple[str, str]] = ()) -> str:
    """Return the data of the text for these settings and features; "" if there are none.

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
    if _WHOLE.fullmatch(text) and len(text) < 20:
        return int(text)
    return float(text) if _REAL.fullmatch(text) else text


def own_texts(nodes: Iterable[Node]) -> list[Node]:
    """Return stepcore's own text as a list of at most one node; raise MJCFError for a second."""
    texts = [node for node in nodes if ours(node)]
    if len(texts) > 1:
        raise texts[1].error(f'a second <text name="{NAME}">')
    return texts


def read(scene: Scene, node: Node) -> None:
    """Read stepcore's own text into a scene that is otherwise complete."""
    from stepcore._core import Settings

    settings: dict[str, Any] = {}
    known = Settings().as_dict()
    seen = set()
    for word in node.attrs.get("data", "").split():
        name, equals, text = word.partition("=")
        if not equals or not text:
            raise node.error(f'<text name="{NAME}"> has the word "{word}": must be name=value')
        if name in seen:
            raise node.error(f'<text name="{NAME}"> has {name} twice')
        seen.add(name)
        if name == "unnamed":
            _unname(scene, node, text)
        elif name in OWN_FEATURES:
            setattr(scene.features, name, _value(text))
        elif name in known:
            settings[name] = _value(text)
        else:
            near = nearest(name, [*known, *OWN_FEATURES, "unnamed"])
            raise node.error(f'<text name="{NAME}"> has an unknown name "{name}"{near}')
    whole = Settings(**(scene.options | settings)).as_dict()
    scene.options.update({name: whole[name] for name in settings})


def _unname(scene: Scene, node: Node, text: str) -> None:
    for word in text.split(","):
        kind, _, name = word.partition("/")
        if kind not in KINDS:
            kinds = ", ".join(f'"{kind}/name"' for kind in KINDS)
            raise node.error(f"unnamed={word}: must be one of {kinds}")
        element = getattr(scene, kind)(name)
        element.name = ""
