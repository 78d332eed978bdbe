"""Figures and videos of a policy, from episodes recorded for them."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import numpy as np
from tensordict import TensorDictBase
from tqdm import tqdm

from ppt_rl.envs import ArmEnv
from ppt_rl.evaluation.episodes import record_episodes, require_run_options
from ppt_rl.evaluation.figures import plot_training
from ppt_rl.evaluation.overlay import Overlay, gauges_of
from ppt_rl.evaluation.policy import Policy
from ppt_rl.evaluation.video import episode_frames, require_video_path, write_video
from ppt_rl.functional.argument_checks import require_whole

__all__ = ["draw_policy", "film", "require_filmable"]

#: Largest number of episodes in a video, and of frames in a GIF; how long the end of an episode is shown [s].
_MOST, _GIF_FRAMES, _PAUSE = 100, 100, 0.8


def require_filmable(episodes: int, name: str = "episodes") -> None:
    """Raise unless a number of episodes fits into a video.

    Args:
        episodes: the number.
        name: name of the option, for the error message.

    Raises:
        ValueError: if it is not from 1 to 100.
    """
    require_whole(name, episodes, 1, _MOST)


def draw_policy(policy: Policy, directory: Path, *, episodes: int, seed: int) -> None:
    """Write the figures of an evaluation: training curves where the run is at hand, one episode, and a video.

    Without an OpenGL library the video alone is left out, with a message.

    Args:
        policy: the policy.
        directory: target directory.
        episodes: number of episodes in the video.
        seed: seed of the episodes.
    """
    run_dir = policy.source if policy.source.is_dir() else policy.source.parent.parent
    if (run_dir / "logs").exists():
        plot_training(
            run_dir, directory / "training.png", p_max=policy.config.p_max if policy.recipe.has_tank else None
        )
    draw_episode = policy.recipe.task.pictures.draw_episode

    def draw(env: ArmEnv, recorded: TensorDictBase) -> None:
        if draw_episode is not None:
            draw_episode(policy, env, recorded[0], directory / "episode.png")

    print(film(policy, directory / f"{policy.variant}.mp4", episodes=episodes, seed=seed, also=draw))


def film(
    policy: Policy,
    path: Path,
    *,
    episodes: int,
    seed: int,
    also: Callable[[ArmEnv, TensorDictBase], None] | None = None,
) -> str:
    """Write a video of a policy, with time, power, tank level and force over it.

    An ``.mp4`` has the cameras of the task side by side, at the full rate. A ``.gif`` has the first camera alone, and
    skips frames until at most 100 are left, so that it stays below 3 MB.

    Args:
        policy: the policy.
        path: path of the video (.mp4 or .gif).
        episodes: number of episodes, one after the other.
        seed: seed of the episodes.
        also: called with the bare environment and the recorded episodes before they are filmed.

    Returns:
        A sentence that says where the video is, or why there is none.

    Raises:
        ValueError: if ``episodes`` is not from 1 to 100, or the path ends neither in ``.mp4`` nor in ``.gif``.
    """
    require_filmable(episodes)
    require_run_options(episodes=episodes, seed=seed)
    require_video_path(path)
    env = policy.make_env(episodes, seed=seed, privileged=True)
    pictures = policy.recipe.task.pictures
    recorded = record_episodes(env, policy.actor, policy.recipe.traced)
    every, cameras = pictures.every, pictures.cameras
    if path.suffix == ".gif":
        every *= -(-int(recorded["control_steps"].sum()) // (every * _GIF_FRAMES))
        cameras = cameras[:1]
    fps = pictures.speed / (every * policy.config.control_dt)
    try:
        if also is not None:
            also(env.base_env, recorded)
        frames = episode_frames(
            env.base_env, recorded, range(episodes), pictures.configuration, every=every, cameras=cameras,
            overlays=_overlays(policy, recorded), pause=round(_PAUSE * fps),
        )  # fmt: skip
        shown = tqdm(frames, desc=f"film of {policy.variant}", unit=" frames", disable=None)
        write_video(path, shown, fps=fps)
    except RuntimeError as error:
        return f"no video: {error}"
    finally:
        env.close()
    return f"video in {path}" + ("" if pictures.speed == 1.0 else f", at {pictures.speed:g} times real time")


def _overlays(policy: Policy, recorded: TensorDictBase) -> list[Overlay]:
    """What is written over each episode; the bars of force have one scale in all of them."""
    config, has_tank = policy.config, policy.recipe.has_tank
    traces = []
    for episode in recorded.unbind(0):
        kept = (key for key in ("power", "tank_energy", "wrench") if key in episode["trace"].keys())
        steps = int(episode["control_steps"])
        traces.append({key: episode["trace", key][:steps].double().numpy() for key in kept})
    top = max((float(np.linalg.norm(t["wrench"][:, :3], axis=-1).max()) for t in traces if "wrench" in t), default=1.0)
    return [
        Overlay(
            gauges_of(
                trace,
                p_max=config.p_max if has_tank else None,
                e_max=config.e_max if has_tank else None,
                top_force=top,
            ),
            config.control_dt,
            ("success", True) if bool(success) else ("missed", False),
        )
        for trace, success in zip(traces, recorded["success"].flatten(), strict=True)
    ]
