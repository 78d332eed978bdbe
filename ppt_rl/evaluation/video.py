"""Videos of recorded episodes."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence
from pathlib import Path
from typing import Any

import imageio.v2 as imageio
import numpy as np
import torch
from imageio_ffmpeg import count_frames_and_secs
from numpy.typing import NDArray
from tensordict import TensorDictBase

from ppt_rl.envs import ArmEnv
from ppt_rl.envs.rendering import require_rendering
from ppt_rl.functional.checks import require_positive

__all__ = ["episode_frames", "pictures", "write_video"]

Image = NDArray[np.uint8]


def episode_frames(
    env: ArmEnv,
    episodes: TensorDictBase,
    rows: Sequence[int],
    configuration: Sequence[str],
    *,
    every: int = 4,
    cameras: Sequence[str] = ("overview", "top"),
    size: tuple[int, int] = (640, 480),
) -> Iterator[Image]:
    """Frames of recorded episodes, cameras side by side.

    Args:
        env: the environment the episodes come from, not reset since: what else is in the scene is taken from it.
        episodes: holds ``control_steps`` and ``("trace", key)``, ``(B, T, n)``, for each key of ``configuration``.
        rows: indices of the environments, filmed one after the other.
        configuration: observations that together are MuJoCo's generalised positions, in order.
        every: control steps between frames.
        cameras: names of cameras, side by side.
        size: width and height of each picture [pixels]; both even.

    Yields:
        ``(height, width * cameras, 3)`` RGB images.

    Raises:
        RuntimeError: if no OpenGL library is found.
    """
    for row in rows:
        steps = int(episodes["control_steps"][row])
        trace = episodes["trace"][row]
        positions = torch.cat([trace[key] for key in configuration], -1).double().numpy()[:steps:every]
        views = [pictures(env, row, positions, camera=camera, size=size) for camera in cameras]
        for frames in zip(*views, strict=True):
            yield np.concatenate(frames, 1)


def pictures(
    env: ArmEnv, row: int, positions: NDArray[np.float64], *, camera: str, size: tuple[int, int] = (640, 480)
) -> Iterator[Image]:
    """Pictures of one environment in given configurations.

    Args:
        env: what else is in the scene is taken from its environment ``row``.
        row: index of the environment.
        positions: ``(N, nq)`` generalised positions.
        camera: name of a camera of the scene.
        size: width and height [pixels].

    Yields:
        ``(height, width, 3)`` RGB images.

    Raises:
        RuntimeError: if no OpenGL library is found.
    """
    require_rendering()
    for position in positions:
        physics = env.physics(row)
        with physics.reset_context():
            physics.data.qpos[:] = position
        yield physics.render(height=size[1], width=size[0], camera_id=camera)


def write_video(path: Path, frames: Iterable[Image], fps: float) -> None:
    """Write an H.264 video atomically.

    Args:
        path: path of the video, ending in ``.mp4``.
        frames: RGB images of one size.
        fps: frames per second.

    Raises:
        ValueError: if ``fps`` is not positive.
        OSError: if it cannot be written to its end.
    """
    require_positive("fps", fps, "frames per second")
    path.parent.mkdir(parents=True, exist_ok=True)
    draft = path.with_name(f".draft-{path.name}")
    writer: Any
    count = 0
    try:
        with imageio.get_writer(draft, fps=fps, codec="libx264", quality=7, macro_block_size=2) as writer:
            for frame in frames:
                writer.append_data(frame)
                count += 1
        _require_frames(draft, count, path)
        draft.replace(path)
    finally:
        draft.unlink(missing_ok=True)


def _require_frames(draft: Path, count: int, path: Path) -> None:
    """Raise unless a video holds all its frames: its writer does not tell that the disk was full."""
    try:
        found = count_frames_and_secs(draft)[0]
    except RuntimeError:
        found = 0
    if found != count:
        raise OSError(f"{path} holds {found} of {count} frames; check that its disk has room, or choose another place.")
