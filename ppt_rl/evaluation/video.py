"""Videos of recorded episodes."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any

import imageio.v2 as imageio
import numpy as np
import torch
from numpy.typing import NDArray
from tensordict import TensorDictBase

from ppt_rl.envs import ArmEnv
from ppt_rl.envs.rendering import require_rendering

__all__ = ["episode_frames", "pictures", "write_video"]

Image = NDArray[np.uint8]


def episode_frames(
    env: ArmEnv,
    episodes: TensorDictBase,
    rows: Sequence[int],
    *,
    every: int = 4,
    cameras: Sequence[str] = ("overview", "top"),
    size: tuple[int, int] = (640, 480),
) -> Iterator[Image]:
    """Frames of recorded episodes, cameras side by side.

    Args:
        env: the environment the episodes come from, not reset since: boxes and goals, or mazes, are its present ones.
        episodes: holds ``("trace", "joint_position")`` (B, T, n) and, where there is a box, ``("trace", "box_pose")``
            (B, T, 7).
        rows: which environments.
        every: control steps between frames.
        cameras: which.
        size: width and height of each picture [pixels]; both even.

    Yields:
        ``(height, width * cameras, 3)`` RGB images.

    Raises:
        RuntimeError: if no OpenGL library is found.
    """
    for row in rows:
        steps = int(episodes["control_steps"][row])
        trace = episodes["trace"][row]
        parts = [trace[key] for key in ("joint_position", "box_pose") if key in trace.keys()]
        positions = torch.cat(parts, -1).double().numpy()[:steps:every]
        views = [pictures(env, row, positions, camera=camera, size=size) for camera in cameras]
        for frames in zip(*views, strict=True):
            yield np.concatenate(frames, 1)


def pictures(
    env: ArmEnv, row: int, positions: NDArray[np.float64], *, camera: str, size: tuple[int, int] = (640, 480)
) -> Iterator[Image]:
    """Pictures of one environment in given configurations.

    Args:
        env: its box and goal, or maze, are the present ones of ``row``.
        row: which environment.
        positions: ``(N, nq)`` joint positions, then the box's pose where there is one.
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


def write_video(path: Path, frames: Iterator[Image], fps: float) -> None:
    """Write an H.264 video atomically.

    Args:
        path: ends in ``.mp4``.
        frames: RGB images of one size.
        fps: frames a second.
    """
    path.parent.mkdir(parents=True, exist_ok=True)
    draft = path.with_name(f".draft-{path.name}")
    writer: Any
    with imageio.get_writer(draft, fps=fps, codec="libx264", quality=7, macro_block_size=2) as writer:
        for frame in frames:
            writer.append_data(frame)
    draft.replace(path)
