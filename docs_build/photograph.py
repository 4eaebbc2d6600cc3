"""Photographs of pages that replay runs, taken by Chromium.

`python docs_build/photograph.py` takes them anew for docs/.
"""

from __future__ import annotations

import re
import shutil
import subprocess
import tempfile
from collections.abc import Callable
from functools import cache
from pathlib import Path

from commands import printed

import stepcore as sc
from stepcore.engine.trajectory import Trajectory
from stepcore.viewing.frames import rms_distance

ROOT = Path(__file__).parents[1]
BROWSERS = ("chromium", "chromium-browser", "google-chrome", "google-chrome-stable")
MODEL = "gymnasium:half_cheetah"
# What a reader did before, once the page played: unchecked boxes, halted the run at a share of it.
HALTED = """<script>
setTimeout(() => {
  for (const name of HIDDEN) document.getElementById(name).checked = false;
  const slider = document.getElementById("slider");
  slider.value = SHARE;
  slider.dispatchEvent(new Event("input"));
}, 2000);
</script>"""


def browser() -> str | None:
    """The path of a Chromium, if there is one."""
    return next(filter(None, map(shutil.which, BROWSERS)), None)


def one_run(page: Path) -> None:
    """A run of a command."""
    printed(f"stepcore run {MODEL} --horizon 2 --motion sines --save {page}", ROOT)


@cache
def worst() -> tuple[int, Trajectory, Trajectory]:
    """The starts of the README's trade, and the converged and the shipped motion of the worst."""
    trade = sc.trade(MODEL, error="10mm", by="flops", progress=False)
    return trade.starts, *trade.seen(trade.shipped)


def error(page: Path) -> None:
    """The worst start of the README's trade as shipped, over its converged motion."""
    _, converged, shipped = worst()
    shipped.save_html(page, over=[converged], labels=["as shipped", "converged"])


def captioned(page: str) -> str:
    """The README with the numbers of this photograph in the text of its figure."""
    starts, converged, shipped = worst()
    apart = rms_distance(shipped._replayed(), converged._replayed())[-1]
    page = re.sub(r"second: \d+ mm apart", f"second: {1e3 * apart:.0f} mm apart", page)
    return re.sub(
        r"in the worst of \w+ starts\.", f"in the worst of {starts} starts.", page, count=1
    )


# What is on each photograph, at which share of the time, and what is hidden.
TAKEN = {
    "view.png": (one_run, 0.268, []),
    "error.png": (error, 1.0, ["contacts", "forces"]),
}


def photographs() -> dict[str, bytes]:
    """The photographs by their names; none where there is no Chromium."""
    chromium = browser()
    return {name: photograph(chromium, *of) for name, of in TAKEN.items()} if chromium else {}


def photograph(
    chromium: str, write: Callable[[Path], None], share: float, hidden: list[str]
) -> bytes:
    """The page that is written, as a PNG."""
    with tempfile.TemporaryDirectory() as folder:
        page, picture = Path(folder, "run.html"), Path(folder, "run.png")
        write(page)
        halted = HALTED.replace("SHARE", f"{share}").replace("HIDDEN", f"{hidden}")
        page.write_text(page.read_text(encoding="utf-8") + halted, encoding="utf-8")
        command = (
            *(chromium, "--headless=new", "--no-sandbox", "--disable-dev-shm-usage"),
            *("--use-angle=swiftshader", "--enable-unsafe-swiftshader", "--hide-scrollbars"),
            *("--window-size=1000,620", "--virtual-time-budget=20000"),
            *(f"--screenshot={picture}", page.as_uri()),
        )
        subprocess.run(command, check=True, capture_output=True, timeout=300)
        return picture.read_bytes()


if __name__ == "__main__":
    for name, taken in photographs().items():
        (ROOT / "docs" / name).write_bytes(taken)
