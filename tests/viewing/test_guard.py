"""Who may open a live view: a page of another site can neither read it nor drive it."""

import contextlib
import http.client
import time
from types import SimpleNamespace
from urllib.parse import urlsplit

import msgspec
import numpy as np
import pytest
import viser
from viewing_browser import opened, wait_for
from viser._messages import GuiUpdateMessage, ViewerCameraMessage
from websockets.exceptions import WebSocketException
from websockets.sync.client import connect

import stepcore as sc
from stepcore.viewing import live
from stepcore.viewing.guard import Guard

PORT = 8560
EVIL = "http://evil.example"
CAMERA = ViewerCameraMessage(
    wxyz=(1.0, 0.0, 0.0, 0.0),
    position=(1.0, 1.0, 1.0),
    fov=1.0,
    near=0.1,
    far=10.0,
    image_height=100,
    image_width=100,
    look_at=(0.0, 0.0, 0.0),
    up_direction=(0.0, 0.0, 1.0),
)


@pytest.fixture
def view():
    scene = sc.Scene()
    body = scene.add_body("secret", pos=(0, 0, 1))
    scene.add_joint(body, "hinge", name="hinge")
    scene.add_geom(body, "sphere", 0.1)
    scene.add_actuator("hinge", type="motor", name="motor", ctrlrange=(-1, 1))
    with live.view_sim(sc.Sim(scene), port=PORT) as made:
        with made._panel.lock:
            made._panel.play(False)
        yield made


def parts(view):
    """Port and token of a view's address."""
    url = urlsplit(view.url)
    return url.port, url.path.removeprefix("/")


def drive(view, url, **options):
    """What a page does that wants to read the scene and to move a slider; True if it read."""
    slider = view._panel.sliders[0]
    message = GuiUpdateMessage(uuid=slider._impl.uuid, updates={"value": 0.75})
    sent = [msgspec.msgpack.encode(each.as_serializable_dict()) for each in (CAMERA, message)]
    options.setdefault("subprotocols", [f"viser-v{viser.__version__}"])
    try:
        with connect(url, max_size=None, open_timeout=60, **options) as page:
            read = len(page.recv(timeout=60)) > 0
            for each in sent:
                # viser hears a page once it has told where it looks from.
                page.send(each)
                time.sleep(0.5)
            end = time.monotonic() + 60
            while ctrl(view) != 0.75 and time.monotonic() < end:
                time.sleep(0.05)
            return read
    except (WebSocketException, OSError, TimeoutError):
        return False


def ctrl(view):
    with view._panel.lock:
        return float(view._panel.sim.ctrl[0])


def test_its_own_page_reads_and_drives(view):
    """So that the refusals below are of what would work."""
    port, token = parts(view)
    assert drive(view, f"ws://localhost:{port}/{token}", origin=f"http://localhost:{port}")
    assert ctrl(view) == 0.75


ADDRESSES = ["ws://localhost:{port}/{token}", "ws://127.0.0.1:{port}/{token}"]
ORIGINS = [
    *(EVIL, None, "null", "", "http://localhost", "http://localhost:1", "file://"),
    *("http://localhost:{port}.evil.example", "http://evil.example#localhost:{port}"),
    *("http://user@localhost:{port}", "http://localhost:{port}/", "chrome-extension://a"),
]


@pytest.mark.parametrize("origin", ORIGINS)
@pytest.mark.parametrize("address", ADDRESSES)
def test_a_page_of_another_origin_neither_reads_nor_drives(view, address, origin):
    port, token = parts(view)
    origin = None if origin is None else origin.format(port=port)
    assert not drive(view, address.format(port=port, token=token), origin=origin)
    assert ctrl(view) == 0.0


@pytest.mark.parametrize(
    "path", ["", "/", "/x", "//{token}", "/{token}x", "/x/{token}", "/?{token}"]
)
def test_nobody_without_the_token_reads_or_drives(view, path):
    port, token = parts(view)
    address = f"localhost:{port}"
    url = f"ws://{address}{path.format(token=token)}"
    assert not drive(view, url, origin=f"http://{address}")
    assert ctrl(view) == 0.0


def test_two_origins_or_an_odd_upgrade_are_no_way_around(view):
    port, token = parts(view)
    url, own = f"ws://localhost:{port}/{token}", f"http://localhost:{port}"
    assert not drive(view, url, origin=own, additional_headers={"Origin": EVIL})
    assert not drive(view, url, origin=EVIL, additional_headers={"Origin": own})
    assert ctrl(view) == 0.0


def answer(port, path, **headers):
    connection = http.client.HTTPConnection("localhost", port, timeout=60)
    try:
        connection.request("GET", path, headers=headers)
        response = connection.getresponse()
        return response.status, response.read()
    finally:
        connection.close()


def test_its_page_is_served_at_its_whole_address_alone(view):
    port, token = parts(view)
    for path, status in ((f"/{token}", 200), (f"/{token}/", 200), ("/", 403), ("/index.html", 403)):
        got, text = answer(port, path)
        assert got == status and (status == 200 or b"whole address" in text)
    assert answer(port, f"/{token}/../../../etc/passwd")[0] == 404
    # A name of another site that means this machine.
    assert answer(port, f"/{token}", Host=f"evil.example:{port}")[0] == 403


def headers(**values):
    return SimpleNamespace(get_all=lambda name: values.get(name, []))


def test_a_view_for_other_machines_is_opened_by_any_of_its_names():
    guard = Guard("0.0.0.0")
    path = f"/{guard.token}"
    page = {"Upgrade": ["websocket"], "Host": ["lab.example:8080"]}
    assert guard.lets_in(path, headers(**page, Origin=["http://lab.example:8080"]))
    assert guard.lets_in(path, headers(**page, Origin=["https://LAB.example:8080"]))
    assert not guard.lets_in(path, headers(**page, Origin=[EVIL]))
    assert not guard.lets_in("/", headers(**page, Origin=["http://lab.example:8080"]))
    assert not Guard("127.0.0.1").lets_in(path, headers(**page))


def test_each_view_has_a_token_of_its_own():
    assert len({Guard("localhost").token for _ in range(100)}) == 100


def test_a_viser_that_does_not_ask_serves_nothing(monkeypatch):
    monkeypatch.setattr(Guard, "before", lambda *_: contextlib.nullcontext())
    with pytest.raises(RuntimeError, match="serves a view to any page"):
        live.view_sim(sc.Sim(sc.lesson.spring()), port=PORT)


SCRIPT = """const done = arguments[arguments.length - 1];
const page = new WebSocket(arguments[0], [arguments[1]]);
page.onopen = () => done("open"); page.onerror = () => done("refused");"""


def test_a_browser_keeps_a_foreign_page_out(view):
    """A page of another port is of another origin, although it knows the whole address."""
    chrome = opened()
    url, protocol = view.url.replace("http", "ws"), f"viser-v{viser.__version__}"
    try:
        with live.view_sim(sc.Sim(sc.lesson.spring()), port=PORT + 50) as other:
            chrome.get(other.url)
            assert chrome.execute_async_script(SCRIPT, url, protocol) == "refused"
        chrome.get(view.url)
        assert chrome.execute_async_script(SCRIPT, url, protocol) == "open"
        wait_for(chrome, "return document.querySelectorAll('[role=slider]').length > 0")
    finally:
        chrome.quit()
    assert np.all(view._panel.sim.ctrl == 0)
