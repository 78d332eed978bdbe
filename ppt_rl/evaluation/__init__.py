"""Judging any task: policies, episodes, statistics, tables, figures, videos and studies."""

from ppt_rl.evaluation.calibration import Calibration, calibrate
from ppt_rl.evaluation.collisions import Collisions, collide
from ppt_rl.evaluation.columns import COLUMNS, POWER_AND_WORK, Column
from ppt_rl.evaluation.difficulty import Sweep, SweepPoint
from ppt_rl.evaluation.disturbed import beside_the_reference
from ppt_rl.evaluation.episodes import ZeroPolicy, record_episodes, run_episodes
from ppt_rl.evaluation.judge import Evaluation, evaluate
from ppt_rl.evaluation.policy import Policy, load_policy
from ppt_rl.evaluation.published import (
    is_pretrained,
    load_pretrained,
    pretrained_card,
    published_policies,
    save_pretrained,
)
from ppt_rl.evaluation.recipe import Recipe, find_recipe, shipped_recipes
from ppt_rl.evaluation.scenario import Scenario
from ppt_rl.evaluation.statistics import Claim, distribution, interval, summarise
from ppt_rl.evaluation.study import Study, find_recipes, run_study
from ppt_rl.evaluation.sweep import run_sweep
from ppt_rl.evaluation.task import Pictures, Report, SecondPass, Task

__all__ = [
    "COLUMNS",
    "POWER_AND_WORK",
    "Calibration",
    "Claim",
    "Collisions",
    "Column",
    "Evaluation",
    "Pictures",
    "Policy",
    "Recipe",
    "Report",
    "Scenario",
    "SecondPass",
    "Study",
    "Sweep",
    "SweepPoint",
    "Task",
    "ZeroPolicy",
    "beside_the_reference",
    "calibrate",
    "collide",
    "distribution",
    "evaluate",
    "find_recipe",
    "find_recipes",
    "interval",
    "is_pretrained",
    "load_policy",
    "load_pretrained",
    "pretrained_card",
    "published_policies",
    "record_episodes",
    "run_episodes",
    "run_study",
    "run_sweep",
    "save_pretrained",
    "shipped_recipes",
    "summarise",
]
