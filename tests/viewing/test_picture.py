"""Pictures and videos."""

import subprocess
import sys

import numpy as np
import pytest

import stepcore as sc
from stepcore import lesson

SMALL = {"width": 160, "height": 120}


def ball(colour="1 0 0 1", height=1.0):
    return sc.Sim(
        sc.loads(
            f"""<mujoco><worldbody><body pos="0 0 {height}"><joint type="slide" axis="0 0 1"/>
            <geom size="0.2" rgba="{colour}"/></body></worldbody></mujoco>"""
        )
    )


def test_a_red_ball_is_red_and_round():
    """It stands in the middle; its picture is as large as its angle of view says."""
    drawn = sc.picture(ball(), far=4.0, **SMALL)
    assert drawn.shape == (120, 160, 3) and drawn.dtype == np.uint8
    red = (drawn[..., 0] > 90) & (drawn[..., 1] < 60)
    rows, columns = np.flatnonzero(red.any(axis=1)), np.flatnonzero(red.any(axis=0))
    assert np.mean(rows) == pytest.approx(59.5, abs=1.5)
    assert np.mean(columns) == pytest.approx(79.5, abs=1.5)
    # The extent is the diagonal of the box round it; the picture is 40 degrees high.
    far = 4.0 * 0.4 * np.sqrt(3)
    radius = np.tan(np.arcsin(0.2 / far)) / np.tan(np.deg2rad(20)) * 60
    assert len(rows) / 2 == pytest.approx(radius, abs=2)
    assert len(columns) / 2 == pytest.approx(radius, abs=2)


def test_a_force_is_an_arrow_to_scale():
    """The longest arrow is as high as its force says."""
    sim = sc.Sim(sc.load("gymnasium:half_cheetah"))
    sim.step(300)
    seen = [
        sc.picture(sim, lift=2.0, forces=forces, width=320, height=240) for forces in (True, False)
    ]
    changed = np.abs(np.subtract(*seen, dtype=float)).max(axis=-1) > 60
    rows = np.flatnonzero(changed.any(axis=1))
    # The largest force, in points: the extent is 1 / (2 · 1.7 · tan 20°) of the height.
    force = np.linalg.norm(sim.contacts["force"], axis=1).max()
    weight = 9.81 * sim.model.body_mass.sum()
    expected = 0.35 * force / weight / (2 * 1.7 * np.tan(np.deg2rad(20))) * 240
    assert np.ptp(rows) == pytest.approx(expected, rel=0.35)


def test_a_tendon_is_drawn_with_and_without_forces():
    text = """<mujoco><worldbody><site name="top" pos="0 0.3 1.6"/><body pos="0 0 1">
      <joint type="slide" axis="0 0 1"/><geom size="0.2" rgba="0 0 1 1"/>
      <site name="end" pos="0 0.3 0"/></body></worldbody>
      <tendon><spatial><site site="top"/><site site="end"/></spatial></tendon></mujoco>"""
    sim = sc.Sim(sc.loads(text))
    for forces in (True, False):
        drawn = sc.picture(sim, forces=forces, far=4.0, width=320, height=240).astype(int)
        brick = (drawn[..., 0] > drawn[..., 1] + 60) & (drawn[..., 0] > drawn[..., 2] + 60)
        assert np.count_nonzero(brick.any(axis=1)) > 10


def test_a_picture_changes_nothing():
    sim = sc.Sim(lesson.stack())
    sim.step(10)
    before = sim.state()
    sc.picture(sim, **SMALL)
    assert sim.state() == before


def test_it_is_written(tmp_path):
    from PIL import Image

    drawn = sc.picture(ball(), tmp_path / "ball.png", **SMALL)
    assert np.array_equal(np.asarray(Image.open(tmp_path / "ball.png")), drawn)


def test_a_video_is_as_long_as_the_run(tmp_path):
    import imageio_ffmpeg

    path = tmp_path / "run.mp4"
    sim = sc.Sim(lesson.drop(), dt=0.01)
    sim.reset(key="start")
    sim.run(0.5).save_video(path, fps=10, speed=0.5, **SMALL)
    raw = ["-v", "error", "-i", str(path), "-f", "rawvideo", "-pix_fmt", "rgb24", "-"]
    read = subprocess.run([imageio_ffmpeg.get_ffmpeg_exe(), *raw], capture_output=True, check=True)
    assert read.stderr == b""
    pictures = np.frombuffer(read.stdout, np.uint8).reshape(-1, 120, 160, 3).astype(float)
    assert len(pictures) == 11
    assert np.abs(pictures[0] - pictures[4]).mean() > 0.5


@pytest.mark.parametrize(
    ("given", "said"),
    [
        ({"width": 0}, "width = 0"),
        ({"height": 1e9}, "height = "),
    ],
)
def test_what_cannot_be_drawn_is_refused(given, said):
    with pytest.raises(ValueError, match=said):
        sc.picture(ball(), **given)


@pytest.mark.parametrize("name", ["run.gif", "run", "run.txt"])
def test_a_file_that_cannot_be_written_is_refused_before_it_is_drawn(tmp_path, name):
    path = tmp_path / name
    with pytest.raises(ValueError, match=r"must be a name that ends in .mp4 or .mov or .mkv"):
        ball().run(0.1).save_video(path, **SMALL)
    if not name.endswith(".gif"):
        with pytest.raises(ValueError, match=r"must be a name that ends in .png, .jpg or alike"):
            sc.picture(ball(), path, **SMALL)
    assert not path.exists()


def test_a_video_has_even_sides(tmp_path):
    with pytest.raises(ValueError, match=r"width = 161: must be an even number"):
        ball().run(0.1).save_video(tmp_path / "run.mp4", width=161, height=120)


def test_only_a_sim_has_a_picture():
    with pytest.raises(ValueError, match=r"must be a stepcore\.Sim"):
        sc.picture(lesson.drop())


def test_a_picture_is_drawn_after_mujoco_was_imported():
    """MuJoCo chooses a way to draw when it is imported; without a display it chooses none."""
    code = (
        "import mujoco, stepcore as sc; from stepcore import lesson; "
        "print(sc.picture(sc.Sim(lesson.stack()), width=160, height=120).shape)"
    )
    run = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert run.stdout == "(120, 160, 3)\n"
