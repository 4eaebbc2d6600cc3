"""What a package index shows of the project: it renders README.md away from the repository.

A relative link or picture is dead there. README's links therefore begin with the repository's
address, which pyproject.toml states, and name files that are here; so does what else is published.
"""

import re
import tomllib
from pathlib import Path

ROOT = Path(__file__).parents[2]
PROJECT = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))["project"]
REPOSITORY = PROJECT["urls"]["Repository"]
README = (ROOT / "README.md").read_text(encoding="utf-8")
# Without code, in which brackets are indices.
TEXT = re.sub(r"^```.*?^```|`[^`]*`", "", README, flags=re.DOTALL | re.MULTILINE)
TARGETS = dict(re.findall(r"^\[([^\]]+)\]: (\S+)$", TEXT, re.MULTILINE))
BODY = re.sub(r"^\[[^\]]+\]: \S+$", "", TEXT, flags=re.MULTILINE)
VERSION = tomllib.loads((ROOT / "Cargo.toml").read_text(encoding="utf-8"))["workspace"]["package"][
    "version"
]


def in_repository(url):
    """The file or folder that a link into the repository names, or None."""
    kind_and_path = re.fullmatch(re.escape(REPOSITORY) + r"/(blob|tree|raw)/main/(.+)", url)
    return kind_and_path and (kind_and_path[1], ROOT / kind_and_path[2])


def test_links_of_the_readme_work_away_from_the_repository():
    inline = re.findall(r"\]\(([^)]*)\)", BODY)
    assert not inline, "README's links are written [text][name], with [name]: address at its end"
    used = {name or text for text, name in re.findall(r"\[([^\]]+)\](?:\[([^\]]+)\])?", BODY)}
    assert used == set(TARGETS)
    for name, url in TARGETS.items():
        if url in PROJECT["urls"].values():
            continue
        kind, path = in_repository(url)
        assert path.exists(), (name, url)
        assert path.is_dir() == (kind == "tree"), (name, url)


def test_pictures_are_shown_as_files_and_pages_as_pages():
    pictures = {name for _, name in re.findall(r"!\[([^\]]+)\]\[([^\]]+)\]", BODY)}
    for name, url in TARGETS.items():
        raw = url.startswith(f"{REPOSITORY}/raw/")
        assert raw == (name in pictures), (name, url)


def test_the_addresses_of_the_project_are_of_one_repository():
    for name, url in PROJECT["urls"].items():
        assert url.startswith(REPOSITORY), name
        place = in_repository(url)
        assert place is None or place[1].exists(), url
    assert f'repository-code: "{REPOSITORY}"' in citation()


def citation():
    return (ROOT / "CITATION.cff").read_text(encoding="utf-8")


def test_the_version_is_one_and_the_changelog_tells_of_it():
    assert f"\nversion: {VERSION}\n" in citation()
    changelog = (ROOT / "CHANGELOG.md").read_text(encoding="utf-8")
    released = re.findall(r"^## (\d+\.\d+\.\d+) - (\d{4}-\d\d-\d\d)$", changelog, re.MULTILINE)
    assert released[0][0] == VERSION
    assert f"\ndate-released: {released[0][1]}\n" in citation()
