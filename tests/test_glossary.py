"""Prose uses the terms of CONTRIBUTING's glossary, and no more of other phrases than is allowed."""

import ast
import io
import re
import tokenize
import tomllib
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[1]
BUDGET = tomllib.loads((ROOT / "tests" / "budget.toml").read_text(encoding="utf-8"))
# Forms that six codebases of the field rarely use: scikit-learn's model_selection, scipy's ODE
# solvers, dm_control.mjcf, mujoco.sysid, httpx, attrs.
FORMS = {
    "tell": r"\b(?:tell|tells|told|telling)\b",
    "say": r"\b(?:say|says|said)\b",
    "ask": r"\b(?:ask|asks|asked)\b",
    "own": r"\bown\b",
    "that of": r"\b(?:that|those) of\b",
    "What": r"(?:^|[.:;] )What ",
    "known": r"\bknown\b",
    "stand": r"\b(?:stand|stands|stood)\b",
    "so many": r"\bso (?:many|much|far)\b",
}


def glossary():
    """The terms, and the phrases that each replaces."""
    text = (ROOT / "CONTRIBUTING.md").read_text(encoding="utf-8")
    table = text[text.index("| term | meaning | instead of |") :].split("\n\n")[0]
    rows = [re.split(r" *\| *", line.strip("| ")) for line in table.splitlines()[2:]]
    return {term: re.findall("`([^`]+)`", phrases) for term, _, phrases in rows}


def is_message(value):
    return isinstance(value, str) and len(value.split()) > 2


def prose_of_python(text):
    """(comments and docstrings, messages) of a module."""
    tokens = tokenize.generate_tokens(io.StringIO(text).readline)
    prose = [token.string.lstrip("# ") for token in tokens if token.type == tokenize.COMMENT]
    messages, documented = [], set()
    for node in ast.walk(ast.parse(text)):
        if isinstance(node, ast.Module | ast.ClassDef | ast.FunctionDef):
            prose.append(ast.get_docstring(node) or "")
            documented |= {id(node.body[0].value)} if ast.get_docstring(node) else set()
        elif isinstance(node, ast.Constant) and id(node) not in documented:
            messages += [node.value] if is_message(node.value) else []
    return prose, messages


def prose_of(file):
    text = file.read_text(encoding="utf-8")
    if file.suffix == ".py":
        return prose_of_python(text)
    if file.suffix == ".rs":
        return re.findall(r"^\s*//[/!]?\s?(.*)$", text, re.M), []
    return [re.sub(r"^```.*?^```", "", text, flags=re.M | re.S)], []


def files_of(room):
    return [file for file in sorted(ROOT.glob(room)) if file.suffix in (".py", ".rs", ".md")]


def count(forms, prose):
    text = " ".join(re.sub("`[^`]*`", "", part) for part in prose)
    return len(text.split()), {name: len(re.findall(form, text)) for name, form in forms.items()}


def test_the_glossary_is_a_list_of_terms():
    terms = glossary()
    phrases = [phrase for each in terms.values() for phrase in each]
    assert len(terms) >= 20 and len(set(phrases)) == len(phrases)
    assert not set(phrases) & set(terms)


@pytest.mark.parametrize("room", BUDGET["phrases"])
def test_no_room_has_more_replaced_phrases(room):
    """In comments, docstrings, messages and pages."""
    forms = {
        phrase: rf"\b{phrase}\b".replace(" ", r"\s+")
        for phrases in glossary().values()
        for phrase in phrases
    }
    text = [part for file in files_of(room) for kind in prose_of(file) for part in kind]
    _, found = count(forms, text)
    used = {name: number for name, number in found.items() if number}
    assert sum(used.values()) <= BUDGET["phrases"][room], used


@pytest.mark.parametrize("room", BUDGET["forms"])
def test_no_form_is_frequent(room):
    """Occurrences per 10,000 words of comments and docstrings; the sum over the forms."""
    words, found = count(FORMS, [part for file in files_of(room) for part in prose_of(file)[0]])
    rate = 1e4 * sum(found.values()) / max(words, 1)
    assert rate <= BUDGET["forms"][room], {
        name: round(1e4 * number / words, 1) for name, number in found.items()
    }
