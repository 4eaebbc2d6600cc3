"""The photograph of a page that replays a run, taken by Chromium."""

from __future__ import annotations

import shutil
import subprocess
import tempfile
from pathlib import Path

from commands import printed

BROWSERS = ("chromium", "chromium-browser", "google-chrome", "google-chrome-stable")
RUN = "stepcore run gymnasium:half_cheetah --duration 2 --motion sines"
# What a reader did before, once the page played: halted the run at this share of it.
HALTED = """<script>
setTimeout(() => {
  const slider = document.getElementById("slider");
  slider.value = 0.268;
  slider.dispatchEvent(new Event("input"));
}, 2000);
</script>"""


def browser() -> str | None:
    """The path of a Chromium, if there is one."""
    return next(filter(None, map(shutil.which, BROWSERS)), None)


def view(root: Path) -> bytes | None:
    """The run as a PNG; None where there is no Chromium."""
    chromium = browser()
    if chromium is None:
        return None
    with tempfile.TemporaryDirectory() as folder:
        page, picture = Path(folder, "run.html"), Path(folder, "view.png")
        printed(f"{RUN} --save {page}", root)
        page.write_text(page.read_text(encoding="utf-8") + HALTED, encoding="utf-8")
        command = (
            *(chromium, "--headless=new", "--no-sandbox", "--disable-dev-shm-usage"),
            *("--use-angle=swiftshader", "--enable-unsafe-swiftshader", "--hide-scrollbars"),
            *("--window-size=1000,620", "--virtual-time-budget=20000"),
            *(f"--screenshot={picture}", page.as_uri()),
        )
        subprocess.run(command, check=True, capture_output=True, timeout=300)
        return picture.read_bytes()
