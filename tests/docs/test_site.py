"""The documentation site: every public name has its place, every page stands in its order.

That it builds without a warning is a step of .ci/run.
"""

import ast
import re
from pathlib import Path

import benchmarks
import links
import photograph

import stepcore as sc
from stepcore import gymnasium, jax, testing, torch
from stepcore.gymnasium import adapters
from stepcore.viewing.frames import rms_distance

ROOT = Path(__file__).parents[2]
DOCS = ROOT / "docs"
API = "\n".join(path.read_text(encoding="utf-8") for path in (DOCS / "api").glob("*.md"))
DOCUMENTED = re.findall(r"^::: stepcore\.([\w.]+)$", API, re.MULTILINE)
# What types a part of a result, and what questions are written with, stands under its module.
PARTS = re.compile(r"(engine|experiment|measure|report|scene)\.")
# Pages that the build makes.
MADE = {"index.md", "adding.md", "benchmarks.md", "changelog.md", "contributing.md"}


def test_every_public_name_is_in_the_reference_once():
    public = set(sc.__all__) - {"__version__", "lesson", "testing"}
    for module in (gymnasium, adapters, jax, testing, torch):
        public |= {f"{module.__name__.removeprefix('stepcore.')}.{name}" for name in module.__all__}
    assert sorted(name for name in DOCUMENTED if not PARTS.match(name)) == sorted(
        public | {"lesson", "lesson.loop"}
    )


def test_what_only_types_a_part_of_a_result_has_no_name_at_the_top():
    parts = [name.rpartition(".")[2] for name in DOCUMENTED if PARTS.match(name)]
    assert len(parts) >= 20 and not set(parts) & set(sc.__all__)


def test_every_setting_is_explained_in_the_stubs_that_the_reference_is_made_from():
    stubs = ast.parse((ROOT / "python/stepcore/_core.pyi").read_text(encoding="utf-8"))
    settings = next(node for node in stubs.body if getattr(node, "name", "") == "Settings")
    explained = {
        member.name
        for member in settings.body
        if isinstance(member, ast.FunctionDef) and ast.get_docstring(member)
    }
    assert set(sc.Settings().as_dict()) <= explained


def test_every_page_is_in_the_navigation():
    text = (ROOT / "mkdocs.yml").read_text(encoding="utf-8").partition("\nnav:")[2]
    listed = re.findall(r"[\w/]+\.(?:md|py)\b", text)
    pages = {path.relative_to(DOCS).as_posix() for path in DOCS.rglob("*.md")}
    pages |= {path.relative_to(DOCS).as_posix() for path in DOCS.rglob("*.py")}
    assert sorted(listed) == sorted(pages | MADE)


def test_the_figure_of_the_readme_and_its_text_are_of_one_run():
    """The text has the distance that the figure ends with; its starts and error are `trade`'s."""
    starts, converged, shipped = photograph.worst()
    readme = (ROOT / "README.md").read_text(encoding="utf-8")
    (apart,) = re.findall(r"after one second: (\d+) mm apart", readme)
    assert int(apart) == round(1e3 * rms_distance(shipped._replayed(), converged._replayed())[-1])
    in_texts = re.findall(r"in the\s+worst of (\w+) starts(?: \(start|\. `python)", readme)
    assert in_texts == [str(starts)] * 2


def test_the_benchmarks_page_has_every_kept_result():
    page = benchmarks.page(ROOT / "benches")
    for bench, path in benchmarks.last_results(ROOT / "benches" / "results").items():
        lines = path.read_text(encoding="utf-8").rstrip("\n").split("\n")
        assert "\n".join(f"    {line}" for line in lines) in page, bench


def test_links_lead_to_pages_and_else_to_the_repository():
    text = (
        "[a](docs/trade.md#errors) [b](benches/README.md) ![c](https://x.org/raw/main/docs/c.png)"
    )
    moved = links.as_in_docs(text)
    assert moved == "[a](trade.md#errors) [b](../benches/README.md) ![c](c.png)"
    assert links.as_in_docs("[c]: https://x.org/blob/main/docs/c.md") == "[c]: c.md"
    led = links.to_repository(moved, "index.md", "https://x.org")
    assert led == "[a](trade.md#errors) [b](https://x.org/blob/main/benches/README.md) ![c](c.png)"
    assert links.to_repository("[m](../method.md)", "api/a.md", "") == "[m](../method.md)"
    assert links.to_repository("[home](../README.md)", "a.md", "") == "[home](index.md)"
