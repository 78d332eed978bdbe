"""What the hooks of a task return, compared with what the environment expects of them."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import torch
from torch import Tensor
from torchrl.data import Composite

__all__ = ["require_observations", "require_over", "require_positions"]


def require_positions(name: str, position: Tensor, rows: int, size: int) -> None:
    """Raise unless ``_begin`` returned the positions of every joint for the rows that begin.

    Args:
        name: of the environment, for the message.
        position: what it returned.
        rows: number R of environments that begin.
        size: number of positions in the compiled model.

    Raises:
        ValueError: if the shape is not ``(R, size)``.
    """
    if position.shape != (rows, size):
        raise ValueError(
            f"{name}._begin returned positions of shape {tuple(position.shape)}; expected ({rows}, {size}): those of "
            "the arm, then those of the joints that _scene adds, in MuJoCo's order."
        )


def require_over(name: str, over: Tensor, num_envs: int) -> None:
    """Raise unless ``_task_over`` returned a flag for each environment.

    Args:
        name: of the environment, for the message.
        over: what it returned.
        num_envs: number of environments.

    Raises:
        ValueError: if it is not bool of shape ``(num_envs, 1)``.
    """
    if over.shape != (num_envs, 1) or over.dtype != torch.bool:
        raise ValueError(
            f"{name}._task_over returned {over.dtype} of shape {tuple(over.shape)}; expected torch.bool of shape "
            f"({num_envs}, 1)."
        )


def require_observations(name: str, hook: str, observation: Mapping[str, Any], spec: Composite) -> None:
    """Raise unless the observations of a hook have the shapes that the task declared.

    Args:
        name: of the environment, for the message.
        hook: which hook returned them.
        observation: by key, nests as mappings.
        spec: declared observations.

    Raises:
        ValueError: if one has another shape or is not declared.
    """
    for key, value in observation.items():
        if key == "reward":
            continue
        if key not in spec.keys():
            known = list(spec.keys())
            raise ValueError(f"{name}.{hook} returned {key!r}; expected what _task_spec declares, among {known}.")
        if isinstance(value, Mapping):
            require_observations(name, hook, value, spec[key])
        elif value.shape != spec[key].shape:
            raise ValueError(
                f"{name}.{hook} returned {key!r} of shape {tuple(value.shape)}; expected {tuple(spec[key].shape)}, as "
                "_task_spec declares it."
            )
