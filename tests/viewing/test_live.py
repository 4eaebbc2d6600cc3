"""The live view: what its panel does, and its page in a headless Chromium."""

import io
import re
import socket
import time
from types import SimpleNamespace
from urllib.parse import urlsplit

import numpy as np
import pytest
from small import unstable
from viewing_browser import complaints, opened, wait_for

import stepcore as sc
from stepcore import cli, lesson
from stepcore.viewing import live

PORT = 8460
TOKEN = "[0-9a-f]{32}"
BY_HAND = SimpleNamespace(client_id=1)


def cheetah():
    return sc.Sim(sc.load("gymnasium:half_cheetah"))


@pytest.fixture
def panel():
    """A panel whose time stands still unless a test lets it pass."""
    sim = cheetah()
    view = live.view_sim(sim, port=PORT)
    with view._panel.lock:
        view._panel.play(False)
        view._panel.restart(None)
        yield view._panel
    view.close()


def test_it_runs_a_copy(panel):
    original = cheetah()
    panel.play(True)
    panel.pass_time(0.1)
    assert panel.sim.time == pytest.approx(0.1)
    original.step(10)
    assert np.array_equal(panel.sim.qpos, original.qpos)


def test_step_reset_and_back(panel):
    panel._step()
    assert panel.sim.time == pytest.approx(0.01) and not panel.playing
    panel.advance(0.3)
    end = panel.sim.time
    panel.back.value = 0.5
    panel._go_back(BY_HAND)
    assert 0.3 * end < panel.sim.time < 0.7 * end, panel.times
    # What goes on from there is the same motion again, bit for bit.
    again = cheetah()
    again.step(round(panel.sim.time / 0.01))
    assert np.array_equal(panel.sim.qpos, again.qpos)
    panel.advance(0.1)
    again.step(10)
    assert np.array_equal(panel.sim.qpos, again.qpos)
    assert np.all(np.diff(panel.times) > 0)
    panel.restart(None)
    assert panel.sim.time == 0.0


def test_sliders_set_controls(panel):
    slider = panel.sliders[2]
    slider.value = 0.75
    panel._set(2, BY_HAND)
    assert panel.sim.ctrl.tolist() == [0, 0, 0.75, 0, 0, 0]


def test_a_keyframe_is_a_start():
    scene = lesson.drop()
    with live.view_sim(sc.Sim(scene), port=PORT) as view, view._panel.lock:
        view._panel.restart(0)
        sim = sc.Sim(scene)
        sim.reset(key="start")
        assert np.array_equal(view._panel.sim.qpos, sim.qpos)


@pytest.mark.filterwarnings("ignore::stepcore.EnergyWarning")
def test_a_failure_is_shown_and_does_not_end_the_view():
    sim = sc.Sim(unstable(integrator="euler"))
    sim.qvel[:] = 1.0
    with live.view_sim(sim, port=PORT) as view, view._panel.lock:
        view._panel.play(True)
        for _ in range(50):
            view._panel.advance(0.5)
        view._panel.draw()
        assert view._panel.failed and not view._panel.playing
        assert "failed" in view._panel.figures.content
        view._panel.restart(None)
        assert not view._panel.failed


def test_energy_and_residual_are_curves_beside(panel):
    for _ in range(5):
        panel.advance(0.05)
        panel.draw()
    time, kinetic, potential, total = panel.energy.data
    assert len(time) == 6 and time[-1] == pytest.approx(panel.sim.time)
    assert kinetic[-1] == pytest.approx(panel.sim.energy.kinetic)
    assert potential[0] == total[0] == 0
    assert 10 ** panel.residual.data[1][-1] == pytest.approx(max(panel.sim.residual, 1e-20))
    # Curves of a motion that goes on from an earlier time are that motion's.
    panel.back.value = 0.5
    panel._go_back(BY_HAND)
    time = panel.energy.data[0]
    assert time[-1] == pytest.approx(panel.sim.time) and np.all(np.diff(time) > 0)


def test_a_motion_that_is_kept_keeps_its_curves(panel):
    """As long as nothing goes on from an earlier time, one can drag back and forth."""

    def drag(to):
        panel.back.value = to
        panel._go_back(BY_HAND)
        return panel.energy.data

    for _ in range(40):
        panel.advance(0.05)
        panel.draw()
    whole = drag(1.0)
    early = drag(0.25)
    assert early[0][-1] == pytest.approx(panel.sim.time) and early[0][-1] < 0.3 * whole[0][-1]
    again = drag(1.0)
    assert set(whole[0]) <= set(again[0]) and len(again[0]) <= len(whole[0]) + 1
    drag(0.25)
    panel.sim.ctrl[:] = 1.0
    # Here another motion begins.
    panel._step()
    assert panel.past[-1].time == panel.sim.time >= panel.times[-1]
    assert np.all(np.diff(panel.energy.data[0]) > 0)


def test_a_start_begins_the_curves_anew():
    """Also at a keyframe whose time is later than the curves' end."""
    scene = sc.loads(
        """<mujoco><worldbody><body><joint/><geom size="1"/></body></worldbody>
        <keyframe><key name="late" time="5" qpos="0.5"/></keyframe></mujoco>"""
    )
    with live.view_sim(sc.Sim(scene), port=PORT) as view, view._panel.lock:
        panel = view._panel
        panel.play(False)
        panel.advance(0.1)
        panel.draw()
        panel.restart(0)
        assert [instant.time for instant in panel.past] == [5.0] == panel.times
        assert panel.energy.data[0].tolist() == [5.0]


def test_runs_are_gone_through_together():
    one, other = cheetah(), cheetah()
    other.qpos[0] += 0.3
    runs = live.labelled_runs([one.run(0.5), other.run(0.5)], ["<first>", "second"])
    with live.view_runs(runs, port=PORT) as view, view._panel.lock:
        panel = view._panel
        panel.play(False)
        assert "&lt;first&gt;: in its own colours" in panel.legend.content
        assert re.search(r'color:#f2731a">■</span> second', panel.legend.content)
        panel.now = 0.0
        panel.step()
        assert panel.now == pytest.approx(runs[0].time[1])
        panel.draw()
        assert re.search(r"distance of second</td>[^>]*>300 mm", panel.figures.content)
        assert panel.apart.data[1] == pytest.approx([300, 300], abs=5)
        assert panel.apart.series[1]["label"] == "second"
        part = live.labelled_runs([one.run(1.0), other.run(0.5)], ["first", "second"])
    with live.view_runs(part, port=PORT) as view, view._panel.lock:
        view._panel.play(False)
        view._panel.now = 1.4
        view._panel.draw()
        assert re.search(r"distance of second</td>[^>]*>–<", view._panel.figures.content)


def test_a_motion_that_nobody_sees_waits(capfd):
    """And viser's own words are not printed beside the address."""
    view = cheetah().view(port=PORT, wait=False)
    time.sleep(0.3)
    now = view._panel.sim.time
    view.close()
    assert now == 0.0
    assert capfd.readouterr().out == f"stepcore view: {view.url}\n"


def test_a_view_that_cannot_be_made_leaves_its_port():
    with socket.socket() as tried:
        tried.bind(("localhost", 0))
        port = tried.getsockname()[1]
    sim = cheetah()
    sim.qpos[0] = np.nan
    with pytest.raises(ValueError, match="must be finite"):
        sim.view(port=port, wait=False)
    with live.view_sim(cheetah(), port=port) as view:
        assert view.url.startswith(f"http://localhost:{port}/")
        # The next view takes the next port that is free.
        with live.view_sim(cheetah(), port=port) as other:
            assert urlsplit(other.url).port > port
    with pytest.raises(ValueError, match="port = 70000: must be a whole number from 1 to 65535"):
        sim.view(port=70000)


@pytest.mark.parametrize("host", ["1.2.3.4", "no.such.host.invalid", "a" * 300])
def test_an_address_that_is_not_this_machine_s_is_refused(host):
    with pytest.raises(ValueError, match="must be an address of this machine"):
        cheetah().view(host=host, wait=False)


def test_what_moves_is_followed_and_seen_through(panel):
    stage, sim = panel.stage, panel.sim
    panel._step()

    def place():
        return np.array(stage.root.position) + sim.xpos[1:].mean(axis=0)

    before = place()
    stage.follow(True, panel.seen)
    sim.qpos[0] += 3.0
    panel.draw()
    assert place() == pytest.approx(before) and stage.root.position[0] == pytest.approx(-3.0)
    stage.follow(False, panel.seen)
    sim.qpos[0] += 1.0
    panel.draw()
    assert place()[0] == pytest.approx(before[0] + 1.0)
    panel.restart(None)
    assert np.array_equal(stage.root.position, np.zeros(3))
    stage.see_through(True)
    assert all(mesh.opacity < 0.5 for mesh, _ in stage.solid) and len(stage.solid) == 8
    stage.see_through(False)
    assert [mesh.opacity for mesh, _ in stage.solid] == [opacity for _, opacity in stage.solid]


def test_what_cannot_be_viewed_is_refused():
    with pytest.raises(ValueError, match=r"must be a Sim, a Scene, a Trajectory or a list"):
        sc.view(3)
    with pytest.raises(ValueError, match="must be a list of trajectories"):
        sc.view([])
    drop = sc.Sim(lesson.drop())
    with pytest.raises(ValueError, match="same bodies"):
        sc.view([cheetah().run(0.1), drop.run(0.1)])


def test_the_page_moves(capsys):
    chrome = opened()
    view = cheetah().view(port=PORT, wait=False)
    try:
        assert capsys.readouterr().out.strip().endswith(view.url)
        chrome.get(view.url)
        wait_for(chrome, "return document.body.innerText.includes('kinetic energy')")
        time.sleep(3)
        shots = []
        with view._panel.lock:
            view._panel.play(False)
        for advance in (0.0, 0.4):
            with view._panel.lock:
                view._panel.restart(None)
                view._panel.advance(advance)
                view._panel.draw()
            time.sleep(2)
            shots.append(picture(chrome))
        changed = np.abs(shots[1] - shots[0])[:, :580].max(axis=-1) > 30
        assert changed.mean() > 0.002
        assert complaints(chrome) == []
    finally:
        view.close()
        chrome.quit()


def press(chrome, name):
    from selenium.webdriver.common.by import By

    button = chrome.find_element(By.XPATH, f"//button[normalize-space()='{name}']")
    chrome.execute_script("arguments[0].click()", button)


def sliders(chrome):
    """What can be dragged, in the order of the page: time, then the controls."""
    from selenium.webdriver.common.by import By

    return chrome.find_elements(By.XPATH, "//*[@role='slider']")


def until(panel, true, seconds=60.0):
    """Waits for what a browser and a view do between them; the view's thread steps the Sim."""
    end = time.monotonic() + seconds
    while True:
        with panel.lock:
            if true():
                return
        assert time.monotonic() < end
        time.sleep(0.05)


def test_what_is_pressed_and_dragged_in_the_page():
    """A person's hands: pause, step, reset, a control, back in time."""
    from selenium.webdriver.common.keys import Keys

    chrome = opened()
    view = cheetah().view(port=PORT, wait=False)
    panel, sim = view._panel, view._panel.sim
    try:
        chrome.get(view.url)
        wait_for(chrome, "return document.body.innerText.includes('kinetic energy')")
        wait_for(chrome, "return document.querySelectorAll('[role=slider]').length === 7")
        wait_for(chrome, "return document.querySelectorAll('.uplot canvas').length === 2")
        until(panel, lambda: sim.time > 0.1)
        press(chrome, "Pause")
        until(panel, lambda: not panel.playing)
        now = sim.time  # nobody steps it now
        press(chrome, "Step")
        until(panel, lambda: sim.time == pytest.approx(now + 0.01))
        sliders(chrome)[0].send_keys(Keys.HOME)
        until(panel, lambda: sim.time == 0.0)
        sliders(chrome)[1].send_keys(Keys.END)
        until(panel, lambda: sim.ctrl[0] == 1.0)
        press(chrome, "Step")
        until(panel, lambda: sim.time == pytest.approx(0.01))
        press(chrome, "Reset")
        until(panel, lambda: sim.time == 0.0 and sim.ctrl[0] == 0.0)
        assert complaints(chrome) == []
    finally:
        view.close()
        chrome.quit()


def picture(chrome):
    from PIL import Image

    return np.asarray(Image.open(io.BytesIO(chrome.get_screenshot_as_png())).convert("RGB"), float)


def test_the_command_writes_a_page(tmp_path, capsys):
    out = tmp_path / "run.html"
    assert cli.main(["view", "lesson:drop", "--horizon", "0.4", "--html", str(out)]) == 0
    assert capsys.readouterr().out == f"{out}: 0.4 s of motion\n"
    assert "<canvas" in out.read_text()
    assert cli.main(["view", "lesson:drop", "--horizon", "1"]) == 2
    assert "--html" in capsys.readouterr().err


@pytest.mark.parametrize(
    ("host", "inner", "others"),
    [
        ("localhost", "localhost", False),
        ("127.0.0.1", "127.0.0.1", False),
        ("::1", r"\[::1\]", False),
        ("0.0.0.0", "localhost", True),
    ],
)
def test_it_says_what_other_machines_type(host, inner, others, capsys):
    try:
        view = live.announced(live.view_sim(sc.Sim(lesson.drop()), host, PORT), False)
    except ValueError:
        pytest.skip(f"this machine has no {host}")
    with view:
        outer = rf" \(from another machine http://[^/:]+:\d+/{TOKEN}\)" if others else ""
        assert re.fullmatch(
            rf"stepcore view: http://{inner}:\d+/{TOKEN}{outer}\n", capsys.readouterr().out
        )
        assert bool(view.outer_url) == others


def test_the_command_opens_a_view(monkeypatch, capsys):
    monkeypatch.setattr(live.View, "wait", live.View.close)
    arguments = ["view", "gymnasium:half_cheetah", "--ctrl", "bthigh=1", "--port", str(PORT)]
    assert cli.main(arguments) == 0
    assert re.search(r"stepcore view: http://localhost:\d+", capsys.readouterr().out)
