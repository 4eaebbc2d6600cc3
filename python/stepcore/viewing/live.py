"""The live view: a page that runs a Sim or plays recorded runs.

It is made with viser (the extra "view"): a server on this machine, and a page in any browser that
can reach it.
"""

from __future__ import annotations

import contextlib
import socket
import sys
import threading
from collections.abc import Callable, Iterator, Sequence
from time import monotonic
from typing import Any

from stepcore import checks
from stepcore.needs import need
from stepcore.viewing.frames import Replayed, rms_distance
from stepcore.viewing.guard import Guard, is_loopback
from stepcore.viewing.panel import Panel, RunPanel, SimPanel

# Hosts that serve every address of the machine.
EVERYWHERE = ("0.0.0.0", "::")


class View:
    """An open view.

    url: its address. The last part is a secret that lets a browser see the view and drive it.
    It stays open until `close`, or the end of the program.
    """

    def __init__(self, server: Any, panel: Panel, guard: Guard) -> None:
        self._server, self._panel = server, panel
        self._host, self._token = guard.host, guard.token
        self._stop = threading.Event()
        self._thread = threading.Thread(target=self._turn, name="stepcore view", daemon=True)
        self._thread.start()

    @property
    def url(self) -> str:
        """The address in a browser of this machine."""
        return self._url("localhost" if self._host in EVERYWHERE else self._host)

    @property
    def outer_url(self) -> str:
        """The address for other machines, if `host` lets them in; otherwise ""."""
        host = self._host
        if host in EVERYWHERE:
            host = socket.gethostname()
            with (
                contextlib.suppress(OSError),
                socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as probe,
            ):
                # Nothing is sent: the system only returns the address from which it would send.
                probe.connect(("192.0.2.1", 9))
                host = str(probe.getsockname()[0])
        return "" if is_loopback(host) else self._url(host)

    def _url(self, host: str) -> str:
        name = f"[{host}]" if ":" in host else host
        return f"http://{name}:{self._server.get_port()}/{self._token}"

    def close(self) -> None:
        """End the view."""
        self._stop.set()
        if self._thread is not threading.current_thread():
            self._thread.join(timeout=5)
        with _quiet():
            self._server.stop()

    def wait(self) -> None:
        """Wait until someone closes the view or presses Ctrl-C, which closes it."""
        try:
            while not self._stop.wait(0.2):
                pass
        except KeyboardInterrupt:
            self.close()

    def _turn(self) -> None:
        last = monotonic()
        while not self._stop.is_set():
            now = monotonic()
            # A motion without viewers pauses.
            if self._server.get_clients():
                self._panel.pass_time(min(now - last, 0.2))
            last = now
            self._stop.wait(max(0.0, 1 / 30 - (monotonic() - now)))

    def __enter__(self) -> View:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    def __repr__(self) -> str:
        return f"<View: {self.url}>"

    def _repr_html_(self) -> str:
        style = (
            "box-sizing:border-box;width:100%;height:520px;border:1px solid #8884;border-radius:6px"
        )
        return f'<iframe src="{self.url}" style="{style}"></iframe>'


def view_sim(sim: Any, host: str = "localhost", port: int = 8080) -> View:
    """Open a live view of a copy of a Sim; see `Sim.view`."""
    return _view(host, port, lambda server: SimPanel(server, sim))


def view_runs(runs: Sequence[Replayed], host: str = "localhost", port: int = 8080) -> View:
    """Open a view of recorded runs over each other; see `Trajectory.view`."""
    return _view(host, port, lambda server: RunPanel(server, runs))


def view(
    runs: Any,
    *,
    labels: Sequence[str] = (),
    host: str = "localhost",
    port: int = 8080,
    wait: bool | None = None,
) -> View:
    """Open a view of a Sim, a scene or a recorded run, or of several runs laid over each other.

    runs: a `Sim`, a `Scene` or a `Trajectory`; or a list of trajectories with the same bodies.
        The first keeps its colours; lines join its bodies with the same bodies of the others, and
        the view shows their RMS distance.
    labels: names of the runs.
    host, port: where the page is served; "0.0.0.0" lets other machines see it. The next free port
        is taken.
    wait: returns only when the view is closed, by Ctrl-C; by default so except at a prompt and in
        a notebook.

    Prints the address of the page, which works without a browser on this machine. Its last part is
    a secret, new for each view; pages of other sites can neither see the view nor drive it. Needs
    the extra "view". Raises ValueError for runs of other bodies.

    >>> from stepcore import Sim, lesson, view
    >>> opened = view(Sim(lesson.stack()), wait=False)  # doctest: +SKIP
    stepcore view: http://localhost:8080/5f0c1e7a9b3d4826a1f7c0e2b4d69387
    >>> opened.close()  # doctest: +SKIP
    """
    if isinstance(runs, (list, tuple)):
        seen = labelled_runs(runs, labels)
        return announced(view_runs(seen, host, port), wait)
    if not hasattr(runs, "view"):
        kinds = "a Sim, a Scene, a Trajectory or a list of trajectories"
        raise ValueError(f"runs = {checks.shown(runs)}: must be {kinds}")
    shown: View = runs.view(host=host, port=port, wait=wait)
    return shown


def labelled_runs(runs: Sequence[Any], labels: Sequence[str] = ()) -> list[Replayed]:
    """Return trajectories for a common drawing, with their labels."""
    if not runs or not all(hasattr(run, "_replayed") for run in runs):
        raise ValueError(f"runs = {checks.shown(runs)}: must be a list of trajectories")
    names = [*labels, *(f"run {k + 1}" for k in range(len(labels), len(runs)))]
    seen = [run._replayed(name) for run, name in zip(runs, names, strict=False)]
    for other in seen[1:]:
        rms_distance(seen[0], other)
    return seen


def announced(view: View, wait: bool | None) -> View:
    """Print the address of the view and, outside of a prompt, wait until it ends."""
    prompt = hasattr(sys, "ps1") or "ipykernel" in sys.modules
    waits = wait or (wait is None and not prompt)
    outer = "" if view.outer_url in ("", view.url) else f"from another machine {view.outer_url}"
    more = "; ".join(filter(None, (outer, "Ctrl-C ends it" if waits else "")))
    print(f"stepcore view: {view.url}{more and f' ({more})'}", flush=True)
    if waits:
        view.wait()
    return view


def _view(host: str, port: int, panel: Callable[[Any], Panel]) -> View:
    checks.whole(1, 65535)("view", "port", port)
    _check_host(host)
    viser, guard = need("viser", "a view"), Guard(host)
    with _quiet(), guard.before(need("viser.infra._infra", "a view")):
        server = viser.ViserServer(host=host, port=port, label="stepcore", verbose=False)
    try:
        if not guard.stands:
            raise RuntimeError("this version of viser serves a view to any page: install another")
        server.scene.set_up_direction("+z")
        return View(server, panel(server), guard)
    except BaseException:
        with _quiet():
            server.stop()
        raise


def _check_host(host: str) -> None:
    """Refuse an address of another machine, on which viser would wait for ever."""
    try:
        family, kind, _, _, address = socket.getaddrinfo(host, 0, type=socket.SOCK_STREAM)[0]
        with socket.socket(family, kind) as tried:
            tried.bind(address)
    except (OSError, UnicodeError, TypeError):
        limit = "an address of this machine, such as localhost or 0.0.0.0"
        raise checks.refuse("view", "host", host, limit) from None


@contextlib.contextmanager
def _quiet() -> Iterator[None]:
    """Suppress viser's output: its address in a box, and its end."""
    console = need("rich", "a view").get_console()
    console.quiet, before = True, console.quiet
    try:
        yield
    finally:
        console.quiet = before
