from __future__ import annotations

import numpy as np
import pytest
from imageio_ffmpeg import count_frames_and_secs
from PIL import Image

from ppt_rl.evaluation import video
from ppt_rl.evaluation.video import write_video


def frames(count):
    return (np.full((32, 48, 3), 20 * index, dtype=np.uint8) for index in range(count))


def test_a_video_holds_its_frames_and_leaves_no_draft(tmp_path):
    write_video(tmp_path / "made" / "a.mp4", frames(7), fps=25.0)
    assert count_frames_and_secs(tmp_path / "made" / "a.mp4")[0] == 7
    assert [path.name for path in (tmp_path / "made").iterdir()] == ["a.mp4"]


@pytest.mark.parametrize("damage", [lambda data: data[: len(data) // 2], lambda data: b""])
def test_a_video_that_a_full_disk_cut_short_is_not_published(tmp_path, monkeypatch, damage):
    (tmp_path / "a.mp4").write_bytes(b"the one before")
    real = video._require_frames

    def cut(draft, count, path):
        draft.write_bytes(damage(draft.read_bytes()))
        real(draft, count, path)

    monkeypatch.setattr(video, "_require_frames", cut)
    with pytest.raises(OSError, match=r"a\.mp4 holds 0 of 7 frames; check that its disk has room"):
        write_video(tmp_path / "a.mp4", frames(7), fps=25.0)
    assert (tmp_path / "a.mp4").read_bytes() == b"the one before"
    assert len(list(tmp_path.iterdir())) == 1


def test_a_gif_holds_its_frames_with_their_colours_for_their_time_and_goes_round(tmp_path):
    write_video(tmp_path / "a.gif", frames(7), fps=25.0)
    with Image.open(tmp_path / "a.gif") as image:
        assert image.n_frames == 7
        assert image.info["loop"] == 0
        for index in range(7):
            image.seek(index)
            assert image.info["duration"] == 40
            assert np.abs(np.asarray(image.convert("RGB")).astype(int) - 20 * index).max() <= 2
    assert [path.name for path in tmp_path.iterdir()] == ["a.gif"]


def test_frames_of_a_gif_that_are_alike_last_longer_instead_of_being_stored_again(tmp_path):
    still = np.full((32, 48, 3), 90, dtype=np.uint8)
    write_video(tmp_path / "a.gif", [*frames(2), still, still, still], fps=10.0)
    with Image.open(tmp_path / "a.gif") as image:
        assert image.n_frames == 3
        image.seek(2)
        assert image.info["duration"] == 300


def test_a_small_patch_keeps_its_colour_in_a_gif(tmp_path):
    generator = np.random.default_rng(0)
    grey = np.repeat(generator.integers(0, 256, (120, 160, 1), dtype=np.uint8), 3, -1)
    grey[:6, :6] = (250, 210, 40)
    write_video(tmp_path / "a.gif", [grey], fps=10.0)
    with Image.open(tmp_path / "a.gif") as image:
        assert np.abs(np.asarray(image.convert("RGB"))[:6, :6].astype(int) - (250, 210, 40)).max() < 20


def test_a_gif_that_a_full_disk_cut_short_is_not_published(tmp_path, monkeypatch):
    real = video._require_frames

    def cut(draft, count, path):
        draft.write_bytes(draft.read_bytes()[:40])
        real(draft, count, path)

    monkeypatch.setattr(video, "_require_frames", cut)
    with pytest.raises(OSError, match=r"a\.gif holds 0 of 7 frames"):
        write_video(tmp_path / "a.gif", frames(7), fps=25.0)
    assert not list(tmp_path.iterdir())


@pytest.mark.parametrize("name", ["a.avi", "a", "a.png"])
def test_a_video_of_another_kind_is_refused(tmp_path, name):
    with pytest.raises(ValueError, match=r"expected the path of a file that ends in \.mp4 or \.gif"):
        write_video(tmp_path / name, frames(2), fps=25.0)
