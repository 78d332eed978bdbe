"""Judging any task: policies, episodes, statistics, tables, figures, videos and studies."""

from ppt_rl.evaluation.episodes import (
    POWER_AND_WORK,
    REPORTED,
    ZeroPolicy,
    distribution,
    record_episodes,
    run_episodes,
    summarise,
)
from ppt_rl.evaluation.published import is_pretrained, load_pretrained, pretrained_card, save_pretrained

__all__ = [
    "POWER_AND_WORK",
    "REPORTED",
    "ZeroPolicy",
    "distribution",
    "is_pretrained",
    "load_pretrained",
    "pretrained_card",
    "record_episodes",
    "run_episodes",
    "save_pretrained",
    "summarise",
]
