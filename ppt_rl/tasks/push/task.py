"""Box pushing as the evaluation and the studies see it."""

from __future__ import annotations

from dataclasses import replace
from functools import partial
from itertools import product
from typing import Any

from torchrl.envs import TransformedEnv

from ppt_rl.envs import ArmEnv
from ppt_rl.evaluation import Claim, Pictures, Policy, Report, Task, ZeroPolicy
from ppt_rl.tasks.push.config import PushConfig, make_push_env
from ppt_rl.tasks.push.figures import draw_push_episode
from ppt_rl.tasks.push.networks import PRIVILEGED
from ppt_rl.tasks.push.scenarios import MOVABLE, SCENARIOS
from ppt_rl.tasks.push.study_figures import draw_push_study

__all__ = ["PUSH"]

_OTHERS = ("PP", "S", "ST")
#: What the paper says of pushing: PPT compared with the others, then step-wise variants compared with PPT.
_CLAIMS = (
    *(Claim("success", "PPT", other, True) for other in _OTHERS),
    *(Claim("success", "PPT", other, False, spread=True) for other in _OTHERS),
    *(
        Claim(metric, "PPT", other, False)
        for metric, other in product(("max_power", "jerk_rms", "wrench_p95", "overload_ratio"), _OTHERS)
    ),
    *(Claim("contact_continuity", "PPT", other, True) for other in _OTHERS),
    *(Claim("progress", other, "PPT", True) for other in ("S", "ST")),
)


def _naive_reference(policy: Policy, base: ArmEnv) -> tuple[TransformedEnv, ZeroPolicy]:
    """A reference that approaches the box along the line to its goal, however much it still has to turn."""
    base.reference = replace(base.reference, counter_turn=0.0)
    return policy.recipe.on(base, policy.config, policy.modules), ZeroPolicy(policy.actor)


def _boxes(config: PushConfig) -> dict[str, dict[str, Any]]:
    groups: dict[str, dict[str, Any]] = {f"{100 * size:.0f} cm": {"box_sizes": (size,)} for size in config.box_sizes}
    for group, mass in zip(groups.values(), config.box_masses, strict=False):  # by default there are none
        group["box_masses"] = (mass,)
    return groups


PUSH = Task(
    name="push",
    make_training_env=make_push_env,
    make_test_env=make_push_env,
    privileged=PRIVILEGED,
    groups=_boxes,
    references={"naive reference": _naive_reference},
    report=Report(
        episode_keys=("box_size",),
        claims=_CLAIMS,
        compared=("success", "max_power", "jerk_rms", "wrench_p95", "contact_continuity", "progress"),
        boxes={
            "jerk_rms": "jerk RMS [m/s³]",
            "wrench_p95": "P95 force [N]",
            "progress": "progress at T [-]",
            "contact_continuity": "contact continuity [-]",
        },
    ),
    pictures=Pictures(
        configuration=("joint_position", "box_pose"),
        cameras=("overview", "close"),
        draw_episode=draw_push_episode,
        draw_study=draw_push_study,
    ),
    scenarios=SCENARIOS,
    make_movable_env=partial(make_push_env, obstacle=MOVABLE),
)
