"""Pages that replay runs, in a headless Chromium."""

import io
import pickle
import re

import numpy as np
import pytest
from viewing_browser import complaints, opened, wait_for

import stepcore as sc
from stepcore import cli, lesson
from stepcore.viewing import page as pages
from stepcore.viewing.frames import rms_distance


@pytest.fixture(scope="module")
def chrome():
    browser = opened()
    yield browser
    browser.quit()


def drop(**fields):
    sim = sc.Sim(lesson.drop(), **fields)
    sim.reset(key="start")
    return sim


def cheetah(duration=1.0):
    sim = sc.Sim(sc.load("gymnasium:half_cheetah"))
    return sim.run(duration, record=("xpos", "qpos"))


def picture(chrome):
    from PIL import Image

    return np.asarray(Image.open(io.BytesIO(chrome.get_screenshot_as_png())).convert("RGB"), float)


def test_the_snapshots_solve_what_the_run_solved():
    """Contacts, forces and energy that are seen are those of the run, bit for bit."""
    run, sim = drop(dt=0.01).run(0.6, record=("energy",)), drop(dt=0.01)
    again = run._replayed()
    for step, instant in zip(range(0, 61, 2), again.instants, strict=True):
        assert instant.time == pytest.approx(0.01 * step)
        assert instant.energy == tuple(run.energy[step])
        # The contacts of a step are those of the state before it.
        sim.step()
        force = sim.contacts["force"]
        assert np.array_equal(instant.forces, force[np.any(force != 0, axis=1)])
        sim.step()
    assert len(again.instants) == 31
    assert any(len(instant.forces) for instant in again.instants)


def test_a_run_keeps_at_most_sixty_states_a_second():
    run = drop(dt=0.001).run(1.0)
    assert 55 <= len(run.snapshots.states) <= 65
    assert len(drop(dt=0.1).run(1.0).snapshots.states) == 11
    with pytest.raises(ValueError, match="has no snapshots"):
        sc.Trajectory(run.time, run.data).save_html("never.html")


def test_a_trajectory_can_still_be_pickled():
    run = drop().run(0.1)
    again = pickle.loads(pickle.dumps(run))
    assert again.snapshots.states == run.snapshots.states
    assert "Snapshots" not in repr(run)


def test_the_page_needs_no_network(tmp_path):
    path = tmp_path / "run.html"
    cheetah().save_html(path)
    text = path.read_text()
    library = pages.three()
    assert library in text
    own = text.replace(library, "")
    assert not re.search(r"https?://|src=|href=|import\(|fetch\(", own)
    assert len(text) < 2_000_000


def test_it_moves_and_no_error_is_reported(chrome, tmp_path):
    run = cheetah()
    run.save_html(tmp_path / "run.html")
    chrome.get((tmp_path / "run.html").as_uri())
    wait_for(chrome, "return !!window.replay")
    # It plays by itself.
    first = chrome.find_element("id", "clock").text
    wait_for(chrome, f"return document.getElementById('clock').textContent !== {first!r}")
    shots = []
    for time in (0.0, 0.5):
        chrome.execute_script(f"replay.seek({time})")
        shots.append(picture(chrome))
        # The page puts the bodies where the run had them.
        step = round(time / 0.01)
        assert np.allclose(chrome.execute_script("return replay.bodies()"), run.xpos[step], 1e-6)
    # Beside the panel, on the left, and above the clock.
    changed = np.abs(shots[1] - shots[0])[:-60, 320:].max(axis=-1) > 30
    assert changed.mean() > 0.005
    assert "kinetic energy" in chrome.find_element("id", "figures").text
    assert complaints(chrome) == []


def test_it_turns_pauses_and_steps(chrome, tmp_path):
    cheetah(0.3).save_html(tmp_path / "run.html")
    chrome.get((tmp_path / "run.html").as_uri())
    wait_for(chrome, "return !!window.replay")
    chrome.execute_script("replay.seek(0.1)")
    before = picture(chrome)
    clock = chrome.find_element("id", "clock").text
    chrome.find_element("id", "on").click()
    assert chrome.find_element("id", "clock").text != clock
    chrome.find_element("id", "back").click()
    assert chrome.find_element("id", "clock").text == clock
    chrome.execute_script("replay.place(0.5, 0.8, 2)")
    turned = picture(chrome)
    assert (np.abs(turned - before).max(axis=-1) > 30).mean() > 0.05
    assert complaints(chrome) == []


def test_what_is_drawn_over_time_is_chosen(chrome, tmp_path):
    slow = sc.Sim(sc.load("gymnasium:half_cheetah"), dt=0.0025)
    cheetah(0.3).save_html(tmp_path / "run.html", over=[slow.run(0.3)], labels=["a", "fine"])
    chrome.get((tmp_path / "run.html").as_uri())
    wait_for(chrome, "return !!window.replay")
    legend = chrome.find_element("id", "legend")
    assert legend.text == "distance of fine [mm]"
    choose = "const c = document.getElementById('curve'); c.value = '{}'; c.onchange()"
    for name, said in (("energy", "kinetic [J]"), ("residual", "log10 of the residual in m/s")):
        chrome.execute_script(choose.format(name))
        assert legend.text.startswith(said)
    assert complaints(chrome) == []


TENDON = """
<mujoco><worldbody><site name="a" pos="-1 0 1"/><site name="s" pos="0 0 2"/>
<geom name="wheel" type="cylinder" size=".3 .5" pos="0 0 1" euler="90 0 0" contype="0"
  conaffinity="0"/>
<body pos=".8 0 .5"><joint type="slide" axis="0 0 1"/><geom size=".1"/><site name="b"/></body>
</worldbody><tendon><spatial stiffness="50" name="rope"><site site="a"/>
<geom geom="wheel" sidesite="s"/><site site="b"/></spatial></tendon></mujoco>"""


def test_a_tendon_goes_round_what_it_wraps(chrome, tmp_path):
    sim = sc.Sim(sc.loads(TENDON))
    run = sim.run(0.2)
    (way,) = run._replayed().instants[-1].tendons
    assert np.allclose(way, sim.tendon_path("rope")[0])
    away = np.linalg.norm(way[1:-1, [0, 2]] - [0, 1], axis=1)
    assert away == pytest.approx(0.3)
    run.save_html(tmp_path / "run.html")
    chrome.get((tmp_path / "run.html").as_uri())
    wait_for(chrome, "return !!window.replay")
    assert complaints(chrome) == []


def test_a_notebook_shows_a_short_run():
    shown = drop().run(0.2)._repr_html_()
    assert shown.startswith("<iframe srcdoc=")
    assert drop(dt=0.01).run(30.0)._repr_html_() is None


def test_the_distance_of_two_runs():
    """Only one body moves, so it is the distance of its places."""
    low, high = drop(dt=0.01), drop(dt=0.01)
    high.qpos[0] += 0.1
    runs = [sim.run(0.4, record=("xpos",)) for sim in (low, high)]
    gap = rms_distance(*(run._replayed() for run in runs))
    expected = np.linalg.norm(runs[0].xpos - runs[1].xpos, axis=-1)[::2, 1]
    assert gap == pytest.approx(expected, abs=1e-12)
    assert gap[0] == pytest.approx(0.1) and gap.min() < 0.09
    # Of a run with other instants it is where its bodies were between them.
    other = drop(dt=0.005).run(0.2, record=("xpos",))
    gap = rms_distance(runs[0]._replayed(), other._replayed())
    assert gap[:5].max() < 0.02
    with pytest.raises(ValueError, match="same bodies"):
        rms_distance(low.run(0.1)._replayed(), cheetah(0.1)._replayed())


def test_nothing_is_compared_after_the_other_has_ended(chrome, tmp_path):
    """Nor is a label taken for what a page is made of."""
    whole, part = drop(dt=0.01).run(1.0), drop(dt=0.01).run(0.5)
    gap = rms_distance(whole._replayed(), part._replayed())
    time = whole._replayed().time
    assert np.array_equal(np.isnan(gap), time > 0.505)
    whole.save_html(tmp_path / "run.html", over=[part], labels=["whole", "<b>part</b>"])
    chrome.get((tmp_path / "run.html").as_uri())
    wait_for(chrome, "return !!window.replay")
    figures = chrome.find_element("id", "figures")
    for at, said in ((0.3, "0.000 mm"), (0.8, "–")):
        chrome.execute_script(f"replay.seek({at})")
        assert figures.text.endswith(f"distance of <b>part</b> {said}")
    assert complaints(chrome) == []


def place_in_window(chrome, body):
    """Where the middle of a body is seen, in shares of the window."""
    return chrome.execute_script(f"return replay.seen({body})")


@pytest.mark.parametrize(("width", "height"), [(400, 800), (800, 400), (1400, 900)])
def test_a_fall_stays_in_the_window_of_a_telephone_too(chrome, tmp_path, width, height):
    drop(dt=0.01).run(1.0).save_html(tmp_path / "run.html")
    size = {"width": width, "height": height, "deviceScaleFactor": 1, "mobile": False}
    chrome.execute_cdp_cmd("Emulation.setDeviceMetricsOverride", size)
    try:
        chrome.get((tmp_path / "run.html").as_uri())
        wait_for(chrome, "return !!window.replay")
        for at in (0.0, 1.0):
            chrome.execute_script(f"replay.seek({at})")
            x, y = place_in_window(chrome, 1)
            assert 0.1 < x < 0.9 and 0.1 < y < 0.85
        ends = chrome.execute_script(
            "return [...document.querySelectorAll('footer > *')]"
            ".map((part) => part.getBoundingClientRect().right)"
        )
        assert max(ends) <= width
        covers = "document.getElementById('panel').getBoundingClientRect().bottom"
        assert chrome.execute_script(
            f"return {covers} <= document.querySelector('footer').getBoundingClientRect().top"
        )
        assert complaints(chrome) == []
    finally:
        chrome.execute_cdp_cmd("Emulation.clearDeviceMetricsOverride", {})


def test_a_model_may_have_any_name(chrome, tmp_path):
    scene = lesson.drop()
    scene.name = "</script>$DATA$ $ Ü <b>"
    sim = sc.Sim(scene)
    sim.run(0.1).save_html(tmp_path / "a name with ü, % and #.html")
    chrome.get((tmp_path / "a name with ü, % and #.html").as_uri())
    wait_for(chrome, "return !!window.replay")
    assert chrome.title == scene.name == chrome.find_element("tag name", "summary").text
    assert complaints(chrome) == []


@pytest.mark.filterwarnings("ignore:dt 10 ms explodes", "ignore::stepcore.EnergyWarning")
@pytest.mark.filterwarnings("ignore::stepcore.StiffnessWarning")
def test_a_run_that_exploded_is_replayed_without_a_warning(chrome, tmp_path, capsys):
    body = '<body><joint type="slide" stiffness="1e8"/><geom size=".1"/></body>'
    model = tmp_path / "boom.xml"
    model.write_text(
        f"<mujoco><worldbody>{body}</worldbody><option timestep='0.01'/>"
        "<keyframe><key qvel='1'/></keyframe></mujoco>"
    )
    out = tmp_path / "run.html"
    assert cli.main(["view", str(model), "--html", str(out)]) == 1
    said = capsys.readouterr()
    assert "diverged in step" in said.err and "overflow" not in said.err
    assert "s of motion" in said.out
    chrome.get(out.as_uri())
    wait_for(chrome, "return !!window.replay")
    chrome.execute_script("replay.seek(replay.end)")
    assert complaints(chrome) == []


def test_without_the_extra_it_says_what_to_install(monkeypatch):
    monkeypatch.setitem(__import__("sys").modules, "trimesh", None)
    with pytest.raises(ImportError, match=r"pip install '\.\[view\]'"):
        drop().run(0.1).save_html("never.html")
