"""The package's docstrings as Markdown, for the API reference.

A docstring explains arguments and fields as "name: text", one below another, with further lines
indented; names other public names in backquotes; and ends in examples. Here the first become a
list, the second links, and the third blocks of code.
"""

from __future__ import annotations

import ast
import re
from typing import Any

import griffe

ENTRY = re.compile(r"(\w+(?: \[[^\]]*\])?(?:, \w+(?: \[[^\]]*\])?)*): (.*)")
NAME = re.compile(r"(?<!`)`(\w+)(\.\w+)?`(?!`)")
PAGE = re.compile(r"docs/(\w+)\.md")
# What makes an attribute, which of its arguments explains it, and what it holds.
ARRAYS = {
    **dict.fromkeys(("StateArray", "readout", "constant"), (0, "NDArray")),
    "Entry": (1, "NDArray"),
    "element_names": (0, "tuple[str, ...]"),
    "number_of": (1, "int"),
}
UNIT = re.compile(r" \[[^\]]*\]")


class Docstrings(griffe.Extension):
    """Rewrites every docstring before it is shown."""

    def on_package(self, *, pkg: griffe.Module, **_: Any) -> None:
        """Called once, with the whole package."""
        # A public name is imported by the package; what it has of its own are its modules.
        public = {name for name, member in pkg.members.items() if member.is_alias}
        for module in _modules(pkg):
            _rewrite(module, public)
            if module.docstring:
                names = _known(module)
                module.docstring.value = markdown(module.docstring.value, names, public)


def _modules(module: griffe.Module) -> list[griffe.Module]:
    inside = [found for found in module.modules.values() if not found.is_alias]
    return [module, *(deeper for found in inside for deeper in _modules(found))]


def _rewrite(holder: Any, public: set[str]) -> None:
    """The docstrings of what a module or class holds."""
    for member in holder.members.values():
        if member.is_alias or member.is_module:
            continue
        if member.is_attribute:
            _explain_array(member)
        if member.is_class:
            _add_defaults(member)
            _explain_fields(member)
            _rewrite(member, public)
        if member.docstring:
            member.docstring.value = markdown(member.docstring.value, _known(member), public)


def _explain_array(attribute: griffe.Attribute) -> None:
    """Gives `qpos = StateArray("Positions …")` that text as its docstring."""
    value = attribute.value
    if isinstance(value, griffe.ExprCall) and str(value.function) in ARRAYS:
        index, annotation = ARRAYS[str(value.function)]
        text = value.arguments[index]
        attribute.docstring = griffe.Docstring(ast.literal_eval(str(text)))
        attribute.docstring.parent = attribute
        attribute.value = None
        attribute.annotation = annotation


def _add_defaults(holder: griffe.Class) -> None:
    """Says at each property of a compiled class which value its argument has by default."""
    made = holder.members.get("__new__")
    if not isinstance(made, griffe.Function):
        return
    for parameter in made.parameters:
        field = holder.members.get(parameter.name)
        if field and field.docstring and parameter.default is not None:
            default = str(parameter.default).replace("'", '"')
            field.docstring.value += f"\n\nDefault: `{default}`."


def _explain_fields(holder: griffe.Class) -> None:
    """Moves the entries of a class's docstring to the attributes that they explain."""
    if not holder.docstring:
        return
    kept: list[str] = []
    explained: list[griffe.Docstring] = []
    for line in _entries(holder.docstring.value, set(holder.members)):
        entry = ENTRY.fullmatch(line)
        fields = _attributes(holder, _names(entry))
        if entry and fields:
            explained = [griffe.Docstring(_capital(entry[2]), parent=field) for field in fields]
            for field, text in zip(fields, explained, strict=True):
                field.docstring = text
        elif explained and line.startswith("    "):
            for text in explained:
                text.value += "\n" + line.strip()
        else:
            explained = []
            kept.append(line)
    holder.docstring.value = "\n".join(kept)


def _attributes(holder: griffe.Class, names: list[str]) -> list[griffe.Attribute]:
    """The attributes of these names; none of them where one is no attribute."""
    members = [holder.members.get(UNIT.sub("", name)) for name in names]
    found = [member for member in members if isinstance(member, griffe.Attribute)]
    return found if len(found) == len(names) else []


def _entries(text: str, known: set[str]) -> list[str]:
    """The lines of a text; "name: … name: …" in one line are as many."""
    lines: list[str] = []
    for line in text.split("\n"):
        if ENTRY.fullmatch(line):
            parts = re.split(r"(?<=\.) (?=(\w+): )", line)
            lines.append(parts[0])
            for name, part in zip(parts[1::2], parts[2::2], strict=True):
                if name in known:
                    lines.append(part)
                else:
                    lines[-1] += f" {part}"
        else:
            lines.append(line)
    return lines


def _names(entry: re.Match[str] | None) -> list[str]:
    return entry[1].split(", ") if entry else []


def _capital(text: str) -> str:
    return text[:1].upper() + text[1:]


def _known(member: Any) -> set[str]:
    """The names that a docstring may explain: parameters and members."""
    known = set()
    if member.is_function or member.is_class:
        known |= {parameter.name.lstrip("*") for parameter in member.parameters}
    if member.is_class:
        known |= set(member.all_members)
    return known


def markdown(text: str, known: set[str], public: set[str]) -> str:
    """A docstring as Markdown.

    known: the names whose "name: text" is an entry. public: the names that have a page.
    """
    blocks = re.split(r"\n\s*\n", text)
    return "\n\n".join(_block(block, known, public) for block in blocks)


def _block(block: str, known: set[str], public: set[str]) -> str:
    if block.lstrip().startswith(">>>"):
        return f"```pycon\n{block}\n```"
    lines: list[str] = []
    for line in _entries(block, known):
        entry = ENTRY.fullmatch(line)
        if entry and {UNIT.sub("", name) for name in _names(entry)} <= known:
            if not lines or not lines[-1].startswith(("- ", "    ")):
                lines.append("")
            line = f"- **{entry[1]}**: {entry[2]}"
        lines.append(line)
    return _linked("\n".join(lines), public)


def _linked(text: str, public: set[str]) -> str:
    """Backquoted public names as links to their reference, and pages of the docs as links."""

    def linked(name: re.Match[str]) -> str:
        return f"[{name[0]}][stepcore.{name[1]}]" if name[1] in public else name[0]

    return PAGE.sub(r"[\1](../\1.md)", NAME.sub(linked, text))
