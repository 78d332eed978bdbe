from __future__ import annotations

import numpy as np
import pytest
from imageio_ffmpeg import count_frames_and_secs

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
