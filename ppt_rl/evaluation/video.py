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
from PIL import Image as PillowImage
from tensordict import TensorDictBase

from ppt_rl.envs import ArmEnv
from ppt_rl.envs.rendering import require_rendering
from ppt_rl.evaluation.overlay import Overlay
from ppt_rl.functional.checks import require_positive

__all__ = ["SUFFIXES", "episode_frames", "pictures", "require_video_path", "write_video"]

Image = NDArray[np.uint8]
#: Endings of the names of videos.
SUFFIXES = (".mp4", ".gif")
#: Colours of a GIF.
_COLOURS = 192


def episode_frames(
    env: ArmEnv,
    episodes: TensorDictBase,
    rows: Sequence[int],
    configuration: Sequence[str],
    *,
    every: int = 4,
    cameras: Sequence[str] = ("overview", "top"),
    size: tuple[int, int] = (640, 480),
    overlays: Sequence[Overlay] | None = None,
    pause: int = 0,
) -> Iterator[Image]:
    """Frames of recorded episodes, cameras side by side.

    Args:
        env: the environment the episodes come from, not reset since: what else is in the scene is taken from it.
        episodes: holds ``control_steps`` and ``("trace", key)``, ``(B, T, n)``, for each key of ``configuration``.
        rows: indices of the environments, filmed one after the other.
        configuration: observations that together are MuJoCo's generalised positions, in order.
        every: control steps between frames; the last step is always shown.
        cameras: names of cameras, side by side.
        size: width and height of each picture [pixels]; both even.
        overlays: by row, what is written over the pictures of the first camera; None writes nothing.
        pause: by how many frames the end of each episode is held.

    Yields:
        ``(height, width * cameras, 3)`` RGB images.

    Raises:
        RuntimeError: if no OpenGL library is found.
    """
    for place, row in enumerate(rows):
        steps = int(episodes["control_steps"][row])
        trace = episodes["trace"][row]
        shown = [*range(0, steps - 1, every), steps - 1]
        positions = torch.cat([trace[key] for key in configuration], -1).double().numpy()[shown]
        views = [pictures(env, row, positions, camera=camera, size=size) for camera in cameras]
        for step, (first, *others) in zip(shown, zip(*views, strict=True), strict=True):
            last = step == steps - 1
            if overlays is not None:
                first = overlays[place].on(first, step, last=last)
            frame = np.concatenate([first, *others], 1)
            for _ in range(1 + (pause if last else 0)):
                yield frame


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
    """Write a video atomically: H.264 if its path ends in ``.mp4``, an endless GIF if it ends in ``.gif``.

    Args:
        path: path of the video.
        frames: RGB images of one size.
        fps: frames per second; a GIF's frames last a whole number of hundredths of a second, the nearest.

    Raises:
        ValueError: if ``fps`` is not positive, or the path has another ending.
        OSError: if it cannot be written to its end.
    """
    require_positive("fps", fps, "frames per second")
    require_video_path(path)
    path.parent.mkdir(parents=True, exist_ok=True)
    draft = path.with_name(f".draft-{path.name}")
    try:
        write = _write_gif if path.suffix == ".gif" else _write_mp4
        _require_frames(draft, write(draft, frames, fps), path)
        draft.replace(path)
    finally:
        draft.unlink(missing_ok=True)


def require_video_path(path: Path, name: str = "path") -> None:
    """Raise unless a path is that of a video.

    Args:
        path: the path.
        name: name of the option, for the error message.

    Raises:
        ValueError: if it ends neither in ``.mp4`` nor in ``.gif``, or is a folder.
    """
    if path.suffix not in SUFFIXES or path.is_dir():
        raise ValueError(f"{name} is {path}; expected the path of a file that ends in {' or '.join(SUFFIXES)}.")


def _write_mp4(path: Path, frames: Iterable[Image], fps: float) -> int:
    """Write the frames and return how many there were."""
    count = 0
    writer: Any
    with imageio.get_writer(path, fps=fps, codec="libx264", quality=7, macro_block_size=2) as writer:
        for frame in frames:
            writer.append_data(frame)
            count += 1
    return count


def _write_gif(path: Path, frames: Iterable[Image], fps: float) -> int:
    """Write the frames, all in the same colours, and return how many there were.

    Colours are not dithered, so what does not move is the same in every frame and takes no room. Frames that are alike
    become one that lasts longer.
    """
    kept = list(frames)
    palette = _palette(kept)
    duration = 10 * max(2, round(100 / fps))  # [ms]; browsers slow down what is faster
    images: list[PillowImage.Image] = []
    lasting: list[int] = []
    for frame in kept:
        picture = PillowImage.fromarray(frame).quantize(palette=palette, dither=PillowImage.Dither.NONE)
        if images and picture.tobytes() == images[-1].tobytes():
            lasting[-1] += duration
        else:
            images.append(picture)
            lasting.append(duration)
    if images:
        images[0].save(path, save_all=True, append_images=images[1:], duration=lasting, loop=0, optimize=False)
    return len(images)


def _palette(frames: Sequence[Image]) -> PillowImage.Image:
    """Colours for all frames, from a few of them: half of the frequent ones, half spread over all that occur."""
    chosen = [frames[index][::2, ::2] for index in np.linspace(0, len(frames) - 1, 12).astype(int)] if frames else []
    seen = PillowImage.fromarray(np.concatenate(chosen) if chosen else np.zeros((1, 1, 3), dtype=np.uint8))
    colours: list[int] = []
    for method in (PillowImage.Quantize.MEDIANCUT, PillowImage.Quantize.MAXCOVERAGE):
        colours += (seen.quantize(_COLOURS // 2, method=method).getpalette() or [])[: 3 * _COLOURS // 2]
    palette = PillowImage.new("P", (1, 1))
    palette.putpalette(colours)
    return palette


def _require_frames(draft: Path, count: int, path: Path) -> None:
    """Raise unless a video holds all its frames: its writer does not tell that the disk was full."""
    try:
        if draft.suffix == ".gif":
            with PillowImage.open(draft) as image:
                image.seek(count - 1)
                image.load()
                found = getattr(image, "n_frames", 1)
        else:
            found = count_frames_and_secs(draft)[0]
    except (RuntimeError, OSError, EOFError, ValueError):
        found = 0
    if found != count:
        raise OSError(f"{path} holds {found} of {count} frames; check that its disk has room, or choose another place.")
