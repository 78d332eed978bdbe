"""Rewards as named groups: the frame that every task shares, and the group that is the same in every task."""

from __future__ import annotations

import functools
import operator
from collections.abc import Mapping, Sequence

import torch
from torch import Tensor
from torchrl.data import Composite

from ppt_rl.envs.specs import SpecMaker
from ppt_rl.functional.constants import constant
from ppt_rl.functional.impedance import power

__all__ = ["REWARD_GROUPS", "reward_spec", "total_reward", "work_penalty", "zero_rewards"]

#: The paper's reward groups (section "Problem Statement"). Each is an entry of its own under ``reward_terms``.
REWARD_GROUPS = ("progress", "free_space", "contact", "power")


def reward_spec(make: SpecMaker, names: Sequence[str] = REWARD_GROUPS) -> Composite:
    """Spec of ``reward_terms``.

    Args:
        make: makes the specs of the environment.
        names: of the groups.

    Returns:
        A composite with one real number per group and environment.
    """
    return make.nest(**{name: make.real(1) for name in names})


def zero_rewards(
    num_envs: int, dtype: torch.dtype, names: Sequence[str] = REWARD_GROUPS, *, device: torch.device | None = None
) -> dict[str, Tensor]:
    """The ``reward_terms`` of a reset, where nothing has been earned yet.

    Args:
        num_envs: number of environments.
        dtype: precision of the rewards.
        names: of the groups.
        device: where they are.

    Returns:
        ``(num_envs, 1)`` zeros by group.
    """
    return {name: torch.zeros(num_envs, 1, dtype=dtype, device=device) for name in names}


def total_reward(terms: Mapping[str, Tensor]) -> Tensor:
    """The reward of a control step: the sum of its groups, added in their order.

    Args:
        terms: ``(B, 1)`` reward of each group by name.

    Returns:
        ``(B, 1)`` reward.
    """
    return functools.reduce(operator.add, terms.values())


def work_penalty(weight: float, *, wrench: Tensor, twist: Tensor, dt: float) -> Tensor:
    r"""The power group: ``-weight |P| dt`` with the measured power ``P = wrench . twist``.

    Work is charged in both directions, so that the arm neither drives energy into the scene nor lets itself be driven.

    Args:
        weight: penalty per unit of work [1/J].
        wrench: ``(B, 6)`` applied by the robot on the world, world axes [N, N m].
        twist: ``(B, 6)`` of the end effector, world axes [m/s, rad/s].
        dt: control step [s].

    Returns:
        ``(B, 1)`` reward, zero or negative.
    """
    work = power(wrench, twist).abs()
    return constant(-weight * dt, work) * work
