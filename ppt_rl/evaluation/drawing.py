"""Figures and videos of a policy, from episodes recorded for them."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

from tensordict import TensorDictBase
from tqdm import tqdm

from ppt_rl.envs import ArmEnv
from ppt_rl.evaluation.episodes import record_episodes, require_run_options
from ppt_rl.evaluation.figures import plot_training
from ppt_rl.evaluation.policy import Policy
from ppt_rl.evaluation.video import episode_frames, write_video
from ppt_rl.functional.argument_checks import require_whole

__all__ = ["draw_policy", "film", "require_filmable"]

#: Largest number of episodes in a video.
_MOST = 100


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
    """Write a video of a policy from two cameras.

    Args:
        policy: the policy.
        path: path of the video (.mp4).
        episodes: number of episodes, one after the other.
        seed: seed of the episodes.
        also: called with the bare environment and the recorded episodes before they are filmed.

    Returns:
        A sentence that says where the video is, or why there is none.

    Raises:
        ValueError: if ``episodes`` is not from 1 to 100, or the path does not end in ``.mp4``.
    """
    require_filmable(episodes)
    require_run_options(episodes=episodes, seed=seed)
    if path.suffix != ".mp4":
        raise ValueError(f"the video's path is {path}; expected one that ends in .mp4.")
    env = policy.make_env(episodes, seed=seed, privileged=True)
    pictures = policy.recipe.task.pictures
    recorded = record_episodes(env, policy.actor, policy.recipe.traced)
    try:
        if also is not None:
            also(env.base_env, recorded)
        frames = episode_frames(env.base_env, recorded, range(episodes), pictures.configuration, every=pictures.every)
        shown = tqdm(frames, desc=f"film of {policy.variant}", unit=" frames", disable=None)
        write_video(path, shown, fps=pictures.speed / (pictures.every * policy.config.control_dt))
    except RuntimeError as error:
        return f"no video: {error}"
    finally:
        env.close()
    return f"video in {path}" + ("" if pictures.speed == 1.0 else f", at {pictures.speed:g} times real time")
