"""What `mkdocs build` makes besides the pages in docs/: pages from other files, outputs, pictures.

mkdocs calls the functions `on_...`, see https://www.mkdocs.org/dev-guide/plugins/#events.
"""

from __future__ import annotations

import os
import re
import tomllib
from functools import partial
from pathlib import Path

import benchmarks
import commands
import links
import photograph
import results
from mkdocs.config.defaults import MkDocsConfig
from mkdocs.structure.files import File, Files
from mkdocs.structure.pages import Page

ROOT = Path(__file__).parents[1]


def on_config(config: MkDocsConfig) -> MkDocsConfig:
    """Notebooks show their figures; below every page stands the repository's address.

    It is not mkdocs' `repo_url`, for which the theme's scripts would ask the host on every page.
    """
    config.plugins["mkdocs-jupyter"].config["cache_dir"] = str(results.folder() / "tutorials")
    os.environ["MPLBACKEND"] = "module://matplotlib_inline.backend_inline"
    project = tomllib.loads(_text("pyproject.toml"))["project"]
    config.extra["repository"] = address = project["urls"]["Repository"]
    config.copyright = f'<a href="{address}">{address}</a>'
    return config


def on_files(files: Files, config: MkDocsConfig) -> Files:
    """Adds the pages that have their text elsewhere, and the pictures of this package."""
    for path, text in _pages().items():
        files.append(File.generated(config, path, content=text))
    for path, picture in _pictures().items():
        if kept := files.get_file_from_path(path):
            files.remove(kept)
        files.append(File.generated(config, path, content=picture))
    return files


def _pictures() -> dict[str, bytes]:
    """The pictures of commands, and photographs where there is a Chromium, by their names."""
    drawn = {
        name: results.reuse(name, command, partial(commands.picture, command, ROOT))
        for name, command in commands.DRAWN.items()
    }
    if chromium := photograph.browser():
        for name in photograph.TAKEN:
            drawn[name] = results.reuse(name, "", partial(photograph.photograph, name, chromium))
    return drawn


def _pages() -> dict[str, str]:
    """The generated pages by their path in docs/."""
    contributing = _text("CONTRIBUTING.md")
    before, adding, after = links.split_at_section(contributing, "How to add …")
    return {
        "index.md": links.as_in_docs(_text("README.md")),
        "contributing.md": links.as_in_docs(
            f"{before}## How to add …\n\nIt has [its own page](docs/adding.md).\n\n{after}"
        ),
        "adding.md": links.as_in_docs("# How to add an element" + adding),
        "changelog.md": links.as_in_docs(_text("CHANGELOG.md")),
        "benchmarks.md": benchmarks.page(ROOT / "benches"),
    }


def _text(name: str) -> str:
    return (ROOT / name).read_text(encoding="utf-8")


def on_page_markdown(markdown: str, page: Page, config: MkDocsConfig, files: Files) -> str:
    """Runs the commands that a page shows, and makes links to the repository's files absolute."""
    del files
    path = page.file.src_uri
    if commands.shown_in(markdown):
        title = f"outputs of {path}"
        shown = partial(commands.with_outputs, markdown, ROOT)
        markdown = results.reuse(title, markdown, lambda: shown().encode()).decode()
    return links.to_repository(markdown, path, config.extra["repository"])


# The theme's search cannot leave out an element with others of its kind inside.
HIDDEN = "jp-InputPrompt|jp-OutputPrompt|clipboard-copy-txt"
CODE = re.compile(rf'<(pre|span class="notice"|div class="(?:{HIDDEN})[^"]*")')


def on_page_content(html: str, page: Page, config: MkDocsConfig, files: Files) -> str:
    """Leaves the code of notebooks and its output out of the search, whose excerpts are text."""
    del config, files
    notebook = page.file.src_uri.endswith(".py")
    return CODE.sub(r"<\1 data-search-exclude", html) if notebook else html
