"""Figures that only a study of pushing has: the movement primitive with its via-points, and film strips."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from ppt_rl.evaluation.runs import KeptRun
from ppt_rl.evaluation.seeds import seeds_of
from ppt_rl.evaluation.study_figures import plot_filmstrip, plot_promp
from ppt_rl.evaluation.video import pictures
from ppt_rl.tasks.push.prior import PUSH_AXES

__all__ = ["draw_push_study"]

#: Pictures of a film strip, and the size of each [pixels].
_PICTURES, _SIZE = 6, (480, 360)


def draw_push_study(groups: Mapping[str, Sequence[KeptRun]], directory: Path) -> None:
    """Draw the movement primitive with the via-points of one episode, and film strips of that episode.

    Args:
        groups: finished runs by label.
        directory: target directory.
    """
    strips: dict[str, list[NDArray[np.uint8]]] = {}
    times: list[float] = []
    for label, (run, *_) in groups.items():
        config, task = run.config(), run.recipe.task
        modules = run.recipe.make_modules(config)
        seed, *_ = seeds_of(run.evaluation()["eval_seed"])
        env = task.make_test_env(config, num_envs=task.pictures.rollouts, seed=seed, audit=False)
        episode = env.reset()[0]
        if run.recipe.has_reference and not (directory / "promp.png").exists():
            run.recipe.fit(config, **modules)
            via = {key: episode[key] for key in ("via_phase", "via_position", "via_cov")}
            axes = [f"{axis} [{'rad' if axis == 'yaw' else 'm'}]" for axis in PUSH_AXES]
            plot_promp(modules["promp"], via, directory / "promp.png", labels=axes)
        rollouts = run.rollouts()
        steps = int(rollouts["steps"][0])
        chosen = np.linspace(0, steps - 1, _PICTURES).round().astype(int)
        times = [config.control_dt * (step + 1) for step in chosen]
        positions = np.concatenate([rollouts[key][0] for key in task.pictures.configuration], -1)[chosen]
        try:
            strips[label] = list(pictures(env, 0, positions, camera="close", size=_SIZE))
        except RuntimeError as error:
            print(f"no film strip: {error}")
            return
        finally:
            env.close()
    plot_filmstrip(
        strips, times, directory / "filmstrip.png", "The same episode by each variant, seed 0, deterministic"
    )
