"""Environments below a transform that step in workers: torchrl's ``SerialEnv`` and ``ParallelEnv``."""

from __future__ import annotations

from tensordict.utils import expand_as_right
from torch import Tensor
from torchrl.envs import EnvBase
from torchrl.envs.batched_envs import BatchedEnvBase

from ppt_rl.transforms.chain import base_of

__all__ = ["steps_whole_workers", "whole_workers"]


def steps_whole_workers(env: EnvBase) -> bool:
    """Whether an environment steps in workers, each of which holds more than one environment.

    A ``_step`` mask then has to select whole workers.

    Args:
        env: any environment.

    Returns:
        Whether it does.
    """
    return isinstance(base_of(env), BatchedEnvBase) and env.batch_size[1:].numel() > 1


def whole_workers(env: EnvBase, mask: Tensor) -> Tensor:
    """The least mask that contains a given one and that an environment can step by.

    Args:
        env: any environment.
        mask: ``(*B,)`` environments that shall step.

    Returns:
        ``(*B,)`` the mask itself, or the environments of every worker that has one of its environments in the mask.
    """
    return expand_as_right(mask.flatten(1).any(1), mask) if steps_whole_workers(env) else mask
