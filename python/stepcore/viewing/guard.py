"""`Guard`: access control of a live view. A page of another site must neither read nor drive it.

A browser lets every page connect to every port of this machine, and viser's websocket accepts every
request, so requests are checked first. A request must have the token in its address, which only the
printed address has. On an address that no other machine reaches, it must also name this machine as
its host (so that no site can make its name mean this machine and become the page's origin). A
websocket must come from a page of the same origin, which a browser states and no page can change.
"""

from __future__ import annotations

import hmac
import secrets
import threading
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from types import SimpleNamespace
from typing import Any
from urllib.parse import urlsplit

REFUSED = "Open the whole address that stepcore printed, with its last part.\n"
_one_at_a_time = threading.Lock()


class Guard:
    """Admits requests by their token, host and origin.

    host: the address on which the view is served. token: the last part of its address.
    """

    def __init__(self, host: str) -> None:
        self.host, self.token = host, secrets.token_hex(16)
        # Whether the server checks requests.
        self.stands = False

    def lets_in(self, path: str, headers: Any) -> bool:
        """Return whether a request for this path may pass."""
        tokens = path.partition("?")[0].split("/")[1:2]
        authorized = bool(tokens) and hmac.compare_digest(tokens[0].encode(), self.token.encode())
        hosts, origins = headers.get_all("Host"), headers.get_all("Origin")
        if not authorized or len(hosts) != 1 or not self._is_own(hosts[0]):
            return False
        if not any(value.lower() == "websocket" for value in headers.get_all("Upgrade")):
            return True
        return len(origins) == 1 and _is_page_of(origins[0], hosts[0])

    def _is_own(self, host: str) -> bool:
        """Return whether the Host header names this machine, for a view of this machine alone."""
        name = _name(f"//{host}")
        return not is_loopback(self.host) or name == self.host or is_loopback(name)

    def asked_first(self, answer: Callable[[Any, Any], Any]) -> Callable[[Any, Any], Any]:
        """Refuse a request, or let the server answer it without its token."""

        def process(connection: Any, request: Any) -> Any:
            if not self.lets_in(request.path, request.headers):
                return connection.respond(403, REFUSED)
            request.path = request.path.replace(f"/{self.token}", "", 1) or "/"
            return answer(connection, request)

        return process

    @contextmanager
    def before(self, infra: Any) -> Iterator[None]:
        """Check the requests to every server that viser's module `infra` starts meanwhile.

        viser has no option for it: it calls `websockets.asyncio.server.serve`, by these names. If a
        later viser did otherwise, `stands` would stay False, and no view would be opened.
        """
        real = infra.websockets
        serving = real.asyncio.server

        def serve(*arguments: Any, **options: Any) -> Any:
            self.stands = True
            answer = options.pop("process_request")
            return serving.serve(*arguments, process_request=self.asked_first(answer), **options)

        server = SimpleNamespace(**{**vars(serving), "serve": serve})
        asyncio = SimpleNamespace(**{**vars(real.asyncio), "server": server})
        with _one_at_a_time:
            infra.websockets = SimpleNamespace(**{**vars(real), "asyncio": asyncio})
            try:
                yield
            finally:
                infra.websockets = real


def _name(address: str) -> str:
    try:
        return (urlsplit(address).hostname or "").lower()
    except ValueError:
        return ""


def is_loopback(name: str) -> bool:
    """Return whether only this machine can reach the name or address."""
    octets = name.split(".")
    return name in ("localhost", "::1") or (
        len(octets) == 4 and octets[0] == "127" and all(octet.isdecimal() for octet in octets)
    )


def _is_page_of(origin: str, host: str) -> bool:
    return origin.lower() in (f"http://{host}".lower(), f"https://{host}".lower())
