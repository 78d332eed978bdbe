"""Videos of recorded episodes."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence
from pathlib import Path
from typing import Any

import imageio.v2 as imageio
import numpy as np
import torch
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
    """
    require_positive("fps", fps, "frames per second")
    path.parent.mkdir(parents=True, exist_ok=True)
    draft = path.with_name(f".draft-{path.name}")
    writer: Any
    with imageio.get_writer(draft, fps=fps, codec="libx264", quality=7, macro_block_size=2) as writer:
        for frame in frames:
            writer.append_data(frame)
    draft.replace(path)
